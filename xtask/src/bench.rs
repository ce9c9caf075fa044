//! Measurements that are reported, not judged: `cargo xtask test` holds the ones with a budget to it.

use std::path::{Path, PathBuf};

use anyhow::Result;

use crate::{firmware, host, process, qemu};

/// What the measurements can be told.
#[derive(clap::Args)]
pub struct Options {
    /// Virtual seconds to run on the virtual board
    #[arg(long, default_value_t = 2)]
    seconds: u32,
    /// Write the instruction counts as JSON (`-` for standard output)
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
}

impl Options {
    /// File names as seen from `directory`, where the person is, which may not be the workspace.
    pub fn seen_from(self, directory: &Path) -> Options {
        Options { json: self.json.map(|path| host::seen_from(directory, path)), ..self }
    }
}

/// Prints the instruction counts of the control loops, how fast the experiments run on this computer, and how fast the firmware
/// runs on the virtual board.
///
/// # Errors
/// When a build or a measurement fails.
pub fn run(options: &Options) -> Result<()> {
    qemu::report(options.json.as_deref())?;
    if options.json.as_deref() == Some(Path::new("-")) {
        return Ok(());
    }
    let mut speed = host::cargo("run");
    speed.args(["--quiet", "--release", "--package", "servo-host-tests", "--example", "speed"]);
    process::run(&mut speed, "the speed of the experiments")?;
    let firmware = firmware::build()?;
    let mut board = host::virtual_board("board", &firmware.elf)?;
    process::run(board.args(["--seconds", &options.seconds.to_string()]), "the virtual board")
}
