//! Measurements that are reported, not judged: `cargo xtask test` holds the ones with a budget to it.

use anyhow::Result;

use crate::{firmware, host, process, qemu};

/// Prints the instruction counts of the control loops and how fast the virtual board runs.
///
/// # Errors
/// When a build or a measurement fails.
pub fn run() -> Result<()> {
    qemu::run()?;
    let firmware = firmware::build()?;
    let mut board = host::virtual_board("board", &firmware.elf)?;
    process::run(board.args(["--seconds", "2"]), "the virtual board")
}
