//! `servoctl sequence FILE`: commands from a file, one a line.

use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::atomic::Ordering;

use anyhow::{Context, Result};
use clap::Parser;
use servo_core::SERVO_HZ;
use servo_protocol::message::Request;

use super::super::interrupt;
use super::super::output::Json;
use super::motion::{self, End, Motion};
use super::{Link, params};
use crate::link::units;

/// Options of `sequence`.
#[derive(Debug, clap::Args)]
pub struct Options {
    /// The file: `move 5mm --velocity 50mm/s`, `wait 500ms`, `set NAME VALUE`, `enable`, `disable`; `#` begins a comment
    file: PathBuf,
    /// Do it so many times
    #[arg(long, default_value_t = 1)]
    times: u32,
    /// Do not wait for settling reports
    #[arg(long)]
    no_report: bool,
    #[command(flatten)]
    json: Json,
}

/// A line of the file.
#[derive(Debug, Parser)]
#[command(no_binary_name = true, disable_help_flag = true, disable_help_subcommand = true)]
enum Step {
    Move {
        #[command(flatten)]
        motion: Motion,
    },
    Wait {
        #[arg(value_parser = units::time)]
        time: f64,
    },
    Set {
        name: String,
        #[arg(allow_hyphen_values = true)]
        value: String,
    },
    Enable,
    Disable,
}

/// Reads the whole file before anything moves.
fn read(text: &str) -> Result<Vec<(usize, Step)>> {
    let lines = text.lines().enumerate().map(|(index, line)| (index + 1, line.split('#').next().unwrap_or_default()));
    let steps = lines.filter(|(_, line)| !line.trim().is_empty()).map(|(number, line)| {
        let step = Step::try_parse_from(line.split_whitespace()).map_err(|error| {
            // The first line of the usual message, which goes on about a command line.
            let text = error.to_string();
            let reason = text.lines().next().unwrap_or_default().trim_start_matches("error: ").to_owned();
            anyhow::anyhow!("line {number}: {reason}")
        })?;
        if let Step::Set { name, value } = &step {
            params::parse(name, value).with_context(|| format!("line {number}"))?;
        }
        Ok((number, step))
    });
    steps.collect()
}

/// Carries the file out, and stops at the first line that fails. Each move is reported as it ends: what has been done is not lost with what
/// fails later.
///
/// # Errors
/// A file that cannot be read, a line that makes no sense, a refusal, a fault; those of the link.
pub fn run(link: &Link, options: &Options) -> Result<ExitCode> {
    let name = options.file.display();
    let text = std::fs::read_to_string(&options.file).with_context(|| format!("reading {name}"))?;
    let steps = read(&text).with_context(|| format!("{name}"))?;
    let mut connected = link.connect()?;
    let interrupted = interrupt::flag_saying("braking; Ctrl-C again leaves the drive to itself")?;
    let mut reports = options.json.lines()?;
    for (number, step) in std::iter::repeat_n(&steps, options.times as usize).flatten() {
        if interrupted.load(Ordering::Relaxed) {
            return Ok(ExitCode::from(interrupt::INTERRUPTED));
        }
        let at = || format!("{name}, line {number}");
        match step {
            Step::Move { motion } => {
                let settings = connected.drive.parameters().with_context(at)?;
                match motion::go(&mut connected, &settings, motion, !options.no_report).with_context(at)? {
                    End::Stopped => return Ok(ExitCode::from(interrupt::INTERRUPTED)),
                    // Nobody reads any more: the rest is done nevertheless.
                    End::Arrived(moved) => reports.write(&serde_json::to_value(&moved)?, || moved.to_text())?,
                };
            }
            Step::Wait { time } => {
                let ticks = (time * f64::from(SERVO_HZ)) as u32;
                let first = connected.drive.status().with_context(at)?.tick;
                while connected.drive.status().with_context(at)?.tick.wrapping_sub(first) < ticks {
                    if interrupted.load(Ordering::Relaxed) {
                        return Ok(ExitCode::from(interrupt::INTERRUPTED));
                    }
                }
            }
            Step::Set { name, value } => {
                let row = params::parse(name, value)?;
                connected.drive.set_parameters(&[row]).with_context(at)?;
            }
            Step::Enable => connected.drive.enable().map(|_| ()).with_context(at)?,
            Step::Disable => connected.drive.order(&Request::Disable).map(|_| ()).with_context(at)?,
        }
    }
    Ok(ExitCode::SUCCESS)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn comments_and_empty_lines_are_no_steps() {
        let steps = read("# two moves\n\nmove -1.5mm --relative # back\nwait 20ms\nset compensator 1\n").unwrap();
        let numbers: Vec<_> = steps.iter().map(|(number, _)| *number).collect();
        assert_eq!(numbers, [3, 4, 5]);
    }

    #[test]
    fn a_line_that_makes_no_sense_is_named_before_anything_moves() {
        for (line, says) in [
            ("move 5", "line 2: invalid value '5' for '<TARGET>': `5` has no unit (m, mm, µm, nm, pm)"),
            ("jump 5mm", "line 2: unrecognized subcommand 'jump'"),
            ("set speed 3", "line 2: there is no parameter `speed`: `servoctl params list` names them all"),
        ] {
            let error = read(&format!("enable\n{line}\n")).unwrap_err();
            assert_eq!(format!("{error:#}"), says);
        }
    }
}
