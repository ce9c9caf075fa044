//! The 100 µm step of section 5.3: where the stage ceases to be linear, found from the extremes of its swing as `servoctl commission` finds it;
//! the linear loop beside it is the same drive on the same mass without friction, where commissioning has the fit of 5.2.

use std::sync::atomic::Ordering;

use rayon::prelude::*;
use serde::Serialize;
use servo_core::SERVO_HZ;
use servo_core::drive::Command;
use servo_core::parameters::Settings;
use servo_core::position::Position;
use servo_core::profile::Limits;
use servo_core::refusal::Refusal;
use servo_core::state::State;
use servo_host_tests::FastBench;
use servo_host_tests::tuning::{self, STANDARD};
use servo_ident::length_scale::{self, End, Swing, USUAL_FACTOR};
use servo_sim::Stage;

use super::campaign::Watch;
use super::experiments::gains;
use super::outcome::ORIGIN;
use super::words::plant;
use crate::settling::round_to;
use crate::table::{MISSING, Table, number};

/// Length of the step, m.
const STEP_M: f64 = 100e-6;
/// Acceleration of its profile, m/s²: 4.5 ms, without saturation. A true step would be all saturation.
const ACCELERATION_M_PER_S2: f64 = 20.0;
/// Time recorded, s.
const RECORD_S: f64 = 1.0;
/// The move before, m: it leaves the guides rolling in one direction, as any move does.
const APPROACH_M: f64 = 0.5e-3;
/// Travel that both need, to either side of its middle where they begin, with an overshoot as long as the step, m.
pub const TRAVEL_M: f64 = 1.4e-3;
/// Time after it, s.
const APPROACH_DWELL_S: f64 = 2.0;
/// Friction of the linear stage, as a share of the stage's.
const LINEAR_SHARE: f64 = 1e-4;

/// Friction with which the step is repeated, as shares of the stage's F_C.
const LESS: [f64; 5] = [1.0, 0.5, 0.25, 0.15, 0.08];
/// Extremes that are shown of those.
const SHOWN: usize = 5;
/// Extremes that are shown of the stage's, and of the linear one's.
const LISTED: usize = 8;

/// Moves with friction of their own if nothing else is asked for.
pub const MOVES: u64 = 50;

/// Everything found.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Step100Um {
    /// Name as typed.
    pub experiment: &'static str,
    /// Section of the thesis.
    pub thesis_section: &'static str,
    /// Where the numbers come from.
    pub origin: &'static str,
    /// Seed of friction and noise.
    pub seed: u64,
    /// Steps with friction drawn that were asked for.
    pub moves_requested: u64,
    /// Whether all of them were made.
    pub complete: bool,
    /// The step on the stage as it stands in its file.
    pub stage: Step,
    /// The same drive on the same mass with next to no friction: what the linear approximation predicts.
    pub linear: Step,
    /// Time between the first extremes of the linear stage (ms), the farthest from noise; `None` if it does not swing, and then nothing is
    /// found.
    pub linear_leg_ms: Option<f64>,
    /// F_C/k_P: nearer to the target the proportional force alone cannot overcome friction (nm).
    pub stuck_within_nm: f64,
    /// What the procedure says of the stage.
    pub finding: Option<Finding>,
    /// The same of the linear stage: how far its own swing can be seen.
    pub linear_finding: Option<Finding>,
    /// The same of steps with friction drawn for each.
    pub redrawn: Vec<Option<Finding>>,
    /// The step with less and less friction.
    pub by_friction: Vec<LessFriction>,
    /// The simulated hardware.
    pub plant: Stage,
}

/// The extremes of the step on a stage with less friction.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct LessFriction {
    /// F_C (N).
    pub coulomb_n: f64,
    /// F_C/k_P (nm).
    pub stuck_within_nm: f64,
    /// Extremes, the first ones (nm from the target).
    pub extreme_nm: Vec<f64>,
}

/// A step and its swing.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Step {
    /// Time since the profile began (ms), one value per tick.
    pub time_ms: Vec<f64>,
    /// Measured position − target (nm).
    pub error_nm: Vec<f64>,
    /// Its extremes.
    pub swing: Swing,
}

/// Where the stage ceases to be linear, as [`length_scale::find`] has it.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Finding {
    /// Distance from the target at which the last linear leg begins (nm).
    pub linear_down_to_nm: f64,
    /// Distance from the target at which the first other one begins: the length scale of pre-rolling (nm).
    pub length_scale_nm: f64,
    /// The extreme that it begins at, from 0.
    pub extreme: usize,
    /// How long this leg takes, to the next extreme or, if none follows, to the target (ms).
    pub leg_ms: f64,
    /// How it is not the linear loop's.
    pub end: End,
    /// How long the leg after it takes (ms); `None` if no extreme follows.
    pub next_leg_ms: Option<f64>,
}

/// Makes the steps. Ended from outside, it is of those that are finished.
///
/// # Errors
/// A stage that the drive's parameters cannot describe.
pub fn run(stage: &Stage, moves: u64, seed: u64, watch: Watch) -> Result<Step100Um, Refusal> {
    let settings = tuning::settings(stage, &STANDARD)?;
    let mut free = *stage;
    free.friction.spread = None;
    free.friction.coulomb_n = (LINEAR_SHARE * stage.friction.coulomb_n).max(1e-6);
    free.friction.static_n = None;
    let mut nominal = *stage;
    nominal.friction.spread = None;
    let made = step(&nominal, &settings, seed, 0)?;
    let linear = step(&free, &settings, seed, 0)?;
    let linear_leg_ms = linear.swing.legs_s().next().map(|s| s * 1e3);
    let redrawn: Vec<Option<Option<Finding>>> = (0..moves)
        .into_par_iter()
        .map(|index| {
            if watch.stop.load(Ordering::Relaxed) {
                return Ok(None);
            }
            let found = finding(&step(stage, &settings, seed, index)?, linear_leg_ms);
            (watch.finished)(1);
            Ok(Some(found))
        })
        .collect::<Result<_, Refusal>>()?;
    let less = |share: f64| {
        let mut stage = nominal;
        stage.friction.coulomb_n *= share;
        stage.friction.static_n = stage.friction.static_n.map(|static_n| share * static_n);
        let coulomb_n = stage.friction.coulomb_n;
        let swing = step(&stage, &settings, seed, 0)?.swing;
        let extreme_nm = swing.extremes.iter().take(SHOWN).map(|extreme| round_to(extreme.error_m * 1e9, 1)).collect();
        let stuck_within_nm = round_to(coulomb_n / gains(&settings).kp_n_per_m * 1e9, 1);
        Ok(LessFriction { coulomb_n: round_to(coulomb_n, 4), stuck_within_nm, extreme_nm })
    };
    let by_friction: Vec<LessFriction> = LESS.par_iter().map(|share| less(*share)).collect::<Result<_, Refusal>>()?;
    let redrawn: Vec<Option<Finding>> = redrawn.into_iter().flatten().collect();
    Ok(Step100Um {
        experiment: "step-100um",
        thesis_section: "5.3",
        origin: ORIGIN,
        seed,
        moves_requested: moves,
        complete: redrawn.len() as u64 == moves,
        finding: finding(&made, linear_leg_ms),
        linear_finding: finding(&linear, linear_leg_ms),
        stage: made,
        linear,
        linear_leg_ms: linear_leg_ms.map(|ms| round_to(ms, 3)),
        stuck_within_nm: round_to(stage.friction.coulomb_n / gains(&settings).kp_n_per_m * 1e9, 1),
        redrawn,
        by_friction,
        plant: nominal,
    })
}

/// The step, after a move that leaves the guides rolling.
fn step(stage: &Stage, settings: &Settings, seed: u64, index: u64) -> Result<Step, Refusal> {
    let ticks = |s: f64| (s * f64::from(SERVO_HZ)).round() as usize;
    let count_nm = settings.encoder_count_m * 1e9;
    let at = |m: f64| Position((m / settings.encoder_count_m).round() as i64);
    let limits = |acceleration: f64| Limits {
        velocity_m_per_s: settings.velocity_max_m_per_s as f32,
        acceleration_m_per_s2: acceleration.min(settings.acceleration_max_m_per_s2) as f32,
        jerk_m_per_s3: None,
    };
    let mut bench = FastBench::new(stage, settings, seed)?;
    bench.enable()?;
    bench.redraw(index);
    bench.command(Command::Move { target: at(APPROACH_M), limits: limits(1.0) })?;
    for _ in 0..ticks(APPROACH_DWELL_S) {
        bench.tick(None);
    }
    let target = at(APPROACH_M + STEP_M);
    bench.command(Command::Move { target, limits: limits(ACCELERATION_M_PER_S2) })?;
    let mut error_nm = Vec::with_capacity(ticks(RECORD_S));
    for _ in 0..ticks(RECORD_S) {
        let record = bench.tick(None).record;
        if record.state != State::OperationEnabled {
            return Err(Refusal::WrongState(record.state));
        }
        error_nm.push(round_to((record.position.0 - target.0) as f64 * count_nm, 3));
    }
    let time_ms: Vec<f64> = (0..error_nm.len()).map(|i| i as f64 * 1e3 / f64::from(SERVO_HZ)).collect();
    let [time_s, error_m] =
        [(&time_ms, 1e-3), (&error_nm, 1e-9)].map(|(v, unit)| v.iter().map(|v| v * unit).collect::<Vec<_>>());
    let swing = Swing::of(&time_s, &error_m, 0.0).expect("finite positions in ticks that follow each other");
    Ok(Step { time_ms, error_nm, swing })
}

/// Where the swing ceases to be that of the linear loop.
fn finding(step: &Step, linear_leg_ms: Option<f64>) -> Option<Finding> {
    let found = length_scale::find(&step.swing, linear_leg_ms? * 1e-3, USUAL_FACTOR).ok()?;
    let nm = |m: f64| round_to(m * 1e9, 1);
    let ms = |s: f64| round_to(s * 1e3, 3);
    Some(Finding {
        linear_down_to_nm: nm(found.linear_from_m),
        length_scale_nm: nm(found.length_m),
        extreme: found.at,
        leg_ms: ms(found.leg_s),
        end: found.end,
        next_leg_ms: step.swing.legs_s().nth(found.at + 1).map(ms),
    })
}

impl Step100Um {
    /// The tables for a terminal.
    pub fn to_text(&self) -> String {
        let tables = [self.extremes_table(), self.finding_table(), self.friction_table()];
        let unfinished = (!self.complete).then(|| {
            format!("Not complete: {} of {} steps with friction drawn.\n", self.redrawn.len(), self.moves_requested)
        });
        tables.iter().map(Table::to_text).chain(unfinished).collect::<Vec<_>>().join("\n")
    }

    /// Extremes of both swings.
    pub fn extremes_table(&self) -> Table {
        let caption = format!(
            "Extremes after a 100 µm step in {} ms, PID 100 Hz / 45° without feedforward (5.3): {ORIGIN}, {}; beside the same \
             drive and mass without friction",
            number(2e3 * libm::sqrt(STEP_M / ACCELERATION_M_PER_S2), 1),
            plant(&self.plant)
        );
        let header = [
            "extreme",
            "at / ms",
            "from target / nm",
            "since last / ms",
            "linear: at / ms",
            "from target / nm",
            "since last / ms",
        ];
        let swings = [&self.stage.swing, &self.linear.swing];
        let rows = swings.map(|swing| swing.extremes.len()).into_iter().max().unwrap_or(0).min(LISTED);
        (0..rows).fold(Table::new(caption, &header), |table, i| {
            let cells = swings.into_iter().flat_map(|swing| {
                let cell = |value: Option<f64>, unit, decimals| {
                    value.map_or(MISSING.to_owned(), |v| number(v / unit, decimals))
                };
                let extreme = swing.extremes.get(i);
                let leg_s = i.checked_sub(1).and_then(|before| swing.legs_s().nth(before));
                [
                    cell(extreme.map(|e| e.time_s), 1e-3, 1),
                    cell(extreme.map(|e| e.error_m), 1e-9, 0),
                    cell(leg_s, 1e-3, 1),
                ]
            });
            table.row(std::iter::once((i + 1).to_string()).chain(cells))
        })
    }

    /// Where the swing ends with less friction.
    pub fn friction_table(&self) -> Table {
        let caption = format!(
            "The first {SHOWN} extremes of the same step with less friction, nm from the target; the thesis' last are 3810, −637, 115 and \
             19 nm: {ORIGIN}, PID 100 Hz / 45°, {}",
            plant(&self.plant)
        );
        let table = Table::new(caption, &["F_C / N", "F_C/k_P / nm", "extremes / nm"]);
        self.by_friction.iter().fold(table, |table, less| {
            let extremes: Vec<String> = less.extreme_nm.iter().map(|nm| number(*nm, 0)).collect();
            table.row([number(less.coulomb_n, 2), number(less.stuck_within_nm, 0), extremes.join(", ")])
        })
    }

    /// The length scale beside the thesis'.
    pub fn finding_table(&self) -> Table {
        let caption = format!(
            "Length scale of pre-rolling: where the first leg begins that is not the linear loop's, because it takes {USUAL_FACTOR} times \
             as long as its {} ms or that many times less, or ends short of the target; a stage that creeps turns no more, and its leg ends \
             at the target. Thesis, the stage as in its file, the same without friction, and {} steps with friction drawn for each (median, \
             least, largest). F_C/k_P is {} nm: a swing that cannot reach farther than that ends there, and the integrator creeps the rest",
            self.linear_leg_ms.map_or(MISSING.to_owned(), |ms| number(ms, 1)),
            self.redrawn.len(),
            number(self.stuck_within_nm, 0)
        );
        let header = ["quantity", "thesis", "nominal", "without friction", "median", "least", "largest"];
        let drawn: Vec<&Finding> = self.redrawn.iter().flatten().collect();
        let row = |name: &str, thesis: &str, of: fn(&Finding) -> Option<f64>, decimals: usize| {
            let cell = |value: Option<f64>| value.map_or(MISSING.to_owned(), |v| number(v, decimals));
            let mut values: Vec<f64> = drawn.iter().filter_map(|f| of(f)).collect();
            values.sort_by(f64::total_cmp);
            [
                name.to_owned(),
                thesis.to_owned(),
                cell(self.finding.as_ref().and_then(of)),
                cell(self.linear_finding.as_ref().and_then(of)),
                cell(values.get(values.len() / 2).copied()),
                cell(values.first().copied()),
                cell(values.last().copied()),
            ]
        };
        Table::new(caption, &header)
            .row(row("linear down to / nm", "3810", |f| Some(f.linear_down_to_nm), 0))
            .row(row("length scale / nm", "637 (≈ 600)", |f| Some(f.length_scale_nm), 0))
            .row(row("leg from there / ms", "23", |f| Some(f.leg_ms), 1))
            .row(row("leg after it / ms", "67", |f| f.next_leg_ms, 1))
    }
}
