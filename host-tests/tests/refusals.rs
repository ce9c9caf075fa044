//! What the drive will not do, and what it says.

use servo_core::cascade::{CascadeGains, ParallelGains};
use servo_core::drive::Command;
use servo_core::parameters::Settings;
use servo_core::position::Position;
use servo_core::profile::Limits;
use servo_core::refusal::Refusal;
use servo_core::state::State;
use servo_host_tests::{Bench, tuning};
use servo_sim::Stage;

fn bench() -> Bench {
    let stage = Stage::default();
    Bench::new(&stage, &tuning::settings(&stage, &tuning::STANDARD).unwrap(), 3).unwrap()
}

fn to(target_m: f64, velocity_m_per_s: f32, acceleration_m_per_s2: f32) -> Command {
    let target = Position((target_m / (4e-6 / 65536.0)).round() as i64);
    Command::Move { target, limits: Limits { velocity_m_per_s, acceleration_m_per_s2, jerk_m_per_s3: None } }
}

fn jerky(jerk_m_per_s3: f32) -> Command {
    let limits = Limits { velocity_m_per_s: 0.1, acceleration_m_per_s2: 1.0, jerk_m_per_s3: Some(jerk_m_per_s3) };
    Command::Move { target: Position(0), limits }
}

#[test]
fn a_move_is_refused_with_field_value_and_range() {
    let mut bench = bench();
    bench.enable().unwrap();
    for (command, says) in [
        (to(0.06103515625, 0.1, 1.0), "target = 0.06103515625 m is outside -0.05 … 0.05 m"),
        (to(-0.0625, 0.1, 1.0), "target = -0.0625 m is outside -0.05 … 0.05 m"),
        (to(0.01, -0.25, 1.0), "velocity = -0.25 m/s is outside 0.000001 … 0.5 m/s"),
        (to(0.01, f32::NAN, 1.0), "velocity = NaN m/s is outside 0.000001 … 0.5 m/s"),
        (to(0.01, f32::INFINITY, 1.0), "velocity = inf m/s is outside 0.000001 … 0.5 m/s"),
        (to(0.01, 0.1, 0.0), "acceleration = 0 m/s² is outside 0.000000001 … 20 m/s²"),
        (to(0.01, 0.1, f32::NAN), "acceleration = NaN m/s² is outside 0.000000001 … 20 m/s²"),
        (jerky(0.0), "jerk = 0 m/s³ is outside 0.000001 … 1000000000 m/s³"),
        (jerky(f32::NAN), "jerk = NaN m/s³ is outside 0.000001 … 1000000000 m/s³"),
    ] {
        assert_eq!(bench.command(command).unwrap_err().to_string(), says);
    }
    bench.run(800, |_| ());
    assert!(bench.plant.position_m().abs() < 5e-9, "a refused move moves nothing");
}

#[test]
fn moving_needs_the_bridge_on_and_the_last_move_done() {
    let mut bench = bench();
    bench.run(5, |_| ());
    assert_eq!(bench.command(to(0.001, 0.1, 1.0)), Err(Refusal::WrongState(State::SwitchOnDisabled)));
    bench.enable().unwrap();
    bench.command(to(0.001, 0.1, 1.0)).unwrap();
    assert_eq!(bench.command(to(0.002, 0.1, 1.0)), Err(Refusal::Moving));
}

#[test]
fn enabling_needs_a_position_and_a_supply() {
    let mut bench = bench();
    for _ in 0..5 {
        bench.tick_with(None, |sample| sample.frame = u64::MAX);
    }
    let answer = bench.tick_with(Some(Command::Enable), |sample| sample.frame = u64::MAX).outcome;
    assert_eq!(answer, Some(Err(Refusal::NoPosition)));
    let answer = bench.tick_with(Some(Command::Enable), |sample| sample.bus_code = 8192).outcome.unwrap();
    assert_eq!(answer.unwrap_err().to_string(), "bus voltage = 10 V is outside 24 … 60 V");
}

#[test]
fn settings_are_refused_by_name_before_they_reach_the_drive() {
    let stage = Stage::default();
    for (change, says) in [
        (
            (|s: &mut Settings| s.niasa_time_constant_s = -0.01) as fn(&mut Settings),
            "niasa_time_constant_s = -0.01 s is outside 0.0001 … 10 s",
        ),
        (
            |s| s.velocity_gain_n_s_per_m = f64::NAN,
            "velocity_gain_n_s_per_m = NaN N s/m is outside 0.001 … 1000000 N s/m",
        ),
        (|s| s.over_current_a = 12.0, "over_current_a = 12 A is outside 8 … 9.95 A"),
        (|s| s.travel_max_m = -0.06, "travel_max_m = -0.06 m is outside -0.05 … 0.20634765625 m"),
        (|s| s.magnet_pitch_m = 0.5, "magnet_pitch_m = 0.5 m is outside 0.00000006103515625 … 0.06103515625 m"),
    ] {
        let mut settings = Settings::default();
        change(&mut settings);
        assert_eq!(Bench::new(&stage, &settings, 1).unwrap_err().to_string(), says);
    }
    let gains = ParallelGains { kp_n_per_m: 4e5, ki_n_per_m_s: f64::NAN, kd_n_s_per_m: 1000.0 };
    let says = CascadeGains::from_parallel(gains).unwrap_err().to_string();
    assert_eq!(says, "integral gain = NaN N/(m s) is outside 0 … 40000000 N/(m s)");
}
