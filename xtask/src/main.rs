//! `cargo xtask <word>`: everything a person types in this repository, and the only place where things get installed.

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::{Context, Result};
use clap::{Parser, Subcommand};

mod apt;
mod bench;
mod commission_stages;
mod demo;
mod docs;
mod embedded;
mod endurance;
mod fault_page;
mod firmware;
mod fuzz;
mod host;
mod process;
mod protocol_page;
mod qemu;
mod scope;
mod setup;
mod test_suite;
mod toolchain;
mod version;
mod virtual_drive;

#[derive(Parser)]
#[command(bin_name = "cargo xtask", about = "What a person types here; each word installs what it needs first.")]
struct Arguments {
    #[command(subcommand)]
    word: Word,
}

/// The words, in the order in which a newcomer needs them.
#[derive(Subcommand)]
enum Word {
    /// Run the firmware on the virtual board: moves with and without the compensator, table and report
    Demo(demo::Options),
    /// Build the virtual drive that `servoctl --virtual` talks to; print where its program and its firmware are
    Virtual,
    /// Run every check that the server runs
    Test(test_suite::Options),
    /// Build the firmware; print path, memory use and hash of its ELF
    Firmware,
    /// Build the firmware and run it on the board that a debug probe finds
    Flash,
    /// Compare bits and instruction counts on a bare Cortex-M7
    Qemu {
        /// Take what was measured as what is agreed upon
        #[arg(long)]
        bless: bool,
    },
    /// Measure: instructions of the control loops, speed of the virtual board
    Bench(bench::Options),
    /// Run the long forms of tests: an hour of motion, a thousand million random ticks
    Endurance(endurance::Options),
    /// Commission every named stage on the virtual board, from a new drive to NIASA, unattended
    CommissionStages,
    /// Look for bytes that break what reads them: serial frames, flash, encoder line, stage file
    Fuzz(fuzz::Options),
    /// Write the pages of docs/ that are made from tables in code
    Docs,
    /// Fetch the plotting library of the page that `servoctl scope` serves
    Scope,
    /// Install what is missing: embedded toolchain, QEMU, C compiler, npm, Chromium (every other word does it by itself)
    Setup {
        /// Only say what would be done
        #[arg(long)]
        dry_run: bool,
    },
}

fn main() -> ExitCode {
    let word = Arguments::parse().word;
    match enter_workspace().and_then(|directory| run(word, &directory)) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {error:#}");
            ExitCode::FAILURE
        }
    }
}

/// Does what `word` says; `directory` is where the person is.
fn run(word: Word, directory: &Path) -> Result<()> {
    match word {
        Word::Demo(options) => demo::run(&options.seen_from(directory)),
        Word::Virtual => virtual_drive::build(),
        Word::Test(options) => test_suite::run(&options),
        Word::Firmware => firmware::build().map(|firmware| println!("{firmware}")),
        Word::Flash => firmware::flash(),
        Word::Qemu { bless: false } => qemu::run(),
        Word::Qemu { bless: true } => qemu::bless(),
        Word::Bench(options) => bench::run(&options.seen_from(directory)),
        Word::Endurance(options) => endurance::run(&options),
        Word::CommissionStages => commission_stages::run(),
        Word::Fuzz(options) => fuzz::run(&options.seen_from(directory)),
        Word::Docs => docs::write(),
        Word::Scope => scope::bundle(),
        Word::Setup { dry_run } => setup::all(dry_run),
    }
}

/// Makes the workspace the current directory, because all paths in this program are relative to it. Returns the one before.
fn enter_workspace() -> Result<PathBuf> {
    let before = std::env::current_dir().context("the current directory")?;
    let package = std::env::var_os("CARGO_MANIFEST_DIR").context("start this through `cargo xtask`")?;
    let workspace = PathBuf::from(package).join("..").canonicalize().context("the workspace")?;
    std::env::set_current_dir(workspace).context("entering the workspace")?;
    Ok(before)
}
