//! Computes everything that the page shows, one part after the other; what is ended early is missing, and named.

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicBool, Ordering};

use anyhow::{Context, Result};
use serde::Serialize;
use servo_core::parameters::Settings;
use servo_sim::Stage;

use super::pictures::Picture;
use super::section::Section;
use super::sections::{
    closed_loop, compensators, first_experiment, frequency, identification, in_position, length_scale, models,
    rate_limit, second_experiment, sensitivity, small_steps, stage, theory_mass, theory_massless,
    traces::{self, Traces},
};
use crate::reproduce::campaign::{Shard, Watch};
use crate::reproduce::experiments::{Experiment, MASS_ERRORS_PERCENT, Plan, Request as Moves};
use crate::reproduce::loop_transmission::{self, LoopTransmission};
use crate::reproduce::outcome::{Outcome, Run};
use crate::reproduce::{
    compensators as tuning, identification as profiles, identification_study, models as fits, step_100um,
};

/// How much is computed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Size {
    /// A minute or two: [`QUICK_MOVES`] moves per configuration.
    Quick,
    /// As many moves as the thesis made.
    Full,
    /// A given number of moves per configuration.
    Moves(u64),
}

/// Moves per configuration of the quick size.
pub const QUICK_MOVES: u64 = 50;

impl Size {
    /// Moves per configuration of an experiment.
    pub fn moves(self, experiment: Experiment) -> u64 {
        match self {
            Size::Quick => QUICK_MOVES.min(experiment.moves()),
            Size::Full => experiment.moves(),
            Size::Moves(moves) => moves,
        }
    }

    /// Settling steps of the identification study; its profiles follow in the thesis' proportion.
    fn identification_steps(self) -> u64 {
        match self {
            Size::Quick => profiles::STEPS / 10,
            Size::Full => profiles::STEPS,
            Size::Moves(moves) => moves,
        }
    }

    /// In words.
    pub fn in_words(self) -> String {
        match self {
            Size::Quick => format!("quick: {QUICK_MOVES} moves per configuration"),
            Size::Full => "full: as many moves per configuration as the thesis made".to_owned(),
            Size::Moves(moves) => format!("{moves} moves per configuration"),
        }
    }
}

/// What to compute.
#[derive(Debug, Clone, PartialEq)]
pub struct Request {
    /// How much.
    pub size: Size,
    /// Seed of every random number.
    pub seed: u64,
    /// The simulated hardware.
    pub stage: Stage,
    /// Name of the stage file; for the built-in one, what it is.
    pub stage_name: String,
}

impl Request {
    /// The built-in stage.
    pub fn new(size: Size, seed: u64) -> Request {
        Request { size, seed, stage: Stage::default(), stage_name: "the stage of the thesis (built in)".to_owned() }
    }

    /// The command that computes this.
    pub fn command(&self) -> String {
        let size = match self.size {
            Size::Quick => "--quick".to_owned(),
            Size::Full => "--full".to_owned(),
            Size::Moves(moves) => format!("--moves {moves}"),
        };
        let stage =
            if self.stage == Stage::default() { String::new() } else { format!(" --stage {}", self.stage_name) };
        format!("servoctl report {size} --seed {}{stage}", self.seed)
    }
}

/// Everything that was computed.
#[derive(Debug, Default)]
pub struct Computed {
    /// What was asked for.
    pub request: Request,
    /// The sections, in the order of the thesis.
    pub sections: Vec<Section>,
    /// What is missing because the run was ended early, in words.
    pub missing: Vec<String>,
    /// The experiments' JSON by name.
    pub experiments: BTreeMap<String, serde_json::Value>,
    /// Pictures for the read-me.
    pub pictures: Vec<Picture>,
}

impl Default for Request {
    fn default() -> Self {
        Request::new(Size::Quick, 1)
    }
}

/// How a run is watched, and ended.
pub trait Observer {
    /// A part begins: its name, and how many pieces of what unit it has. Returns what to call with the number of pieces done.
    fn begin(&self, part: &str, pieces: u64, unit: &str) -> Box<dyn Fn(u64) + Sync>;
    /// Set it, and what is not under way is not begun.
    fn stop(&self) -> &AtomicBool;
}

/// Nobody watches.
pub struct Nobody;

static NEVER: AtomicBool = AtomicBool::new(false);

impl Observer for Nobody {
    fn begin(&self, _: &str, _: u64, _: &str) -> Box<dyn Fn(u64) + Sync> {
        Box::new(|_| ())
    }

    fn stop(&self) -> &AtomicBool {
        &NEVER
    }
}

/// A computation under way.
struct Work<'a> {
    computed: Computed,
    observer: &'a dyn Observer,
}

/// Computes everything, in the order in which the thesis has it.
///
/// # Errors
/// A stage or moves that the drive refuses.
pub fn run(request: Request, observer: &dyn Observer) -> Result<Computed> {
    let mut work = Work { computed: Computed { request, ..Computed::default() }, observer };
    work.part("2 friction models", |w| {
        let finished = w.observer.begin("models", fits::FITS, "fits");
        let found = fits::run(Watch { stop: w.observer.stop(), finished: &finished });
        drop(finished);
        w.keep("models", &found)?;
        Ok(found.complete.then(|| models::section(&found)))
    })?;
    work.part("3.2 stage and profiles", |w| Ok(Some(stage::section(&w.computed.request.stage))))?;
    work.part("4 compensators", |w| {
        let Some((_, outcome)) = w.settling(Experiment::Compensators)? else { return Ok(None) };
        Ok(outcome.all().next().map(|run| compensators::section(&outcome, run)))
    })?;
    let (mut with_niasa, mut second_order) = (None, None);
    work.part("5.1 loop transmission", |w| {
        let Some(measured) = w.loop_transmission()? else { return Ok(None) };
        with_niasa = Some(frequency::with_niasa(&measured));
        second_order = closed_loop::section(&measured);
        Ok(Some(frequency::by_amplitude(&measured)))
    })?;
    work.part("5.2 closed loop", |_| Ok(second_order))?;
    work.part("5.3 length scale", Work::length_scale)?;
    work.part("6 identification", Work::identification)?;
    work.part("7.4, 7.5 theory without inertia", |w| {
        Ok(Some(theory_massless::section(&theory_massless::compute()?, &w.computed.request.stage)))
    })?;
    work.part("7.6 theory with mass", |w| {
        let comparisons = theory_mass::compute()?;
        w.computed.pictures.extend(Picture::of_theory(&comparisons));
        Ok(Some(theory_mass::section(&comparisons)))
    })?;
    work.part("8.1 rate limit", |_| Ok(Some(rate_limit::section(&Settings::default()))))?;
    work.part("8.2 loop transmission with NIASA", |_| Ok(with_niasa))?;
    work.part("8.1, 11 sensitivity", |w| {
        let Some((_, outcome)) = w.settling(Experiment::Sensitivity)? else { return Ok(None) };
        Ok(Some(sensitivity::section(&outcome.all().collect::<Vec<_>>())))
    })?;
    work.part("9.1 first experiment", |w| {
        let Some((plan, outcome)) = w.settling(Experiment::Exp1)? else { return Ok(None) };
        let runs: Vec<&Run> = outcome.all().collect();
        let traces = w.traces(&plan, &[0], 0.45)?;
        w.computed.pictures.extend(Picture::of_first_experiment(runs[0], &traces));
        Ok(Some(first_experiment::section(runs[0], &traces)))
    })?;
    work.part("9.2 second experiment", |w| {
        let Some((plan, outcome)) = w.settling(Experiment::Exp2)? else { return Ok(None) };
        let exact = plan.comparisons.iter().position(|c| c.mass_error_percent == Some(0.0)).unwrap_or(0);
        let traces = w.traces(&plan, &[exact, (exact + 1).min(plan.comparisons.len() - 1)], 0.3)?;
        Ok(Some(second_experiment::section(&outcome.all().collect::<Vec<_>>(), &traces)))
    })?;
    work.part("9.3 in position", |w| {
        let Some((_, outcome)) = w.settling(Experiment::InPosition)? else { return Ok(None) };
        Ok(Some(in_position::section(&outcome.all().collect::<Vec<_>>())))
    })?;
    work.part("9.4 steps of 5 µm", |w| {
        let Some((_, outcome)) = w.settling(Experiment::Step5Um)? else { return Ok(None) };
        Ok(Some(small_steps::five_micrometres(&outcome.all().collect::<Vec<_>>())))
    })?;
    work.part("9.4 steps of 50 nm", |w| {
        let Some((plan, outcome)) = w.settling(Experiment::Step50Nm)? else { return Ok(None) };
        let traces = w.traces(&plan, &[0, 1], 0.07)?;
        Ok(Some(small_steps::fifty_nanometres(&outcome.all().collect::<Vec<_>>(), &traces)))
    })?;
    Ok(work.computed)
}

impl Work<'_> {
    fn stopped(&self) -> bool {
        self.observer.stop().load(Ordering::Relaxed)
    }

    /// Computes a section, unless the run has been ended; what gives none is missing.
    fn part(&mut self, name: &str, compute: impl FnOnce(&mut Self) -> Result<Option<Section>>) -> Result<()> {
        let section = if self.stopped() { None } else { compute(self).with_context(|| name.to_owned())? };
        match section {
            Some(section) => self.computed.sections.push(section),
            None => self.computed.missing.push(format!("{name}: the run was ended before")),
        }
        Ok(())
    }

    /// Keeps the JSON of an experiment.
    fn keep(&mut self, name: &str, data: &impl Serialize) -> Result<()> {
        self.computed.experiments.insert(name.to_owned(), serde_json::to_value(data)?);
        Ok(())
    }

    /// A settling experiment; `None` if it was ended before the first pass.
    fn settling(&mut self, experiment: Experiment) -> Result<Option<(Plan, Outcome)>> {
        let request = &self.computed.request;
        let mass_errors = if experiment == Experiment::Exp2 { MASS_ERRORS_PERCENT.to_vec() } else { Vec::new() };
        let moves = Moves {
            experiment,
            moves: request.size.moves(experiment),
            seed: request.seed,
            mass_errors_percent: mass_errors,
            stage: request.stage,
        };
        let tuned = if experiment == Experiment::Compensators { tuning::candidates() } else { 0 };
        let tried = (tuned > 0).then(|| self.observer.begin("compensators: tuning", tuned, "candidates"));
        let finished = |pieces| tried.as_ref().map_or((), |tried| tried(pieces));
        let plan = moves.plan_watched(Watch { stop: self.observer.stop(), finished: &finished })?;
        drop(tried);
        let finished = self.observer.begin(experiment.name(), plan.campaign.moves_of(Shard::ALL), "moves");
        let passes = plan.campaign.run(Shard::ALL, Watch { stop: self.observer.stop(), finished: &finished })?;
        drop(finished);
        if passes.is_empty() {
            return Ok(None);
        }
        let outcome = Outcome::new(&plan, &passes);
        if !outcome.complete {
            let made = outcome.all().next().map_or(0, |run| run.settling.moves);
            let note = format!(
                "{}: {made} of {} moves per configuration were made",
                experiment.name(),
                outcome.moves_requested
            );
            self.computed.missing.push(note);
        }
        self.keep(experiment.name(), &outcome)?;
        Ok(Some((plan, outcome)))
    }

    /// The loop transmissions; `None` if they were ended: with a part of them there is nothing to judge.
    fn loop_transmission(&mut self) -> Result<Option<LoopTransmission>> {
        let finished = self.observer.begin("loop-transmission", loop_transmission::SWEEPS, "sweeps");
        let watch = Watch { stop: self.observer.stop(), finished: &finished };
        let measured = loop_transmission::run(&self.computed.request.stage, self.computed.request.seed, watch)?;
        drop(finished);
        if let Some(measured) = &measured {
            self.keep("loop-transmission", measured)?;
        }
        Ok(measured.filter(|measured| measured.complete))
    }

    /// The 100 µm steps; `None` if they were ended.
    fn length_scale(&mut self) -> Result<Option<Section>> {
        let request = &self.computed.request;
        let steps = match request.size {
            Size::Quick => step_100um::MOVES.min(20),
            Size::Full => step_100um::MOVES,
            Size::Moves(moves) => moves,
        };
        let finished = self.observer.begin("step-100um", steps, "steps");
        let watch = Watch { stop: self.observer.stop(), finished: &finished };
        let found = step_100um::run(&request.stage, steps, request.seed, watch)?;
        drop(finished);
        self.keep("step-100um", &found)?;
        Ok(found.complete.then(|| length_scale::section(&found)))
    }

    /// The identification study; `None` if it was ended.
    fn identification(&mut self) -> Result<Option<Section>> {
        let request = &self.computed.request;
        let steps = request.size.identification_steps();
        let runs = profiles::runs_beside(steps);
        let finished = self.observer.begin("identification-study", profiles::pieces(runs, steps), "runs");
        let watch = Watch { stop: self.observer.stop(), finished: &finished };
        let study = identification_study::run(&request.stage, runs, steps, request.seed, watch)?;
        drop(finished);
        let Some(study) = study else { return Ok(None) };
        self.keep("identification-study", &study)?;
        Ok(study.complete.then(|| identification::section(&study)))
    }

    /// Traces of PID and of the thesis' NIASA in some comparisons of a plan, in pairs.
    fn traces(&self, plan: &Plan, comparisons: &[usize], until_s: f64) -> Result<Vec<Traces>> {
        let cases = comparisons.iter().flat_map(|c| {
            let comparison = &plan.comparisons[*c];
            let name = if comparison.name.is_empty() { &comparison.tuning } else { &comparison.name };
            comparison.cases.iter().take(2).map(move |case| (name, *case))
        });
        let record = |(name, case): (&String, usize)| {
            let case = &plan.campaign.cases[case];
            Ok(traces::record(case, name, plan.request.seed, plan.request.moves, until_s)?)
        };
        cases.map(record).collect()
    }
}
