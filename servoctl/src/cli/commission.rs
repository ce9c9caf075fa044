//! `servoctl commission`: from an unknown stage to a tuned axis that settles with NIASA.

use std::path::PathBuf;
use std::sync::atomic::Ordering;

use anyhow::{Context, Result, bail, ensure};

use super::interrupt;
use super::output::Json;
use super::progress::Progress;
use super::reproduce::read_stage;
use crate::commission::{Found, Simulated, Step, page, run as commission, stages};

/// Options of `commission`.
#[derive(Debug, clap::Args)]
pub struct Options {
    /// On a simulated drive and stage; the only kind there is so far
    #[arg(long, required = true)]
    simulated: bool,
    /// Stage file (TOML) [default: the stage of the thesis, its friction the same in every move]
    #[arg(long, value_name = "FILE", conflicts_with = "random")]
    stage: Option<PathBuf>,
    /// Instead of one stage, N drawn at random, 1 to 10 000: 0.8 to 3 kg, 4 to 17 N/µm, 0.3 to 1.1 N, Dahl's model and Maxwell slip
    #[arg(long, value_name = "N", conflicts_with_all = ["from", "found"])]
    random: Option<u64>,
    /// Seed of noise, and of the stages drawn
    #[arg(long, value_name = "S", default_value_t = 1)]
    seed: u64,
    /// The step to begin with, with what earlier ones found in --found
    #[arg(long, value_name = "STEP", default_value = "offsets")]
    from: Step,
    /// What earlier steps found: the JSON of a run that was ended
    #[arg(long, value_name = "FILE")]
    found: Option<PathBuf>,
    /// The report
    #[arg(short, long, value_name = "FILE", default_value = "out/commissioning.html")]
    output: PathBuf,
    #[command(flatten)]
    json: Json,
}

/// Commissions, writes the report and prints what each step found.
///
/// # Errors
/// Options out of range, files that cannot be read or written, the step that ended it and why.
pub fn run(options: &Options) -> Result<()> {
    if let Some(count) = options.random {
        return run_random(options, count);
    }
    let mut stage = read_stage(options.stage.as_ref())?;
    if options.stage.is_none() {
        stage.friction.spread = None;
    }
    let mut found: Found = match &options.found {
        None => Found::default(),
        Some(file) => {
            let text = std::fs::read_to_string(file).with_context(|| format!("--found {}", file.display()))?;
            serde_json::from_str(&text).with_context(|| format!("--found {}", file.display()))?
        }
    };
    let mut link = Simulated::new(&stage, options.seed)?;
    let settings = *link.settings();
    let ended =
        commission(&mut link, &settings, &mut found, options.from, interrupt::flag()?, |step, result| match result {
            Ok(words) => eprintln!("{}: {words}", step.purpose()),
            Err(why) => eprintln!("{}: refused: {why}", step.purpose()),
        });
    if let Some(directory) = options.output.parent() {
        std::fs::create_dir_all(directory).with_context(|| format!("{}: cannot make it", directory.display()))?;
    }
    let ended = ended.err().map(|(step, failure)| format!("{}: {failure}", step.purpose()));
    std::fs::write(&options.output, page::render(&found, &stage, ended.as_deref()))
        .with_context(|| format!("{}: cannot write", options.output.display()))?;
    options.json.write(&found, || format!("{}\n", options.output.display()))?;
    match ended {
        Some(why) => bail!("{why}"),
        None => Ok(()),
    }
}

fn run_random(options: &Options, count: u64) -> Result<()> {
    ensure!((1..=10_000).contains(&count), "random = {count} is outside 1 to 10000");
    let stop = interrupt::flag()?;
    let progress = Progress::new("commissioning", count, "stages");
    let all = stages::commission_all(options.seed, 0..count, stop, || progress.advance(1))
        .map_err(|why| anyhow::anyhow!("{why}"))?;
    if stop.load(Ordering::Relaxed) {
        bail!("ended by the user");
    }
    options.json.write(&all, || stages::text(&all))
}
