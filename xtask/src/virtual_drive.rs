//! What `servoctl --virtual` starts: the virtual board behind a TCP port.

use std::path::PathBuf;

use anyhow::{Context, Result};
use serde_json::json;

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
