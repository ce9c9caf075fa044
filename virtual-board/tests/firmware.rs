//! The firmware on the virtual board, bridge off: boot, rates, determinism, snapshots, resets. Needs the ELF that `SERVO_ELF`
//! names; `cargo xtask test` builds it and sets the variable.

mod common;

use std::path::Path;
use std::time::Duration;

use common::{BOOT, board, booted, elf, logged};
use servo_virtual_board::{Config, Counts, Elf, LogLine, VirtualBoard};

const SERVO_PERIOD: Duration = Duration::from_micros(125);

/// Everything observable about a run.
#[derive(Debug, PartialEq)]
struct Observed {
    log: Vec<LogLine>,
    counts: Counts,
    plant: String,
    memory: Vec<u8>,
    sent: Vec<u8>,
}

fn observe(board: &mut VirtualBoard) -> Observed {
    Observed {
        log: board.log().unwrap(),
        counts: board.counts().unwrap(),
        plant: format!("{:?}", board.plant().unwrap()),
        memory: board.read_memory(0x2000_0000, 0x2_0000).unwrap(),
        sent: board.received().unwrap(),
    }
}

#[test]
fn it_boots_and_says_so() {
    let (_, log) = booted();
    assert!(logged(log, "servo-firmware"), "{log:#?}");
    assert!(logged(log, "SwitchOnDisabled"), "{log:#?}");
    assert!(log.iter().all(|line| line.level != "error"), "{log:#?}");
}

#[test]
fn the_pwm_runs_at_40_khz_and_the_encoder_at_8_khz() {
    let mut board = board();
    let (updates, frames) = (board.counts().unwrap().updates, board.encoder_frames().unwrap().0);
    board.run_for(Duration::from_millis(50)).unwrap();
    assert_eq!(board.counts().unwrap().updates - updates, 2000);
    assert_eq!(board.encoder_frames().unwrap().0 - frames, 400);
    assert!(!board.bridge_enabled().unwrap(), "nobody asked for torque");
}

#[test]
fn two_runs_are_the_same_run_however_time_is_cut() {
    let mut whole = board();
    whole.send(b"not a frame\0").unwrap();
    whole.run_for(Duration::from_millis(40)).unwrap();
    let mut pieces = board();
    pieces.send(b"not a frame\0").unwrap();
    for _ in 0..1000 {
        pieces.run_for(Duration::from_nanos(39_999)).unwrap();
    }
    pieces.run_until_ns(whole.time_ns()).unwrap();
    let (whole, pieces) = (observe(&mut whole), observe(&mut pieces));
    assert_eq!(whole.log, pieces.log);
    assert_eq!(whole.plant, pieces.plant);
    assert!(whole.memory == pieces.memory, "RAM differs");
    assert_eq!(whole.sent, pieces.sent);
}

#[test]
fn a_snapshot_goes_on_as_the_run_it_was_taken_from() {
    let mut original = board();
    original.run_for(Duration::from_micros(12_345)).unwrap();
    let mut copy = VirtualBoard::from_snapshot(&original.snapshot().unwrap()).unwrap();
    for board in [&mut original, &mut copy] {
        board.run_for(Duration::from_millis(30)).unwrap();
    }
    assert_eq!(observe(&mut original), observe(&mut copy));
}

#[test]
fn another_seed_is_another_run() {
    let encoder = |seed| {
        let mut board = VirtualBoard::boot(&elf(), &Config { seed, ..common::config() }).unwrap();
        board.run_for(BOOT).unwrap();
        format!("{:?}", board.plant().unwrap())
    };
    assert_ne!(encoder(1), encoder(2));
}

#[test]
fn the_emulator_has_nothing_unexplained_to_say() {
    let mut board = board();
    board.run_for(Duration::from_millis(100)).unwrap();
    board.check_told().unwrap();
}

#[test]
fn the_power_stage_can_trip_the_bridge() {
    let mut board = board();
    board.set_bridge_fault(true).unwrap();
    board.run_for(Duration::from_millis(12)).unwrap();
    let log = board.log().unwrap();
    assert!(logged(&log, "fault"), "{log:#?}");
    assert!(!board.bridge_enabled().unwrap());
}

#[test]
fn the_reset_pin_starts_it_again() {
    let mut board = board();
    board.reset().unwrap();
    board.run_for(BOOT).unwrap();
    assert_eq!(board.resets().unwrap(), 1);
    assert!(logged(&board.log().unwrap(), "servo-firmware"));
    board.check_told().unwrap();
}

#[test]
fn the_truth_can_be_traced_at_every_servo_tick() {
    let mut board = board();
    board.start_trace().unwrap();
    board.run_for(Duration::from_millis(10)).unwrap();
    let trace = board.take_trace().unwrap();
    assert_eq!(trace.len(), 80);
    for pair in trace.windows(2) {
        let period_ns = pair[1].time_ns - pair[0].time_ns;
        assert!(period_ns.abs_diff(SERVO_PERIOD.as_nanos() as u64) < 100, "{period_ns} ns");
    }
    assert!(board.take_trace().unwrap().is_empty());
}

#[test]
fn memory_can_be_read_by_symbol() {
    let mut board = board();
    assert_eq!(board.read_symbol_u32("_SEGGER_RTT").unwrap().to_le_bytes(), *b"SEGG");
    let error = board.read_symbol_u32("no_such_symbol").unwrap_err().to_string();
    assert!(error.contains("no_such_symbol"), "{error}");
    assert!(board.read_memory(0x3000_0000_0000, 1).is_err());
}

#[test]
fn a_missing_or_useless_firmware_is_named() {
    let missing = Elf::read(Path::new("no-such-firmware.elf")).unwrap_err().to_string();
    assert!(missing.contains("no-such-firmware.elf") && missing.contains("cargo xtask firmware"), "{missing}");
    let useless = Elf::read(Path::new("Cargo.toml")).unwrap_err().to_string();
    assert!(useless.contains("Cargo.toml") && useless.contains("ELF"), "{useless}");
}
