//! What the tests of this crate share: one snapshot after boot, from which every test starts.
#![allow(dead_code, reason = "every test binary uses another part")]

use std::sync::OnceLock;
use std::time::Duration;

use servo_virtual_board::{Config, Elf, LogLine, Snapshot, VirtualBoard};

/// The converters' calibration and the start-up take 76 ms.
pub const BOOT: Duration = Duration::from_millis(150);

pub fn elf() -> Elf {
    Elf::find(None).unwrap_or_else(|error| panic!("{error}"))
}

/// The state after boot, and what had been logged by then.
pub fn booted() -> &'static (Snapshot, Vec<LogLine>) {
    static BOOTED: OnceLock<(Snapshot, Vec<LogLine>)> = OnceLock::new();
    BOOTED.get_or_init(|| {
        let mut board = VirtualBoard::boot(&elf(), &Config::default()).unwrap();
        board.run_for(BOOT).unwrap();
        let log = board.log().unwrap();
        (board.snapshot().unwrap(), log)
    })
}

/// A board just after boot.
pub fn board() -> VirtualBoard {
    VirtualBoard::from_snapshot(&booted().0).unwrap()
}

pub fn logged(lines: &[LogLine], text: &str) -> bool {
    lines.iter().any(|line| line.message.contains(text))
}
