//! `servoctl log`: the firmware's log.

use std::io::{Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::atomic::Ordering;
use std::time::Duration;

use anyhow::{Context, Result, bail};
use serde_json::json;

use super::super::interrupt;
use super::super::output::Json;
use super::Link;
use crate::link::virtual_drive;

/// Options of `log`.
#[derive(Debug, clap::Args)]
pub struct Options {
    /// Go on with what comes (a board's log always does)
    #[arg(long, short)]
    follow: bool,
    /// For a board: the ELF that is on it, whose table decodes the log
    #[arg(long)]
    elf: Option<PathBuf>,
    #[command(flatten)]
    json: Json,
}

/// How often the file is looked at.
const LOOK: Duration = Duration::from_millis(100);
/// The chip as probe-rs names it.
const CHIP: &str = "STM32H743ZITx";

/// Prints the virtual drive's log, or a board's by a debug probe.
///
/// # Errors
/// No virtual drive; no probe-rs, or none that finds a board.
pub fn run(link: &Link, options: &Options) -> Result<()> {
    match &options.elf {
        Some(elf) => {
            let mut probe = Command::new("probe-rs");
            let status = probe.args(["attach", "--chip", CHIP]).arg(elf).status().context(
                "a board's log comes through its debug probe: install probe-rs (`cargo install probe-rs-tools --locked`)",
            )?;
            if status.success() { Ok(()) } else { bail!("probe-rs ended with {status}") }
        }
        None if link.port.is_none() => print_file(&virtual_drive::log_file(), options),
        None => bail!("a board's log comes through its debug probe: name the firmware with --elf FILE"),
    }
}

fn print_file(path: &Path, options: &Options) -> Result<()> {
    let mut file = std::fs::File::open(path).with_context(|| {
        format!("no log of a virtual drive at {}: `servoctl --virtual info` starts one", path.display())
    })?;
    let ended = interrupt::flag()?;
    let mut out = options.json.lines()?;
    let mut text = String::new();
    loop {
        file.read_to_string(&mut text).with_context(|| format!("reading {}", path.display()))?;
        // What is being written now has no end yet.
        while let Some(end) = text.find('\n') {
            let line: String = text.drain(..=end).collect();
            if !out.write(&json!({ "line": line.trim_end() }), || line.clone())? {
                return Ok(());
            }
        }
        if !options.follow || ended.load(Ordering::Relaxed) {
            return Ok(());
        }
        std::thread::sleep(LOOK);
        // A new drive has begun a new log.
        if std::fs::metadata(path).is_ok_and(|now| file.stream_position().is_ok_and(|at| now.len() < at)) {
            file.seek(SeekFrom::Start(0)).context("the log")?;
        }
    }
}
