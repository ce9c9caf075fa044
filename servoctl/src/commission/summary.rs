//! What the commissioning of many stages comes to, against what is wanted.

use serde::Serialize;
use servo_ident::maxwell;

use super::LEAST_GAIN;
use super::stages::Commissioned;
use crate::table::{MISSING, Table, number};

/// Share of stages that have to succeed, of 1: 48 of 50.
const SUCCEED: f64 = 0.96;
/// Points of a steady loop in each direction, where two are compared.
const LOOP_POINTS: usize = 400;

/// Stages commissioned, and how near to the truth.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Summary {
    /// Seed of the stages and of the noise.
    pub seed: u64,
    /// Stages tried.
    pub tried: usize,
    /// Commissioned to the end.
    pub succeeded: usize,
    /// Ended with the bridge on, in motion, without a report, or with saved parameters that oscillate.
    pub unsafe_ends: usize,
    /// Least gain of NIASA of a stage that succeeded (%).
    pub least_gain_percent: Option<f64>,
    /// Error of σ of a stage with Dahl's model, median and worst (%).
    pub sigma_error_percent: Option<[f64; 2]>,
    /// Error of F_C of a stage with Dahl's model, median and worst (%).
    pub coulomb_error_percent: Option<[f64; 2]>,
    /// Share of the 95 % intervals of σ and F_C, of every profile on a stage with Dahl's model, that contain the truth (%).
    pub covered_percent: Option<[f64; 2]>,
    /// Number of these intervals of each.
    pub intervals: usize,
    /// Stages whose model of friction was told, and of these those where it was the right one.
    pub models_told: [usize; 2],
    /// Fitted loop against the true one of a stage with parallel elements, in F_C, median and worst of the profiles (% rms).
    pub loop_error_percent: Option<[f64; 2]>,
}

/// Stages and what they come to.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Many {
    /// All together.
    pub summary: Summary,
    /// Each of them.
    pub stages: Vec<Commissioned>,
}

impl Commissioned {
    /// Fitted loop against the true one over the motion of each profile, in F_C (rms share of 1); none for Dahl's model.
    pub fn loop_errors(&self) -> Vec<f64> {
        let truth = &self.true_elements;
        let of = |profile: &super::ProfileFit| {
            let [fitted_n, true_n] = [&profile.elements, truth]
                .map(|elements| maxwell::steady_loop_n(elements, 0.5 * profile.span_m, LOOP_POINTS));
            let square_n2: f64 = fitted_n.iter().zip(&true_n).map(|(a, b)| (a - b) * (a - b)).sum();
            (square_n2 / fitted_n.len() as f64).sqrt() / self.true_coulomb_n
        };
        self.found.profiles.iter().filter(|_| !truth.is_empty()).map(of).collect()
    }

    fn is_dahl(&self) -> bool {
        self.true_elements.is_empty()
    }
}

impl Many {
    /// The stages drawn from `seed`, and what they come to.
    pub fn new(seed: u64, stages: Vec<Commissioned>) -> Many {
        let good = || stages.iter().filter(|c| c.ended.is_none());
        let dahl = || stages.iter().filter(|c| c.is_dahl());
        let errors = |of: fn(&Commissioned) -> Option<f64>| median_and_worst(dahl().filter_map(of).collect());
        let intervals = dahl().flat_map(|c| c.found.profiles.iter().map(move |profile| (c, profile)));
        let inside: Vec<[bool; 2]> = intervals
            .map(|(c, profile)| {
                let within = |[low, high]: [f64; 2], value: f64| (low..=high).contains(&value);
                let sigma = within(profile.sigma_ci95_n_per_m, c.true_sigma_n_per_m);
                [sigma, within(profile.coulomb_ci95_n, c.true_coulomb_n)]
            })
            .collect();
        let share = |which: usize| 100.0 * inside.iter().filter(|i| i[which]).count() as f64 / inside.len() as f64;
        let told: Vec<bool> =
            stages.iter().filter_map(|c| c.found.needs_maxwell.map(|needed| needed != c.is_dahl())).collect();
        let loops = stages.iter().flat_map(Commissioned::loop_errors).map(|error| 100.0 * error).collect();
        let summary = Summary {
            seed,
            tried: stages.len(),
            succeeded: good().count(),
            unsafe_ends: stages.iter().filter(|c| c.unsafe_end.is_some()).count(),
            least_gain_percent: good().filter_map(|c| c.found.gain()).map(|gain| 100.0 * gain).reduce(f64::min),
            sigma_error_percent: errors(|c| percent(c.found.sigma_n_per_m, c.true_sigma_n_per_m)),
            coulomb_error_percent: errors(|c| percent(c.found.coulomb_n, c.true_coulomb_n)),
            covered_percent: (!inside.is_empty()).then(|| [share(0), share(1)]),
            intervals: inside.len(),
            models_told: [told.len(), told.iter().filter(|right| **right).count()],
            loop_error_percent: median_and_worst(loops),
        };
        Many { summary, stages }
    }

    /// A line for each stage, then what they come to.
    pub fn to_text(&self) -> String {
        let header = [
            "stage",
            "model",
            "mass / kg",
            "σ / N/µm",
            "F_C / N",
            "mass / %",
            "σ / %",
            "F_C / %",
            "loop / % of F_C",
            "without / ms",
            "NIASA / ms",
            "less / %",
            "ended",
        ];
        let caption = "Commissioning of simulated stages: errors against the truth, settling of 5 mm moves at 1 m/s² to ±10 nm (1 s where later)";
        let table = self.stages.iter().fold(Table::new(caption.to_owned(), &header), |table, c| table.row(row(c)));
        table.to_text() + &self.summary.to_text()
    }
}

fn row(c: &Commissioned) -> [String; 13] {
    let found = &c.found;
    let show = |value: Option<f64>, decimals: usize| value.map_or_else(|| MISSING.to_owned(), |v| number(v, decimals));
    // σ and F_C are those of Dahl's curve: other elements have none.
    let like_dahl = c.model != "Gms";
    let friction = |found, truth| show(percent(found, truth).filter(|_| like_dahl), 2);
    let settled = found.settled.as_ref().map(|settled| [settled[0].mean_ms, settled[1].mean_ms]);
    [
        c.name.clone(),
        c.model.clone(),
        number(c.true_mass_kg, 2),
        number(c.true_sigma_n_per_m * 1e-6, 2),
        number(c.true_coulomb_n, 2),
        show(percent(found.mass_kg, c.true_mass_kg), 2),
        friction(found.sigma_n_per_m, c.true_sigma_n_per_m),
        friction(found.coulomb_n, c.true_coulomb_n),
        show(c.loop_errors().into_iter().reduce(f64::max).map(|worst| 100.0 * worst), 1),
        show(settled.map(|ms| ms[0]), 0),
        show(settled.map(|ms| ms[1]), 0),
        show(found.gain().map(|gain| 100.0 * gain), 0),
        ended(c),
    ]
}

fn ended(c: &Commissioned) -> String {
    let refused = c.ended.iter().map(|(step, why)| format!("{step:?}: {why}"));
    let parts: Vec<String> = refused.chain(c.unsafe_end.iter().map(|why| format!("UNSAFE: {why}"))).collect();
    parts.join("; ")
}

impl Summary {
    /// Whether none ended unsafely and at least 96 % succeeded.
    pub fn is_good(&self) -> bool {
        self.unsafe_ends == 0 && self.succeeded as f64 >= SUCCEED * self.tried as f64
    }

    /// In words.
    pub fn to_text(&self) -> String {
        let pair = |name: &str, values: Option<[f64; 2]>| {
            values.map_or_else(String::new, |[median, worst]| {
                format!("{name}: median {median:.2} %, worst {worst:.2} %\n")
            })
        };
        let mut text = format!(
            "{} of {} stages commissioned (seed {}); {} ended unsafely; ",
            self.succeeded, self.tried, self.seed, self.unsafe_ends
        );
        if let Some(least) = self.least_gain_percent {
            text += &format!("NIASA {least:.0} % less at least, {:.0} % wanted", 100.0 * LEAST_GAIN);
        }
        text += "\n";
        text += &pair("σ of Dahl's model", self.sigma_error_percent);
        text += &pair("F_C of Dahl's model", self.coulomb_error_percent);
        if let Some([sigma, coulomb]) = self.covered_percent {
            text += &format!(
                "95 % intervals that contain the truth: σ {sigma:.0} %, F_C {coulomb:.0} % of {} each\n",
                self.intervals
            );
        }
        text += &pair("Maxwell slip's loop, rms in F_C", self.loop_error_percent);
        let [told, right] = self.models_told;
        text + &format!("Dahl's model or Maxwell slip: the right one on {right} of {told} stages\n")
    }
}

fn percent(found: Option<f64>, truth: f64) -> Option<f64> {
    found.map(|value| 100.0 * (value / truth - 1.0))
}

/// Median and largest of the sizes.
fn median_and_worst(values: Vec<f64>) -> Option<[f64; 2]> {
    let mut sizes: Vec<f64> = values.into_iter().map(f64::abs).collect();
    sizes.sort_by(f64::total_cmp);
    Some([*sizes.get(sizes.len() / 2)?, *sizes.last()?])
}
