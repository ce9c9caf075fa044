//! `servoctl fit`: friction models fitted to measured columns.

use std::path::PathBuf;

use anyhow::{Context, Result};
use servo_ident::Record;
use servo_ident::choice::{self, Choice, Model};
use servo_ident::dahl::{self, DahlFit};
use servo_ident::maxwell::{self, MaxwellFit};

use super::output::Json;
use crate::csv::Columns;
use crate::table::{Table, number};

/// Models of `fit`.
#[derive(Debug, clap::Subcommand)]
pub enum Options {
    /// Dahl's model: sigma and F_C with 95 % confidence intervals
    Dahl(Fit),
    /// Maxwell slip: springs in parallel, each sliding at its own force
    Maxwell(SlipFit),
    /// Both models, and which of them the data need
    Choose(SlipFit),
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
        let text = std::fs::read_to_string(&self.file).with_context(|| self.name())?;
        let record = Columns::parse(&text).and_then(|columns| columns.friction(self.mass, self.force_constant));
        record.with_context(|| self.name())
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
        Options::Dahl(Fit { data, json }) => {
            let record = data.record()?;
            let fit = dahl::fit(&record).with_context(|| data.name())?;
            json.write(&fit, || dahl_text(&data.name(), &record, &fit))
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
