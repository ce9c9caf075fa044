//! From a command to a settled stage, on the host.

use servo_core::config::Compensator;
use servo_core::drive::Command;
use servo_core::position::Position;
use servo_core::profile::Limits;
use servo_core::record::flags;
use servo_core::settling::TOLERANCES;
use servo_core::state::State;
use servo_host_tests::experiment::{FIVE_MM_SLOW, Move};
use servo_host_tests::{Bench, experiment, tuning};
use servo_sim::Stage;

const LIGHT_STIFF: &str = include_str!("../../sim/stages/light-stiff.toml");

fn settled_bench(stage: &Stage) -> Bench {
    let settings = tuning::settings(stage, &tuning::STANDARD).unwrap();
    let mut bench = Bench::new(stage, &settings, 7).unwrap();
    bench.enable().unwrap();
    bench
}

fn five_mm(bench: &Bench) -> Command {
    let target = Position((5e-3 / bench.axis.drive().config().count_m).round() as i64);
    Command::Move { target, limits: Limits { velocity_m_per_s: 0.5, acceleration_m_per_s2: 1.0, jerk_m_per_s3: None } }
}

fn mean_s(moves: &[Move], tolerance: usize) -> f64 {
    let settled: Vec<f64> = moves.iter().filter_map(|m| m.settling.settled_after_s(tolerance)).collect();
    settled.iter().sum::<f64>() / settled.len() as f64
}

#[test]
fn enabling_moves_the_stage_by_less_than_the_encoder_noise() {
    let stage = Stage::default();
    let settings = tuning::settings(&stage, &tuning::STANDARD).unwrap();
    let mut bench = Bench::new(&stage, &settings, 7).unwrap();
    bench.enable().unwrap();
    assert!(bench.plant.position_m().abs() < 2e-9, "{}", bench.plant.position_m());
}

#[test]
fn a_move_arrives_and_stays() {
    let mut bench = settled_bench(&Stage::default());
    let command = five_mm(&bench);
    bench.command(command).unwrap();
    bench.run(3 * 8000, |_| ());
    assert!((bench.plant.position_m() - 5e-3).abs() < 3e-9, "{}", bench.plant.position_m());
    assert_eq!(bench.axis.drive().state(), State::OperationEnabled);
}

#[test]
fn niasa_settles_every_move_to_3_nm_and_at_least_70_percent_sooner_on_two_stages() {
    for stage in [Stage::default(), Stage::from_toml(LIGHT_STIFF).unwrap()] {
        let settings = tuning::settings(&stage, &tuning::STANDARD).unwrap();
        let [pid, niasa] = [Compensator::None, Compensator::Niasa]
            .map(|c| experiment::run(&stage, &settings, c, &FIVE_MM_SLOW, 10, 1).unwrap());
        for tolerance in 0..TOLERANCES {
            assert!(niasa.iter().all(|m| m.settling.settled_after_s(tolerance).is_some()));
            let reduction = 1.0 - mean_s(&niasa, tolerance) / mean_s(&pid, tolerance);
            assert!(reduction >= 0.7, "tolerance {tolerance}: {reduction:.3}, mass {}", stage.mechanics.mass_kg);
        }
        for m in &niasa {
            let noise_nm = f64::from(m.settling.noise_ct2.unwrap()).sqrt() * settings.encoder_count_m * 1e9;
            assert!(noise_nm < 1.0, "{noise_nm}");
        }
    }
}

#[test]
fn the_same_seed_gives_the_same_move_to_the_bit_and_another_seed_another() {
    let stage = Stage::default();
    let settings = tuning::settings(&stage, &tuning::STANDARD).unwrap();
    let run = |seed| experiment::run(&stage, &settings, Compensator::Niasa, &FIVE_MM_SLOW, 1, seed).unwrap();
    assert_eq!(run(1), run(1));
    assert_ne!(run(1), run(2));
}

#[test]
fn new_gains_in_mid_move_do_not_step_the_force() {
    let stage = Stage::default();
    let mut bench = settled_bench(&stage);
    let command = five_mm(&bench);
    bench.command(command).unwrap();
    bench.run(400, |_| ());
    let other = tuning::settings(&stage, &tuning::HIGH_PERFORMANCE).unwrap();
    let config = servo_core::config::Config::new(&other).unwrap();
    let before = bench.tick(None).record;
    let after = bench.tick(Some(Command::Configure { config, needs_bridge_off: false })).record;
    assert!(before.flags & flags::MOVING != 0 && after.flags & flags::MOVING != 0);
    // 1 % of full scale; what remains is the rate part, noise with another gain.
    assert!((after.force_n - before.force_n).abs() < 0.01 * 78.0, "{before:?} {after:?}");
    // And the drive goes on with the gains it was given.
    assert_eq!(bench.axis.drive().config(), &config);
}

#[test]
fn a_stop_brings_the_stage_to_rest_within_its_braking_distance() {
    let mut bench = settled_bench(&Stage::default());
    let command = five_mm(&bench);
    bench.command(command).unwrap();
    bench.run(560, |_| ());
    let at_m = bench.plant.position_m();
    bench.command(Command::Stop).unwrap();
    bench.run(8000, |_| ());
    // 70 mm/s braked at 20 m/s²: 0.12 mm.
    let gone_m = bench.plant.position_m() - at_m;
    assert!((0.0..0.2e-3).contains(&gone_m), "{gone_m}");
    assert_eq!(bench.axis.drive().state(), State::OperationEnabled);
}
