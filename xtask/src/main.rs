//! `cargo xtask <word>`: everything a person types in this repository, and the only place where things get installed.

use std::path::PathBuf;
use std::process::ExitCode;

use anyhow::{Context, Result};
use clap::{Parser, Subcommand};

mod apt;
mod embedded;
mod firmware;
mod process;
mod setup;
mod toolchain;
mod version;

#[derive(Parser)]
#[command(
    name = "cargo xtask",
    about = "What a person types here; each word installs what it needs first."
)]
struct Arguments {
    #[command(subcommand)]
    word: Word,
}

/// The words, in the order in which a newcomer needs them.
#[derive(Subcommand)]
enum Word {
    /// Install what is missing: embedded toolchain, QEMU, C compiler
    Setup {
        /// Only say what would be done
        #[arg(long)]
        dry_run: bool,
    },
    /// Build the firmware; print path, memory use and hash of its ELF
    Firmware,
    /// Build the firmware and run it on the board that a debug probe finds
    Flash,
}

fn main() -> ExitCode {
    match enter_workspace().and_then(|()| run(Arguments::parse().word)) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {error:#}");
            ExitCode::FAILURE
        }
    }
}

fn run(word: Word) -> Result<()> {
    match word {
        Word::Setup { dry_run } => setup::all(dry_run),
        Word::Firmware => firmware::build().map(|firmware| println!("{firmware}")),
        Word::Flash => firmware::flash(),
    }
}

/// Makes the workspace the current directory: all paths in this program are relative to it.
fn enter_workspace() -> Result<()> {
    let package =
        std::env::var_os("CARGO_MANIFEST_DIR").context("start this through `cargo xtask`")?;
    let workspace = PathBuf::from(package)
        .join("..")
        .canonicalize()
        .context("the workspace")?;
    std::env::set_current_dir(workspace).context("entering the workspace")
}
