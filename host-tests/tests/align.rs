//! The drive looks for the motor's electrical zero on the whole simulated board: current loop, both phases' currents, dead time and noise.

use std::thread;

use servo_core::alignment::Reason;
use servo_core::axis::ServoOutput;
use servo_core::config::Config;
use servo_core::current::{DUTY_MAX, DUTY_MIN};
use servo_core::drive::{Command, Commutation};
use servo_core::fault::Fault;
use servo_core::parameters::Settings;
use servo_core::position::Position;
use servo_core::profile::Limits;
use servo_core::record::flags;
use servo_core::refusal::Refusal;
use servo_core::state::{ControlWord, State};
use servo_core::{PWM_TOP, SERVO_HZ};
use servo_host_tests::{Bench, tuning};
use servo_sim::Stage;

const PITCH_M: f64 = 0.03;
const TRAVEL_M: f64 = 200e-6;

/// A stage whose magnets are at `turns` of the electrical circle when it is in mid-travel.
fn stage(turns: f64) -> Stage {
    let mut stage = Stage::default();
    stage.motor.commutation_offset_m = turns * PITCH_M;
    stage
}

/// Settings of somebody who knows everything but the offset.
fn settings() -> Settings {
    let known = tuning::settings(&Stage::default(), &tuning::STANDARD).unwrap();
    Settings { commutation_identity: -1.0, ..known }
}

fn bench(stage: &Stage) -> Bench {
    let mut bench = Bench::new(stage, &settings(), 1).unwrap();
    bench.run(5, |_| ());
    bench
}

/// Aligns; how far the stage was from its beginning at most, m, and the last output.
fn align(bench: &mut Bench) -> (f64, ServoOutput) {
    let began_m = bench.plant.position_m();
    let mut furthest_m: f64 = 0.0;
    let mut command = Some(Command::Align);
    for tick in 0..10 * SERVO_HZ {
        let output = bench.tick(command.take());
        let other = output.record.fault.filter(|fault| *fault != Fault::Alignment);
        assert_eq!(other, None, "after {tick} ticks, heat {} A²", bench.axis.drive().heat_a2());
        furthest_m = furthest_m.max((bench.plant.position_m() - began_m).abs());
        if !matches!(bench.axis.drive().commutation(), Commutation::Unknown) {
            assert!(!output.bridge.enabled, "the bridge is off in the tick of the end");
            return (furthest_m, output);
        }
    }
    panic!("no end");
}

fn in_parallel(angles: u32, check: impl Fn(f64) + Sync) {
    let check = &check;
    thread::scope(|scope| {
        for part in 0..2 {
            scope
                .spawn(move || (part..angles).step_by(2).for_each(|start| check(f64::from(start) / f64::from(angles))));
        }
    });
}

#[test]
fn from_36_angles_the_zero_is_found_to_a_twentieth_of_a_degree_within_the_travel_and_the_stage_then_moves() {
    in_parallel(36, |turns| {
        let stage = stage(turns);
        let mut bench = bench(&stage);
        assert_eq!(bench.command(Command::Enable), Err(Refusal::NotAligned(None)));
        let (furthest_m, output) = align(&mut bench);
        assert_eq!((output.record.fault, output.record.state), (None, State::SwitchOnDisabled), "{turns}");
        assert!(furthest_m <= TRAVEL_M, "{furthest_m} m at {turns}");
        let Commutation::Found(zero) = bench.axis.drive().commutation() else {
            panic!("{:?} at {turns}", bench.axis.drive().commutation())
        };
        let count_m = bench.axis.drive().config().count_m;
        let wrong = ((zero.0 as f64 * count_m / PITCH_M + turns) + 0.5).rem_euclid(1.0) - 0.5;
        assert!(wrong.abs() < 0.05 / 360.0, "{} degrees off at {turns}", wrong * 360.0);

        bench.enable().unwrap();
        let target = Position((1e-3 / count_m) as i64);
        let limits = Limits { velocity_m_per_s: 0.05, acceleration_m_per_s2: 1.0, jerk_m_per_s3: None };
        bench.command(Command::Move { target, limits }).unwrap();
        bench.run(4_000, |output| assert_eq!(output.record.fault, None));
        assert!((bench.plant.position_m() - 1e-3).abs() < 50e-9, "{}", bench.plant.position_m());
    });
}

/// The drive's refusal to enable after an alignment that failed with fault 25, the stage having stayed within its bound.
fn refused(bench: &mut Bench) -> Refusal {
    let (furthest_m, output) = align(bench);
    assert_eq!(output.record.fault, Some(Fault::Alignment));
    assert!(furthest_m <= 1.001 * TRAVEL_M, "{furthest_m} m");
    bench.run(2, |_| ());
    bench.command(Command::ResetFault).unwrap();
    bench.command(Command::Enable).unwrap_err()
}

#[test]
fn a_blocked_stage_is_refused() {
    in_parallel(6, |turns| {
        // By the friction of a clamp, which is elastic for small motions, and between hard stops a micrometre apart.
        let (mut clamped, mut stopped) = (stage(turns), stage(turns));
        (clamped.friction.coulomb_n, clamped.friction.spread) = (1e3, None);
        stopped.mechanics.travel_m = 1e-6;
        for stage in [clamped, stopped] {
            let found = refused(&mut bench(&stage));
            assert_eq!(found, Refusal::NotAligned(Some(Reason::Blocked)), "{turns}");
        }
    });
}

#[test]
fn an_encoder_that_counts_backwards_is_refused() {
    in_parallel(12, |turns| {
        let mut bench = bench(&stage(turns));
        bench.plant.reverse_encoder();
        let found = refused(&mut bench);
        assert_eq!(found, Refusal::NotAligned(Some(Reason::Reversed)), "{turns}");
    });
}

#[test]
fn two_exchanged_phases_are_refused() {
    in_parallel(12, |turns| {
        let mut bench = bench(&stage(turns));
        bench.plant.exchange_phases();
        assert_eq!(refused(&mut bench), Refusal::NotAligned(Some(Reason::Reversed)), "{turns}");
    });
}

#[test]
fn an_open_phase_is_refused_before_the_stage_has_moved_by_a_micrometre() {
    in_parallel(12, |turns| {
        for open in 0..3 {
            let mut bench = bench(&stage(turns));
            bench.plant.set_open_phase(Some(open));
            let (furthest_m, output) = align(&mut bench);
            assert_eq!(output.record.fault, Some(Fault::Alignment), "phase {open} at {turns}");
            assert_eq!(
                bench.axis.drive().commutation(),
                Commutation::Failed(Reason::NoCurrent),
                "phase {open} at {turns}"
            );
            assert!(furthest_m < 1e-6, "{furthest_m} m");
        }
    });
}

#[test]
fn what_is_asked_for_meanwhile_is_refused_and_a_stop_or_a_controlword_ends_it() {
    let ways: [(Command, &str); 4] = [
        (Command::Disable, "disable"),
        (Command::Stop, "stop"),
        (Command::Control(ControlWord(0x06)), "shutdown"),
        (Command::Control(ControlWord(0x02)), "quick stop"),
    ];
    for (command, what) in ways {
        let mut bench = bench(&stage(0.3));
        bench.command(Command::Align).unwrap();
        bench.run(4_000, |_| ());
        let output = bench.tick(None);
        assert!(output.bridge.enabled && output.record.flags & flags::ALIGNING != 0);
        let limits = Limits { velocity_m_per_s: 0.05, acceleration_m_per_s2: 1.0, jerk_m_per_s3: None };
        let go = Command::Move { target: Position(1_000), limits };
        assert_eq!(bench.command(go), Err(Refusal::Aligning));
        assert_eq!(bench.command(Command::Enable), Err(Refusal::Aligning));
        assert_eq!(bench.command(Command::Align), Err(Refusal::WrongState(State::OperationEnabled)));
        assert!(bench.tick(None).bridge.enabled);
        let output = bench.tick(Some(command));
        assert_eq!((output.outcome, output.bridge.enabled, output.record.fault), (Some(Ok(())), false, None), "{what}");
        assert_eq!(bench.axis.drive().commutation(), Commutation::Unknown);
        bench.run(10, |output| assert!(!output.bridge.enabled));
        assert_eq!(bench.command(Command::Enable), Err(Refusal::NotAligned(None)));
    }
}

#[test]
fn a_fault_during_an_alignment_turns_the_bridge_off_and_never_brakes() {
    let settings = Settings { fault_reaction_option: 2.0, ..settings() };
    let mut bench = Bench::new(&stage(0.6), &settings, 1).unwrap();
    bench.run(5, |_| ());
    bench.command(Command::Align).unwrap();
    bench.run(8_000, |_| ());
    let hot = |bench: &mut Bench| bench.tick_with(None, |sample| sample.temperature_code = u16::MAX);
    let output = (0..4).map(|_| hot(&mut bench)).find(|output| output.record.fault.is_some()).unwrap();
    assert_eq!((output.record.fault, output.bridge.enabled), (Some(Fault::OverTemperature), false));
}

#[test]
fn an_offset_holds_for_the_encoder_that_it_was_found_with_and_no_other() {
    let known = tuning::settings(&Stage::default(), &tuning::STANDARD).unwrap();
    let new = Settings::default();
    let cases = [
        (new.encoder_identity, new.commutation_identity, Err(Refusal::NotAligned(None))),
        (0.0, 0.0, Ok(())),
        (4711.0, 4711.0, Ok(())),
        (4712.0, 4711.0, Err(Refusal::NotAligned(None))),
        (0.0, -1.0, Err(Refusal::NotAligned(None))),
    ];
    for (encoder_identity, commutation_identity, expected) in cases {
        let settings = Settings { encoder_identity, commutation_identity, ..known };
        let mut bench = Bench::new(&Stage::default(), &settings, 1).unwrap();
        bench.run(5, |_| ());
        assert_eq!(bench.command(Command::Enable), expected, "{encoder_identity} {commutation_identity}");
        bench.command(Command::Disable).unwrap();
        // A controlword that asks for the same gets the same answer.
        bench.run(5, |_| ());
        bench.command(Command::Control(ControlWord(0x06))).unwrap();
        bench.command(Command::Control(ControlWord(0x07))).unwrap();
        assert_eq!(bench.command(Command::Control(ControlWord(0x0f))), expected);
    }
}

#[test]
fn an_alignment_that_failed_is_undone_by_another_zero_only() {
    let known = tuning::settings(&Stage::default(), &tuning::STANDARD).unwrap();
    let mut bench = Bench::new(&Stage::default(), &known, 1).unwrap();
    bench.plant.exchange_phases();
    bench.run(5, |_| ());
    bench.command(Command::Align).unwrap();
    bench.run(10 * SERVO_HZ, |_| ());
    assert_eq!(bench.axis.drive().fault(), Some(Fault::Alignment));
    bench.command(Command::ResetFault).unwrap();
    let failed = Err(Refusal::NotAligned(Some(Reason::Reversed)));
    for (settings, expected) in
        [(Settings { travel_max_m: 0.04, ..known }, failed), (Settings { commutation_offset_m: 1e-3, ..known }, Ok(()))]
    {
        let config = Config::new(&settings).unwrap();
        bench.command(Command::Configure { config, needs_bridge_off: true }).unwrap();
        bench.run(5, |_| ());
        assert_eq!(bench.command(Command::Enable), expected);
        bench.command(Command::Disable).unwrap();
    }
}

#[test]
fn an_incremental_encoder_is_aligned_after_every_start_and_loses_it_with_its_position() {
    let mut stage = Stage::from_toml(include_str!("../../sim/stages/sin-cos.toml")).unwrap();
    stage.motor.commutation_offset_m = 0.4 * PITCH_M;
    let settings = tuning::settings(&stage, &tuning::STANDARD).unwrap();
    let mut bench = Bench::new(&stage, &settings, 1).unwrap();
    bench.run(5, |_| ());
    let config = Config::new(&settings).unwrap();
    bench.command(Command::Configure { config, needs_bridge_off: true }).unwrap();
    bench.run(5, |_| ());
    assert_eq!(bench.command(Command::Enable), Err(Refusal::NotAligned(None)));
    let (_, output) = align(&mut bench);
    assert_eq!(output.record.fault, None);
    bench.enable().unwrap();
    bench.command(Command::Disable).unwrap();
    for _ in 0..4 {
        bench.tick_with(None, |sample| sample.frame = 0);
    }
    bench.run(2, |_| ());
    assert_eq!(bench.command(Command::Enable), Err(Refusal::NotAligned(None)));
}

/// Compares in the tick: no duty of an alignment is outside the limits.
#[test]
fn the_duties_of_an_alignment_stay_within_their_limits() {
    let mut bench = bench(&stage(0.1));
    bench.command(Command::Align).unwrap();
    let [least, most] = [DUTY_MIN, DUTY_MAX].map(|duty| (duty * f32::from(PWM_TOP)).round() as u16);
    bench.run(4 * SERVO_HZ, |output| {
        assert!(output.bridge.compare.iter().all(|on| (least..=most).contains(on)), "{:?}", output.bridge);
    });
}
