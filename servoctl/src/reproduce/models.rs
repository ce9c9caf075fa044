//! Friction models fitted to the same oscillation (2.1 to 2.5, figures 4 to 10).

use std::sync::atomic::Ordering;

use rayon::prelude::*;
use serde::Serialize;
use servo_sim::friction::curves::{self, FIGURES_5_TO_10, Fit, Motion};

use super::campaign::Watch;
use crate::settling::round_to;
use crate::table::{Table, number};

/// Where these numbers come from: the thesis' own data are not printed.
pub const ORIGIN: &str = "simulated: the eight elements of table 4 stand for the measured stage";

/// Figures 4 to 10.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Models {
    /// Name as typed.
    pub experiment: &'static str,
    /// Section of the thesis.
    pub thesis_section: &'static str,
    /// Where the numbers come from.
    pub origin: &'static str,
    /// Whether every model was fitted.
    pub complete: bool,
    /// Figure 4.
    pub motion: Curve,
    /// Figures 5 to 10.
    pub fits: Vec<Model>,
}

/// The oscillation of figure 4, and the friction along it.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Curve {
    /// Time (s).
    pub time_s: Vec<f64>,
    /// Displacement (m).
    pub position_m: Vec<f64>,
    /// Friction force (N).
    pub force_n: Vec<f64>,
    /// Root mean square of the force (N).
    pub force_rms_n: f64,
}

/// A model fitted to it.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Model {
    /// Number of the figure in the thesis.
    pub figure: u32,
    /// Name of the model.
    pub name: &'static str,
    /// Fitted parameters: name as in the stage file, value in SI units.
    pub parameters: Vec<(String, f64)>,
    /// Root mean square of what the model leaves (N).
    pub rms_n: f64,
    /// The same in percent of the force.
    pub rms_percent: f64,
    /// Force of the model, one value for each sample of the motion (N).
    pub force_n: Vec<f64>,
}

/// Number of fits, for progress.
pub const FITS: u64 = FIGURES_5_TO_10.len() as u64;

/// Computes figure 4 and fits the models. Ended from outside, it has those that are fitted.
pub fn run(watch: Watch) -> Models {
    let motion = curves::figure_4();
    let force_rms_n = libm::sqrt(motion.force_n.iter().map(|f| f * f).sum::<f64>() / motion.force_n.len() as f64);
    let fit = |fit: &fn(&Motion) -> Fit| {
        let found = (!watch.stop.load(Ordering::Relaxed)).then(|| Model::new(fit(&motion), force_rms_n));
        (watch.finished)(1);
        found
    };
    let fits: Vec<Option<Model>> = FIGURES_5_TO_10.par_iter().with_max_len(1).map(fit).collect();
    Models {
        experiment: "models",
        thesis_section: "2.1 to 2.5",
        origin: ORIGIN,
        complete: fits.iter().all(Option::is_some),
        fits: fits.into_iter().flatten().collect(),
        motion: Curve::new(&motion, force_rms_n),
    }
}

/// A number with four digits or so.
fn short(value: f64) -> String {
    if value.abs() >= 1e4 { format!("{value:.3e}") } else { format!("{value:.3}") }
}

fn rounded(values: &[f64], decimals: i32) -> Vec<f64> {
    values.iter().map(|v| round_to(*v, decimals)).collect()
}

impl Curve {
    fn new(motion: &Motion, force_rms_n: f64) -> Curve {
        Curve {
            time_s: rounded(&motion.time_s, 6),
            position_m: rounded(&motion.position_m, 12),
            force_n: rounded(&motion.force_n, 6),
            force_rms_n: round_to(force_rms_n, 6),
        }
    }
}

impl Model {
    fn new(fit: Fit, force_rms_n: f64) -> Model {
        Model {
            figure: fit.figure,
            name: fit.name,
            parameters: fit.parameters,
            rms_n: round_to(fit.rms_n, 6),
            rms_percent: round_to(100.0 * fit.rms_n / force_rms_n, 3),
            force_n: rounded(&fit.force_n, 6),
        }
    }
}

impl Models {
    /// The table for a terminal.
    pub fn to_text(&self) -> String {
        let unfinished = (!self.complete).then(|| format!("\nNot complete: {} of {FITS} fits.\n", self.fits.len()));
        self.table().to_text() + &unfinished.unwrap_or_default()
    }

    /// How near each model comes.
    pub fn table(&self) -> Table {
        let caption = format!(
            "Friction models fitted by least squares to a decaying oscillation of {} µm and {} Hz (figures 4 to 10): {ORIGIN}; rms \
             of the force {} N",
            curves::AMPLITUDE_M * 1e6,
            curves::FREQUENCY_HZ,
            number(self.motion.force_rms_n, 3)
        );
        let header = ["model", "parameters", "figure", "left over / mN rms", "of the force"];
        let table = Table { text_columns: 2, ..Table::new(caption, &header) };
        self.fits.iter().fold(table, |table, fit| {
            // Eight elements have sixteen numbers: those are for the JSON.
            let parameters = match fit.parameters.len() {
                0..=4 => {
                    fit.parameters.iter().map(|(name, value)| format!("{name} {}", short(*value))).collect::<Vec<_>>()
                }
                many => vec![format!("{} elements", many / 2)],
            };
            table.row([
                fit.name.to_owned(),
                parameters.join(", "),
                fit.figure.to_string(),
                number(fit.rms_n * 1e3, 1),
                format!("{} %", number(fit.rms_percent, 1)),
            ])
        })
    }
}
