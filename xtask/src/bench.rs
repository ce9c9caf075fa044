//! Measurements that are reported, not judged: `cargo xtask test` holds the ones with a budget to it.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use serde_json::Value;

use crate::{firmware, host, process, qemu};

/// What the measurements can be told.
#[derive(clap::Args)]
pub struct Options {
    /// Virtual seconds to run on the virtual board
    #[arg(long, default_value_t = 2)]
    seconds: u32,
    /// Write instruction counts and the speed of the experiments as JSON (`-` for standard output: nothing else
    /// is measured then)
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
}

impl Options {
    /// File names as seen from `directory`, where the person is, which may not be the workspace.
    pub fn seen_from(self, directory: &Path) -> Options {
        Options { json: self.json.map(|path| host::seen_from(directory, path)), ..self }
    }
}

/// Where the speed of the experiments is left beside its table.
const SPEED: &str = "out/speed.json";

/// Prints the instruction counts of the control loops, how fast the experiments run on this computer, and how fast the firmware
/// runs on the virtual board.
///
/// # Errors
/// When a build or a measurement fails, or a file cannot be written.
pub fn run(options: &Options) -> Result<()> {
    const LABEL: &str = "the speed of the experiments";
    let for_programs = options.json.as_deref() == Some(Path::new("-"));
    let (table, counts) = qemu::report()?;
    let mut speed = host::cargo("run");
    speed.args(["--quiet", "--release", "--package", "servo-host-tests", "--example", "speed", "--"]);
    let experiments = if for_programs {
        process::capture(speed.arg("-"), LABEL)?
    } else {
        print!("{table}");
        process::run(speed.arg(SPEED), LABEL)?;
        std::fs::read_to_string(SPEED).with_context(|| format!("reading {SPEED}"))?
    };
    let results = format!("{:#}\n", results(counts, &experiments)?);
    match &options.json {
        Some(_) if for_programs => {
            print!("{results}");
            return Ok(());
        }
        Some(file) => std::fs::write(file, results).with_context(|| format!("writing {}", file.display()))?,
        None => {}
    }
    let firmware = firmware::build()?;
    let mut board = host::virtual_board("board", &firmware.elf)?;
    process::run(board.args(["--seconds", &options.seconds.to_string()]), "the virtual board")
}

/// The counts, and beside them what `speed` wrote.
fn results(mut counts: Value, experiments: &str) -> Result<Value> {
    counts["experiments"] =
        serde_json::from_str(experiments).context("what the measurement of the experiments wrote")?;
    Ok(counts)
}
