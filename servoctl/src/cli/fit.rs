//! `servoctl fit`: friction models fitted to measured columns.

use std::path::PathBuf;
use std::time::{Duration, Instant};

use anyhow::{Context, Result};
use serde::Serialize;
use servo_ident::Record;
use servo_ident::choice::{self, Choice, Model};
use servo_ident::confidence::Interval;
use servo_ident::dahl::{self, DahlFit};
use servo_ident::genetic::{self, Organism, Search};
use servo_ident::maxwell::{self, MaxwellFit};
use servo_ident::move_check::MoveFit;

use super::output::Json;
use crate::csv::Columns;
use crate::table::{Table, number};

/// Models of `fit`.
#[derive(Debug, clap::Subcommand)]
pub enum Options {
    /// Dahl's model: sigma and F_C with 95 % confidence intervals
    Dahl(DahlFitting),
    /// Maxwell slip: springs in parallel, each sliding at its own force
    Maxwell(SlipFit),
    /// Both models, and which of them the data need
    Choose(SlipFit),
    /// Mass, viscous and Coulomb friction from moves to and fro; with a known mass, the force constant
    Move(Fit),
}

/// What a fit of Dahl's model has beside the usual.
#[derive(Debug, clap::Args)]
pub struct DahlFitting {
    #[command(flatten)]
    fit: Fit,
    /// Run the thesis' genetic algorithm (appendix B, corrected) on the same data, and tell both times
    #[arg(long)]
    genetic: bool,
}

/// What every fit has.
#[derive(Debug, clap::Args)]
pub struct Fit {
    #[command(flatten)]
    data: Data,
    #[command(flatten)]
    json: Json,
}

/// What a fit of Maxwell slip has beside that.
#[derive(Debug, clap::Args)]
pub struct SlipFit {
    #[command(flatten)]
    fit: Fit,
    /// Most elements, 1 to 12
    #[arg(long, value_name = "N", default_value_t = maxwell::USUAL_ELEMENTS)]
    elements: usize,
}

/// Where the friction comes from.
#[derive(Debug, clap::Args)]
pub struct Data {
    /// Columns time_s, position_m and force_n (friction) or current_a, comma-separated, names in the first line
    #[arg(value_name = "FILE.csv")]
    file: PathBuf,
    /// With current_a: moving mass, kg, 0.001 to 10000
    #[arg(long, value_name = "KG", allow_negative_numbers = true)]
    mass: Option<f64>,
    /// With current_a: force constant, N/A, 0.001 to 10000
    #[arg(long, value_name = "N/A", allow_negative_numbers = true)]
    force_constant: Option<f64>,
}

impl Data {
    fn record(&self) -> Result<Record> {
        self.columns()?.friction(self.mass, self.force_constant).with_context(|| self.name())
    }

    fn columns(&self) -> Result<Columns> {
        let text = std::fs::read_to_string(&self.file).with_context(|| self.name())?;
        Columns::parse(&text).with_context(|| self.name())
    }

    fn name(&self) -> String {
        self.file.display().to_string()
    }
}

/// Fits and prints.
///
/// # Errors
/// A file that cannot be read, data that are refused, with file, line and value.
pub fn run(options: &Options) -> Result<()> {
    match options {
        Options::Dahl(DahlFitting { fit: Fit { data, json }, genetic }) => {
            let record = data.record()?;
            let started = Instant::now();
            let fit = dahl::fit(&record).with_context(|| data.name())?;
            let text = || dahl_text(&data.name(), &record, &fit);
            if !genetic {
                return json.write(&fit, text);
            }
            let compared = Compared::new(&fit, started.elapsed(), &record);
            json.write(&compared, || text() + &compared.to_text())
        }
        Options::Move(Fit { data, json }) => {
            let force_constant = data.force_constant.context("a move needs --force-constant")?;
            let fit = data.columns()?.moves(force_constant).with_context(|| data.name())?;
            let checked = Moved {
                force_constant_n_per_a: data.mass.map(|kg| fit.force_constant_n_per_a(force_constant, kg)),
                fit,
            };
            json.write(&checked, || checked.to_text(&data.name()))
        }
        Options::Maxwell(SlipFit { fit: Fit { data, json }, elements }) => {
            let record = data.record()?;
            let fit = maxwell::fit(&record, *elements).with_context(|| data.name())?;
            json.write(&fit, || maxwell_text(&data.name(), &record, &fit))
        }
        Options::Choose(SlipFit { fit: Fit { data, json }, elements }) => {
            let record = data.record()?;
            let choice = choice::fit(&record, *elements).with_context(|| data.name())?;
            json.write(&choice, || choice_text(&data.name(), &record, &choice))
        }
    }
}

/// A fit beside the genetic algorithm's.
#[derive(Debug, Serialize)]
struct Compared<'a> {
    #[serde(flatten)]
    fit: &'a DahlFit,
    /// Time of the fit, ms.
    time_ms: f64,
    /// What the genetic algorithm found.
    genetic: Organism,
    /// Its time, ms.
    genetic_time_ms: f64,
}

impl Compared<'_> {
    fn new<'a>(fit: &'a DahlFit, time: Duration, record: &Record) -> Compared<'a> {
        let started = Instant::now();
        let genetic = genetic::fit(record, &Search::default());
        let ms = |time: Duration| time.as_secs_f64() * 1e3;
        Compared { fit, time_ms: ms(time), genetic, genetic_time_ms: ms(started.elapsed()) }
    }

    fn to_text(&self) -> String {
        format!(
            "genetic algorithm: sigma {} N/µm, F_C {} N, left over {:.4e} N² against {:.4e} N²; {} ms against {} ms: {} times slower\n",
            number(self.genetic.sigma_n_per_m * 1e-6, 4),
            number(self.genetic.coulomb_n, 4),
            self.genetic.mse_n2,
            self.fit.mse_n2,
            number(self.genetic_time_ms, 1),
            number(self.time_ms, 1),
            number(self.genetic_time_ms / self.time_ms, 0)
        )
    }
}

/// What a move says, and the force constant that fits a known mass.
#[derive(Debug, Serialize)]
struct Moved {
    #[serde(flatten)]
    fit: MoveFit,
    /// `null` without a known mass.
    force_constant_n_per_a: Option<f64>,
}

impl Moved {
    fn to_text(&self, name: &str) -> String {
        let MoveFit { mass_kg, mass_ci95_kg: Interval([low, high]), .. } = self.fit;
        let row = |name: &str, value: f64, decimals| [name.to_owned(), number(value, decimals)];
        let table = Table::new(
            format!("Moves of {name}: {} samples; mass between {low:.4} and {high:.4} kg (95 %)", self.fit.samples),
            &["quantity", "value"],
        )
        .row(row("mass / kg", mass_kg, 4))
        .row(row("viscous friction / N s/m", self.fit.viscous_n_s_per_m, 3))
        .row(row("Coulomb friction / N", self.fit.coulomb_n, 4))
        .row(row("constant force / N", self.fit.offset_n, 4))
        .row(row("left over, rms / N", self.fit.rms_n, 4));
        match self.force_constant_n_per_a {
            Some(constant) => table.row(row("force constant that fits the known mass / N/A", constant, 4)).to_text(),
            None => table.to_text(),
        }
    }
}

fn caption(model: &str, name: &str, record: &Record) -> String {
    format!(
        "{model} fitted to {name}: {} samples of {} ms, motion of {} nm with {} reversals",
        record.samples(),
        number(record.sample_s * 1e3, 4),
        number(record.span_m() * 1e9, 1),
        record.legs.len() - 1
    )
}

fn dahl_text(name: &str, record: &Record, fit: &DahlFit) -> String {
    let header = ["parameter", "value", "95 % from", "to"];
    let [sigma, coulomb] = [fit.ci95.sigma_n_per_m, fit.ci95.coulomb_n];
    let row = |name: &str, scale: f64, value: f64, [low, high]: [f64; 2]| {
        [name.to_owned(), number(value * scale, 4), number(low * scale, 4), number(high * scale, 4)]
    };
    let single = |name: &str, value: f64| [name.to_owned(), number(value, 4), String::new(), String::new()];
    Table::new(caption("Dahl's model", name, record), &header)
        .row(row("sigma / N/µm", 1e-6, fit.sigma_n_per_m, sigma.0))
        .row(row("F_C / N", 1.0, fit.coulomb_n, coulomb.0))
        .row(single("friction at the first sample / N", fit.initial_n))
        .row(single("offset / N", fit.offset_n))
        .row(single("left over, rms / N", fit.mse_n2.sqrt()))
        .to_text()
}

fn maxwell_text(name: &str, record: &Record, fit: &MaxwellFit) -> String {
    let mut table = Table::new(
        caption("Maxwell slip", name, record),
        &["element", "stiffness / N/µm", "saturation / N", "slides after / nm"],
    );
    let last = fit.elements.len() - 1;
    for (i, element) in fit.elements.iter().enumerate() {
        let length_nm = element.saturation_n / element.stiffness_n_per_m * 1e9;
        let unsaturated = i == last && fit.unsaturated_n_per_m > 0.0;
        let after = if unsaturated { "never here".to_owned() } else { number(length_nm, 2) };
        table = table.row([
            (i + 1).to_string(),
            number(element.stiffness_n_per_m * 1e-6, 4),
            number(element.saturation_n, 4),
            after,
        ]);
    }
    table.to_text()
        + &format!(
            "together: F_C {} N, half the stiffness {} N/µm; offset {} N; left over {} N rms of {} samples\n",
            number(fit.coulomb_n(), 4),
            number(fit.sigma_n_per_m() * 1e-6, 4),
            number(fit.offset_n, 4),
            number(fit.rms_n, 5),
            fit.samples
        )
}

fn choice_text(name: &str, record: &Record, choice: &Choice) -> String {
    let verdict = match choice.model {
        Model::Dahl => "Dahl's model does",
        Model::MaxwellSlip => "Maxwell slip is needed",
    };
    format!(
        "{}\n{}\n{verdict}: it leaves {} N rms, Maxwell slip {} N, on the same {} samples\n",
        dahl_text(name, record, &choice.dahl),
        maxwell_text(name, record, &choice.maxwell),
        number(choice.dahl_rms_n, 5),
        number(choice.maxwell.rms_n, 5),
        choice.maxwell.samples
    )
}
