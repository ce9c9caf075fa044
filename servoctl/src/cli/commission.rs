//! `servoctl commission`: from an unknown stage to a tuned axis that settles with NIASA.

use std::path::{Path, PathBuf};
use std::sync::atomic::Ordering;

use anyhow::{Context, Result, bail, ensure};
use servo_core::parameters::Settings;
use servo_sim::Stage;

use super::drive::Link as Line;
use super::interrupt;
use super::output::Json;
use super::progress::Progress;
use super::reproduce::read_stage;
use crate::commission::{
    Failure, Found, Link, Many, OnLine, Simulated, Step, data_sheet, page, run as commission, stages,
};
use crate::link::virtual_drive;

/// Options of `commission`.
#[derive(Debug, clap::Args)]
pub struct Options {
    /// On a simulated drive without firmware and line: faster than a virtual one
    #[arg(long, conflicts_with_all = ["port", "virtual_drive"])]
    simulated: bool,
    /// Stage file (TOML) of a simulated or virtual drive, whose parameters then begin as its data sheets say [default: the stage of the
    /// thesis, its friction the same in every move]
    #[arg(long, value_name = "FILE", conflicts_with_all = ["random", "port"])]
    stage: Option<PathBuf>,
    /// Instead of one stage, N drawn at random, 1 to 10 000: 0.8 to 3 kg, 4 to 17 N/µm, 0.3 to 1.1 N, Dahl's model and Maxwell slip
    #[arg(long, value_name = "N", requires = "simulated", conflicts_with_all = ["from", "found"])]
    random: Option<u64>,
    /// Seed of noise, and of the stages drawn
    #[arg(long, value_name = "S", default_value_t = 1, requires = "simulated")]
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
pub fn run(line: &Line, options: &Options) -> Result<()> {
    if let Some(count) = options.random {
        return run_random(options, count);
    }
    let found: Found = match &options.found {
        None => Found::default(),
        Some(file) => {
            let text = std::fs::read_to_string(file).with_context(|| format!("--found {}", file.display()))?;
            serde_json::from_str(&text).with_context(|| format!("--found {}", file.display()))?
        }
    };
    if options.simulated {
        let mut stage = read_stage(options.stage.as_ref())?;
        if options.stage.is_none() {
            stage.friction.spread = None;
        }
        let mut link = Simulated::new(&stage, options.seed)?;
        let settings = *link.settings();
        return one(&mut link, &settings, found, &about("the drive of servo-core, simulated", &stage), options);
    }
    let stage = options.stage.as_ref().map(|file| read_stage(Some(file))).transpose()?;
    if let Some(file) = &options.stage {
        ensure!(line.virtual_drive, "--stage {}: only a simulated or a virtual drive has a stage file", file.display());
        start_on(file)?;
    }
    let connected = line.connect()?;
    let kind = if connected.is_virtual { "the firmware on the virtual board, simulated" } else { "drive" };
    let board = connected.drive.identity().board.to_string();
    let (mut link, mut settings) = OnLine::new(connected.drive)?;
    let caption = match &stage {
        Some(stage) => {
            settings = data_sheet(stage)?;
            link.prepare(&settings)?;
            about(kind, stage)
        }
        None => format!("{kind} {board}"),
    };
    one(&mut link, &settings, found, &caption, options)
}

fn about(drive: &str, stage: &Stage) -> String {
    format!("{drive}, on a stage of {} kg with {:?} friction", stage.mechanics.mass_kg, stage.friction.model)
}

/// A new virtual drive on this stage.
fn start_on(file: &Path) -> Result<()> {
    if let Some(address) = virtual_drive::find() {
        bail!("a virtual drive runs at {address}, on a stage of its own: `servoctl virtual --stop` ends it");
    }
    let file = std::path::absolute(file)?.display().to_string();
    virtual_drive::start(&["--stage".to_owned(), file, "--blank".to_owned()]).map(|_| ())
}

fn one(link: &mut dyn Link, settings: &Settings, mut found: Found, caption: &str, options: &Options) -> Result<()> {
    let said = |step: Step, result: &Result<String, Failure>| match result {
        Ok(words) => eprintln!("{}: {words}", step.purpose()),
        Err(why) => eprintln!("{}: refused: {why}", step.purpose()),
    };
    let ended = commission(link, settings, &mut found, options.from, interrupt::flag()?, said);
    if let Some(directory) = options.output.parent() {
        std::fs::create_dir_all(directory).with_context(|| format!("{}: cannot make it", directory.display()))?;
    }
    let ended = ended.err().map(|(step, failure)| format!("{}: {failure}", step.purpose()));
    std::fs::write(&options.output, page::render(&found, caption, ended.as_deref()))
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
    let many = Many::new(options.seed, all);
    options.json.write(&many, || many.to_text())
}
