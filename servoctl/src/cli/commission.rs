//! `servoctl commission`: from an unknown stage to a tuned axis that settles with NIASA.

use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::atomic::Ordering;

use anyhow::{Context, Result, bail, ensure};
use servo_core::parameters::Settings;
use servo_ident::tuning::{STANDARD, Wish};
use servo_sim::Stage;

use super::drive::Link as Line;
use super::interrupt;
use super::output::Json;
use super::progress::Progress;
use super::stage::read_stage;
use crate::commission::{
    CROSSOVER_HZ, Event, Failure, Found, Link, Many, OnLine, PHASE_MARGIN_DEG, Plan, Simulated, Step, data_sheet, page,
    run as commission, stages,
};
use crate::link::{help, units, virtual_drive};

/// Options of `commission`.
#[derive(Debug, clap::Args)]
pub struct Options {
    /// On a simulated drive without firmware and line: faster than a virtual one
    #[arg(long, conflicts_with_all = ["port", "virtual_drive"])]
    simulated: bool,
    /// Stage file (TOML) of a simulated drive, or of a new virtual one, whose parameters then begin as its data sheets say [default:
    /// simulated, the stage of the thesis with friction the same in every move; virtual, the drive that runs and its stage]
    #[arg(long, value_name = "FILE", conflicts_with_all = ["random", "port"])]
    stage: Option<PathBuf>,
    /// Instead of one stage, N drawn at random, 1 to 10 000: 0.8 to 3 kg, 4 to 17 N/µm, 0.3 to 1.1 N, Dahl's model and Maxwell slip.
    /// Exit code 1 if one ends unsafely or less than 96 % succeed; Ctrl-C tells of those that were finished
    #[arg(long, value_name = "N", requires = "simulated", conflicts_with_all = ["from", "found"])]
    random: Option<u64>,
    /// Seed of noise, and of the stages drawn
    #[arg(long, value_name = "S", default_value_t = 1, requires = "simulated")]
    seed: u64,
    /// Crossover frequency that the position loop is to have, 40 to 400 Hz [default: 100 Hz; the thesis' other tuning has 315 Hz]
    #[arg(long, value_name = "F", value_parser = units::frequency)]
    crossover: Option<f64>,
    /// Its phase margin, 30 to 65 degrees [default: 45; the thesis' other tuning has 50]
    #[arg(long, value_name = "DEGREES", allow_negative_numbers = true)]
    phase_margin: Option<f64>,
    /// The step to begin with, with what earlier ones found in --found
    #[arg(long, value_name = "STEP", default_value = "offsets")]
    from: Step,
    /// What earlier steps found: the JSON of a run that was ended [default with --from: the file beside the report]
    #[arg(long, value_name = "FILE")]
    found: Option<PathBuf>,
    /// The report; what was found is written beside it, with the ending .json
    #[arg(short, long, value_name = "FILE", default_value = "out/commissioning.html")]
    output: PathBuf,
    #[command(flatten)]
    json: Json,
}

impl Options {
    fn wish(&self) -> Result<Wish> {
        let within = |name: &str, value: f64, [min, max]: [f64; 2]| {
            ensure!((min..=max).contains(&value), "--{name} = {value} is outside {min} to {max}");
            Ok(value)
        };
        let wish = Wish {
            crossover_hz: self.crossover.unwrap_or(STANDARD.crossover_hz),
            phase_margin_deg: self.phase_margin.unwrap_or(STANDARD.phase_margin_deg),
            ..STANDARD
        };
        within("crossover", wish.crossover_hz, CROSSOVER_HZ)?;
        within("phase-margin", wish.phase_margin_deg, PHASE_MARGIN_DEG)?;
        Ok(wish)
    }

    /// Where what was found is written.
    fn beside(&self) -> PathBuf {
        self.output.with_extension("json")
    }

    fn found(&self) -> Result<Found> {
        let file = match &self.found {
            Some(file) => file.clone(),
            None if self.from > Step::Offsets && self.beside().exists() => self.beside(),
            None => return Ok(Found::default()),
        };
        let text = std::fs::read_to_string(&file).with_context(|| format!("--found {}", file.display()))?;
        serde_json::from_str(&text).with_context(|| format!("--found {}", file.display()))
    }
}

/// Commissions, writes the report and prints what each step found.
///
/// # Errors
/// Options out of range, files that cannot be read or written, the step that ended it and why.
pub fn run(line: &Line, options: &Options) -> Result<ExitCode> {
    let wish = options.wish()?;
    if let Some(count) = options.random {
        return run_random(options, wish, count);
    }
    let found = options.found()?;
    let plan = |settings: Settings| Plan { wish, from: options.from, ..Plan::new(settings) };
    if options.simulated {
        let mut stage = read_stage(options.stage.as_deref(), 0.0)?;
        if options.stage.is_none() {
            stage.friction.spread = None;
        }
        let mut link = Simulated::new(&stage, options.seed)?;
        let plan = plan(*link.settings());
        return one(&mut link, &plan, found, &about("the drive of servo-core, simulated", &stage), options);
    }
    let stage = options.stage.as_ref().map(|file| read_stage(Some(file), 0.0)).transpose()?;
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
    one(&mut link, &plan(settings), found, &caption, options)
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

/// Says on standard error what is done, how far it is, and what came of it.
fn teller() -> impl FnMut(Event) {
    let mut bar: Option<(Progress, u32)> = None;
    let mut name = String::new();
    move |event| match event {
        Event::Begins(step) => {
            name = step.name();
            eprintln!("{name}: {}", step.purpose());
        }
        Event::Done(done, of) => {
            let (progress, before) = bar.get_or_insert_with(|| (Progress::new(&name, of.into(), "parts"), 0));
            progress.advance(u64::from(done.saturating_sub(*before)));
            *before = done;
        }
        Event::Ended(_, result) => {
            bar = None;
            match result {
                Ok(words) => eprintln!("    {words}"),
                Err(Failure::Stopped) => eprintln!("    not finished"),
                Err(why) => eprintln!("    refused: {why}"),
            }
        }
    }
}

fn one(link: &mut dyn Link, plan: &Plan, mut found: Found, caption: &str, options: &Options) -> Result<ExitCode> {
    let interrupted = interrupt::flag_saying(
        "stopping, then turning the bridge off; Ctrl-C again leaves that to the drive's command time-out",
    )?;
    let ended = commission(link, plan, &mut found, interrupted, &mut teller()).err();
    if let Some(directory) = options.output.parent() {
        std::fs::create_dir_all(directory).with_context(|| format!("{}: cannot make it", directory.display()))?;
    }
    let why = ended.as_ref().map(|(step, failure)| format!("{}: {failure}", step.purpose()));
    let page = page::render(&found, caption, ended.as_ref().map(|(step, failure)| (*step, failure)));
    let pages = [(&options.output, page), (&options.beside(), serde_json::to_string(&found)? + "\n")];
    for (file, text) in pages {
        std::fs::write(file, text).with_context(|| format!("{}: cannot write", file.display()))?;
    }
    options.json.write(&found, || format!("{}\n", options.output.display()))?;
    match (ended, why) {
        (Some((step, Failure::Stopped)), _) => {
            eprintln!("ended by the user; the bridge is off. `--from {}` goes on", step.name());
            Ok(ExitCode::from(interrupt::INTERRUPTED))
        }
        (Some((_, Failure::Refused(refusal))), Some(why)) => bail!("{why}\n  {}", help(&refusal)),
        (_, Some(why)) => bail!("{why}"),
        _ => Ok(ExitCode::SUCCESS),
    }
}

fn run_random(options: &Options, wish: Wish, count: u64) -> Result<ExitCode> {
    ensure!((1..=10_000).contains(&count), "random = {count} is outside 1 to 10000");
    let stop = interrupt::flag()?;
    let progress = Progress::new("commissioning", count, "stages");
    let all = stages::commission_all(options.seed, 0..count, wish, stop, || progress.advance(1))
        .map_err(|why| anyhow::anyhow!("{why}"))?;
    let many = Many::new(options.seed, all);
    options.json.write(&many, || many.to_text())?;
    if stop.load(Ordering::Relaxed) {
        return Ok(ExitCode::from(interrupt::INTERRUPTED));
    }
    Ok(if many.summary.is_good() { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}
