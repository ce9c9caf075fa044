//! `cargo xtask fuzz`: libFuzzer on everything that reads bytes from outside, with the installed stable compiler.
//!
//! The coverage that libFuzzer steers by is a pass of LLVM, which stable compilers run when they are told to; no sanitizer is needed, since
//! there is no code to find broken memory in. What is looked for: panics (overflow checks are on), broken promises (`fuzz/src`), inputs that
//! take ten seconds, and memory.

use std::fmt::Write;
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use anyhow::{Context, Result, bail};
use serde_json::json;

use crate::{host, process};

/// What the fuzzer can be told.
#[derive(clap::Args)]
pub struct Options {
    /// Targets [default: all]
    #[arg(value_parser = TARGETS.map(|target| target.name))]
    targets: Vec<String>,
    /// Minutes on each target
    #[arg(long, default_value_t = 10.0)]
    minutes: f64,
    /// Write the figures as JSON (`-` for standard output)
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
}

impl Options {
    /// File names as seen from `directory`, where the person is, which may not be the workspace.
    pub fn seen_from(self, directory: &Path) -> Options {
        Options { json: self.json.map(|path| host::seen_from(directory, path)), ..self }
    }
}

/// A target of `servo-fuzz`.
struct Target {
    name: &'static str,
    /// Longest input that is worth trying, bytes.
    longest: u32,
}

const TARGETS: [Target; 4] = [
    Target { name: "frame", longest: 1100 },
    Target { name: "image", longest: 2048 },
    Target { name: "biss", longest: 64 },
    Target { name: "stage", longest: 2048 },
];

/// An input that allocates more at once, or a fuzzer that takes more altogether, has found something, MB.
const MOST_AT_ONCE_MB: u32 = 256;
const MOST_MB: u32 = 1024;

/// What libFuzzer said about a run.
#[derive(Clone, Debug, Default, PartialEq)]
struct Figures {
    executions: u64,
    edges: u64,
    features: u64,
    peak_mb: u64,
}

impl Figures {
    /// Takes in a line of its output.
    fn read(&mut self, line: &str) {
        let number = |text: &str| text.trim().parse().ok();
        let words: Vec<&str> = line.split_whitespace().collect();
        for pair in words.windows(2) {
            match (pair[0], number(pair[1])) {
                ("cov:", Some(edges)) => self.edges = edges,
                ("ft:", Some(features)) => self.features = features,
                ("stat::number_of_executed_units:", Some(executions)) => self.executions = executions,
                ("stat::peak_rss_mb:", Some(peak_mb)) => self.peak_mb = peak_mb,
                _ => {}
            }
        }
    }
}

/// Builds the targets, runs the fuzzer on each and keeps the smallest set of inputs that covers as much as it found.
///
/// # Errors
/// When the build fails or a target finds something: the message says where the input is.
pub fn run(options: &Options) -> Result<()> {
    let chosen: Vec<&Target> = TARGETS
        .iter()
        .filter(|target| options.targets.is_empty() || options.targets.iter().any(|name| name == target.name))
        .collect();
    let programs = build(&chosen)?;
    let mut rows = Vec::new();
    for target in chosen {
        eprintln!("\n== {}: {} min", target.name, options.minutes);
        let program = programs.join(target.name);
        let work = target_dir().join("corpus").join(target.name);
        let kept = Path::new("fuzz/corpus").join(target.name);
        for folder in [&work, &kept] {
            std::fs::create_dir_all(folder).with_context(|| format!("creating {}", folder.display()))?;
        }
        let mut seeds = host::cargo("run");
        seeds.args(["--quiet", "--package", "servo-fuzz", "--bin", "seeds", "--", target.name]).arg(&work);
        process::run(&mut seeds, "seeds")?;
        let figures = fuzz(target, &program, &work, &kept, options.minutes)?;
        let (inputs, bytes) = minimise(target, &program, &work, &kept)?;
        rows.push((target.name, figures, inputs, bytes));
    }
    let mut table = format!(
        "\n  {:<8} {:>12} {:>8} {:>9} {:>8} {:>12} {:>8}\n",
        "target", "executions", "edges", "features", "inputs", "corpus bytes", "peak MB"
    );
    for (name, f, inputs, bytes) in &rows {
        let _ = writeln!(
            table,
            "  {name:<8} {:>12} {:>8} {:>9} {inputs:>8} {bytes:>12} {:>8}",
            f.executions, f.edges, f.features, f.peak_mb
        );
    }
    eprint!("{table}");
    if let Some(path) = &options.json {
        let rows = rows.iter().map(|(name, f, inputs, bytes)| {
            json!({
                "target": name, "time_min": options.minutes, "executions": f.executions, "edges": f.edges, "features": f.features,
                "corpus_inputs": inputs, "corpus_bytes": bytes, "peak_mb": f.peak_mb,
            })
        });
        let text = serde_json::to_string_pretty(&rows.collect::<Vec<_>>())? + "\n";
        if path == Path::new("-") {
            print!("{text}");
        } else {
            std::fs::write(path, text).with_context(|| format!("writing {}", path.display()))?;
        }
    }
    Ok(())
}

/// Where instrumented programs and work in progress go: other flags, another folder.
fn target_dir() -> PathBuf {
    PathBuf::from(std::env::var_os("CARGO_TARGET_DIR").unwrap_or("target".into())).join("fuzz")
}

/// Builds the chosen programs and returns their folder.
fn build(chosen: &[&Target]) -> Result<PathBuf> {
    const FLAGS: [&str; 8] = [
        "-Cpasses=sancov-module",
        "-Cllvm-args=-sanitizer-coverage-level=4",
        "-Cllvm-args=-sanitizer-coverage-inline-8bit-counters",
        "-Cllvm-args=-sanitizer-coverage-pc-table",
        "-Cllvm-args=-sanitizer-coverage-trace-compares",
        "-Ccodegen-units=1",
        "-Cdebug-assertions",
        "-Coverflow-checks",
    ];
    let printed = process::capture(Command::new("rustc").arg("-vV"), "rustc")?;
    let triple = printed.lines().find_map(|line| line.strip_prefix("host: ")).context("rustc names no host")?;
    let mut cargo = host::cargo("build");
    // A target, even if it is the host: the flags are then not for build scripts and procedural macros.
    cargo.args(["--release", "--package", "servo-fuzz", "--features", "libfuzzer", "--target", triple]);
    cargo.args(chosen.iter().flat_map(|target| ["--bin", target.name]));
    cargo.arg("--target-dir").arg(target_dir()).env("RUSTFLAGS", FLAGS.join(" "));
    process::run(&mut cargo, "building the fuzz targets")?;
    Ok(target_dir().join(triple).join("release"))
}

/// Runs the fuzzer, passing on what it says now and then.
fn fuzz(target: &Target, program: &Path, work: &Path, kept: &Path, minutes: f64) -> Result<Figures> {
    let findings = target_dir().join("findings").join(target.name);
    std::fs::create_dir_all(&findings).with_context(|| format!("creating {}", findings.display()))?;
    let mut command = Command::new(program);
    command.args([work, kept]).args([
        format!("-max_total_time={}", (60.0 * minutes).ceil()),
        format!("-max_len={}", target.longest),
        format!("-malloc_limit_mb={MOST_AT_ONCE_MB}"),
        format!("-rss_limit_mb={MOST_MB}"),
        format!("-artifact_prefix={}/", findings.display()),
        "-timeout=10".to_string(),
        "-print_final_stats=1".to_string(),
    ]);
    let mut child = command.stderr(Stdio::piped()).spawn().context("starting the fuzzer")?;
    let mut figures = Figures::default();
    let stderr = child.stderr.take().context("the fuzzer's output")?;
    for line in BufReader::new(stderr).lines() {
        let line = line.context("the fuzzer's output")?;
        figures.read(&line);
        // Every new input is a line: too many to watch.
        if !["NEW ", "NEW_FUNC", "REDUCE "].iter().any(|news| line.contains(news)) {
            eprintln!("{line}");
        }
    }
    if !child.wait().context("waiting for the fuzzer")?.success() {
        bail!("{} has found something; the input is in {}", target.name, findings.display());
    }
    Ok(figures)
}

/// Replaces the kept corpus by the fewest inputs that cover as much as it and the work in progress; how many, and their bytes.
fn minimise(target: &Target, program: &Path, work: &Path, kept: &Path) -> Result<(usize, u64)> {
    let fewest = target_dir().join("fewest").join(target.name);
    if fewest.exists() {
        std::fs::remove_dir_all(&fewest).with_context(|| format!("emptying {}", fewest.display()))?;
    }
    std::fs::create_dir_all(&fewest).with_context(|| format!("creating {}", fewest.display()))?;
    process::capture(
        Command::new(program).args(["-set_cover_merge=1", "-use_counters=0"]).args([&fewest, kept, work]),
        "minimising",
    )?;
    for old in std::fs::read_dir(kept).context("the corpus")? {
        std::fs::remove_file(old.context("the corpus")?.path()).context("the corpus")?;
    }
    let (mut inputs, mut bytes) = (0, 0);
    for new in std::fs::read_dir(&fewest).context("the new corpus")? {
        let new = new.context("the new corpus")?;
        bytes += std::fs::copy(new.path(), kept.join(new.file_name())).context("the new corpus")?;
        inputs += 1;
    }
    Ok((inputs, bytes))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_figures_are_read_from_what_libfuzzer_prints() {
        let mut figures = Figures::default();
        for line in [
            "#2\tINITED cov: 39 ft: 40 corp: 1/1b exec/s: 0 rss: 41Mb",
            "#524288\tDONE   cov: 345 ft: 1234 corp: 200/12Kb lim: 4096 exec/s: 100 rss: 51Mb",
            "stat::number_of_executed_units: 524288",
            "stat::peak_rss_mb:              451",
        ] {
            figures.read(line);
        }
        assert_eq!(figures, Figures { executions: 524_288, edges: 345, features: 1234, peak_mb: 451 });
    }
}
