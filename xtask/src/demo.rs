//! The demonstration: the firmware's ELF on the virtual board, with and without the compensator.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use serde_json::Value;

use crate::firmware::{self, Firmware};
use crate::{host, process};

/// What the demonstration can be told; it checks the values itself.
#[derive(Default, clap::Args)]
pub struct Options {
    /// Moves per configuration [default: 5]
    #[arg(long)]
    moves: Option<u32>,
    /// Stage file (TOML) [default: the stage of the thesis]
    #[arg(long, value_name = "FILE")]
    stage: Option<PathBuf>,
    /// Seed of friction and noise; the same seed gives the same numbers [default: 1]
    #[arg(long)]
    seed: Option<u64>,
    /// Write the results as JSON (`-` for standard output)
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
    /// Where the report goes [default: out/report.html]
    #[arg(long, value_name = "FILE")]
    report: Option<PathBuf>,
}

impl Options {
    /// File names as seen from `directory`, where the person is, which may not be the workspace.
    pub fn seen_from(self, directory: &Path) -> Options {
        let seen = |path: Option<PathBuf>| path.map(|path| host::seen_from(directory, path));
        Options { stage: seen(self.stage), json: seen(self.json), report: seen(self.report), ..self }
    }

    fn arguments(&self) -> Vec<String> {
        let text = |path: &PathBuf| path.display().to_string();
        let options = [
            ("--moves", self.moves.map(|moves| moves.to_string())),
            ("--stage", self.stage.as_ref().map(text)),
            ("--seed", self.seed.map(|seed| seed.to_string())),
            ("--json", self.json.as_ref().map(text)),
            ("--report", self.report.as_ref().map(text)),
        ];
        options.into_iter().filter_map(|(name, value)| Some([name.to_string(), value?])).flatten().collect()
    }
}

/// Builds what it takes and runs the demonstration.
///
/// # Errors
/// When set-up, a build or the demonstration fails.
pub fn run(options: &Options) -> Result<()> {
    let firmware = firmware::build()?;
    run_on(&firmware, options)
}

/// The demonstration in short, on `firmware`: few moves, and its JSON held to what must be true of any number of moves.
///
/// # Errors
/// When the demonstration fails or its JSON shows a wrong ELF, a missing move, an overrun, or a move that the
/// compensator did not settle, or noise in position beyond [`MOST_NOISE_NM`].
pub fn smoke_test(firmware: &Firmware) -> Result<()> {
    const MOVES: u32 = 2;
    let json = PathBuf::from("out/smoke.json");
    std::fs::create_dir_all("out").context("creating out/")?;
    let report = Some(PathBuf::from("out/smoke.html"));
    run_on(firmware, &Options { moves: Some(MOVES), json: Some(json.clone()), report, ..Options::default() })?;
    let text = std::fs::read_to_string(&json).with_context(|| format!("reading {}", json.display()))?;
    let results = serde_json::from_str(&text).with_context(|| format!("{} is not JSON", json.display()))?;
    let wrong = complaints(&results, &firmware.sha256, MOVES);
    if !wrong.is_empty() {
        bail!("{}:\n  {}", json.display(), wrong.join("\n  "));
    }
    eprintln!("{}: {MOVES} moves per configuration, every check passed", json.display());
    Ok(())
}

fn run_on(firmware: &Firmware, options: &Options) -> Result<()> {
    let mut demo = host::virtual_board("demo", &firmware.elf)?;
    process::run(demo.args(options.arguments()), "the demonstration")
}

/// Tolerances that settling times are given for.
const TOLERANCES: usize = 6;

/// Largest rms error in position, with and without the compensator.
const MOST_NOISE_NM: f64 = 1.0;

/// Least reduction of the mean settling time, at every tolerance.
const LEAST_REDUCTION_PERCENT: f64 = 70.0;

/// Longest servo tick: a quarter of its period.
const LONGEST_TICK_US: f64 = 31.25;

/// What is wrong with the demonstration's results, one line each.
fn complaints(results: &Value, elf_sha256: &str, moves: u32) -> Vec<String> {
    let mut wrong = Vec::new();
    let mut expect = |field: &str, expected: Value| {
        let found = results.pointer(field).unwrap_or(&Value::Null);
        if *found != expected {
            wrong.push(format!("{field} is {found}, expected {expected}"));
        }
    };
    expect("/elf_sha256", elf_sha256.into());
    expect("/moves", moves.into());
    expect("/tolerances_nm/0", 3.into());
    expect("/servo_tick/rate_hz", 8000.into());
    expect("/servo_tick/overruns", 0.into());
    expect("/configs/0/name", "pid".into());
    expect("/configs/1/name", "pid+niasa".into());
    expect("/configs/1/unsettled", [0; TOLERANCES].to_vec().into());
    let mut number = |field: &str, words: &str, limit: f64, fits: fn(&f64, &f64) -> bool| {
        let found = results.pointer(field).unwrap_or(&Value::Null);
        if !found.as_f64().is_some_and(|found| fits(&found, &limit)) {
            wrong.push(format!("{field} is {found}, expected at {words} {limit}"));
        }
    };
    number("/configs/0/in_position_rms_nm", "most", MOST_NOISE_NM, f64::le);
    number("/configs/1/in_position_rms_nm", "most", MOST_NOISE_NM, f64::le);
    number("/servo_tick/max_us", "most", LONGEST_TICK_US, f64::le);
    for tolerance in 0..TOLERANCES {
        number(&format!("/reduction_percent/{tolerance}"), "least", LEAST_REDUCTION_PERCENT, f64::ge);
    }
    wrong
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    fn good() -> Value {
        json!({
            "elf_sha256": "ab12", "moves": 2, "tolerances_nm": [3, 5, 10, 20, 50, 100],
            "configs": [
                {"name": "pid", "unsettled": [2, 1, 0, 0, 0, 0], "in_position_rms_nm": 0.7},
                {"name": "pid+niasa", "unsettled": [0, 0, 0, 0, 0, 0], "in_position_rms_nm": 1.0},
            ],
            "reduction_percent": [80.0, 79.0, 78.0, 77.0, 76.0, 70.0],
            "servo_tick": {"rate_hz": 8000, "count": 9, "overruns": 0, "max_us": 13.0}, "told": [],
        })
    }

    #[test]
    fn good_results_pass() {
        assert_eq!(complaints(&good(), "ab12", 2), Vec::<String>::new());
    }

    #[test]
    fn every_wrong_field_is_named_with_what_was_found() {
        let cases = [
            ("/elf_sha256", json!("cd34"), r#"/elf_sha256 is "cd34", expected "ab12""#),
            ("/moves", json!(1), "/moves is 1, expected 2"),
            ("/servo_tick/overruns", json!(3), "/servo_tick/overruns is 3, expected 0"),
            ("/configs/1/unsettled/5", json!(1), "/configs/1/unsettled is [0,0,0,0,0,1], expected [0,0,0,0,0,0]"),
            ("/servo_tick/max_us", json!(31.3), "/servo_tick/max_us is 31.3, expected at most 31.25"),
            ("/reduction_percent/5", json!(69.9), "/reduction_percent/5 is 69.9, expected at least 70"),
            ("/reduction_percent/0", json!(null), "/reduction_percent/0 is null, expected at least 70"),
            ("/configs/1/in_position_rms_nm", json!(1.1), "/configs/1/in_position_rms_nm is 1.1, expected at most 1"),
            ("/configs/0/in_position_rms_nm", json!(null), "/configs/0/in_position_rms_nm is null, expected at most 1"),
            ("/configs", json!([]), r#"/configs/0/name is null, expected "pid""#),
        ];
        for (field, value, complaint) in cases {
            let mut results = good();
            *results.pointer_mut(field).unwrap() = value;
            let wrong = complaints(&results, "ab12", 2);
            assert_eq!(wrong.first().map(String::as_str), Some(complaint));
        }
    }

    #[test]
    fn only_given_options_are_passed_on() {
        assert!(Options::default().arguments().is_empty());
        let options = Options { moves: Some(3), json: Some("-".into()), ..Options::default() };
        assert_eq!(options.arguments(), ["--moves", "3", "--json", "-"]);
    }

    #[test]
    fn file_names_are_those_of_the_person_not_of_the_workspace() {
        let options = Options { stage: Some("a.toml".into()), json: Some("-".into()), ..Options::default() };
        let seen = options.seen_from(Path::new("elsewhere"));
        assert_eq!(seen.stage, Some(Path::new("elsewhere").join("a.toml")));
        assert_eq!(seen.json, Some("-".into()), "standard output is nowhere");
    }
}
