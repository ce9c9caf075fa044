//! One pass of an experiment: five steps up and five back, the unit of work of every campaign.
//!
//! A pass begins with a drive and a stage of its own and a warm-up move, and everything random in it follows from the seed and
//! the number of the move. What a pass gives therefore depends neither on the passes before nor on who computes it.

use serde::{Deserialize, Serialize};
use servo_core::drive::Command;
use servo_core::parameters::Settings;
use servo_core::position::Position;
use servo_core::profile::Limits;
use servo_core::record::{TickRecord, flags};
use servo_core::refusal::Refusal;
use servo_core::settling::{HOLD_TICKS, NOISE_TICKS};
use servo_core::state::State;
use servo_host_tests::FastBench;
use servo_host_tests::experiment::Steps;
use servo_sim::Stage;

/// Moves in a pass.
pub const MOVES: u64 = 10;
/// Added to the number of a pass: the number of its warm-up move.
const WARM_UP: u64 = 1 << 62;
/// Shortest warm-up move, m: far beyond pre-rolling.
const WARM_UP_M: f64 = 0.5e-3;
/// Time after the warm-up move, s.
const WARM_UP_DWELL_S: f64 = 0.5;

/// One configuration of the drive on one stage, making one kind of step.
#[derive(Debug, Clone, PartialEq)]
pub struct Case {
    /// Name for tables and JSON, for example `pid+niasa`.
    pub name: String,
    /// The simulated hardware.
    pub stage: Stage,
    /// All parameters of the drive, the choice of its compensator among them.
    pub settings: Settings,
    /// The steps.
    pub steps: Steps,
    /// Settling tolerances (±, nm), finest first.
    pub tolerances_nm: Vec<u32>,
}

/// What is kept of a move: integers, so that files and sums lose nothing.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct MoveResult {
    /// Per tolerance, ticks from the end of the profile to the last sample outside (0 if there is none); `None` if it was left
    /// in the last [`HOLD_TICKS`] of the dwell, or by a fault.
    pub settled_ticks: Vec<Option<u32>>,
    /// Error in the [`NOISE_TICKS`] after settling to the finest tolerance; nothing if the move did not settle.
    pub after_settling: Squares,
    /// Error in the last [`NOISE_TICKS`] of the dwell; nothing if the move did not settle to the finest tolerance.
    pub holding: Squares,
    /// Error in the last [`NOISE_TICKS`] of the dwell, settled or not.
    pub rest: Rest,
    /// Error in the first sample after the profile.
    pub end: Squares,
    /// Error while the profile moves.
    pub tracking: Squares,
    /// Number of the fault that ended the pass in or before this move.
    pub fault: Option<u16>,
}

/// Errors summed up in integers.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Squares {
    /// Sum of the squares, counts².
    pub ct2: u64,
    /// Number of samples.
    pub samples: u32,
}

/// What a move comes to, in integers: whether it stays away, and whether it stays restless.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Rest {
    /// Sum of the errors, counts.
    pub sum_ct: i64,
    /// Sum of their squares, counts².
    pub ct2: u64,
    /// Number of samples.
    pub samples: u32,
}

impl Rest {
    fn of(errors_ct: &[i32]) -> Rest {
        let Squares { ct2, samples } = Squares::of(errors_ct);
        Rest { sum_ct: errors_ct.iter().copied().map(i64::from).sum(), ct2, samples }
    }

    /// Mean error, counts; 0 without samples.
    pub fn mean_ct(&self) -> f64 {
        self.sum_ct as f64 / f64::from(self.samples.max(1))
    }

    /// Variance about that mean, counts²; 0 without samples.
    pub fn variance_ct2(&self) -> f64 {
        let samples = f64::from(self.samples.max(1));
        (self.ct2 as f64 / samples - self.mean_ct() * self.mean_ct()).max(0.0)
    }
}

impl Squares {
    fn add(&mut self, error_ct: i32) {
        self.ct2 += u64::from(error_ct.unsigned_abs()) * u64::from(error_ct.unsigned_abs());
        self.samples += 1;
    }

    fn of<'a>(errors_ct: impl IntoIterator<Item = &'a i32>) -> Squares {
        let mut sum = Squares::default();
        errors_ct.into_iter().for_each(|error_ct| sum.add(*error_ct));
        sum
    }
}

/// Makes the first `moves` moves (at most [`MOVES`]) of pass number `pass`.
///
/// After a fault the rest of the pass counts as unsettled.
///
/// # Errors
/// Settings or moves that the drive refuses.
pub fn run(case: &Case, seed: u64, pass: u64, moves: u64) -> Result<Vec<MoveResult>, Refusal> {
    run_observed(case, seed, pass, moves, |_, _, _| ())
}

/// The same; `look` sees the move within the pass and every tick of it, and the bench after the tick.
///
/// # Errors
/// As for [`run`].
pub fn run_observed(
    case: &Case,
    seed: u64,
    pass: u64,
    moves: u64,
    mut look: impl FnMut(u64, &TickRecord, &FastBench),
) -> Result<Vec<MoveResult>, Refusal> {
    let mut bench = FastBench::new(&case.stage, &case.settings, seed)?;
    let start = Position((-start_m(case) / case.settings.encoder_count_m).round() as i64);
    bench.enable()?;
    bench.redraw(WARM_UP + pass);
    bench.command(Command::Move { target: start, limits: warm_up_limits(case) })?;
    let mut fault = rest(&mut bench, (WARM_UP_DWELL_S * f64::from(servo_core::SERVO_HZ)) as usize, |_, _| ()).err();

    let mut error_ct = Vec::with_capacity(case.steps.dwell_ticks() as usize);
    (0..moves.min(MOVES))
        .map(|index| {
            let mut result = MoveResult::unsettled(case.tolerances_nm.len());
            if fault.is_none() {
                let target = case.steps.target(start, index, case.settings.encoder_count_m);
                error_ct.clear();
                bench.redraw(pass * MOVES + index);
                bench.command(Command::Move { target, limits: case.steps.limits(&case.settings) })?;
                fault = rest(&mut bench, case.steps.dwell_ticks() as usize, |record, bench| {
                    look(index, record, bench);
                    if record.flags & flags::MOVING != 0 {
                        result.tracking.add(record.error_ct);
                    } else {
                        error_ct.push(record.error_ct);
                    }
                })
                .err();
                if fault.is_none() {
                    result.judge(&error_ct, &limits_ct(case));
                }
            }
            result.fault = fault;
            Ok(result)
        })
        .collect()
}

/// Where the steps begin, m below mid-travel: their middle is in mid-travel unless they are small.
fn start_m(case: &Case) -> f64 {
    let travel_m = case.stage.mechanics.travel_m;
    (2.5 * case.steps.step_m).max(WARM_UP_M.min(0.25 * travel_m))
}

fn warm_up_limits(case: &Case) -> Limits {
    let s = &case.settings;
    Limits {
        velocity_m_per_s: s.velocity_max_m_per_s as f32,
        acceleration_m_per_s2: s.acceleration_max_m_per_s2.min(1.0) as f32,
        jerk_m_per_s3: None,
    }
}

/// Runs until the profile has ended and `dwell_ticks` ticks more; `look` sees every tick.
///
/// # Errors
/// The number of the fault that ended it.
fn rest(bench: &mut FastBench, dwell_ticks: usize, mut look: impl FnMut(&TickRecord, &FastBench)) -> Result<(), u16> {
    let mut left = dwell_ticks;
    while left > 0 {
        let record = bench.tick(None).record;
        if record.state != State::OperationEnabled {
            return Err(record.fault.map_or(0, |fault| fault.number()));
        }
        left -= usize::from(record.flags & flags::MOVING == 0);
        look(&record, bench);
    }
    Ok(())
}

/// Largest error within each tolerance, counts.
fn limits_ct(case: &Case) -> Vec<u32> {
    let count_nm = case.settings.encoder_count_m * 1e9;
    case.tolerances_nm.iter().map(|&nm| (f64::from(nm) / count_nm).floor() as u32).collect()
}

impl MoveResult {
    fn unsettled(tolerances: usize) -> Self {
        MoveResult {
            settled_ticks: vec![None; tolerances],
            after_settling: Squares::default(),
            holding: Squares::default(),
            rest: Rest::default(),
            end: Squares::default(),
            tracking: Squares::default(),
            fault: None,
        }
    }

    /// What the errors after the profile say: the rules of [`crate::settling`], on counts.
    fn judge(&mut self, error_ct: &[i32], limits_ct: &[u32]) {
        self.end = Squares::of(error_ct.first());
        self.rest = Rest::of(&error_ct[error_ct.len().saturating_sub(NOISE_TICKS as usize)..]);
        let hold_from = error_ct.len().saturating_sub(HOLD_TICKS as usize);
        self.settled_ticks = limits_ct
            .iter()
            .map(|limit| match error_ct.iter().rposition(|e| e.unsigned_abs() > *limit) {
                None => Some(0),
                Some(last) if last < hold_from => Some(last as u32),
                Some(_) => None,
            })
            .collect();
        let finest = (0..limits_ct.len()).min_by_key(|i| limits_ct[*i]);
        if let Some(settled) = finest.and_then(|i| self.settled_ticks[i]) {
            let window = NOISE_TICKS as usize;
            self.after_settling = Squares::of(error_ct.iter().skip(settled as usize + 1).take(window));
            self.holding = Squares::of(&error_ct[error_ct.len().saturating_sub(window)..]);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::reproduce::experiments::with;
    use crate::settling;
    use servo_core::SERVO_HZ;
    use servo_core::compensator::Compensator;
    use servo_host_tests::experiment::FIVE_MM_SLOW;
    use servo_host_tests::tuning;

    fn case(stage: Stage, compensator: Compensator) -> Case {
        let settings = with(tuning::settings(&stage, &tuning::STANDARD).unwrap(), compensator);
        let steps = Steps { dwell_s: 0.7, ..FIVE_MM_SLOW };
        Case { name: String::new(), stage, settings, steps, tolerances_nm: vec![3, 10, 100] }
    }

    #[test]
    fn a_move_is_judged_as_its_trace_in_nanometres_is() {
        let case = case(Stage::default(), Compensator::Niasa);
        let mut errors_nm = vec![Vec::new(); 2];
        let results = run_observed(&case, 1, 0, 2, |index, record, _| {
            if record.flags & flags::MOVING == 0 {
                errors_nm[index as usize].push(f64::from(record.error_ct) * case.settings.encoder_count_m * 1e9);
            }
        })
        .unwrap();
        let expected = settling::Config::from_errors("", &case.tolerances_nm, &errors_nm, f64::from(SERVO_HZ));
        for (result, expected_ms) in results.iter().zip(&expected.settling_ms) {
            let ms: Vec<_> = result.settled_ticks.iter().map(|t| t.map(|t| f64::from(t) / 8.0)).collect();
            assert_eq!(&ms, expected_ms);
            assert!(ms[0] > ms[2] && ms[2] > Some(0.0));
        }
        let ct2: u64 = results.iter().map(|r| r.after_settling.ct2).sum();
        let samples: u32 = results.iter().map(|r| r.after_settling.samples).sum();
        let rms_nm = (ct2 as f64 / f64::from(samples)).sqrt() * case.settings.encoder_count_m * 1e9;
        assert!((rms_nm - expected.in_position_rms_nm.unwrap()).abs() < 1e-3);
    }

    #[test]
    fn the_moves_of_a_pass_do_not_depend_on_how_many_follow() {
        let case = case(Stage::default(), Compensator::None);
        let three = run(&case, 1, 4, 3).unwrap();
        assert_eq!(run(&case, 1, 4, 2).unwrap(), three[..2]);
        assert_ne!(run(&case, 1, 5, 2).unwrap(), three[..2]);
    }

    #[test]
    fn a_fault_leaves_the_rest_of_the_pass_unsettled() {
        let mut case = case(Stage::default(), Compensator::None);
        case.settings.following_error_max_m = 1e-6;
        let results = run(&case, 1, 0, 3).unwrap();
        assert!(results.iter().all(|r| r.fault.is_some() && r.settled_ticks == [None; 3]));
    }
}
