//! The identification study of chapter 6: σ and F_C from a decaying sine at three frequencies and six places, and from settling.

use std::collections::BTreeMap;
use std::sync::atomic::Ordering;

use rayon::prelude::*;
use serde::Serialize;
use servo_core::SERVO_HZ;
use servo_core::drive::Command;
use servo_core::measure::{self, Node, Shape};
use servo_core::parameters::Settings;
use servo_core::position::Position;
use servo_core::record::{TickRecord, flags};
use servo_core::refusal::Refusal;
use servo_core::state::State;
use servo_host_tests::FastBench;
use servo_host_tests::experiment::{FIVE_MM_SLOW, Steps};
use servo_host_tests::tuning::{self, STANDARD};
use servo_ident::dahl::{self, DahlFit};
use servo_ident::{DataError, Record};
use servo_sim::Stage;

use super::campaign::Watch;
use super::pass::{self, Case};

/// Frequencies of the identification profile, Hz (6.1).
pub const FREQUENCIES_HZ: [f32; 3] = [8.0, 16.0, 32.0];
/// Places along the travel (6.2).
pub const PLACES: u64 = 6;
/// Runs at each place and frequency (6.2).
pub const RUNS: u64 = 50;
/// Steps that are identified from their settling (6.3).
pub const STEPS: u64 = 250;
/// Distance of the places, m (6.2).
const SPACING_M: f64 = 5e-3;
/// Periods of the profile; the thesis does not say.
const PERIODS: u32 = 8;
/// Amplitude at its end over that at its beginning; the thesis does not say. The last reversals still slide.
const END_SHARE: f32 = 0.7;
/// Motion that a profile has to make, m: "one micrometre and smaller" (6.1), there and back.
const SPAN_M: f64 = 1.6e-6;
/// The amplitude is raised by this factor until it does, with single periods at the highest frequency.
const RAISE: f64 = 1.25;
/// Amplitude that is tried first: the force of the position loop at this error, m.
const FIRST_ERROR_M: f64 = 0.5e-6;
/// Amplitudes that are tried.
const ATTEMPTS: usize = 16;
/// What ends a profile before harm is done: far beyond what it does, m and m/s.
const TRAVEL_M: f32 = 100e-6;
const SPEED_M_PER_S: f32 = 0.05;
/// Rest after each excitation, ticks.
const REST_TICKS: u32 = 400;
/// Settling that is looked at, s from the end of the profile.
const SETTLING_S: f64 = 0.25;
/// Residual of a fit to settling, as a share of F_C, beyond which Dahl's curve is not what was seen.
const POOR_SHARE: f64 = 0.03;
/// Upper end of the interval of σ over its lower end, beyond which a settling does not tell σ: the stage hardly turned back.
const WIDEST: f64 = 1.5;
/// Seeds of the settling steps begin here: other friction than that of the profiles.
const STEPS_FROM: u64 = 1 << 40;

/// Runs at each place and frequency beside `steps` steps, in the thesis' proportion.
pub fn runs_beside(steps: u64) -> u64 {
    (steps * RUNS).div_ceil(STEPS)
}

/// Fits of a study.
pub fn pieces(runs: u64, steps: u64) -> u64 {
    runs * PLACES * FREQUENCIES_HZ.len() as u64 + steps
}

/// One fit.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Fitted {
    /// Place, from 0; of a settling step its number.
    pub place: u64,
    /// σ found (N/m).
    pub sigma_n_per_m: f64,
    /// F_C found (N).
    pub coulomb_n: f64,
    /// σ drawn (N/m).
    pub true_sigma_n_per_m: f64,
    /// F_C drawn (N).
    pub true_coulomb_n: f64,
    /// Whether the 95 % interval of σ contains what was drawn.
    pub sigma_covered: bool,
    /// Whether that of F_C does.
    pub coulomb_covered: bool,
    /// Mean square of what the model leaves (N²).
    pub mse_n2: f64,
}

/// A measured loop and the model over it: what the thesis' figures 20, 22 and 31 show.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Trace {
    /// Which.
    pub name: String,
    /// Position against the beginning (nm).
    pub position_nm: Vec<f64>,
    /// Force of the motor (N).
    pub motor_n: Vec<f64>,
    /// The same less the inertia: friction (N).
    pub friction_n: Vec<f64>,
    /// Dahl's model (N).
    pub model_n: Vec<f64>,
    /// The fit.
    pub fit: Fitted,
}

/// Fits of one kind.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Group {
    /// Frequency of the profile (Hz); none of settling.
    pub frequency_hz: Option<f64>,
    /// The fits.
    pub fits: Vec<Fitted>,
    /// Runs whose data were refused, by the reason.
    pub refused: BTreeMap<String, u64>,
    /// The first run and the one with the largest mean square error.
    pub traces: Vec<Trace>,
}

/// Everything found.
#[derive(Debug, Clone, PartialEq)]
pub struct Study {
    /// By frequency.
    pub profiles: Vec<Group>,
    /// From the settling of steps.
    pub settling: Group,
    /// Parameters of the drive.
    pub settings: Settings,
}

/// Makes `runs` runs at each place and frequency and `steps` steps; ended from outside, it gives those that are finished.
///
/// # Errors
/// What the drive refuses.
pub fn run(stage: &Stage, runs: u64, steps: u64, seed: u64, watch: Watch) -> Result<Study, Refusal> {
    let settings = tuning::settings(stage, &STANDARD)?;
    let places: Vec<(usize, u64)> = (0..FREQUENCIES_HZ.len()).flat_map(|f| (0..PLACES).map(move |p| (f, p))).collect();
    let at_places: Vec<Found> = places
        .par_iter()
        .with_max_len(1)
        .map(|(frequency, place)| at_place(stage, &settings, seed, *frequency, *place, runs, watch))
        .collect::<Result<_, Refusal>>()?;
    let passes: Vec<u64> = (0..steps.div_ceil(pass::MOVES)).collect();
    let settled: Vec<Found> = passes
        .par_iter()
        .with_max_len(1)
        .map(|number| settle(stage, &settings, seed, *number, steps - number * pass::MOVES, watch))
        .collect::<Result<_, Refusal>>()?;
    let profiles = FREQUENCIES_HZ.iter().zip(at_places.chunks(PLACES as usize));
    Ok(Study {
        profiles: profiles.map(|(hz, found)| Group::new(Some(f64::from(*hz)), found)).collect(),
        settling: Group::new(None, &settled),
        settings,
    })
}

/// Runs of one kind, one after the other.
type Found = Vec<Result<(Fitted, Trace), DataError>>;

/// All runs at one place and frequency: the stage goes there once; friction is drawn for each run.
fn at_place(
    stage: &Stage,
    settings: &Settings,
    seed: u64,
    frequency: usize,
    place: u64,
    runs: u64,
    watch: Watch,
) -> Result<Found, Refusal> {
    let mut bench = FastBench::new(stage, settings, seed)?;
    bench.enable()?;
    let place_m = (place as f64 - 0.5 * (PLACES - 1) as f64) * SPACING_M.min(stage.mechanics.travel_m / 10.0);
    let target = Position((place_m / settings.encoder_count_m).round() as i64);
    bench.command(Command::Move { target, limits: FIVE_MM_SLOW.limits(settings) })?;
    rest(&mut bench, SERVO_HZ)?;
    let mut found = Vec::new();
    for run in 0..runs {
        if watch.stop.load(Ordering::Relaxed) {
            break;
        }
        bench.redraw((frequency as u64 * PLACES + place) * runs + run);
        let records = identification_profile(&mut bench, settings, FREQUENCIES_HZ[frequency])?;
        let name = format!("{} Hz, place {}", FREQUENCIES_HZ[frequency], place + 1);
        found.push(fit(stage, bench.carriage.drawn_friction(), &records, place, name, false));
        (watch.finished)(1);
    }
    Ok(found)
}

/// Finds an amplitude and plays the profile with it, at the force summing node.
fn identification_profile(bench: &mut FastBench, settings: &Settings, hz: f32) -> Result<Vec<TickRecord>, Refusal> {
    let mut amplitude_n = super::experiments::gains(settings).kp_n_per_m * FIRST_ERROR_M;
    let highest_hz = FREQUENCIES_HZ.iter().copied().fold(0.0, f32::max);
    for _ in 0..ATTEMPTS {
        let tried = play(bench, settings, profile(amplitude_n, highest_hz, 1, 1.0))?;
        let positions = || tried.iter().map(|record| record.position);
        let span_ct = positions().max().zip(positions().min()).map_or(0, |(high, low)| high.minus(low));
        if f64::from(span_ct) * settings.encoder_count_m >= SPAN_M {
            break;
        }
        amplitude_n *= RAISE;
    }
    play(bench, settings, profile(amplitude_n, hz, PERIODS, END_SHARE))
}

fn profile(amplitude_n: f64, frequency_hz: f32, periods: u32, end_share: f32) -> Shape {
    Shape::DecayingSine { amplitude: amplitude_n as f32, frequency_hz, periods, end_share }
}

/// Has the drive play a profile of force, and rests; the records of the profile.
fn play(bench: &mut FastBench, settings: &Settings, shape: Shape) -> Result<Vec<TickRecord>, Refusal> {
    let current_a = settings.current_limit_a as f32;
    let request =
        measure::Request { shape, node: Node::Force, travel_m: TRAVEL_M, speed_m_per_s: SPEED_M_PER_S, current_a };
    let mut command = Some(Command::Excite(measure::Order::new(&request, settings.encoder_count_m)?));
    let mut records = Vec::new();
    loop {
        let output = bench.tick(command.take());
        output.outcome.unwrap_or(Ok(()))?;
        let record = operational(output.record)?;
        if record.flags & flags::EXCITED == 0 {
            break;
        }
        records.push(record);
    }
    rest(bench, REST_TICKS)?;
    Ok(records)
}

/// Waits until the axis has been standing for `ticks` ticks.
fn rest(bench: &mut FastBench, ticks: u32) -> Result<(), Refusal> {
    let mut left = ticks;
    while left > 0 {
        let record = operational(bench.tick(None).record)?;
        left -= u32::from(record.flags & flags::MOVING == 0);
    }
    Ok(())
}

fn operational(record: TickRecord) -> Result<TickRecord, Refusal> {
    match record.state {
        State::OperationEnabled => Ok(record),
        other => Err(Refusal::WrongState(other)),
    }
}

/// One pass of steps, each identified from what follows the profile.
fn settle(
    stage: &Stage,
    settings: &Settings,
    seed: u64,
    number: u64,
    left: u64,
    watch: Watch,
) -> Result<Found, Refusal> {
    if watch.stop.load(Ordering::Relaxed) {
        return Ok(Vec::new());
    }
    let case = Case {
        name: "pid".to_owned(),
        stage: *stage,
        settings: *settings,
        steps: Steps { dwell_s: SETTLING_S, ..FIVE_MM_SLOW },
        tolerances_nm: vec![100],
    };
    let mut steps: Vec<Vec<TickRecord>> = Vec::new();
    let mut drawn: Vec<[f64; 2]> = Vec::new();
    pass::run_observed(&case, seed, STEPS_FROM + number, left, |index, record, bench| {
        if record.flags & flags::MOVING == 0 {
            if steps.len() <= index as usize {
                steps.push(Vec::new());
                drawn.push(bench.carriage.drawn_friction());
            }
            steps[index as usize].push(*record);
        }
    })?;
    let found = steps.iter().zip(drawn).zip(number * pass::MOVES..);
    let found: Found = found
        .map(|((records, drawn), step)| {
            let name = format!("settling of step {}", step + 1);
            let known_offset = true;
            fit(stage, drawn, records, step, name, known_offset)
        })
        .collect();
    (watch.finished)(found.len() as u64);
    Ok(found)
}

/// Dahl's model fitted to what the drive recorded.
///
/// The current is taken as it was recorded: read 25 µs before the position, but at the end of its hold, where the current loop
/// overshoots by about as much. Without noise that leaves 0.05 % of σ; reckoned with the 25 µs it would be 0.5 % at 32 Hz.
fn fit(
    stage: &Stage,
    [true_sigma_n_per_m, true_coulomb_n]: [f64; 2],
    records: &[TickRecord],
    place: u64,
    name: String,
    no_offset: bool,
) -> Result<(Fitted, Trace), DataError> {
    let time_s: Vec<f64> = (0..records.len()).map(|i| i as f64 / f64::from(SERVO_HZ)).collect();
    let position_m: Vec<f64> =
        records.iter().map(|r| f64::from(r.position.minus(records[0].position)) * stage.encoder.count_m).collect();
    let current_a: Vec<f64> = records.iter().map(|record| f64::from(record.iq_a)).collect();
    let (mass_kg, constant) = (stage.mechanics.mass_kg, stage.motor.force_constant_n_per_a);
    let record = Record::from_current(&time_s, &position_m, &current_a, mass_kg, constant)?;
    let found = dahl::fit_any_memory(&record, no_offset)?;
    if no_offset {
        determined(&found)?;
    }
    let fit = Fitted {
        place,
        sigma_n_per_m: found.sigma_n_per_m,
        coulomb_n: found.coulomb_n,
        true_sigma_n_per_m,
        true_coulomb_n,
        sigma_covered: found.ci95.sigma_n_per_m.contains(true_sigma_n_per_m),
        coulomb_covered: found.ci95.coulomb_n.contains(true_coulomb_n),
        mse_n2: found.mse_n2,
    };
    let trace = Trace {
        name,
        position_nm: record.position_m.iter().map(|x| x * 1e9).collect(),
        motor_n: current_a.iter().map(|i| i * constant - found.offset_n).collect(),
        friction_n: record.force_n.iter().map(|f| f - found.offset_n).collect(),
        model_n: found.force_n(&record).iter().map(|f| f - found.offset_n).collect(),
        fit,
    };
    Ok((fit, trace.thinned()))
}

/// Whether a settling tells what friction is: Dahl's curve must be what was seen, and the interval of σ must be narrow.
fn determined(found: &DahlFit) -> Result<(), DataError> {
    let undetermined = |why| Err(DataError::Undetermined { what: "sigma_n_per_m", why });
    let [low, high] = found.ci95.sigma_n_per_m.0;
    let share = found.mse_n2.sqrt() / found.coulomb_n;
    if high > WIDEST * low {
        undetermined(format!("its interval is {low:.3e} to {high:.3e} N/m"))
    } else if share > POOR_SHARE {
        undetermined(format!("the model leaves {:.1} % of F_C", share * 100.0))
    } else {
        Ok(())
    }
}

impl Study {
    /// Runs that were made, fitted or refused.
    pub fn made(&self) -> u64 {
        let groups = self.profiles.iter().chain([&self.settling]);
        groups.map(|group| group.fits.len() as u64 + group.refused.values().sum::<u64>()).sum()
    }
}

impl Group {
    fn new(frequency_hz: Option<f64>, found: &[Found]) -> Group {
        let runs = || found.iter().flatten();
        let good = || runs().filter_map(|run| run.as_ref().ok());
        let mut refused = BTreeMap::new();
        for error in runs().filter_map(|run| run.as_ref().err()) {
            *refused.entry(error.kind().to_owned()).or_insert(0) += 1;
        }
        let worst = good().max_by(|a, b| a.0.mse_n2.total_cmp(&b.0.mse_n2));
        Group {
            frequency_hz,
            fits: good().map(|run| run.0).collect(),
            refused,
            traces: good().take(1).chain(worst).map(|run| run.1.clone()).collect(),
        }
    }
}

impl Trace {
    /// At most 1,000 points.
    fn thinned(&self) -> Trace {
        let every = self.position_nm.len().div_ceil(1_000).max(1);
        let thin = |values: &[f64], decimals: i32| -> Vec<f64> {
            values.iter().step_by(every).map(|v| crate::settling::round_to(*v, decimals)).collect()
        };
        Trace {
            name: self.name.clone(),
            position_nm: thin(&self.position_nm, 2),
            motor_n: thin(&self.motor_n, 4),
            friction_n: thin(&self.friction_n, 4),
            model_n: thin(&self.model_n, 4),
            fit: self.fit,
        }
    }
}
