//! Measurements of speed. Instruction counts are only reported here, `cargo xtask test` holds them to their budgets; the speed of the
//! experiments, which depends on the computer, is held to what is wanted of it here and nowhere else.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, ensure};
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
/// When a build or a measurement fails, a file cannot be written, or, after everything has been measured, the experiments are slower than
/// wanted.
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
    let results = results(counts, &experiments)?;
    let fast_enough = fast_enough(&results["experiments"]);
    let results = format!("{results:#}\n");
    match &options.json {
        Some(_) if for_programs => {
            print!("{results}");
            return fast_enough;
        }
        Some(file) => std::fs::write(file, results).with_context(|| format!("writing {}", file.display()))?,
        None => {}
    }
    let firmware = firmware::build()?;
    let mut board = host::virtual_board("board", &firmware.elf)?;
    process::run(board.args(["--seconds", &options.seconds.to_string()]), "the virtual board")?;
    fast_enough
}

/// Whether the experiments are as fast as `speed` wants them to be.
fn fast_enough(experiments: &Value) -> Result<()> {
    let of = |name: &str| experiments[name].as_f64().with_context(|| format!("{name} was not measured"));
    let (fast, wanted) = (of("fast_simulated_s_per_s")?, of("wanted_simulated_s_per_s")?);
    ensure!(
        fast >= wanted,
        "the experiments run at {fast} simulated seconds per second and core, below the wanted {wanted}"
    );
    Ok(())
}

/// The counts, and beside them what `speed` wrote.
fn results(mut counts: Value, experiments: &str) -> Result<Value> {
    counts["experiments"] =
        serde_json::from_str(experiments).context("what the measurement of the experiments wrote")?;
    Ok(counts)
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::fast_enough;

    #[test]
    fn experiments_that_are_too_slow_or_were_not_measured_fail() {
        let measured = |fast: f64| json!({"fast_simulated_s_per_s": fast, "wanted_simulated_s_per_s": 200.0});
        assert!(fast_enough(&measured(200.0)).is_ok());
        let slow = fast_enough(&measured(199.9)).unwrap_err().to_string();
        assert!(slow.contains("199.9") && slow.contains("below the wanted 200"), "{slow}");
        assert!(fast_enough(&json!({})).is_err());
    }
}
