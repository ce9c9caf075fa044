//! Every compensator on the drive: switched without a bump, and doing what chapter 4 of the thesis says of it.

use servo_core::compensator::Compensator;
use servo_core::config::Config;
use servo_core::drive::Command;
use servo_core::parameters::Settings;
use servo_core::position::Position;
use servo_core::profile::Limits;
use servo_core::state::State;
use servo_host_tests::{Bench, tuning};
use servo_sim::Stage;

/// Ticks of the 5 mm triangle at 1 m/s².
const PROFILE_TICKS: u32 = 1132;

fn settings() -> Settings {
    tuning::settings(&Stage::default(), &tuning::STANDARD).unwrap()
}

fn moving_bench(settings: &Settings, compensator: Compensator) -> Bench {
    let mut bench = Bench::new(&Stage::default(), settings, 7).unwrap();
    bench.enable().unwrap();
    bench.command(Command::Compensator(compensator)).unwrap();
    let target = Position((5e-3 / settings.encoder_count_m).round() as i64);
    let limits = Limits { velocity_m_per_s: 0.5, acceleration_m_per_s2: 1.0, jerk_m_per_s3: None };
    bench.command(Command::Move { target, limits }).unwrap();
    bench
}

#[test]
fn switching_between_any_two_in_mid_settling_does_not_step_the_force() {
    for from in Compensator::ALL {
        // 20 ms after the profile: integrators and models hold force.
        let mut settled = moving_bench(&settings(), from);
        settled.run(PROFILE_TICKS + 160, |_| ());
        for to in Compensator::ALL {
            let mut bench = settled.clone();
            let before = bench.tick(None).record;
            let after = bench.tick(Some(Command::Compensator(to))).record;
            // A quarter of a percent of full scale: noise, and a tick's work of the integrators.
            assert!((after.force_n - before.force_n).abs() < 0.2, "{from:?} → {to:?}: {before:?} {after:?}");
            bench.run(400, |_| ());
            assert_eq!(bench.axis.drive().state(), State::OperationEnabled, "{from:?} → {to:?}");
        }
    }
}

#[test]
fn switching_between_any_two_in_mid_profile_does_not_step_the_force_either() {
    for from in Compensator::ALL {
        let mut moving = moving_bench(&settings(), from);
        moving.run(400, |_| ());
        for to in Compensator::ALL {
            let mut bench = moving.clone();
            let before = bench.tick(None).record;
            let after = bench.tick(Some(Command::Compensator(to))).record;
            assert!((after.force_n - before.force_n).abs() < 0.01 * 78.0, "{from:?} → {to:?}: {before:?} {after:?}");
        }
    }
}

#[test]
fn feedforward_gives_no_new_force_once_the_reference_rests() {
    for model in 0..5 {
        let settings = Settings { feedforward_model: f64::from(model), ..settings() };
        let mut bench = moving_bench(&settings, Compensator::Feedforward);
        bench.run(PROFILE_TICKS + 2, |_| ());
        let at_end = bench.tick(None).record.compensator_n;
        assert!(at_end.abs() > 0.3, "model {model} has built up friction: {at_end}");
        bench.run(4000, |output| assert_eq!(output.record.compensator_n, at_end, "model {model}"));
    }
}

#[test]
fn scheduled_pd_leaves_a_steady_error_and_integral_action_does_not() {
    let error_nm = |compensator| {
        let mut bench = moving_bench(&settings(), compensator);
        bench.run(PROFILE_TICKS + 16_000, |_| ());
        (bench.plant.position_m() - 5e-3).abs() * 1e9
    };
    assert!(error_nm(Compensator::Niasa) < 1.0);
    assert!(error_nm(Compensator::NiasaMaxwell) < 1.0);
    assert!(error_nm(Compensator::DisturbanceObserver) < 3.0);
    // No integral action: what friction holds stays.
    assert!(error_nm(Compensator::ScheduledPd) > 10.0);
}

#[test]
fn new_parameters_of_the_acting_compensator_do_not_step_the_force() {
    for compensator in Compensator::ALL {
        let mut bench = moving_bench(&settings(), compensator);
        bench.run(PROFILE_TICKS + 160, |_| ());
        let other = Settings {
            compensator: f64::from(compensator as u8),
            friction_stiffness_n_per_m: 4e6,
            friction_coulomb_n: 0.4,
            friction_static_n: 0.5,
            niasa_stiffness_n_per_m: 8e6,
            schedule_share: 0.3,
            disturbance_bandwidth_hz: 10.0,
            ..settings()
        };
        let before = bench.tick(None).record;
        let config = Config::new(&other).unwrap();
        let after = bench.tick(Some(Command::Configure { config, needs_bridge_off: false })).record;
        assert!((after.force_n - before.force_n).abs() < 0.01 * 78.0, "{compensator:?}: {before:?} {after:?}");
    }
}
