//! The settling experiments of the thesis as campaigns: what is compared with what.

use serde::{Deserialize, Serialize};
use servo_core::cascade::{CascadeGains, ParallelGains};
use servo_core::config::Compensator;
use servo_core::parameters::Settings;
use servo_core::refusal::Refusal;
use servo_host_tests::experiment::Steps;
use servo_host_tests::tuning::{self, HIGH_PERFORMANCE, STANDARD, Tuning};
use servo_sim::Stage;

use super::campaign::{Campaign, Watch};
use super::compensators::{self, Search};
use super::pass::Case;
use super::sensitivity;
use crate::settling::TOLERANCES_NM;

/// The settling experiments.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Experiment {
    /// First experiment (9.1): 5 mm at 1 m/s², PID 100 Hz / 45° without feedforward.
    Exp1,
    /// Second experiment (9.2): 5 mm at 10 m/s², PID 315 Hz / 50° with acceleration feedforward.
    Exp2,
    /// 5 µm steps (9.4), both tunings.
    #[serde(rename = "step-5um")]
    Step5Um,
    /// 50 nm steps (9.4), both tunings.
    #[serde(rename = "step-50nm")]
    Step50Nm,
    /// In-position noise (9.3, table 3), both tunings.
    InPosition,
    /// Every compensator on the moves of the first experiment, each tuned first (chapter 4).
    Compensators,
    /// NIASA's parameters one by one, and stages that are not what the model says (8.1, 7.4).
    Sensitivity,
}

/// What to compute: all that a result depends on, besides the program.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Request {
    /// The experiment.
    pub experiment: Experiment,
    /// Moves per configuration.
    pub moves: u64,
    /// Seed of every random number.
    pub seed: u64,
    /// Errors of the feedforward mass, %, one run each; only the second experiment looks at them.
    pub mass_errors_percent: Vec<f64>,
    /// The simulated hardware.
    pub stage: Stage,
}

/// An experiment ready to run: cases, and which of them are compared.
#[derive(Debug, Clone, PartialEq)]
pub struct Plan {
    /// What was asked for.
    pub request: Request,
    /// The work.
    pub campaign: Campaign,
    /// The comparisons, in the order in which they are reported.
    pub comparisons: Vec<Comparison>,
    /// How the cases were tuned, where they were.
    pub search: Option<Search>,
}

/// Configurations that are compared, baseline first.
#[derive(Debug, Clone, PartialEq)]
pub struct Comparison {
    /// Short name, for example `mass error -1 %`; empty if it is the only one.
    pub name: String,
    /// The tuning in words.
    pub tuning: String,
    /// What the gains were computed for.
    pub tuned_for: Tuning,
    /// Error of the feedforward mass, %, where it was varied.
    pub mass_error_percent: Option<f64>,
    /// Indices of the campaign's cases.
    pub cases: Vec<usize>,
}

/// Steps of the second experiment.
pub const FIVE_MM_FAST: Steps = Steps { step_m: 5e-3, acceleration_m_per_s2: 10.0, dwell_s: 1.5 };
/// Steps of the first experiment. PID alone creeps over the last nanometres for seconds.
pub const FIVE_MM_SLOW: Steps = Steps { dwell_s: 4.0, ..servo_host_tests::experiment::FIVE_MM_SLOW };
/// Steps just beyond pre-rolling.
pub const FIVE_UM: Steps = Steps { step_m: 5e-6, acceleration_m_per_s2: 0.1, dwell_s: 2.0 };
/// Steps inside pre-rolling.
pub const FIFTY_NM: Steps = Steps { step_m: 50e-9, acceleration_m_per_s2: 1e-3, dwell_s: 2.0 };

/// Mass errors of the second experiment if none are given, %.
pub const MASS_ERRORS_PERCENT: [f64; 5] = [-2.0, -1.0, 0.0, 1.0, 2.0];

impl Experiment {
    /// Section of the thesis.
    pub fn section(self) -> &'static str {
        match self {
            Experiment::Exp1 => "9.1",
            Experiment::Exp2 => "9.2",
            Experiment::InPosition => "9.3",
            Experiment::Step5Um | Experiment::Step50Nm => "9.4",
            Experiment::Compensators => "4.2",
            Experiment::Sensitivity => "7.4, 8.1",
        }
    }

    /// Name as typed.
    pub fn name(self) -> &'static str {
        match self {
            Experiment::Exp1 => "exp1",
            Experiment::Exp2 => "exp2",
            Experiment::Step5Um => "step-5um",
            Experiment::Step50Nm => "step-50nm",
            Experiment::InPosition => "in-position",
            Experiment::Compensators => "compensators",
            Experiment::Sensitivity => "sensitivity",
        }
    }

    /// Travel that its five steps up and back need, m.
    pub fn travel_m(self) -> f64 {
        let steps = match self {
            Experiment::Step5Um => FIVE_UM,
            Experiment::Step50Nm => FIFTY_NM,
            _ => FIVE_MM_SLOW,
        };
        5.0 * steps.step_m
    }

    /// Moves per configuration if nothing else is asked for: those of the thesis where it has the experiment.
    pub fn moves(self) -> u64 {
        match self {
            Experiment::Exp1 | Experiment::InPosition => 250,
            Experiment::Compensators | Experiment::Sensitivity => 100,
            _ => 500,
        }
    }
}

impl Request {
    /// The plan of this request.
    ///
    /// # Errors
    /// A stage that the drive's parameters cannot describe.
    pub fn plan(&self) -> Result<Plan, Refusal> {
        self.plan_watched(Watch::NOBODY)
    }

    /// The same; `watch` hears of each candidate that [`compensators::search`] tries.
    ///
    /// # Errors
    /// As for [`Request::plan`].
    pub fn plan_watched(&self, watch: Watch) -> Result<Plan, Refusal> {
        let campaign = Campaign { seed: self.seed, moves: self.moves, cases: Vec::new() };
        let mut plan = Plan { request: self.clone(), campaign, comparisons: Vec::new(), search: None };
        match self.experiment {
            Experiment::Exp1 => {
                let settings = tuning::settings(&self.stage, &STANDARD)?;
                let cases = plan.pid_and_niasa(settings, FIVE_MM_SLOW, &TOLERANCES_NM);
                plan.compare("", STANDARD, None, &cases);
            }
            Experiment::Exp2 => {
                for &percent in &self.mass_errors_percent {
                    let tuned_for = Tuning { feedforward: 1.0 + percent / 100.0, ..HIGH_PERFORMANCE };
                    let settings = tuning::settings(&self.stage, &tuned_for)?;
                    let cases = plan.pid_and_niasa(settings, FIVE_MM_FAST, &TOLERANCES_NM);
                    let signed = if percent == 0.0 { "0".to_owned() } else { format!("{percent:+}") };
                    plan.compare(&format!("mass error {signed} %"), tuned_for, Some(percent), &cases);
                }
            }
            Experiment::Step5Um => plan.both_tunings(FIVE_UM, FIVE_UM, &[3, 5, 10, 20, 50])?,
            Experiment::Step50Nm => plan.both_tunings(FIFTY_NM, FIFTY_NM, &[3, 4, 5, 6, 7, 8, 9, 10])?,
            Experiment::InPosition => plan.both_tunings(FIVE_MM_SLOW, FIVE_MM_FAST, &TOLERANCES_NM)?,
            Experiment::Compensators => {
                let search = compensators::search(self, watch)?;
                let cases: Vec<usize> = search
                    .tuned
                    .iter()
                    .map(|tuned| (tuned.name, tuned.settings))
                    .chain(compensators::without_dead_band(&search))
                    .map(|(name, settings)| plan.case(name, self.stage, settings, FIVE_MM_SLOW, &TOLERANCES_NM))
                    .collect();
                plan.compare("", STANDARD, None, &cases);
                plan.search = Some(search);
            }
            Experiment::Sensitivity => sensitivity::plan(&mut plan)?,
        }
        Ok(plan)
    }
}

impl Plan {
    /// Adds a case, unless it is there, and gives its index.
    pub(super) fn case(
        &mut self,
        name: &str,
        stage: Stage,
        settings: Settings,
        steps: Steps,
        tolerances_nm: &[u32],
    ) -> usize {
        let case = Case { name: name.to_owned(), stage, settings, steps, tolerances_nm: tolerances_nm.to_vec() };
        let cases = &mut self.campaign.cases;
        cases.iter().position(|known| *known == case).unwrap_or_else(|| {
            cases.push(case);
            cases.len() - 1
        })
    }

    /// The same with only the named configurations beside each comparison's baseline, which stays.
    ///
    /// # Errors
    /// A name that no configuration has, with the names that there are.
    pub fn only(mut self, names: &[String]) -> Result<Plan, String> {
        let cases = std::mem::take(&mut self.campaign.cases);
        if let Some(unknown) = names.iter().find(|name| cases.iter().all(|case| case.name != **name)) {
            let mut known: Vec<&str> = Vec::new();
            for case in &cases {
                if !known.contains(&case.name.as_str()) {
                    known.push(&case.name);
                }
            }
            return Err(format!("configs: {unknown} is not one of {}", known.join(", ")));
        }
        for comparison in &mut self.comparisons {
            let baseline = comparison.cases[0];
            comparison.cases.retain(|case| *case == baseline || names.contains(&cases[*case].name));
            for index in &mut comparison.cases {
                let case = &cases[*index];
                let kept = &mut self.campaign.cases;
                *index = kept.iter().position(|known| known == case).unwrap_or_else(|| {
                    kept.push(case.clone());
                    kept.len() - 1
                });
            }
        }
        Ok(self)
    }

    /// PID; with NIASA as the thesis' experiments had it (App. E); with NIASA as the drive has it by default (7.55).
    fn pid_and_niasa(&mut self, settings: Settings, steps: Steps, tolerances_nm: &[u32]) -> [usize; 3] {
        let (stage, niasa) = (self.request.stage, with(settings, Compensator::Niasa));
        [
            self.case("pid", stage, settings, steps, tolerances_nm),
            self.case("pid+niasa", stage, appendix_e(niasa), steps, tolerances_nm),
            self.case("pid+niasa-7.55", stage, niasa, steps, tolerances_nm),
        ]
    }

    pub(super) fn compare(&mut self, name: &str, tuned_for: Tuning, mass_error_percent: Option<f64>, cases: &[usize]) {
        self.comparisons.push(Comparison {
            name: name.to_owned(),
            tuning: in_words(&tuned_for),
            tuned_for,
            mass_error_percent,
            cases: cases.to_vec(),
        });
    }

    /// One comparison per tuning of the thesis.
    fn both_tunings(&mut self, standard: Steps, high_performance: Steps, tolerances_nm: &[u32]) -> Result<(), Refusal> {
        for (name, tuned_for, steps) in
            [("standard", STANDARD, standard), ("high performance", HIGH_PERFORMANCE, high_performance)]
        {
            let settings = tuning::settings(&self.request.stage, &tuned_for)?;
            let cases = self.pid_and_niasa(settings, steps, tolerances_nm);
            self.compare(name, tuned_for, None, &cases);
        }
        Ok(())
    }
}

/// Settings with a compensator chosen.
pub fn with(settings: Settings, compensator: Compensator) -> Settings {
    Settings { compensator: f64::from(compensator as u8), ..settings }
}

/// NIASA as appendix E of the thesis ends: the slope alone, beside the linear integral, always active.
pub fn appendix_e(settings: Settings) -> Settings {
    Settings { niasa_with_proportional: 0.0, niasa_frozen_in_profile: 0.0, ..settings }
}

/// The parallel gains in `settings`.
pub fn gains(settings: &Settings) -> ParallelGains {
    let cascade = CascadeGains {
        position_per_s: settings.position_gain_per_s,
        velocity_n_s_per_m: settings.velocity_gain_n_s_per_m,
        integral_per_s: settings.velocity_integral_per_s,
    };
    cascade.to_parallel()
}

fn in_words(tuning: &Tuning) -> String {
    let feedforward = match tuning.feedforward {
        0.0 => "no feedforward".to_owned(),
        1.0 => "acceleration feedforward".to_owned(),
        share => format!("acceleration feedforward {:+.1} %", (share - 1.0) * 100.0),
    };
    format!("{} Hz / {}°, {feedforward}", tuning.crossover_hz, tuning.phase_margin_deg)
}
