//! What an experiment gave: statistics, tables, JSON.

mod json;

use serde::Serialize;
use servo_core::SERVO_HZ;
use servo_core::compensator::Compensator;
use servo_core::fault::Fault;
use servo_core::fingerprint::Fingerprint;
use servo_core::parameters::Settings;
use servo_sim::Stage;

use super::campaign::Passes;
use super::claims::{self, Claim};
use super::compensators::Search;
use super::experiments::{Comparison, Experiment, Plan, gains};
use super::pass::{Case, MoveResult, Squares};
use super::words::{length, plant};
use crate::settling::{Config, SettlingExperiment, reduction_percent, round_to};
use crate::table::{Conditions, MISSING, Table, number, settling_table};

/// Where every number of these experiments comes from.
pub const ORIGIN: &str = "simulated (drive of servo-core on the carriage of servo-sim)";

/// An experiment's result, as it is printed and written.
#[derive(Debug, Clone, PartialEq)]
pub struct Outcome {
    /// Name as typed.
    pub experiment: String,
    /// Section of the thesis.
    pub thesis_section: String,
    /// Where the numbers come from.
    pub origin: String,
    /// Seed of every random number.
    pub seed: u64,
    /// Moves per configuration that were asked for.
    pub moves_requested: u64,
    /// Whether all of them were made.
    pub complete: bool,
    /// Fingerprint of every move's result: the same on any computer, in debug and release.
    pub results_hash: String,
    /// How the configurations were tuned, where they were.
    pub search: Option<Search>,
    /// What the thesis says of the compensators, and what was found.
    pub claims: Vec<Claim>,
    /// The only comparison; in JSON its fields stand at this level.
    pub only: Option<Run>,
    /// The comparisons of an experiment with several tunings or mass errors; in JSON each says for itself what it is a part of.
    pub runs: Vec<Run>,
}

/// One comparison of configurations.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Run {
    /// Name within the experiment; empty if it is the only one.
    pub name: String,
    /// Settling times: moves, tolerances, configurations, reduction of the second against the first.
    #[serde(flatten, serialize_with = "json::without_configs")]
    pub settling: SettlingExperiment,
    /// The configurations with what belongs to them.
    pub configs: Vec<ConfigOutcome>,
    /// The tuning of the position loop.
    pub tuning: TuningOutcome,
    /// The move.
    pub step: StepOutcome,
    /// The simulated hardware.
    pub plant: Stage,
}

/// One configuration.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ConfigOutcome {
    /// Settling times and their statistics.
    #[serde(flatten)]
    pub settling: Config,
    /// Reduction of the mean settling time against the first configuration, per tolerance (%).
    pub reduction_percent: Vec<Option<f64>>,
    /// What acts beside the PID.
    pub compensator: String,
    /// Moves lost to a fault of the drive.
    pub faults: usize,
    /// The first of them: number and name.
    pub first_fault: Option<String>,
    /// Root mean square of the position error while the profile moves (nm).
    pub tracking_rms_nm: Option<f64>,
    /// Root mean square of the position error when the profile ends (nm).
    pub end_error_rms_nm: Option<f64>,
    /// Root mean square of the error in the 500 ms after settling to the finest tolerance (nm): what is left of the creep is in
    /// it. The `in_position_rms_nm` beside it is of the last 500 ms of the dwell.
    pub after_settling_rms_nm: Option<f64>,
    /// Error that stays: root mean square over the moves of each one's mean in the last 500 ms of the dwell, settled or not (nm).
    pub steady_error_nm: Option<f64>,
    /// Unrest that stays: standard deviation about those means (nm).
    pub restless_nm: Option<f64>,
    /// Every parameter of the drive.
    #[serde(serialize_with = "json::by_name")]
    pub parameters: Settings,
}

/// A tuning, and what it leaves to settle.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct TuningOutcome {
    /// In words.
    pub name: String,
    /// Crossover frequency on the free mass (Hz).
    pub crossover_hz: f64,
    /// Phase margin there (°).
    pub phase_margin_deg: f64,
    /// k_P (N/m).
    pub kp_n_per_m: f64,
    /// k_I (N/(m s)).
    pub ki_n_per_m_s: f64,
    /// k_D (N s/m).
    pub kd_n_s_per_m: f64,
    /// Error of the feedforward mass (%), where it was varied.
    pub feedforward_mass_error_percent: Option<f64>,
    /// Force that the loop, not the feedforward, holds while the stage brakes: (m − m_ff)·a (N). When the profile ends, it is
    /// too much by this.
    pub terminal_force_n: f64,
    /// The same as a share of F_C.
    pub terminal_force_per_coulomb: f64,
}

/// A kind of move.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct StepOutcome {
    /// Length (m).
    pub length_m: f64,
    /// Acceleration (m/s²).
    pub acceleration_m_per_s2: f64,
    /// Length of the profile (ms).
    pub profile_ms: f64,
    /// Time after the profile (s).
    pub dwell_s: f64,
}

impl Outcome {
    /// The statistics of finished passes.
    pub fn new(plan: &Plan, passes: &Passes) -> Outcome {
        let run = |comparison: &Comparison| {
            let cases: Vec<&Case> = comparison.cases.iter().map(|case| &plan.campaign.cases[*case]).collect();
            let moves = comparison.cases.iter().map(|case| passes.values().flat_map(|p| &p[*case]).collect()).collect();
            Run::new(comparison, &cases, moves)
        };
        let mut runs: Vec<Run> = plan.comparisons.iter().map(run).collect();
        let only = match plan.comparisons.as_slice() {
            [one] if one.name.is_empty() => runs.pop(),
            _ => None,
        };
        let claims = match (plan.request.experiment, &only) {
            (Experiment::Compensators, Some(run)) if !passes.is_empty() => claims::of(run),
            _ => Vec::new(),
        };
        Outcome {
            experiment: plan.request.experiment.name().to_owned(),
            thesis_section: plan.request.experiment.section().to_owned(),
            origin: ORIGIN.to_owned(),
            seed: plan.request.seed,
            moves_requested: plan.request.moves,
            complete: passes.len() as u64 == plan.campaign.passes(),
            results_hash: results_hash(passes),
            search: plan.search.clone(),
            claims,
            only,
            runs,
        }
    }

    /// All comparisons.
    pub fn all(&self) -> impl Iterator<Item = &Run> {
        self.only.iter().chain(&self.runs)
    }

    /// The tables for a terminal.
    pub fn to_text(&self) -> String {
        let mut text: String = self.search.iter().map(|search| search.table().to_text() + "\n").collect();
        let made = self.all().next().map_or(0, |run| run.settling.moves);
        if made == 0 {
            return text + "Not complete: ended before the first moves were finished.\n";
        }
        text.extend(self.all().map(|run| run.table().to_text() + "\n"));
        text += &self.configurations().to_text();
        if !self.claims.is_empty() {
            text += &format!("\n{}", claims::table(&self.claims).to_text());
        }
        for run in self.all() {
            text.extend(run.configs.iter().filter_map(|config| {
                let fault = config.first_fault.as_ref()?;
                Some(format!("{}: {} of {made} moves lost to {fault}\n", config.settling.name, config.faults))
            }));
        }
        text += &format!("Results {}\n", self.results_hash);
        if !self.complete {
            text += &format!("\nNot complete: {made} of {} moves per configuration.\n", self.moves_requested);
        }
        text
    }

    /// What the settling tables do not show: error at the end of the profile, in position, and the force that is left over.
    pub fn configurations(&self) -> Table {
        let caption = format!(
            "{} {}, seed {}: rms of the position error while moving, at the end of the profile, in the 500 ms after settling to \
             the finest tolerance and in position (last 500 ms of the dwell of the moves that settled); of all moves in those last \
             500 ms the error that stays and the unrest about it; force that is left over when the profile ends, and its share of \
             F_C",
            self.experiment, ORIGIN, self.seed
        );
        let header = [
            "configuration",
            "moving / nm",
            "end / nm",
            "settled / nm",
            "in position / nm",
            "stays / nm",
            "unrest / nm",
            "left over / N",
            "of F_C",
            "faults",
        ];
        let mut table = Table::new(caption, &header);
        for run in self.all() {
            for config in &run.configs {
                let name = [&run.name, &config.settling.name].map(String::as_str);
                let nm = |value: Option<f64>, decimals| value.map_or(MISSING.to_owned(), |v| number(v, decimals));
                table = table.row([
                    name.into_iter().filter(|part| !part.is_empty()).collect::<Vec<_>>().join(": "),
                    nm(config.tracking_rms_nm, 0),
                    nm(config.end_error_rms_nm, 0),
                    nm(config.after_settling_rms_nm, 2),
                    nm(config.settling.in_position_rms_nm, 2),
                    nm(config.steady_error_nm, 2),
                    nm(config.restless_nm, 2),
                    number(run.tuning.terminal_force_n, 3),
                    format!("{} %", number(100.0 * run.tuning.terminal_force_per_coulomb, 0)),
                    config.faults.to_string(),
                ]);
            }
        }
        table
    }
}

impl Run {
    fn new(comparison: &Comparison, cases: &[&Case], moves: Vec<Vec<&MoveResult>>) -> Run {
        let baseline = cases[0];
        let settled: Vec<Config> = cases.iter().zip(&moves).map(|(case, moves)| config(case, moves)).collect();
        let settling = SettlingExperiment::new(&baseline.tolerances_nm, settled);
        let configs = cases
            .iter()
            .zip(&moves)
            .zip(&settling.configs)
            .map(|((case, moves), config)| ConfigOutcome::new(case, moves, config, &settling.configs[0]))
            .collect();
        Run {
            name: comparison.name.clone(),
            settling,
            configs,
            tuning: TuningOutcome::new(comparison, baseline),
            step: StepOutcome::new(baseline),
            plant: baseline.stage,
        }
    }

    /// What the numbers were made on.
    pub fn conditions(&self) -> Conditions {
        let spread = if self.plant.friction.spread.is_some() { ", redrawn per move" } else { "" };
        Conditions {
            origin: ORIGIN.to_owned(),
            step: format!("{} at {} m/s²", length(self.step.length_m), self.step.acceleration_m_per_s2),
            tuning: self.tuning.name.clone(),
            plant: plant(&self.plant) + spread,
        }
    }

    /// The settling table; with many configurations, one in a row.
    pub fn table(&self) -> Table {
        if self.configs.len() <= 3 {
            return settling_table(&self.settling, &self.conditions());
        }
        let name = if self.name.is_empty() { String::new() } else { format!("{}: ", self.name) };
        let caption = format!(
            "{name}mean settling time after the end of the profile in ms (reduction against {}), where at least half of the moves settled: {}",
            self.configs[0].settling.name,
            self.conditions().caption(self.settling.moves)
        );
        let mut header = vec!["configuration".to_owned(), "unsettled".to_owned()];
        header.extend(self.settling.tolerances_nm.iter().map(|nm| format!("±{nm} nm")));
        let header: Vec<&str> = header.iter().map(String::as_str).collect();
        self.configs.iter().enumerate().fold(Table::new(caption, &header), |table, (index, config)| {
            let cell = |t: usize| {
                let Some(mean_ms) = config.typical_ms(t) else { return MISSING.to_owned() };
                let reduction = config.reduction_percent[t].filter(|_| index > 0);
                let mean = number(mean_ms, if mean_ms < 100.0 { 1 } else { 0 });
                mean + &reduction.map_or(String::new(), |r| format!(" ({} %)", number(r, 0)))
            };
            let cells = (0..self.settling.tolerances_nm.len()).map(cell);
            let mut unsettled: Vec<String> = config.settling.unsettled.iter().map(usize::to_string).collect();
            unsettled.dedup();
            let name = std::iter::once(config.settling.name.clone());
            table.row(name.chain([unsettled.join(" / ")]).chain(cells))
        })
    }
}

/// Settling times of a case.
fn config(case: &Case, moves: &[&MoveResult]) -> Config {
    let ms = |ticks: &Option<u32>| ticks.map(|t| f64::from(t) / f64::from(SERVO_HZ) * 1e3);
    let settling_ms: Vec<Vec<Option<f64>>> = moves.iter().map(|m| m.settled_ticks.iter().map(ms).collect()).collect();
    Config::new(&case.name, &case.tolerances_nm, &settling_ms, rms_nm(case, moves.iter().map(|m| m.holding)))
}

/// Root mean square of all samples, nm; `None` without samples.
fn rms_nm(case: &Case, sums: impl Iterator<Item = Squares>) -> Option<f64> {
    let (ct2, samples) = sums.fold((0u128, 0u64), |(ct2, n), s| (ct2 + u128::from(s.ct2), n + u64::from(s.samples)));
    (samples > 0).then(|| (ct2 as f64 / samples as f64).sqrt() * case.settings.encoder_count_m * 1e9)
}

impl ConfigOutcome {
    /// Mean settling time at a tolerance (ms) if at least half of the moves settled: else it is of those that were lucky.
    pub fn typical_ms(&self, tolerance: usize) -> Option<f64> {
        let mean_ms = self.settling.mean_ms.get(tolerance).copied().flatten();
        mean_ms.filter(|_| 2 * self.settling.unsettled[tolerance] <= self.settling.settling_ms.len())
    }

    fn new(case: &Case, moves: &[&MoveResult], settling: &Config, baseline: &Config) -> Self {
        let rms_nm = |of: fn(&MoveResult) -> Squares| {
            let finished = moves.iter().filter(|m| m.fault.is_none());
            rms_nm(case, finished.map(|m| of(m))).map(|nm| round_to(nm, 3))
        };
        let count_nm = case.settings.encoder_count_m * 1e9;
        let finished: Vec<&&MoveResult> = moves.iter().filter(|m| m.fault.is_none()).collect();
        let at_rest_nm = |of: fn(&MoveResult) -> f64| {
            let mean = finished.iter().map(|m| of(m)).sum::<f64>() / finished.len() as f64;
            (!finished.is_empty()).then(|| round_to(libm::sqrt(mean) * count_nm, 3))
        };
        let means = baseline.mean_ms.iter().zip(&settling.mean_ms);
        ConfigOutcome {
            settling: settling.clone(),
            reduction_percent: means.map(|(before, after)| reduction_percent((*before)?, (*after)?)).collect(),
            compensator: Compensator::ALL[case.settings.compensator as usize].name().to_owned(),
            faults: moves.iter().filter(|m| m.fault.is_some()).count(),
            first_fault: moves.iter().find_map(|m| m.fault).map(fault_in_words),
            tracking_rms_nm: rms_nm(|m| m.tracking),
            end_error_rms_nm: rms_nm(|m| m.end),
            after_settling_rms_nm: rms_nm(|m| m.after_settling),
            steady_error_nm: at_rest_nm(|m| m.rest.mean_ct() * m.rest.mean_ct()),
            restless_nm: at_rest_nm(|m| m.rest.variance_ct2()),
            parameters: case.settings,
        }
    }
}

/// `fault 8 (Following error)`.
fn fault_in_words(number: u16) -> String {
    let title = Fault::by_number(number).map_or("unknown", Fault::title);
    format!("fault {number} ({title})")
}

/// Fingerprint of passes, as they are written in a part's file.
pub fn results_hash(passes: &Passes) -> String {
    let text = serde_json::to_string(passes).unwrap_or_default();
    let words: Vec<u32> = text.bytes().map(u32::from).collect();
    format!("{:016x}", Fingerprint::default().with_words(&words).0)
}

impl TuningOutcome {
    fn new(comparison: &Comparison, case: &Case) -> Self {
        let gains = gains(&case.settings);
        let missing_kg = case.stage.mechanics.mass_kg - case.settings.feedforward_mass_kg;
        let terminal_force_n = missing_kg * case.steps.acceleration_m_per_s2;
        TuningOutcome {
            name: comparison.tuning.clone(),
            crossover_hz: comparison.tuned_for.crossover_hz,
            phase_margin_deg: comparison.tuned_for.phase_margin_deg,
            kp_n_per_m: gains.kp_n_per_m,
            ki_n_per_m_s: gains.ki_n_per_m_s,
            kd_n_s_per_m: gains.kd_n_s_per_m,
            feedforward_mass_error_percent: comparison.mass_error_percent,
            terminal_force_n: round_to(terminal_force_n, 6),
            terminal_force_per_coulomb: round_to(terminal_force_n / case.stage.friction.coulomb_n, 4),
        }
    }
}

impl StepOutcome {
    fn new(case: &Case) -> Self {
        let steps = &case.steps;
        StepOutcome {
            length_m: steps.step_m,
            acceleration_m_per_s2: steps.acceleration_m_per_s2,
            profile_ms: round_to(2e3 * (steps.step_m / steps.acceleration_m_per_s2).sqrt(), 3),
            dwell_s: steps.dwell_s,
        }
    }
}
