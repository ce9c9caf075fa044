//! Broken hardware, with the loop closed: each fault is seen in time, the bridge is off, and the drive says why.

mod common;

use std::time::Duration;

use common::{enabled, five_mm, status};
use servo_core::fault::Fault;
use servo_core::state::State;
use servo_protocol::message::{Reply, Request};
use servo_virtual_board::{AdcFault, Analog, EncoderFault, Lasting, Link, VirtualBoard};

const PWM_PERIOD_NS: u64 = 25_000;
const SERVO_PERIOD_NS: u64 = 125_000;

/// A board in mid-move, at some 60 mm/s.
fn moving() -> (VirtualBoard, Link) {
    let (mut board, mut link) = enabled();
    assert!(matches!(link.request(&mut board, &five_mm()).unwrap(), Reply::Done { .. }));
    board.run_for(Duration::from_millis(60)).unwrap();
    assert!(board.bridge_enabled().unwrap());
    (board, link)
}

/// Time until the bridge is off, to a microsecond, at most `limit_ns`.
fn time_to_off_ns(board: &mut VirtualBoard, limit_ns: u64) -> Option<u64> {
    let start_ns = board.time_ns();
    while board.time_ns() - start_ns < limit_ns {
        board.run_for(Duration::from_micros(1)).unwrap();
        if !board.bridge_enabled().unwrap() {
            return Some(board.time_ns() - start_ns);
        }
    }
    None
}

fn assert_latched(board: &mut VirtualBoard, link: &mut Link, fault: Fault) {
    board.run_for(Duration::from_millis(20)).unwrap();
    let status = status(board, link);
    assert_eq!((status.state, status.fault), (State::Fault, Some(fault)));
    assert!(!board.bridge_enabled().unwrap());
    let log = board.log().unwrap();
    assert!(common::logged(&log, "fault"), "{log:#?}");
    board.check_told().unwrap();
}

const LINE_FAULTS: [EncoderFault; 4] = [
    EncoderFault::Corrupted { mask: 1 << 35 },
    EncoderFault::Missing,
    EncoderFault::Shorted,
    EncoderFault::Shifted { bits: 16 },
];

#[test]
fn the_third_unusable_frame_in_a_row_turns_the_bridge_off() {
    for fault in LINE_FAULTS {
        let (mut board, mut link) = moving();
        board.inject_encoder_fault(fault, Lasting::Forever).unwrap();
        let off_ns = time_to_off_ns(&mut board, 5 * SERVO_PERIOD_NS);
        assert!(off_ns.is_some(), "{fault:?}");
        assert_eq!(board.encoder_frames().unwrap().1, 3, "{fault:?}");
        assert_latched(&mut board, &mut link, Fault::EncoderLost);
    }
}

#[test]
fn two_unusable_frames_are_counted_and_survived() {
    for fault in LINE_FAULTS {
        let (mut board, mut link) = moving();
        board.inject_encoder_fault(fault, Lasting::Frames(2)).unwrap();
        board.run_for(Duration::from_millis(100)).unwrap();
        let status = status(&mut board, &mut link);
        assert_eq!((status.state, status.fault), (State::OperationEnabled, None), "{fault:?}");
        assert_eq!(status.counters.bad_frames, 2, "{fault:?}");
        board.check_told().unwrap();
    }
}

/// The acknowledge bits absorb the delay of the line: only what is lost at the end of the frame counts.
#[test]
fn a_line_one_bit_slower_is_no_fault() {
    let (mut board, mut link) = moving();
    board.inject_encoder_fault(EncoderFault::Shifted { bits: 1 }, Lasting::Forever).unwrap();
    board.run_for(Duration::from_millis(20)).unwrap();
    let status = status(&mut board, &mut link);
    assert_eq!((status.state, status.counters.bad_frames), (State::OperationEnabled, 0));
    board.check_told().unwrap();
}

#[test]
fn an_encoder_that_repeats_itself_is_a_following_error() {
    let (mut board, mut link) = moving();
    board.inject_encoder_fault(EncoderFault::Stuck, Lasting::Forever).unwrap();
    // 200 µm at some 60 mm/s.
    let off_ns = time_to_off_ns(&mut board, 10_000_000).unwrap();
    assert!(off_ns < 5_000_000, "{off_ns} ns");
    assert_latched(&mut board, &mut link, Fault::FollowingError);
}

#[test]
fn an_over_current_turns_the_bridge_off_within_two_pwm_periods() {
    for code in [0, u16::MAX] {
        let (mut board, mut link) = moving();
        board.set_adc_fault(Analog::PhaseB, Some(AdcFault::Stuck { code })).unwrap();
        let off_ns = time_to_off_ns(&mut board, SERVO_PERIOD_NS);
        assert!(off_ns.is_some_and(|off_ns| off_ns <= 2 * PWM_PERIOD_NS), "{off_ns:?}");
        board.set_adc_fault(Analog::PhaseB, None).unwrap();
        assert_latched(&mut board, &mut link, Fault::OverCurrent);
    }
}

#[test]
fn the_power_stage_turns_the_bridge_off_by_itself_and_the_drive_can_be_enabled_again() {
    let (mut board, mut link) = moving();
    board.set_bridge_fault(true).unwrap();
    // The break input is filtered, and needs no instruction.
    assert!(time_to_off_ns(&mut board, 10_000).unwrap() <= 1_000);
    assert_latched(&mut board, &mut link, Fault::BridgeFault);

    let refused = link.request(&mut board, &Request::Enable).unwrap();
    assert!(matches!(refused, Reply::Refused(_)), "{refused:?}");
    board.set_bridge_fault(false).unwrap();
    board.run_for(Duration::from_millis(1)).unwrap();
    for request in [Request::ResetFault, Request::Enable] {
        assert!(matches!(link.request(&mut board, &request).unwrap(), Reply::Done { .. }), "{request:?}");
        board.run_for(Duration::from_millis(5)).unwrap();
    }
    assert_eq!(status(&mut board, &mut link).state, State::OperationEnabled);
    assert!(board.bridge_enabled().unwrap());
    board.check_told().unwrap();
}

#[test]
fn a_bus_voltage_out_of_its_limits_turns_the_bridge_off() {
    for (code, fault) in [(u16::MAX, Fault::BusOverVoltage), (0, Fault::BusUnderVoltage)] {
        let (mut board, mut link) = moving();
        board.set_adc_fault(Analog::Bus, Some(AdcFault::Stuck { code })).unwrap();
        // The conversion is read one servo period after its start, and every seventeenth is the temperature's.
        let off_ns = time_to_off_ns(&mut board, 5 * SERVO_PERIOD_NS);
        assert!(off_ns.is_some_and(|off_ns| off_ns <= 3 * SERVO_PERIOD_NS), "{fault:?} {off_ns:?}");
        assert_latched(&mut board, &mut link, fault);
    }
}

#[test]
fn a_reset_in_mid_move_turns_the_bridge_off_at_once() {
    let (mut board, mut link) = moving();
    board.reset().unwrap();
    assert!(!board.bridge_enabled().unwrap());
    board.run_for(common::BOOT).unwrap();
    let status = status(&mut board, &mut link);
    assert_eq!((status.state, status.fault), (State::SwitchOnDisabled, None));
    board.check_told().unwrap();
}

#[test]
fn garbled_requests_are_dropped_and_counted() {
    let (mut board, mut link) = enabled();
    board.send(b"\x05hello\x00").unwrap();
    board.send(&[0xA5; 2000]).unwrap();
    board.send(&[0]).unwrap();
    // 2008 bytes at 921,600 bit/s.
    board.run_for(Duration::from_millis(25)).unwrap();
    assert_eq!(status(&mut board, &mut link).bad_requests, 2);

    board.set_serial_errors(1_000_000, 0, 1).unwrap();
    assert!(link.request(&mut board, &Request::Identity).is_err(), "every byte is noise");
    board.set_serial_errors(0, 0, 1).unwrap();
    board.send(&[0]).unwrap();
    let status = status(&mut board, &mut link);
    assert_eq!(status.state, State::OperationEnabled);
    assert!(status.bad_requests > 2, "{}", status.bad_requests);
    board.check_told().unwrap();
}
