//! The recorded run: complete, repeatable, and with the bits that were agreed upon.

use servo_core::axis::{Axis, ServoSample};
use servo_core::config::{Compensator, Config};
use servo_core::current::PhaseCodes;
use servo_core::fault::Fault;
use servo_core::record::flags;
use servo_host_tests::golden;
use servo_qemu::recording::Tick;
use servo_qemu::script;

const GOLDEN: &str = include_str!("../../qemu/golden.txt");

#[test]
fn every_field_of_a_recorded_tick_survives_the_bytes() {
    let phases = |n: u16| PhaseCodes { a: n, b: 0x8000 | n };
    let sample = ServoSample {
        phases: phases(0x1234),
        frame: 0x0123_4567_89ab_cdef,
        bus_code: 0xfedc,
        temperature_code: 0xba98,
        signals: 0x89ab_cdef,
        last_tick_cycles: 0x7654_3210,
    };
    let tick = Tick { sample, phases: std::array::from_fn(|i| phases(i as u16 + 1)) };
    assert_eq!(Tick::from_bytes(&tick.to_bytes()), tick);
    let other = Tick { sample: ServoSample { signals: 0x89ab_cdee, ..sample }, ..tick };
    assert_eq!(Tick::from_bytes(&other.to_bytes()), other);
}

#[test]
fn the_run_has_the_agreed_bits_and_its_recording_gives_them_again() {
    let (ticks, digest) = golden::record().unwrap();
    assert_eq!(golden::replay(&ticks).unwrap(), digest);
    assert_eq!(
        digest.to_string(),
        GOLDEN,
        "the bits of the recorded run have changed; if that is meant: cargo xtask qemu --bless"
    );
}

#[test]
fn the_run_passes_through_what_it_is_meant_to_cover() {
    let (ticks, _) = golden::record().unwrap();
    let mut axis = Axis::new(Config::new(&script::settings()).unwrap());
    let mut at_work = Vec::new();
    let (mut seen_flags, mut faults, mut refusals, mut captured) = (0, Vec::new(), 0, 0);
    for (number, tick) in (0..).zip(&ticks) {
        if number == script::SIN_COS_TICK {
            axis = Axis::new(script::sin_cos_config().unwrap());
        }
        if number == script::CAPTURE_TICK {
            axis.arm_capture(script::CAPTURE);
        }
        let output = axis.on_servo(&tick.sample, script::command(number).unwrap().as_ref());
        for phases in tick.phases {
            axis.on_period(phases);
        }
        let kind = axis.drive().config().compensator.kind;
        if output.record.flags & flags::BRIDGE_ON != 0 && !at_work.contains(&kind) {
            at_work.push(kind);
        }
        seen_flags |= output.record.flags;
        refusals += u32::from(matches!(output.outcome, Some(Err(_))));
        captured += u32::from(output.sample.is_some());
        if let Some(fault) = output.record.fault.filter(|fault| faults.last() != Some(fault)) {
            faults.push(fault);
        }
    }
    assert_eq!(at_work.len(), Compensator::ALL.len(), "only {at_work:?} with the bridge on");
    let all = flags::MOVING | flags::FORCE_LIMITED | flags::RATE_LIMITED | flags::COMPENSATED | flags::FRAME_BAD;
    assert_eq!(seen_flags & all, all);
    assert_eq!(faults, [Fault::EncoderLost, Fault::OverCurrent, Fault::BusUnderVoltage, Fault::EncoderFrozen]);
    assert_eq!((refusals, captured), (6, script::CAPTURE.samples));
    assert!(axis.drive().subdivisional_error_m().is_some(), "sine and cosine have taught nothing");
}
