//! The fast bench against the full one: the same drive, with and without motor, bridge and converters.

use servo_core::config::Compensator;
use servo_core::drive::Command;
use servo_core::position::Position;
use servo_core::settling::TOLERANCES;
use servo_host_tests::experiment::{self, FIVE_MM_SLOW, Steps};
use servo_host_tests::tuning::{self, HIGH_PERFORMANCE, STANDARD};
use servo_host_tests::{Bench, FastBench};
use servo_sim::Stage;

const FIVE_MM_FAST: Steps = Steps { step_m: 5e-3, acceleration_m_per_s2: 10.0, dwell_s: 1.0 };

/// Mean settling time on the full and on the fast bench, s, and of how many moves: those that settled on both.
fn means_s(
    tuning: &tuning::Tuning,
    steps: &Steps,
    compensator: Compensator,
    moves: u64,
) -> [(f64, f64, usize); TOLERANCES] {
    let stage = Stage::default();
    let settings = tuning::settings(&stage, tuning).unwrap();
    let full = experiment::run(&stage, &settings, compensator, steps, moves, 1).unwrap();
    let mut bench = FastBench::new(&stage, &settings, 1).unwrap();
    bench.enable().unwrap();
    bench.command(Command::Compensator(compensator)).unwrap();
    let fast: Vec<_> = (0..moves)
        .map(|index| {
            let target = steps.target(Position(0), index, settings.encoder_count_m);
            bench.redraw(index);
            bench.command(Command::Move { target, limits: steps.limits(&settings) }).unwrap();
            while bench.drive.settling().ticks < steps.dwell_ticks() || bench.is_moving() {
                bench.tick(None);
            }
            bench.drive.settling()
        })
        .collect();
    std::array::from_fn(|t| {
        let settled = full.iter().zip(&fast);
        let both: Vec<_> =
            settled.filter_map(|(a, b)| Some((a.settling.settled_after_s(t)?, b.settled_after_s(t)?))).collect();
        let n = both.len() as f64;
        (both.iter().map(|b| b.0).sum::<f64>() / n, both.iter().map(|b| b.1).sum::<f64>() / n, both.len())
    })
}

#[test]
fn both_benches_settle_alike_with_either_tuning_with_and_without_niasa() {
    for (tuning, steps) in [(STANDARD, FIVE_MM_SLOW), (HIGH_PERFORMANCE, FIVE_MM_FAST)] {
        for compensator in [Compensator::None, Compensator::Niasa] {
            for (t, (full_s, fast_s, settled)) in means_s(&tuning, &steps, compensator, 60).into_iter().enumerate() {
                let apart_s = (full_s - fast_s).abs();
                let case = format!("{tuning:?} {compensator:?} tolerance {t}: {full_s} s, {fast_s} s");
                assert!(settled >= 55, "{case}: {settled} moves");
                assert!(apart_s < 2e-3 || apart_s < 0.1 * full_s, "{case}");
            }
        }
    }
}

/// The largest steps of force there are: 18 N at either end of a phase of 10 m/s², fed forward. The voltage saturates.
#[test]
fn the_force_follows_its_set_point_alike() {
    let mut stage = Stage::default();
    (stage.friction.coulomb_n, stage.encoder.noise_m_rms) = (2e-3, 0.0);
    let settings = tuning::settings(&stage, &HIGH_PERFORMANCE).unwrap();
    let (mut full, mut fast) =
        (Bench::new(&stage, &settings, 1).unwrap(), FastBench::new(&stage, &settings, 1).unwrap());
    full.enable().unwrap();
    fast.enable().unwrap();
    let target = Position((5e-3 / settings.encoder_count_m).round() as i64);
    let command = Command::Move { target, limits: FIVE_MM_FAST.limits(&settings) };
    full.command(command).unwrap();
    fast.command(command).unwrap();
    let (mut impulse_n_s, mut largest_n) = ([0.0; 2], 0.0f64);
    for tick in 0..400 {
        full.tick(None);
        fast.tick(None);
        let (full_n, fast_n) = (full.plant.force_n(), fast.force_n());
        largest_n = largest_n.max(full_n.abs());
        assert!((full_n - fast_n).abs() < 0.05 * 18.0, "tick {tick}: {full_n} N, {fast_n} N");
        for (impulse, force_n) in impulse_n_s.iter_mut().zip([full_n, fast_n]) {
            *impulse += force_n.abs() * 125e-6;
        }
    }
    assert!(largest_n > 15.0);
    assert!((impulse_n_s[0] / impulse_n_s[1] - 1.0).abs() < 2e-3, "{impulse_n_s:?}");
}

#[test]
fn the_same_seed_and_move_give_the_same_bits_whatever_came_before() {
    let stage = Stage::default();
    let settings = tuning::settings(&stage, &STANDARD).unwrap();
    let run = |seed, first| {
        let mut bench = FastBench::new(&stage, &settings, seed).unwrap();
        bench.redraw(first);
        bench.redraw(5);
        bench.enable().unwrap();
        (0..800).map(|_| bench.tick(None).record.words()).collect::<Vec<_>>()
    };
    assert_eq!(run(1, 3), run(1, 4));
    assert_ne!(run(1, 3), run(2, 3));
}
