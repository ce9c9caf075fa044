//! The black box of the firmware: read over the link after a fault and after a reset, and run again on this computer, bit for bit.

mod common;

use std::time::Duration;

use common::{enabled, five_mm, status};
use servo_core::black_box::{AFTER_TICKS, BEFORE_TICKS};
use servo_core::compensator::Compensator;
use servo_core::fault::Fault;
use servo_protocol::black_box::BlackBox;
use servo_protocol::message::{Reply, Request};
use servo_virtual_board::{EncoderFault, Lasting, Link, VirtualBoard};

/// `udf #0`: a processor fault.
const UNDEFINED: u16 = 0xDE00;
/// What housekeeping calls ten times a second.
const CALLED_BY_A_TASK: &str = "stack_free_bytes";

/// In mid-move, with a compensator and a gain changed on the way.
fn moving() -> (VirtualBoard, Link) {
    let (mut board, mut link) = enabled();
    let stiffer = Request::SetParameters([(0x0302, 950.0)].into_iter().collect());
    for request in [Request::Compensator(Compensator::Niasa), five_mm(), stiffer] {
        assert!(matches!(link.request(&mut board, &request).unwrap(), Reply::Done { .. }), "{request:?}");
        board.run_for(Duration::from_millis(30)).unwrap();
    }
    assert!(board.bridge_enabled().unwrap());
    (board, link)
}

#[test]
fn the_ticks_around_a_fault_are_those_that_this_computer_computes() {
    let (mut board, mut link) = moving();
    board.inject_encoder_fault(EncoderFault::Missing, Lasting::Forever).unwrap();
    board.run_for(Duration::from_millis(40)).unwrap();
    assert_eq!(status(&mut board, &mut link).fault, Some(Fault::EncoderLost));

    let words = common::black_box(&mut board, &mut link);
    let black_box = BlackBox(&words[..]);
    assert!(black_box.is_intact());
    let before = black_box.entries().take_while(|entry| entry.fault_number() == 0).count() as u32;
    let faulty: Vec<_> = black_box.entries().skip(before as usize).map(|entry| entry.fault_number()).collect();
    assert!(before >= BEFORE_TICKS, "{before}");
    assert_eq!(faulty, vec![Fault::EncoderLost.number(); 1 + AFTER_TICKS as usize]);
    let replayed = black_box.replay().unwrap_or_else(|error| panic!("{error}"));
    assert!(replayed > BEFORE_TICKS + AFTER_TICKS, "{replayed}");
    board.check_told().unwrap();
}

#[test]
fn a_processor_fault_in_mid_move_leaves_its_last_ticks_to_the_next_run() {
    let (mut board, mut link) = moving();
    let last = status(&mut board, &mut link).counters.ticks;
    let address = board.elf().address(CALLED_BY_A_TASK).unwrap() & !1;
    let healthy = board.patch(address, UNDEFINED).unwrap();
    for _ in 0..150 {
        if board.resets().unwrap() > 0 {
            break;
        }
        board.run_for(Duration::from_millis(1)).unwrap();
    }
    board.patch(address, healthy).unwrap();
    board.run_for(common::BOOT).unwrap();
    assert_eq!(status(&mut board, &mut link).fault, Some(Fault::Panic));

    let words = common::black_box(&mut board, &mut link);
    let black_box = BlackBox(&words[..]);
    assert!(black_box.is_intact());
    let newest = black_box.entries().last().unwrap();
    assert!(newest.sequence() > last && newest.fault_number() == 0, "{newest:?}");
    let replayed = black_box.replay().unwrap_or_else(|error| panic!("{error}"));
    assert!(replayed > BEFORE_TICKS, "{replayed}");
}
