//! `servoctl log`: the firmware's log.

use std::io::{BufRead, BufReader, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::atomic::Ordering;
use std::time::Duration;

use anyhow::{Context, Result, bail, ensure};
use serde_json::json;
use servo_core::fingerprint::Fingerprint;

use super::super::interrupt;
use super::super::output::Json;
use super::Link;
use crate::link::virtual_drive;
use crate::program;

/// Options of `log`.
#[derive(Debug, clap::Args)]
pub struct Options {
    /// Go on with what comes (a board's log always does)
    #[arg(long, short)]
    follow: bool,
    /// For a board: the ELF that is on it, whose table decodes the log; refused if the drive runs another program
    #[arg(long)]
    elf: Option<PathBuf>,
    #[command(flatten)]
    json: Json,
}

/// How often the file is looked at.
const LOOK: Duration = Duration::from_millis(100);
/// The chip as probe-rs names it.
const CHIP: &str = "STM32H743ZITx";

/// Prints the virtual drive's log, or a board's by a debug probe. An ELF that is not on the drive would decode the log wrongly: it is
/// refused if the drive can be asked.
///
/// # Errors
/// No virtual drive; an ELF that is not on the drive; no probe-rs, or none that finds a board.
pub fn run(link: &Link, options: &Options) -> Result<()> {
    let is_virtual = match &options.elf {
        Some(elf) => compare(link, elf)?,
        None => is_here(link),
    };
    match &options.elf {
        _ if is_virtual => {
            ensure!(
                is_here(link),
                "the log of a virtual drive is on the computer that it runs on: `servoctl log` there"
            );
            print_file(&virtual_drive::log_file(), options)
        }
        Some(elf) => attach(elf, options),
        None => bail!("a board's log comes through its debug probe: name the firmware with --elf FILE"),
    }
}

/// The drive, if it is a virtual one, is that of this computer.
fn is_here(link: &Link) -> bool {
    link.port.is_none() || link.port == virtual_drive::find()
}

/// Whether the drive is a virtual one. One that cannot be asked is a board: its log comes another way.
///
/// # Errors
/// The drive runs another program than `elf`.
fn compare(link: &Link, elf: &Path) -> Result<bool> {
    let Fingerprint(named) = program::fingerprint(elf)?;
    let connected = match link.connect() {
        Ok(connected) => connected,
        Err(error) => {
            let reason = error.to_string();
            let reason = reason.lines().next().unwrap_or_default();
            eprintln!("not compared with what is on the drive: {reason}");
            return Ok(false);
        }
    };
    let runs = connected.drive.identity().program;
    ensure!(
        named == runs,
        "{} is program {named:016x}, the drive runs program {runs:016x}: its log would be decoded with the wrong table\n  \
         name the ELF that is on the drive, or flash this one (`cargo xtask flash`)",
        elf.display()
    );
    Ok(connected.is_virtual)
}

/// The log by RTT, which probe-rs reads and decodes.
fn attach(elf: &Path, options: &Options) -> Result<()> {
    let mut probe = Command::new("probe-rs");
    probe.args(["attach", "--chip", CHIP]).arg(elf).stdin(Stdio::null()).stdout(Stdio::piped());
    let mut probe = probe.spawn().context(
        "a board's log comes through its debug probe: install probe-rs (`cargo install probe-rs-tools --locked`)",
    )?;
    let mut out = options.json.lines()?;
    let lines = probe.stdout.take().map(BufReader::new).context("the output of probe-rs")?;
    for line in lines.lines() {
        let line = line.context("reading what probe-rs prints")?;
        if !out.write(&json!({ "line": line }), || format!("{line}\n"))? {
            return probe.kill().context("ending probe-rs");
        }
    }
    let status = probe.wait().context("probe-rs")?;
    if status.success() { Ok(()) } else { bail!("probe-rs ended with {status}") }
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
