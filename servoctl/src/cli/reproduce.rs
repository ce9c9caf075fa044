//! `servoctl reproduce`: an experiment of the thesis, simulated.

use std::path::PathBuf;

use anyhow::{Context, Result, bail, ensure};
use clap::ValueEnum;
use serde::Serialize;
use servo_core::refusal::Refusal;
use servo_sim::Stage;

use super::interrupt;
use super::output::Json;
use super::progress::Progress;
use crate::reproduce::campaign::{Shard, Watch};
use crate::reproduce::experiments::{Experiment, MASS_ERRORS_PERCENT, Request};
use crate::reproduce::loop_transmission::{self, LoopTransmission};
use crate::reproduce::outcome::Outcome;
use crate::reproduce::shard::ShardFile;

/// Options of `reproduce`.
#[derive(Debug, clap::Args)]
pub struct Options {
    /// The experiment
    name: Name,
    /// Stage file (TOML) [default: the stage of the thesis]
    #[arg(long, value_name = "FILE")]
    stage: Option<PathBuf>,
    /// Moves per configuration, 1 to 10 000 000 [default: as many as the thesis made]
    #[arg(long, value_name = "N")]
    moves: Option<u64>,
    /// Seed of friction and noise; the same seed gives the same numbers, on any number of threads
    #[arg(long, value_name = "S", default_value_t = 1)]
    seed: u64,
    /// exp2: error of the feedforward mass in percent, −20 to 20; repeatable [default: −2, −1, 0, 1, 2]
    #[arg(long, value_name = "PERCENT", allow_negative_numbers = true, value_delimiter = ',')]
    mass_error: Vec<f64>,
    /// Compute only the I-th of N parts and write it to the --json file, for `servoctl merge`
    #[arg(long, value_name = "I/N", requires = "json")]
    shard: Option<Shard>,
    /// Threads [default: one per core]
    #[arg(long, value_name = "N")]
    threads: Option<usize>,
    #[command(flatten)]
    json: Json,
}

/// What can be reproduced.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Name {
    /// First experiment (9.1): 5 mm at 1 m/s², PID 100 Hz / 45° without feedforward
    Exp1,
    /// Second experiment (9.2): 5 mm at 10 m/s², PID 315 Hz / 50° with acceleration feedforward, five mass errors
    Exp2,
    /// 5 µm steps (9.4), both tunings
    #[value(name = "step-5um")]
    Step5Um,
    /// 50 nm steps (9.4), both tunings
    #[value(name = "step-50nm")]
    Step50Nm,
    /// In-position noise (9.3, table 3), both tunings
    InPosition,
    /// Loop transmission by stepped sine (5.1, 8.2): amplitudes, NIASA, rate limit
    LoopTransmission,
}

impl Name {
    fn typed(self) -> String {
        self.to_possible_value().map_or(String::new(), |value| value.get_name().to_owned())
    }

    fn settling(self) -> Option<Experiment> {
        Some(match self {
            Name::Exp1 => Experiment::Exp1,
            Name::Exp2 => Experiment::Exp2,
            Name::Step5Um => Experiment::Step5Um,
            Name::Step50Nm => Experiment::Step50Nm,
            Name::InPosition => Experiment::InPosition,
            Name::LoopTransmission => return None,
        })
    }
}

/// Computes and prints.
///
/// # Errors
/// Options out of range, a wrong stage file, a refusal of the drive, a file that cannot be written.
pub fn run(options: &Options) -> Result<()> {
    if let Some(threads) = options.threads {
        ensure!((1..=1024).contains(&threads), "threads = {threads} is outside 1 to 1024");
        rayon::ThreadPoolBuilder::new().num_threads(threads).build_global()?;
    }
    let stage = read_stage(options.stage.as_ref())?;
    if let Some(experiment) = options.name.settling() {
        return settling(options, experiment, stage);
    }
    let settling_only = [
        ("moves", options.moves.is_some()),
        ("mass-error", !options.mass_error.is_empty()),
        ("shard", options.shard.is_some()),
    ];
    if let Some((option, _)) = settling_only.into_iter().find(|(_, given)| *given) {
        bail!("{option} is an option of the settling experiments, not of {}", options.name.typed());
    }
    let seed = options.seed;
    match options.name {
        Name::LoopTransmission => {
            let run = |watch: Watch| loop_transmission::run(&stage, seed, watch);
            measure(options, loop_transmission::SWEEPS, "sweeps", run, LoopTransmission::to_text)
        }
        _ => Ok(()),
    }
}

/// Runs what is shown as a whole or not at all, with progress.
fn measure<T: Serialize>(
    options: &Options,
    pieces: u64,
    unit: &str,
    run: impl FnOnce(Watch) -> Result<Option<T>, Refusal>,
    text: impl FnOnce(&T) -> String,
) -> Result<()> {
    let progress = Progress::new(&options.name.typed(), pieces, unit);
    let finished = |pieces| progress.advance(pieces);
    let found = run(Watch { stop: interrupt::flag()?, finished: &finished })?;
    drop(progress);
    let found = found.context("ended before it was finished: nothing to show")?;
    options.json.write(&found, || text(&found))
}

fn settling(options: &Options, experiment: Experiment, stage: Stage) -> Result<()> {
    let moves = options.moves.unwrap_or(experiment.moves());
    ensure!((1..=10_000_000).contains(&moves), "moves = {moves} is outside 1 to 10000000");
    ensure!(
        options.mass_error.is_empty() || experiment == Experiment::Exp2,
        "mass-error is an option of exp2, not of {}",
        experiment.name()
    );
    for percent in &options.mass_error {
        ensure!((-20.0..=20.0).contains(percent), "mass-error = {percent} is outside -20 to 20 %");
    }
    let given = if options.mass_error.is_empty() { &MASS_ERRORS_PERCENT[..] } else { &options.mass_error };
    let mass_errors_percent = if experiment == Experiment::Exp2 { given.to_vec() } else { Vec::new() };
    let plan = Request { experiment, moves, seed: options.seed, mass_errors_percent, stage }.plan()?;

    let shard = options.shard.unwrap_or(Shard::ALL);
    let progress = Progress::new(experiment.name(), plan.campaign.moves_of(shard), "moves");
    let finished = |moves| progress.advance(moves);
    let passes = plan.campaign.run(shard, Watch { stop: interrupt::flag()?, finished: &finished })?;
    drop(progress);
    if options.shard.is_some() {
        let part = ShardFile::new(&plan, shard, passes);
        return options.json.write(&part, || {
            let what = if part.complete { "complete" } else { "not complete" };
            format!(
                "part {}/{} of {}: {} passes, {what}\n",
                shard.number,
                shard.of,
                experiment.name(),
                part.passes.len()
            )
        });
    }
    ensure!(!passes.is_empty(), "ended before the first pass was finished: nothing to show");
    let outcome = Outcome::new(&plan, &passes);
    options.json.write(&outcome, || outcome.to_text())
}

/// The stage file, or the built-in one.
///
/// # Errors
/// A file that cannot be read, or is wrong: with line, key, value and range.
pub fn read_stage(file: Option<&PathBuf>) -> Result<Stage> {
    let Some(file) = file else { return Ok(Stage::default()) };
    let text = std::fs::read_to_string(file).with_context(|| format!("--stage {}", file.display()))?;
    Stage::from_toml(&text).with_context(|| format!("--stage {}", file.display()))
}
