//! What the scope's page takes from others: fetched by a lock file, bundled by `servoctl/build.rs`, never committed.

use std::process::Command;

use anyhow::Result;

use crate::apt::Access;
use crate::process;

/// Where `package.json` and its lock file are.
const FOLDER: &str = "servoctl/web";

/// Fetches uPlot into `servoctl/web/node_modules`, exactly the release of the lock file.
///
/// # Errors
/// When npm is missing and cannot be installed, or the registry cannot be reached.
pub fn fetch() -> Result<()> {
    if !process::succeeds(Command::new("npm").arg("--version")) {
        Access::find().install("npm", &["npm"])?;
    }
    let mut npm = Command::new("npm");
    process::run(npm.args(["ci", "--ignore-scripts", "--prefix", FOLDER]), "npm ci")
}

/// Makes sure that there is a browser for the page's test.
///
/// # Errors
/// When Chromium is missing and cannot be installed.
pub fn browser() -> Result<()> {
    if std::env::var_os("CHROMIUM").is_none() && !process::succeeds(Command::new("chromium").arg("--version")) {
        Access::find().install("browser", &["chromium"])?;
    }
    Ok(())
}
