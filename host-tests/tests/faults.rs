//! Whatever is wrong, the bridge is off in the tick that sees it, and the drive says why.

use servo_core::axis::{ServoOutput, ServoSample};
use servo_core::drive::Command;
use servo_core::encoder::tracker::LOST_AFTER;
use servo_core::fault::Fault;
use servo_core::position::Position;
use servo_core::profile::Limits;
use servo_core::refusal::Refusal;
use servo_core::state::State;
use servo_host_tests::{Bench, tuning};
use servo_sim::Stage;

fn moving_bench(ticks_into_move: u32) -> Bench {
    let stage = Stage::default();
    let mut bench = Bench::new(&stage, &tuning::settings(&stage, &tuning::STANDARD).unwrap(), 3).unwrap();
    bench.enable().unwrap();
    let limits = Limits { velocity_m_per_s: 0.5, acceleration_m_per_s2: 1.0, jerk_m_per_s3: None };
    bench.command(Command::Move { target: Position(81_920_000), limits }).unwrap();
    bench.run(ticks_into_move, |_| ());
    bench
}

/// Feeds tampered samples until the bridge is off; the tick that did it and how many it took.
fn until_off(bench: &mut Bench, mut tamper: impl FnMut(&mut ServoSample)) -> (ServoOutput, u32) {
    for ticks in 1..400 {
        let output = bench.tick_with(None, &mut tamper);
        if !output.bridge.enabled {
            return (output, ticks);
        }
    }
    panic!("the bridge stayed on");
}

type Tamper = fn(&mut ServoSample);

#[test]
fn every_provoked_fault_turns_the_bridge_off_in_time_and_is_latched_with_its_cause() {
    let cases: &[(Fault, u32, Tamper)] = &[
        (Fault::OverCurrent, 2, |s| s.phases.a = u16::MAX),
        (Fault::BridgeFault, 1, |s| s.bridge_fault = true),
        (Fault::BusOverVoltage, 1, |s| s.bus_code = (62.0 / 80.0 * 65536.0) as u16),
        (Fault::BusUnderVoltage, 1, |s| s.bus_code = (20.0 / 80.0 * 65536.0) as u16),
        (Fault::EncoderLost, u32::from(LOST_AFTER), |s| s.frame = u64::MAX),
        (Fault::EncoderLost, u32::from(LOST_AFTER), |s| s.frame = 0),
        (Fault::EncoderLost, u32::from(LOST_AFTER), |s| s.frame ^= 1 << 30),
        (Fault::TickOverrun, 1, |s| s.last_tick_cycles = 10_001),
    ];
    for (fault, within, tamper) in cases {
        let mut bench = moving_bench(300);
        let (_, ticks) = until_off(&mut bench, tamper);
        assert!(ticks <= *within, "{fault:?} after {ticks}");
        bench.run(3, |_| ());
        assert_eq!((bench.axis.drive().state(), bench.axis.drive().fault()), (State::Fault, Some(*fault)));
        assert_eq!(bench.command(Command::Enable), Err(Refusal::WrongState(State::Fault)), "latched");
        bench.command(Command::ResetFault).unwrap();
        bench.run(2, |_| ());
        assert_eq!((bench.axis.drive().state(), bench.axis.drive().fault()), (State::SwitchOnDisabled, None));
    }
}

#[test]
fn a_reset_while_the_cause_lasts_does_not_leave_fault() {
    let mut bench = moving_bench(300);
    until_off(&mut bench, |s| s.bridge_fault = true);
    for _ in 0..5 {
        let answer = bench.tick_with(Some(Command::ResetFault), |s| s.bridge_fault = true).outcome;
        assert_eq!(answer, Some(Err(Refusal::FaultPersists(Fault::BridgeFault))));
    }
    assert_eq!(bench.axis.drive().state(), State::Fault);
    assert_eq!(bench.axis.drive().fault(), Some(Fault::BridgeFault));
}

#[test]
fn a_stage_held_fast_is_a_following_error() {
    let mut bench = moving_bench(0);
    let stuck = bench.plant.encoder_frame();
    let (output, ticks) = until_off(&mut bench, |s| s.frame = stuck);
    assert_eq!(output.record.fault, Some(Fault::FollowingError));
    // 200 µm at 1 m/s² take 20 ms.
    assert!(ticks < 165, "{ticks}");
}

#[test]
fn the_first_fault_is_kept_when_others_follow() {
    let mut bench = moving_bench(300);
    until_off(&mut bench, |s| s.bus_code = u16::MAX);
    bench.tick_with(None, |s| s.bridge_fault = true);
    assert_eq!(bench.axis.drive().fault(), Some(Fault::BusOverVoltage));
}

/// Position of the stage, m, over 200 ticks in which the first `bad` frames are replaced.
fn path_after_bad_frames(bad: u32, ticks_into_move: u32, replace: Tamper) -> Vec<f64> {
    let mut bench = moving_bench(ticks_into_move);
    (0..200)
        .map(|tick| {
            bench.tick_with(None, |s| {
                if tick < bad {
                    replace(s)
                }
            });
            assert_eq!(bench.axis.drive().state(), State::OperationEnabled);
            bench.plant.position_m()
        })
        .collect()
}

#[test]
fn one_or_two_bad_frames_move_the_stage_no_more_than_the_noise_that_they_replace() {
    // In mid-move at 37 mm/s the stage is a free mass: the noise of one reading (0.44 nm) through the D part (912 N s/m) is a kick
    // of 0.2 µm/s, which a 100 Hz loop brings back after some 0.4 nm; two of them are allowed per frame. At rest the contact stiffness
    // (17.3 N/µm) gives way to the same 4.5 mN by 0.26 nm.
    for (ticks_into_move, allowed_m) in [(300, 0.8e-9), (4 * 8000, 0.26e-9)] {
        let clean = path_after_bad_frames(0, ticks_into_move, |_| ());
        for bad in [1, 2] {
            let broken: [Tamper; 4] =
                [|s| s.frame = u64::MAX, |s| s.frame = 0, |s| s.frame ^= 1 << 35, |s| s.frame ^= 0b11 << 20];
            for replace in broken {
                let disturbed = path_after_bad_frames(bad, ticks_into_move, replace);
                let worst = clean.iter().zip(&disturbed).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
                assert!(worst < f64::from(bad) * allowed_m, "{bad} bad frames at {ticks_into_move}: {worst:e} m");
            }
        }
    }
}
