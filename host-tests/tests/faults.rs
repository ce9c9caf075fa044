//! Whatever is wrong, the bridge is off in the tick that sees it, and the drive says why.

use servo_core::axis::{ServoOutput, ServoSample};
use servo_core::current::PhaseCodes;
use servo_core::drive::Command;
use servo_core::encoder::tracker::LOST_AFTER;
use servo_core::fault::{Fault, Reaction};
use servo_core::monitor::signals;
use servo_core::parameters::Settings;
use servo_core::position::Position;
use servo_core::profile::Limits;
use servo_core::record::flags;
use servo_core::refusal::Refusal;
use servo_core::state::State;
use servo_host_tests::{Bench, tuning};
use servo_sim::Stage;

const FIVE_MM: Position = Position(81_920_000);

fn settings(stage: &Stage) -> Settings {
    tuning::settings(stage, &tuning::STANDARD).unwrap()
}

/// A drive with `settings` on `stage`, `ticks_into_move` into 5 mm at 1 m/s².
fn moving_with(stage: &Stage, settings: &Settings, ticks_into_move: u32) -> Bench {
    let mut bench = Bench::new(stage, settings, 3).unwrap();
    bench.enable().unwrap();
    let limits = Limits { velocity_m_per_s: 0.5, acceleration_m_per_s2: 1.0, jerk_m_per_s3: None };
    bench.command(Command::Move { target: FIVE_MM, limits }).unwrap();
    bench.run(ticks_into_move, |_| ());
    bench
}

fn moving_bench(ticks_into_move: u32) -> Bench {
    let stage = Stage::default();
    moving_with(&stage, &settings(&stage), ticks_into_move)
}

/// Feeds tampered samples until the bridge is off; the tick that did it and how many it took.
fn until_off(bench: &mut Bench, mut tamper: impl FnMut(&mut ServoSample)) -> (ServoOutput, u32) {
    for ticks in 1..4000 {
        let output = bench.tick_with(None, &mut tamper);
        if !output.bridge.enabled {
            return (output, ticks);
        }
        assert_eq!(output.record.fault, None, "a fault with the bridge on");
    }
    panic!("the bridge stayed on");
}

/// A frame as the encoder sends it, built bit by bit: start, CDS, position, nError, nWarning, inverted CRC-6.
fn frame(counts: u32, error: bool, warning: bool) -> u64 {
    let data = u64::from(counts) << 2 | u64::from(!error) << 1 | u64::from(!warning);
    let crc = (0..34).rev().fold(0u64, |crc, i| {
        let feedback = crc >> 5 & 1 ^ data >> i & 1;
        (crc << 1 & 0x3f) ^ if feedback == 1 { 0x03 } else { 0 }
    });
    0b10_u64 << 62 | 1 << 61 | data << 26 | (!crc & 0x3f) << 20
}

type Tamper = fn(&mut ServoSample);

#[test]
fn every_fault_seen_in_a_sample_turns_the_bridge_off_in_time_and_is_latched_with_its_cause() {
    let cases: &[(Fault, u32, Tamper)] = &[
        (Fault::OverCurrent, 2, |s| s.phases.a = u16::MAX),
        (Fault::OverCurrent, 2, |s| s.phases.b = 0),
        (Fault::BridgeFault, 1, |s| s.signals = signals::BRIDGE_FAULT),
        (Fault::BusOverVoltage, 1, |s| s.bus_code = (60.1 / 80.0 * 65536.0) as u16),
        (Fault::BusOverVoltage, 1, |s| s.bus_code = u16::MAX),
        (Fault::BusUnderVoltage, 1, |s| s.bus_code = (23.9 / 80.0 * 65536.0) as u16),
        (Fault::BusUnderVoltage, 1, |s| s.bus_code = 0),
        (Fault::OverTemperature, 4, |s| s.temperature_code = (131.0 / 330.0 * 65536.0) as u16),
        (Fault::TemperatureSensor, 4, |s| s.temperature_code = 0),
        (Fault::TemperatureSensor, 4, |s| s.temperature_code = 654),
        (Fault::EncoderLost, u32::from(LOST_AFTER), |s| s.frame = u64::MAX),
        (Fault::EncoderLost, u32::from(LOST_AFTER), |s| s.frame = 0),
        (Fault::EncoderLost, u32::from(LOST_AFTER), |s| s.frame = 1 << 63 | s.frame >> 48),
        (Fault::EncoderChecksum, u32::from(LOST_AFTER), |s| s.frame ^= 1 << 30),
        (Fault::EncoderErrorBit, u32::from(LOST_AFTER), |s| s.frame = frame(0x8000_0000, true, false)),
        (Fault::EncoderJump, 1, |s| s.frame = frame(0x8000_0000, false, false)),
        (Fault::TickOverrun, 1, |s| s.last_tick_cycles = 10_001),
        (Fault::TaskHung, 1, |s| s.signals = signals::TASK_HUNG),
        (Fault::StackLow, 1, |s| s.signals = signals::STACK_LOW),
    ];
    for (fault, within, tamper) in cases {
        let mut bench = moving_bench(300);
        let (output, ticks) = until_off(&mut bench, tamper);
        assert!(ticks <= *within, "{fault:?} after {ticks}");
        // Over-current trips in any PWM period; the tick after it says so.
        assert!(output.record.fault == Some(*fault) || *fault == Fault::OverCurrent, "{fault:?}");
        bench.run(3, |output| assert!(!output.bridge.enabled));
        assert_eq!((bench.axis.drive().state(), bench.axis.drive().fault()), (State::Fault, Some(*fault)));
        assert_eq!(bench.command(Command::Enable), Err(Refusal::WrongState(State::Fault)), "latched");
        bench.command(Command::ResetFault).unwrap();
        bench.run(2, |_| ());
        assert_eq!((bench.axis.drive().state(), bench.axis.drive().fault()), (State::SwitchOnDisabled, None));
    }
}

#[test]
fn what_ended_the_last_run_is_a_fault_of_the_first_tick_of_this_one() {
    for (signal, fault) in [(signals::PANICKED, Fault::Panic), (signals::WATCHDOG_RESET, Fault::WatchdogReset)] {
        let stage = Stage::default();
        let mut bench = Bench::new(&stage, &settings(&stage), 3).unwrap();
        bench.tick_with(None, |s| s.signals = signal);
        bench.run(3, |_| ());
        assert_eq!((bench.axis.drive().state(), bench.axis.drive().fault()), (State::Fault, Some(fault)));
        assert!(bench.command(Command::Enable).is_err());
        bench.command(Command::ResetFault).unwrap();
        bench.enable().unwrap();
    }
}

#[test]
fn a_frozen_encoder_is_seen_within_three_frames_in_motion_and_after_its_ticks_at_rest() {
    // At some 5, 37 and 70 mm/s; the reading that stays is new once, so that three repetitions take four ticks.
    for (ticks_into_move, within) in [(50, 4), (300, 2), (560, 2)] {
        let mut bench = moving_bench(ticks_into_move);
        let stuck = bench.plant.encoder_frame();
        let (output, ticks) = until_off(&mut bench, |s| s.frame = stuck);
        assert_eq!(output.record.fault, Some(Fault::EncoderFrozen), "{ticks_into_move}");
        assert!(ticks <= within, "{ticks_into_move}: {ticks}");
    }

    let mut bench = moving_bench(3 * 8000);
    let stuck = bench.plant.encoder_frame();
    let (output, ticks) = until_off(&mut bench, |s| s.frame = stuck);
    assert_eq!(output.record.fault, Some(Fault::EncoderFrozen));
    assert!((80..=82).contains(&ticks), "{ticks}");
}

#[test]
fn an_encoder_without_noise_may_stand_still_if_the_drive_is_told_so() {
    let mut stage = Stage::default();
    stage.encoder.noise_m_rms = 0.0;
    let mut bench = moving_with(&stage, &settings(&stage), 3 * 8000);
    let stuck = bench.plant.encoder_frame();
    for _ in 0..8000 {
        assert_eq!(bench.tick_with(None, |s| s.frame = stuck).record.fault, None);
    }
}

#[test]
fn the_warning_bit_warns_and_is_no_fault() {
    let mut bench = moving_bench(3 * 8000);
    let at = 0x8000_0000 + FIVE_MM.0 as u32;
    let mut noise = 0;
    for _ in 0..100 {
        noise = (noise * 7 + 5) % 13;
        let record = bench.tick_with(None, |s| s.frame = frame(at + noise, false, true)).record;
        assert_eq!((record.fault, record.flags & flags::ENCODER_WARNING), (None, flags::ENCODER_WARNING));
        assert_ne!(bench.axis.drive().status_word(&record) & servo_core::state::status::WARNING, 0);
    }
}

#[test]
fn a_stage_that_does_not_follow_is_a_following_error() {
    // Held by a friction that the current limit does not overcome: the encoder is well, the stage is not.
    let mut stage = Stage::default();
    stage.friction.coulomb_n = 90.0;
    let settings = Settings { niasa_coulomb_n: 0.6, ..settings(&Stage::default()) };
    let mut bench = moving_with(&stage, &settings, 0);
    let (output, ticks) = until_off(&mut bench, |_| ());
    assert_eq!(output.record.fault, Some(Fault::FollowingError));
    // 200 µm at 1 m/s² take 20 ms.
    assert!(ticks < 200, "{ticks}");
}

#[test]
fn a_stage_that_departs_is_a_runaway_before_it_is_a_following_error() {
    let mut stage = Stage::default();
    stage.mechanics.mass_kg = 0.2;
    let settings = Settings { following_error_max_m: 5e-3, over_current_a: 9.9, ..settings(&stage) };
    let mut bench = moving_with(&stage, &settings, 3 * 8000);
    // Something pulls with more than the motor has.
    bench.plant.set_external_force_n(80.0);
    let (output, ticks) = until_off(&mut bench, |_| ());
    assert_eq!(output.record.fault, Some(Fault::Runaway), "after {ticks}");
    assert!(output.record.error_ct == 0 && ticks < 40, "{ticks}");
}

#[test]
fn a_reversed_commutation_is_seen_before_the_stage_has_gone_far() {
    for offset_m in [15e-3, -15e-3, 12e-3] {
        let stage = Stage::default();
        let settings = Settings { commutation_offset_m: offset_m, following_error_max_m: 2e-3, ..settings(&stage) };
        let mut bench = Bench::new(&stage, &settings, 3).unwrap();
        bench.run(5, |_| ());
        bench.command(Command::Enable).unwrap();
        bench.run(2, |_| ());
        assert_eq!(bench.axis.drive().state(), State::OperationEnabled);
        // At rest friction holds what the loop cannot: it takes a motion to show.
        let limits = Limits { velocity_m_per_s: 0.5, acceleration_m_per_s2: 1.0, jerk_m_per_s3: None };
        bench.command(Command::Move { target: FIVE_MM, limits }).unwrap();
        let from_m = bench.plant.position_m();
        let (output, _) = until_off(&mut bench, |_| ());
        let gone_m = (bench.plant.position_m() - from_m).abs();
        assert!(
            matches!(output.record.fault, Some(Fault::WrongCommutation | Fault::Runaway)),
            "{:?} {offset_m}",
            output.record.fault
        );
        assert!(gone_m < 200e-6, "{gone_m:e} m");
    }
}

#[test]
fn overspeed_is_seen_in_the_tick_that_is_too_fast() {
    let stage = Stage::default();
    let settings = Settings { overspeed_m_per_s: 0.05, ..settings(&stage) };
    let mut bench = moving_with(&stage, &settings, 0);
    let (output, ticks) = until_off(&mut bench, |_| ());
    assert_eq!(output.record.fault, Some(Fault::Overspeed));
    // 50 mm/s are reached after 50 ms at 1 m/s², give and take what the loop swings.
    assert!((360..420).contains(&ticks), "{ticks}");
}

#[test]
fn leaving_the_travel_by_more_than_the_margin_is_a_position_limit() {
    let stage = Stage::default();
    let mut bench = moving_with(&stage, &settings(&stage), 3 * 8000);
    // The limits move, not the stage: what counts is where they are to each other.
    let inside = Settings { travel_max_m: 4.95e-3, travel_margin_m: 1e-4, ..settings(&stage) };
    let outside = Settings { travel_max_m: 4.85e-3, ..inside };
    let configure = |settings: &Settings| Command::Configure {
        config: servo_core::config::Config::new(settings).unwrap(),
        needs_bridge_off: false,
    };
    bench.command(configure(&inside)).unwrap();
    bench.run(100, |output| assert_eq!(output.record.fault, None));
    let mut output = bench.tick(Some(configure(&outside)));
    let mut ticks = 0;
    while output.bridge.enabled {
        output = bench.tick(None);
        ticks += 1;
    }
    assert_eq!(output.record.fault, Some(Fault::PositionLimit));
    assert!(ticks <= 4, "{ticks}");
}

#[test]
fn a_silent_host_turns_the_bridge_off_and_one_that_keeps_in_touch_does_not() {
    let stage = Stage::default();
    let settings = Settings { command_timeout_s: 0.05, ..settings(&stage) };
    let mut bench = Bench::new(&stage, &settings, 3).unwrap();
    bench.run(5, |_| ());
    bench.command(Command::Enable).unwrap();
    for _ in 0..20 {
        bench.run(300, |output| assert_eq!(output.record.fault, None));
        bench.command(Command::KeepAlive).unwrap();
    }
    let (output, ticks) = until_off(&mut bench, |_| ());
    assert_eq!(output.record.fault, Some(Fault::CommandTimeout));
    assert!((400..=404).contains(&ticks), "{ticks}");
}

#[test]
fn too_much_current_for_too_long_is_an_overload_and_the_model_is_the_exponential_it_claims_to_be() {
    let stage = Stage::default();
    let settings = Settings { continuous_current_a: 0.5, thermal_time_constant_s: 0.1, ..settings(&stage) };
    let mut bench = moving_with(&stage, &settings, 3 * 8000);
    // A steady push of 1 A: the mean square passes (0.5 A)² after −τ ln(1 − 0.25) = 28.8 ms.
    bench.plant.set_external_force_n(7.8);
    let (output, ticks) = until_off(&mut bench, |_| ());
    assert_eq!(output.record.fault, Some(Fault::MotorOverload));
    let expected = -0.1 * (1.0f64 - 0.25).ln() * 8000.0;
    // The loop takes some 3 ms to push back.
    assert!((f64::from(ticks) - expected).abs() < 40.0, "{ticks} instead of {expected:.0}");
    // Off, it cools with the same time constant.
    let hot = bench.axis.drive().heat_a2();
    bench.run(800, |_| ());
    assert!((bench.axis.drive().heat_a2() / hot - (-1.0f32).exp()).abs() < 0.01);
}

#[test]
fn a_fault_is_acknowledged_in_state_fault_only() {
    // In the very tick that would see it: an over-current since the last tick.
    let mut bench = moving_bench(500);
    bench.tick_lying(|phases| phases.a = u16::MAX);
    let output = bench.tick(Some(Command::ResetFault));
    assert_eq!((output.bridge.enabled, output.record.fault), (false, Some(Fault::OverCurrent)));

    // While the drive still brakes, though the cause is gone.
    let stage = Stage::default();
    let mut bench = moving_with(&stage, &Settings { fault_reaction_option: 2.0, ..settings(&stage) }, 500);
    while bench.axis.drive().state() == State::OperationEnabled {
        bench.tick_with(None, |s| s.temperature_code = u16::MAX);
    }
    assert_eq!(bench.command(Command::ResetFault), Err(Refusal::WrongState(State::FaultReactionActive)));
    bench.run(1_000, |output| assert_eq!(output.record.fault, Some(Fault::OverTemperature)));
    assert_eq!(bench.command(Command::ResetFault), Ok(()));
}

#[test]
fn a_fault_that_may_brake_brakes_to_rest_if_asked_and_any_other_one_ends_that_at_once() {
    let stage = Stage::default();
    let settings = Settings { fault_reaction_option: 2.0, quick_stop_m_per_s2: 20.0, ..settings(&stage) };
    let hot: Tamper = |s| s.temperature_code = u16::MAX;
    let mut bench = moving_with(&stage, &settings, 500);
    let mut reacting = 0;
    for _ in 0..400 {
        let output = bench.tick_with(None, hot);
        if output.record.state == State::FaultReactionActive {
            assert!(output.bridge.enabled);
            reacting += 1;
        } else if output.record.state == State::Fault {
            assert!(!output.bridge.enabled);
            break;
        }
    }
    // 62 mm/s at 20 m/s²: 3.1 ms, and 20 ms for the stage to follow.
    assert!((180..195).contains(&reacting), "{reacting}");
    let left_m_per_s = bench.plant.velocity_m_per_s();
    assert!(left_m_per_s.abs() < 1e-3, "{left_m_per_s}");

    let mut bench = moving_with(&stage, &settings, 500);
    for _ in 0..8 {
        bench.tick_with(None, hot);
    }
    assert_eq!(bench.axis.drive().state(), State::FaultReactionActive);
    let output = bench.tick_with(None, |s| s.signals = signals::BRIDGE_FAULT);
    assert!(!output.bridge.enabled);
    assert_eq!(bench.axis.drive().fault(), Some(Fault::OverTemperature), "the first one is kept");
    assert_eq!(Fault::BridgeFault.reaction(), Reaction::Off);
}

#[test]
fn a_drive_that_brakes_in_a_fault_turns_off_when_the_option_to_do_so_is_taken_back() {
    let stage = Stage::default();
    let settings = Settings { fault_reaction_option: 2.0, quick_stop_m_per_s2: 20.0, ..settings(&stage) };
    let mut bench = moving_with(&stage, &settings, 500);
    while bench.axis.drive().state() != State::FaultReactionActive {
        bench.tick_with(None, |s| s.temperature_code = u16::MAX);
    }
    // The cause is gone, the braking goes on.
    bench.run(5, |output| assert!(output.bridge.enabled));
    let config = servo_core::config::Config::new(&Settings { fault_reaction_option: 0.0, ..settings }).unwrap();
    let output = bench.tick(Some(Command::Configure { config, needs_bridge_off: false }));
    assert_eq!(output.outcome, Some(Ok(())));
    assert_eq!((output.bridge.enabled, output.record.state), (false, State::Fault));
    assert_eq!(output.record.fault, Some(Fault::OverTemperature));
}

#[test]
fn a_reset_while_the_cause_lasts_does_not_leave_fault() {
    let mut bench = moving_bench(300);
    let broken: Tamper = |s| s.signals = signals::BRIDGE_FAULT;
    until_off(&mut bench, broken);
    bench.tick_with(None, broken);
    for _ in 0..5 {
        let answer = bench.tick_with(Some(Command::ResetFault), broken).outcome;
        assert_eq!(answer, Some(Err(Refusal::FaultPersists(Fault::BridgeFault))));
    }
    assert_eq!(bench.axis.drive().state(), State::Fault);
    assert_eq!(bench.axis.drive().fault(), Some(Fault::BridgeFault));
}

#[test]
fn the_first_fault_is_kept_when_others_follow() {
    let mut bench = moving_bench(300);
    until_off(&mut bench, |s| s.bus_code = u16::MAX);
    bench.tick_with(None, |s| s.signals = signals::BRIDGE_FAULT);
    assert_eq!(bench.axis.drive().fault(), Some(Fault::BusOverVoltage));
}

/// Converters that answer nonsense: open or at an end, or stuck anywhere, in one phase or both.
#[test]
fn a_current_converter_that_lies_ends_in_a_fault_before_the_stage_has_gone_far() {
    let liars: &[fn(&mut PhaseCodes)] = &[
        |p| p.a = 0,
        |p| p.a = u16::MAX,
        |p| p.b = 0,
        |p| (p.a, p.b) = (u16::MAX, u16::MAX),
        |p| (p.a, p.b) = (0, 0),
        |p| (p.a, p.b) = (32_768, 32_768),
        |p| p.a = 32_768,
        |p| p.b = 32_768,
        |p| p.a = 34_000,
        |p| p.b = 31_000,
    ];
    for (case, lie) in liars.iter().enumerate() {
        let mut bench = moving_bench(300);
        let from_m = bench.plant.position_m();
        let mut ticks = 0;
        while bench.axis.drive().fault().is_none() {
            bench.tick_lying(lie);
            ticks += 1;
            assert!(ticks < 400, "liar {case} goes unseen");
        }
        assert!((bench.plant.position_m() - from_m).abs() < 3e-3, "liar {case}");
    }
}

#[test]
fn limits_that_act_are_flagged_and_are_no_faults() {
    let stage = Stage::default();
    let settings = Settings { current_limit_a: 0.2, following_error_max_m: 1e-3, ..settings(&stage) };
    let mut bench = Bench::new(&stage, &settings, 3).unwrap();
    bench.enable().unwrap();
    let limits = Limits { velocity_m_per_s: 0.5, acceleration_m_per_s2: 1.0, jerk_m_per_s3: None };
    bench.command(Command::Move { target: Position(819_200), limits }).unwrap();
    let mut seen = 0;
    bench.run(400, |output| seen |= output.record.flags);
    assert_eq!(bench.axis.drive().fault(), None);
    assert_ne!(seen & flags::FORCE_LIMITED, 0);

    // 20 m/s² fed forward: 36 N at once are more than the bus drives through the winding.
    let settings =
        Settings { feedforward_mass_kg: 1.8, ..tuning::settings(&stage, &tuning::HIGH_PERFORMANCE).unwrap() };
    let mut bench = Bench::new(&stage, &settings, 3).unwrap();
    bench.enable().unwrap();
    let limits = Limits { velocity_m_per_s: 0.5, acceleration_m_per_s2: 20.0, jerk_m_per_s3: None };
    bench.command(Command::Move { target: FIVE_MM, limits }).unwrap();
    let mut seen = 0;
    bench.run(400, |output| seen |= output.record.flags);
    assert_eq!(bench.axis.drive().fault(), None);
    assert_ne!(seen & flags::VOLTAGE_LIMITED, 0);
}
