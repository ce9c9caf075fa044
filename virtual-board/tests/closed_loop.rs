//! The firmware on the virtual board with the loop closed: from a command on the serial line to a settled stage.

mod common;

use std::num::NonZeroU64;
use std::time::Duration;

use common::{BOOT, elf, enabled, five_mm, status};
use servo_core::config::Compensator;
use servo_protocol::message::{Reply, Request};
use servo_virtual_board::{Config, Link, VirtualBoard};

/// A 5 mm move at 1 m/s² takes 141 ms; the rest is for settling.
const MOVE_AND_SETTLE: Duration = Duration::from_millis(700);
/// A quarter of the servo period: what the tick may take from sampling to the new compare values.
const TICK_LIMIT_NS: u64 = 125_000 / 4;
const TOLERANCE_3_NM: usize = 0;
/// Number of the parameter `tick_limit_cycles`.
const TICK_LIMIT_CYCLES: u16 = 0x0601;

#[test]
fn enabling_does_not_move_the_stage() {
    let mut board = common::board();
    board.start_trace().unwrap();
    assert!(matches!(Link::new().request(&mut board, &Request::Enable).unwrap(), Reply::Done { .. }));
    board.run_for(Duration::from_millis(100)).unwrap();
    assert!(board.bridge_enabled().unwrap());
    let trace = board.take_trace().unwrap();
    let furthest_m = trace.iter().map(|truth| truth.position_m.abs()).fold(0.0, f64::max);
    assert!(furthest_m < 5e-9, "{furthest_m:e} m");
    board.check_told().unwrap();
}

#[test]
fn a_move_with_niasa_settles_to_3_nm_within_its_time_budget() {
    let (mut board, mut link) = enabled();
    assert!(matches!(link.request(&mut board, &Request::Compensator(Compensator::Niasa)).unwrap(), Reply::Done { .. }));
    assert!(matches!(link.request(&mut board, &five_mm()).unwrap(), Reply::Done { .. }));
    board.run_for(MOVE_AND_SETTLE).unwrap();

    let Reply::Settling(settling) = link.request(&mut board, &Request::Settling).unwrap() else {
        panic!("no settling")
    };
    assert!(settling.settled_after_s(TOLERANCE_3_NM).is_some(), "{settling:?}");
    let truth_m = board.plant().unwrap().position_m();
    assert!((truth_m - 5e-3).abs() < 5e-9, "{truth_m}");

    let status = status(&mut board, &mut link);
    assert_eq!((status.fault, status.counters.overruns, status.counters.bad_frames), (None, 0, 0));
    assert_eq!(status.lost_records, 0);
    assert!(board.counts().unwrap().servo_tick.max_ns <= TICK_LIMIT_NS, "{:?}", board.counts().unwrap().servo_tick);
    board.check_told().unwrap();
}

/// The emulator has one rate for all instructions. 100 million a second is a Cortex-M7 at 400 MHz that waits three cycles of four.
#[test]
fn a_processor_less_than_half_as_fast_still_keeps_the_time_budget() {
    let config = Config { instructions_per_second: NonZeroU64::new(100_000_000).unwrap(), ..common::config() };
    let mut board = VirtualBoard::boot(&elf(), &config).unwrap();
    board.run_for(2 * BOOT).unwrap();
    let mut link = Link::new();
    // The drive's own limit is one PWM period, which the tick that plans a move exceeds here: set it to the budget.
    let limit_cycles = TICK_LIMIT_NS as f64 * 0.4;
    let limit = Request::SetParameters([(TICK_LIMIT_CYCLES, limit_cycles)].into_iter().collect());
    for request in [limit, Request::Enable, Request::Compensator(Compensator::Niasa)] {
        assert!(matches!(link.request(&mut board, &request).unwrap(), Reply::Done { .. }), "{request:?}");
    }
    board.run_for(Duration::from_millis(10)).unwrap();
    assert!(matches!(link.request(&mut board, &five_mm()).unwrap(), Reply::Done { .. }));
    board.run_for(Duration::from_millis(200)).unwrap();
    let status = status(&mut board, &mut link);
    assert_eq!((status.fault, status.counters.overruns, status.counters.bad_frames), (None, 0, 0));
    assert!(board.counts().unwrap().servo_tick.max_ns <= TICK_LIMIT_NS, "{:?}", board.counts().unwrap().servo_tick);
}

#[test]
fn the_same_calls_give_the_same_move_to_the_bit() {
    let run = || {
        let (mut board, mut link) = enabled();
        board.redraw_friction(7).unwrap();
        link.request(&mut board, &five_mm()).unwrap();
        board.start_trace().unwrap();
        board.run_for(Duration::from_millis(200)).unwrap();
        (board.take_trace().unwrap(), board.log().unwrap(), board.plant().unwrap())
    };
    let (first, second) = (run(), run());
    assert_eq!(first.0.len(), 1600);
    assert!(first == second);
}

#[test]
fn another_draw_of_the_friction_is_another_move() {
    let run = |draw| {
        let (mut board, mut link) = enabled();
        board.redraw_friction(draw).unwrap();
        link.request(&mut board, &five_mm()).unwrap();
        board.run_for(Duration::from_millis(200)).unwrap();
        board.plant().unwrap().position_m()
    };
    assert_ne!(run(1), run(2));
}

#[test]
fn a_snapshot_in_mid_move_goes_on_as_the_run_it_was_taken_from() {
    let (mut original, mut link) = enabled();
    link.request(&mut original, &five_mm()).unwrap();
    original.run_for(Duration::from_micros(60_017)).unwrap();
    let mut copy = VirtualBoard::from_snapshot(&original.snapshot().unwrap()).unwrap();
    for board in [&mut original, &mut copy] {
        board.run_for(Duration::from_millis(60)).unwrap();
    }
    assert!(original.plant().unwrap().velocity_m_per_s() > 0.01, "still moving");
    assert_eq!(original.plant().unwrap(), copy.plant().unwrap());
    assert_eq!(original.counts().unwrap(), copy.counts().unwrap());
    assert_eq!(original.log().unwrap(), copy.log().unwrap());
}

#[test]
fn a_refused_move_moves_nothing() {
    let (mut board, mut link) = enabled();
    let Request::Move { limits, .. } = five_mm() else { unreachable!() };
    let beyond = Request::Move { target_ct: 1_000_000_000, limits };
    let reply = link.request(&mut board, &beyond).unwrap();
    assert!(matches!(reply, Reply::Refused(_)), "{reply:?}");
    assert!(!status(&mut board, &mut link).moving);
    board.check_told().unwrap();
}

/// The line is dead for the 76 ms of boot, and what is sent meanwhile is lost, as on the real board.
#[test]
fn a_request_before_boot_gets_no_reply_and_names_itself() {
    let mut board = VirtualBoard::boot(&elf(), &Config::default()).unwrap();
    let error = Link::new().request(&mut board, &Request::Identity).unwrap_err().to_string();
    assert!(error.contains("Identity"), "{error}");
}
