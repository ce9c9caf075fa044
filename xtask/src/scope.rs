//! The scope page's plotting library: fetched with npm, held to the hashes of the lock file, put where `servoctl` is built from.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, Result};

use crate::firmware::Firmware;
use crate::{process, setup, virtual_drive};

const WEB: &str = "servoctl/web";
const LOCK: &str = "package-lock.json";
/// What the page loads, from the package's directory.
const FILES: [&str; 2] = ["uPlot.esm.js", "uPlot.min.css"];

/// Fetches what the lock file names, unless it is there already.
///
/// # Errors
/// When npm cannot be installed, the registry cannot be reached, or what it sends is not what the lock file says.
pub fn bundle() -> Result<()> {
    let web = Path::new(WEB);
    let vendor = web.join("vendor");
    let lock = read(&web.join(LOCK))?;
    if fs::read(vendor.join(LOCK)).is_ok_and(|fetched| fetched == lock) {
        eprintln!("setup: scope page: already there");
        return Ok(());
    }
    setup::npm()?;
    let directory = target().join("scope");
    fs::create_dir_all(&directory).with_context(|| format!("creating {}", directory.display()))?;
    for file in ["package.json", LOCK] {
        write(&directory.join(file), &read(&web.join(file))?)?;
    }
    let mut npm = Command::new("npm");
    npm.args(["ci", "--ignore-scripts", "--no-audit", "--no-fund"]).current_dir(&directory);
    process::run(&mut npm, "npm ci")?;
    fs::create_dir_all(&vendor).with_context(|| format!("creating {}", vendor.display()))?;
    for file in FILES {
        write(&vendor.join(file), &read(&directory.join("node_modules/uplot/dist").join(file))?)?;
    }
    // Last: only complete is there.
    write(&vendor.join(LOCK), &lock)
}

/// The page's tests, in a real browser, in front of the drive of core and of `firmware` on the virtual board.
///
/// # Errors
/// When set-up or a test fails.
pub fn test(firmware: &Firmware) -> Result<()> {
    setup::chromium()?;
    bundle()?;
    process::run(&mut virtual_drive::test(firmware, "scope")?, "the scope page in a browser")
}

fn target() -> PathBuf {
    std::env::var_os("CARGO_TARGET_DIR").map_or(PathBuf::from("target"), PathBuf::from)
}

fn read(file: &Path) -> Result<Vec<u8>> {
    fs::read(file).with_context(|| format!("reading {}", file.display()))
}

fn write(file: &Path, bytes: &[u8]) -> Result<()> {
    fs::write(file, bytes).with_context(|| format!("writing {}", file.display()))
}
