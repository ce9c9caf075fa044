//! `cargo xtask test`: everything that the server checks, step by step, cheap ones first.

use std::fmt::Write;
use std::time::{Duration, Instant};

use anyhow::{Result, bail};
use clap::ValueEnum;

use crate::firmware::{self, Firmware};
use crate::{demo, embedded, host, process, qemu, scope, setup, virtual_drive};

/// What the test suite can be told.
#[derive(clap::Args)]
pub struct Options {
    /// Run these steps only (several: separated by commas)
    #[arg(long, value_enum, value_delimiter = ',', value_name = "STEP")]
    only: Vec<Step>,
    /// Run the remaining steps after a failure
    #[arg(long)]
    keep_going: bool,
}

/// The steps, in order.
#[derive(Clone, Copy, Debug, PartialEq, ValueEnum)]
enum Step {
    /// What is missing gets installed
    Setup,
    /// Every crate is formatted
    Fmt,
    /// No lint warns in the host workspace, virtual board included
    Clippy,
    /// No lint warns in the embedded workspace
    ClippyEmbedded,
    /// Every public item is documented and every link leads somewhere
    Docs,
    /// Control law, simulated stage, protocol, host tool
    HostTests,
    /// The experiments' results are the same optimised
    SameBits,
    /// The firmware's ELF
    Firmware,
    /// Hot code in ITCM, stack at the bottom of DTCM
    Layout,
    /// Bits and instruction counts on a bare Cortex-M7
    Qemu,
    /// The ELF on the emulated board
    VirtualBoard,
    /// The host tool's commands on the virtual drive, from the first move to a pulled cable
    Commands,
    /// The scope page in a real browser
    Scope,
    /// The demonstration with two moves
    Demo,
}

/// How a step ended.
#[derive(Clone, Copy, Debug, PartialEq)]
enum End {
    Passed,
    Failed,
}

/// Runs the steps that `options` selects and prints how each ended.
///
/// # Errors
/// When a step fails; without `keep_going` the ones after it do not run.
pub fn run(options: &Options) -> Result<()> {
    let start = Instant::now();
    let mut ends = Vec::new();
    for step in Step::value_variants().iter().filter(|step| selects(&options.only, **step)) {
        let name = name(*step);
        eprintln!("\n== {name}: {}", about(*step));
        let step_start = Instant::now();
        let result = run_step(*step);
        let end = if result.is_ok() { End::Passed } else { End::Failed };
        let time = step_start.elapsed();
        eprintln!("== {name}: {} after {}", word(end), process::elapsed(time));
        if let Err(error) = result {
            eprintln!("error: {error:#}");
        }
        ends.push((*step, end, time));
        if end == End::Failed && !options.keep_going {
            break;
        }
    }
    eprint!("\n{}", summary(&options.only, &ends, start.elapsed()));
    let failed: Vec<_> = ends.iter().filter(|(_, end, _)| *end == End::Failed).map(|(step, ..)| name(*step)).collect();
    if !failed.is_empty() {
        bail!("failed: {}. Once more: cargo xtask test --only {}", failed.join(", "), failed.join(","));
    }
    Ok(())
}

fn run_step(step: Step) -> Result<()> {
    match step {
        Step::Setup => setup::all(false),
        Step::Fmt => formatting(),
        Step::Clippy => {
            let mut clippy = host::cargo_with_emulator("clippy")?;
            process::run(clippy.args(["--workspace", "--all-targets", "--", "-D", "warnings"]), "clippy")
        }
        Step::ClippyEmbedded => {
            let mut clippy = setup::embedded_clippy()?;
            process::run(clippy.args(["--workspace", "--", "-D", "warnings"]), "clippy, embedded")
        }
        Step::Docs => documentation(),
        Step::HostTests => process::run(&mut host::cargo("test"), "host tests"),
        Step::Commands => virtual_drive::test_commands(&firmware::build()?),
        Step::Scope => scope::test(&firmware::build()?),
        Step::SameBits => {
            let mut test = host::cargo("test");
            process::run(test.args(["--release", "--package", "servoctl", "--test", "same_bits"]), "results, optimised")
        }
        Step::Firmware => firmware::build().map(|firmware| eprintln!("{firmware}")),
        Step::Layout => firmware::build().and_then(|firmware| firmware.check_layout()),
        Step::Qemu => qemu::run(),
        Step::VirtualBoard => virtual_board_tests(&firmware::build()?),
        Step::Demo => demo::smoke_test(&firmware::build()?),
    }
}

fn formatting() -> Result<()> {
    process::run(host::cargo("fmt").args(["--all", "--check"]), "formatting")?;
    let embedded = ["--all", "--check", "--manifest-path", "firmware/Cargo.toml"];
    process::run(host::cargo("fmt").args(embedded), "formatting, embedded")
}

fn documentation() -> Result<()> {
    const DENY: (&str, &str) = ("RUSTDOCFLAGS", "-D warnings");
    let mut host_docs = host::cargo_with_emulator("doc")?;
    process::run(host_docs.args(["--workspace", "--no-deps"]).env(DENY.0, DENY.1), "documentation")?;
    let mut embedded_docs = setup::firmware_toolchain()?.cargo("doc", &embedded::target_dir()?);
    embedded_docs.args(["--workspace", "--no-deps", "--document-private-items"]).env(DENY.0, DENY.1);
    process::run(&mut embedded_docs, "documentation, embedded")
}

fn virtual_board_tests(firmware: &Firmware) -> Result<()> {
    let mut tests = host::cargo_with_emulator("test")?;
    tests.args(["--release", "--package", "servo-virtual-board"]).env("SERVO_ELF", host::absolute(&firmware.elf)?);
    process::run(&mut tests, "virtual-board tests")
}

fn selects(only: &[Step], step: Step) -> bool {
    only.is_empty() || only.contains(&step)
}

fn name(step: Step) -> String {
    step.to_possible_value().map_or_else(String::new, |value| value.get_name().to_string())
}

fn about(step: Step) -> String {
    let value = step.to_possible_value();
    value.and_then(|value| value.get_help().map(ToString::to_string)).unwrap_or_default()
}

fn word(end: End) -> &'static str {
    match end {
        End::Passed => "passed",
        End::Failed => "FAILED",
    }
}

/// The table at the end; a selected step that has no end did not run.
fn summary(only: &[Step], ends: &[(Step, End, Duration)], total: Duration) -> String {
    let mut table = String::new();
    for step in Step::value_variants().iter().filter(|step| selects(only, **step)) {
        let end = ends.iter().find(|(ended, ..)| ended == step);
        let (result, time) =
            end.map_or(("not run", String::new()), |(_, end, time)| (word(*end), process::elapsed(*time)));
        let _ = writeln!(table, "  {:<16} {result:<8} {time:>13}", name(*step));
    }
    let _ = writeln!(table, "  {:<16} {:<8} {:>13}", "total", "", process::elapsed(total));
    table
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_summary_shows_what_passed_failed_and_did_not_run() {
        let seconds = Duration::from_secs;
        let only = [Step::Fmt, Step::Docs, Step::Qemu];
        let ends = [(Step::Fmt, End::Passed, seconds(2)), (Step::Docs, End::Failed, seconds(70))];
        let expected = "  fmt              passed           2.0 s\n\
                        \x20 docs             FAILED      1 min 10 s\n\
                        \x20 qemu             not run               \n\
                        \x20 total                        1 min 12 s\n";
        assert_eq!(summary(&only, &ends, seconds(72)), expected);
    }

    #[test]
    fn without_a_selection_every_step_runs() {
        assert!(Step::value_variants().iter().all(|step| selects(&[], *step)));
        assert!(selects(&[Step::Fmt], Step::Fmt));
        assert!(!selects(&[Step::Fmt], Step::Qemu));
    }

    #[test]
    fn every_step_says_what_it_is_about() {
        assert!(Step::value_variants().iter().all(|step| !about(*step).is_empty()));
    }
}
