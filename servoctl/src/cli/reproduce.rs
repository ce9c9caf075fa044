//! `servoctl reproduce`: an experiment of the thesis, simulated.

use std::path::PathBuf;
use std::sync::atomic::Ordering;

use anyhow::{Context, Result, bail, ensure};
use clap::ValueEnum;
use serde_json::{Map, Value, json};
use servo_core::refusal::Refusal;
use servo_sim::Stage;

use super::interrupt;
use super::output::Json;
use super::progress::Progress;
use super::stage::read_stage;
use crate::reproduce::campaign::{Shard, Watch};
use crate::reproduce::experiments::{Experiment, MASS_ERRORS_PERCENT, Request};
use crate::reproduce::identification;
use crate::reproduce::identification_study::{self, IdentificationStudy};
use crate::reproduce::loop_transmission::{self, LoopTransmission};
use crate::reproduce::outcome::Outcome;
use crate::reproduce::shard::ShardFile;
use crate::reproduce::step_100um::{self, Step100Um};
use crate::reproduce::{compensators, models};

/// Options of `reproduce`.
#[derive(Debug, clap::Args)]
pub struct Options {
    /// The experiment
    name: Name,
    /// Stage file (TOML) [default: the stage of the thesis]
    #[arg(long, value_name = "FILE")]
    stage: Option<PathBuf>,
    /// Moves per configuration, 1 to 10 000 000; step-100um: steps; identification-study: steps, and its runs in proportion
    /// [default: as many as the thesis made]
    #[arg(long, value_name = "N")]
    moves: Option<u64>,
    /// Seed of friction and noise; the same seed gives the same numbers, on any number of threads
    #[arg(long, value_name = "S", default_value_t = 1)]
    seed: u64,
    /// exp2: error of the feedforward mass in percent, −20 to 20; repeatable [default: −2, −1, 0, 1, 2]
    #[arg(long, value_name = "PERCENT", allow_hyphen_values = true, value_delimiter = ',')]
    mass_error: Vec<f64>,
    /// Only these configurations, by name, beside the first, which everything is compared with [default: all]
    #[arg(long, value_name = "NAMES", value_delimiter = ',', conflicts_with = "shard")]
    configs: Vec<String>,
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
    /// 100 µm step (5.3): where the stage ceases to be linear
    #[value(name = "step-100um")]
    Step100Um,
    /// Friction models fitted to the same data (figures 4 to 10)
    Models,
    /// σ and F_C by identification profile and from settling (6.2, 6.3, tables 1 and 2)
    IdentificationStudy,
    /// Every compensator on the moves of exp1, each tuned first (chapter 4)
    Compensators,
    /// NIASA's parameters one by one, and stages that are not what the model says (8.1, 7.4)
    Sensitivity,
    /// All of them, one after the other
    All,
}

/// What is computed.
enum Kind {
    Settling(Experiment),
    LoopTransmission,
    Step100Um,
    Models,
    IdentificationStudy,
    All,
}

impl Name {
    fn typed(self) -> String {
        self.to_possible_value().map_or(String::new(), |value| value.get_name().to_owned())
    }

    /// Travel that its moves of 5 mm or its own steps need, m; what hardly moves needs less than any stage has.
    fn travel_m(self) -> f64 {
        match self.kind() {
            Kind::Settling(experiment) => experiment.travel_m(),
            Kind::IdentificationStudy | Kind::All => Experiment::Exp1.travel_m(),
            Kind::Step100Um => step_100um::TRAVEL_M,
            Kind::LoopTransmission | Kind::Models => 0.0,
        }
    }

    fn kind(self) -> Kind {
        Kind::Settling(match self {
            Name::Exp1 => Experiment::Exp1,
            Name::Exp2 => Experiment::Exp2,
            Name::Step5Um => Experiment::Step5Um,
            Name::Step50Nm => Experiment::Step50Nm,
            Name::InPosition => Experiment::InPosition,
            Name::Compensators => Experiment::Compensators,
            Name::Sensitivity => Experiment::Sensitivity,
            Name::LoopTransmission => return Kind::LoopTransmission,
            Name::Step100Um => return Kind::Step100Um,
            Name::Models => return Kind::Models,
            Name::IdentificationStudy => return Kind::IdentificationStudy,
            Name::All => return Kind::All,
        })
    }
}

/// Something finished: for people, and for programs.
type Found = (String, Value);

/// Computes and prints.
///
/// # Errors
/// Options out of range, a wrong stage file, a refusal of the drive, a file that cannot be written.
pub fn run(options: &Options) -> Result<()> {
    if let Some(threads) = options.threads {
        ensure!((1..=1024).contains(&threads), "threads = {threads} is outside 1 to 1024");
        rayon::ThreadPoolBuilder::new().num_threads(threads).build_global()?;
    }
    options.check()?;
    let stage = read_stage(options.stage.as_deref(), options.name.travel_m())?;
    if let Some(note) = options.unused() {
        eprintln!("{note}");
    }
    let (text, value) = match options.name.kind() {
        Kind::All => all(options, &stage)?,
        Kind::Settling(experiment) if options.shard.is_some() => return part(options, experiment, stage),
        _ => one(options, options.name, &stage)?,
    };
    options.json.write(&value, || text)
}

impl Options {
    /// Options that the experiment does not have, or out of range.
    fn check(&self) -> Result<()> {
        let name = self.name.typed();
        let settling = matches!(self.name.kind(), Kind::Settling(_));
        if let Some(moves) = self.moves {
            ensure!((1..=10_000_000).contains(&moves), "moves = {moves} is outside 1 to 10000000");
        }
        if self.shard.is_some() && !settling {
            bail!("shard is an option of the settling experiments, not of {name}");
        }
        ensure!(self.configs.is_empty() || settling, "configs is an option of the settling experiments, not of {name}");
        let has_mass_error = matches!(self.name, Name::Exp2 | Name::All);
        ensure!(self.mass_error.is_empty() || has_mass_error, "mass-error is an option of exp2, not of {name}");
        for percent in &self.mass_error {
            ensure!((-20.0..=20.0).contains(percent), "mass-error = {percent} is outside -20 to 20 %");
        }
        Ok(())
    }

    /// What was asked for and means nothing to the experiment: said, so that nobody takes the result for something else.
    fn unused(&self) -> Option<String> {
        let given = [("moves", self.moves.is_some()), ("stage", self.stage.is_some())];
        let (used, why): (&[&str], _) = match self.name {
            Name::LoopTransmission => {
                (&["stage"], "each sweep measures 49 tones, with friction as it stands in the stage file")
            }
            Name::Models => (&[], "the models are fitted to one motion of the published elements (table 4)"),
            _ => return None,
        };
        let unused: Vec<_> = given
            .iter()
            .filter(|(key, given)| *given && !used.contains(key))
            .map(|(key, _)| format!("--{key}"))
            .collect();
        (!unused.is_empty()).then(|| format!("{}: {} not used; {why}", self.name.typed(), unused.join(" and ")))
    }

    fn request(&self, experiment: Experiment, stage: Stage) -> Request {
        let given = if self.mass_error.is_empty() { &MASS_ERRORS_PERCENT[..] } else { &self.mass_error };
        let mass_errors_percent = if experiment == Experiment::Exp2 { given.to_vec() } else { Vec::new() };
        let moves = self.moves.unwrap_or(experiment.moves());
        Request { experiment, moves, seed: self.seed, mass_errors_percent, stage }
    }
}

/// Every experiment in turn. Ended early, it gives those that are finished.
fn all(options: &Options, stage: &Stage) -> Result<Found> {
    let stop = interrupt::flag()?;
    let (mut text, mut found) = (String::new(), Map::new());
    let names: Vec<Name> = Name::value_variants().iter().copied().filter(|name| *name != Name::All).collect();
    let mut finished = 0;
    for name in &names {
        if stop.load(Ordering::Relaxed) {
            break;
        }
        match one(options, *name, stage) {
            Ok((words, value)) => {
                text += &format!("── {} ──\n\n{words}\n", name.typed());
                found.insert(name.typed(), value);
                finished += 1;
            }
            // What had not begun to give results has none.
            Err(_) if stop.load(Ordering::Relaxed) => break,
            Err(error) => return Err(error.context(name.typed())),
        }
    }
    let complete = finished == names.len() && !stop.load(Ordering::Relaxed);
    if !complete {
        text += "Not complete: ended before the last experiment was finished.\n";
    }
    Ok((text, json!({ "experiment": "all", "complete": complete, "experiments": found })))
}

fn one(options: &Options, name: Name, stage: &Stage) -> Result<Found> {
    let seed = options.seed;
    match name.kind() {
        Kind::Settling(experiment) => settling(options.request(experiment, *stage), &options.configs),
        Kind::LoopTransmission => {
            let run = |watch: Watch| loop_transmission::run(stage, seed, watch);
            let found: LoopTransmission = measured(name, loop_transmission::SWEEPS, "sweeps", run)?;
            Ok((found.to_text(), serde_json::to_value(&found)?))
        }
        Kind::Step100Um => {
            let moves = options.moves.unwrap_or(step_100um::MOVES);
            let run = |watch: Watch| step_100um::run(stage, moves, seed, watch).map(Some);
            let found: Step100Um = measured(name, moves, "steps", run)?;
            Ok((found.to_text(), serde_json::to_value(&found)?))
        }
        Kind::Models => {
            let found = measured(name, models::FITS, "fits", |watch| Ok(Some(models::run(watch))))?;
            Ok((found.to_text(), serde_json::to_value(&found)?))
        }
        Kind::IdentificationStudy => {
            let steps = options.moves.unwrap_or(identification::STEPS);
            let runs = identification::runs_beside(steps);
            let pieces = identification::pieces(runs, steps);
            let run = |watch: Watch| identification_study::run(stage, runs, steps, seed, watch);
            let found: IdentificationStudy = measured(name, pieces, "runs", run)?;
            Ok((found.to_text(), serde_json::to_value(&found)?))
        }
        Kind::All => bail!("all is not one experiment"),
    }
}

/// Runs a measurement, with progress. Ended early, it gives what is finished.
fn measured<T>(
    name: Name,
    pieces: u64,
    unit: &str,
    run: impl FnOnce(Watch) -> Result<Option<T>, Refusal>,
) -> Result<T> {
    let progress = Progress::new(&name.typed(), pieces, unit);
    let finished = |pieces| progress.advance(pieces);
    let found = run(Watch { stop: interrupt::flag()?, finished: &finished })?;
    drop(progress);
    found.context("ended before anything was finished: nothing to show")
}

fn settling(request: Request, configs: &[String]) -> Result<Found> {
    let name = request.experiment.name();
    let plan = planned(&request)?;
    let plan = if configs.is_empty() { plan } else { plan.only(configs).map_err(anyhow::Error::msg)? };
    let progress = Progress::new(name, plan.campaign.moves_of(Shard::ALL), "moves");
    let finished = |moves| progress.advance(moves);
    let passes = plan.campaign.run(Shard::ALL, Watch { stop: interrupt::flag()?, finished: &finished })?;
    drop(progress);
    let something = !passes.is_empty() || plan.search.is_some();
    ensure!(something, "ended before the first pass was finished: nothing to show");
    let outcome = Outcome::new(&plan, &passes);
    Ok((outcome.to_text(), serde_json::to_value(&outcome)?))
}

/// One part of an experiment, into its file.
fn part(options: &Options, experiment: Experiment, stage: Stage) -> Result<()> {
    let (name, shard) = (experiment.name(), options.shard.unwrap_or(Shard::ALL));
    let plan = planned(&options.request(experiment, stage))?;
    let progress = Progress::new(name, plan.campaign.moves_of(shard), "moves");
    let finished = |moves| progress.advance(moves);
    let passes = plan.campaign.run(shard, Watch { stop: interrupt::flag()?, finished: &finished })?;
    drop(progress);
    let part = ShardFile::new(&plan, shard, passes);
    options.json.write(&part, || {
        let what = if part.complete { "complete" } else { "not complete" };
        format!("part {}/{} of {name}: {} passes, {what}\n", shard.number, shard.of, part.passes.len())
    })
}

/// The plan, with progress where it has to be searched for.
fn planned(request: &Request) -> Result<crate::reproduce::experiments::Plan> {
    if request.experiment != Experiment::Compensators {
        return Ok(request.plan()?);
    }
    let progress = Progress::new("tuning", compensators::candidates(), "candidates");
    let finished = |candidates| progress.advance(candidates);
    Ok(request.plan_watched(Watch { stop: interrupt::flag()?, finished: &finished })?)
}

#[cfg(test)]
mod tests {
    use clap::Parser;

    use super::Options;
    use crate::cli::{Arguments, Command};

    fn options(typed: &[&str]) -> Options {
        match Arguments::try_parse_from([&["servoctl", "reproduce"], typed].concat()).unwrap().command {
            Command::Reproduce(options) => options,
            _ => panic!("{typed:?}"),
        }
    }

    /// A loop over all experiments with one number of moves must not end at those that do not move.
    #[test]
    fn options_without_a_meaning_are_accepted_and_said_to_be_unused() {
        let loops = options(&["loop-transmission", "--moves", "3", "--stage", "a.toml"]);
        assert!(loops.check().is_ok());
        assert!(loops.unused().unwrap().starts_with("loop-transmission: --moves not used"));
        let models = options(&["models", "--moves", "3", "--stage", "a.toml"]);
        assert!(models.unused().unwrap().starts_with("models: --moves and --stage not used"));
        assert_eq!(options(&["exp1", "--moves", "3"]).unused(), None);
        assert!(options(&["exp1", "--moves", "0"]).check().is_err());
    }

    #[test]
    fn a_list_of_mass_errors_may_begin_with_a_minus() {
        let options = options(&["exp2", "--mass-error", "-2,1", "--moves", "3"]);
        assert_eq!((options.mass_error, options.moves), (vec![-2.0, 1.0], Some(3)));
    }
}
