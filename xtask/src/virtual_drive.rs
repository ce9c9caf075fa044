//! What `servoctl --virtual` starts: the virtual board behind a TCP port.

use std::path::PathBuf;
use std::process::Command;

use anyhow::{Context, Result};
use serde_json::json;

use crate::firmware::Firmware;
use crate::{firmware, host, process};

/// The program's name.
const PROGRAM: &str = "virtual_drive";

/// Builds firmware and virtual board and prints both paths as one line of JSON; how far it is goes to standard error.
///
/// # Errors
/// When set-up or a build fails.
pub fn build() -> Result<()> {
    let firmware = firmware::build()?;
    println!("{}", json!({ "program": program()?, "elf": host::absolute(&firmware.elf)? }));
    Ok(())
}

/// Builds the virtual board behind a TCP port and returns where it is.
///
/// # Errors
/// When the build fails.
pub fn program() -> Result<PathBuf> {
    let mut cargo = host::cargo_with_emulator("build")?;
    cargo.args(["--release", "--package", "servo-virtual-board", "--bin", PROGRAM]);
    process::run(&mut cargo, "building the virtual board")?;
    let target = std::env::var_os("CARGO_TARGET_DIR").map_or(PathBuf::from("target"), PathBuf::from);
    std::path::absolute(target.join("release").join(PROGRAM)).context("the target directory")
}

/// A test of servoctl that needs the virtual drive, on a drive of its own, whatever else runs here; not started.
///
/// # Errors
/// When the build fails.
pub fn test(firmware: &Firmware, name: &str) -> Result<Command> {
    let target = std::env::var_os("CARGO_TARGET_DIR").map_or(PathBuf::from("target"), PathBuf::from);
    let state = std::path::absolute(target.join(format!("virtual-drive-of-{name}"))).context("the target directory")?;
    let mut test = host::cargo("test");
    test.env("SERVO_VIRTUAL_DRIVE", program()?)
        .env("SERVO_ELF", host::absolute(&firmware.elf)?)
        .env("SERVO_VIRTUAL_STATE", state);
    test.args(["--package", "servoctl", "--test", name, "--", "--include-ignored"]);
    Ok(test)
}

/// The commands, as a person types them, in front of `firmware` on the virtual board.
///
/// # Errors
/// When a build or a test fails.
pub fn test_commands(firmware: &Firmware) -> Result<()> {
    process::run(&mut test(firmware, "commands")?, "the commands on the virtual drive")
}
