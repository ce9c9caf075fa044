//! `cargo xtask commission-stages`: every named stage commissioned on the virtual board, from a new drive to NIASA, unattended.

use anyhow::Result;

use crate::{firmware, host, process};

/// Builds the firmware and runs the test of commissioning with all its stages, optimised.
///
/// # Errors
/// When a stage cannot be commissioned.
pub fn run() -> Result<()> {
    let firmware = firmware::build()?;
    let mut tests = host::cargo_with_emulator("test")?;
    tests.args(["--release", "--package", "servo-virtual-board", "--test", "commission"]);
    tests.args(["--", "--include-ignored", "--nocapture"]).env("SERVO_ELF", host::absolute(&firmware.elf)?);
    process::run(&mut tests, "stages commissioned on the virtual board")
}
