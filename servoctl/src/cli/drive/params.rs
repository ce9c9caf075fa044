//! `servoctl params`: the drive's parameters, by name and with their units.

use std::collections::BTreeMap;
use std::fmt::Write;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, anyhow, bail};
use serde_json::json;
use servo_core::parameters::{Access, Parameter, Settings, TABLE};
use servo_protocol::message::Request;

use super::super::output::Json;
use super::Link;
use crate::link::{Drive, units};
use crate::table::Table;

/// Options of `params`.
#[derive(Debug, clap::Args)]
pub struct Options {
    #[command(subcommand)]
    action: Action,
    #[command(flatten)]
    json: Json,
}

#[derive(Debug, clap::Subcommand)]
enum Action {
    /// Show some
    Get {
        /// Names
        #[arg(required = true)]
        names: Vec<String>,
    },
    /// Change one, at once and until the next start: see `save`
    Set {
        /// Name
        name: String,
        /// Value: a number in the parameter's unit, or with a unit of its own (10ms, 4N/µm)
        #[arg(allow_hyphen_values = true)]
        value: String,
    },
    /// Show all, with limits
    List {
        /// Only what differs from a new drive
        #[arg(long)]
        changed: bool,
    },
    /// Write all to a file that `load` reads
    Dump {
        /// The file [default: standard output]
        #[arg(short, long)]
        output: Option<PathBuf>,
    },
    /// Use those of a file, or without one those that are stored in the drive
    Load {
        /// The file
        file: Option<PathBuf>,
    },
    /// Show where those in use differ from a file, or without one from a new drive
    Diff {
        /// The file
        file: Option<PathBuf>,
    },
    /// Store those in use in the drive (bridge off)
    Save,
    /// Use those of a new drive; what is stored stays
    Reset,
}

/// Carries the action out.
///
/// # Errors
/// A name or value that makes no sense, a refusal; those of the link.
pub fn run(link: &Link, options: &Options) -> Result<()> {
    let json = &options.json;
    match &options.action {
        Action::Get { names } => {
            let rows = names.iter().map(|name| row(name)).collect::<Result<Vec<_>>>()?;
            show(json, &rows, &link.connect()?.drive.parameters()?)
        }
        Action::Set { name, value } => {
            let (id, value) = parse(name, value)?;
            let mut drive = link.connect()?.drive;
            drive.set_parameters(&[(id, value)])?;
            show(json, &[row(name)?], &drive.parameters()?)
        }
        Action::List { changed } => {
            let settings = link.connect()?.drive.parameters()?;
            let rows: Vec<_> = TABLE.iter().filter(|row| !changed || row.get(&settings) != row.default).collect();
            show(json, &rows, &settings)
        }
        Action::Dump { output } => {
            let mut drive = link.connect()?.drive;
            let settings = drive.parameters()?;
            let text = dump(&settings, &drive);
            let Some(file) = output else { return json.write(&values(TABLE, &settings), || text) };
            std::fs::write(file, text).with_context(|| format!("writing {}", file.display()))?;
            json.write(&json!({ "file": file }), || format!("{}: {} parameters\n", file.display(), TABLE.len()))
        }
        Action::Load { file: None } => {
            link.connect()?.drive.order(&Request::LoadParameters)?;
            json.write(&json!({ "loaded": "stored" }), || "the stored parameters are in use\n".to_owned())
        }
        Action::Load { file: Some(file) } => {
            let values = read(file)?;
            let mut drive = link.connect()?.drive;
            let mut wanted = drive.parameters()?;
            for (row, value) in values {
                row.set(&mut wanted, value).map_err(|refusal| anyhow!("{}: {refusal}", file.display()))?;
            }
            let changed = drive.make_parameters(&wanted)?;
            json.write(&json!({ "changed": changed.len() }), || format!("{} parameters changed\n", changed.len()))
        }
        Action::Diff { file } => {
            let other = match file {
                None => TABLE.iter().map(|row| (row, row.default)).collect(),
                Some(file) => read(file)?,
            };
            diff(json, &link.connect()?.drive.parameters()?, &other)
        }
        Action::Save => {
            let store = link.connect()?.drive.save_parameters()?;
            let number = store.image.map(|image| image.sequence);
            json.write(&json!({ "saved": number }), || format!("saved as number {}\n", number.unwrap_or_default()))
        }
        Action::Reset => {
            link.connect()?.drive.order(&Request::ResetParameters)?;
            json.write(&json!({ "loaded": "defaults" }), || {
                "the parameters of a new drive are in use; `servoctl params load` returns to the stored ones\n"
                    .to_owned()
            })
        }
    }
}

fn row(name: &str) -> Result<&'static Parameter> {
    Parameter::by_name(name)
        .with_context(|| format!("there is no parameter `{name}`: `servoctl params list` names them all"))
}

/// Id and value of a typed parameter.
///
/// # Errors
/// An unknown name, a value that is no number or of another dimension; limits are the drive's to check.
pub fn parse(name: &str, value: &str) -> Result<(u16, f64)> {
    let row = row(name)?;
    let value = units::parse(value, row.unit, true).map_err(|reason| anyhow!("{name}: {reason}"))?;
    Ok((row.id, value))
}

/// Names and values, for a program.
fn values<'a>(rows: impl IntoIterator<Item = &'a Parameter>, settings: &Settings) -> BTreeMap<&'static str, f64> {
    rows.into_iter().map(|row| (row.name, row.get(settings))).collect()
}

fn show(json: &Json, rows: &[&Parameter], settings: &Settings) -> Result<()> {
    json.write(&values(rows.iter().copied(), settings), || match rows {
        [row] => {
            let unit = if row.unit.is_empty() { String::new() } else { format!(" {}", row.unit) };
            format!("{} = {}{unit}\n", row.name, units::show_number(row.get(settings)))
        }
        rows => rows
            .iter()
            .fold(
                Table::new("", &["parameter", "value", "unit", "lowest", "highest", "default", "changes"]),
                |table, row| {
                    let access = match row.access {
                        Access::Always => "any time",
                        Access::BridgeOff => "bridge off",
                    };
                    let [value, min, max, default] =
                        [row.get(settings), row.min, row.max, row.default].map(units::show_number);
                    table.row([row.name, &value, row.unit, &min, &max, &default, access])
                },
            )
            .to_text()
            .trim_start()
            .to_owned(),
    })
}

fn dump(settings: &Settings, drive: &Drive) -> String {
    let [major, minor, patch] = drive.identity().firmware;
    let serial = drive.identity().serial.map(|word| format!("{word:08x}")).concat();
    let mut text = format!(
        "# Parameters of drive {serial}, firmware {major}.{minor}.{patch}: `servoctl params load` reads this.\n"
    );
    for row in TABLE {
        let value = row.get(settings);
        let value = units::show_exactly(value);
        let value = if row.unit.is_empty() { value } else { format!("\"{value} {}\"", row.unit) };
        let [min, max] = [row.min, row.max].map(units::show_number);
        let _ = write!(text, "\n# {}\n# {min} … {max} {}\n{} = {value}\n", row.doc, row.unit, row.name);
    }
    text
}

/// Reads `name = "value unit"` or `name = value`.
fn read(file: &Path) -> Result<Vec<(&'static Parameter, f64)>> {
    let name = file.display();
    let text = std::fs::read_to_string(file).with_context(|| format!("reading {name}"))?;
    let table: toml::Table = toml::from_str(&text).with_context(|| format!("{name}"))?;
    let values = table.iter().map(|(key, value)| {
        let row = row(key)?;
        let value = match value {
            toml::Value::String(text) => parse(key, text)?.1,
            toml::Value::Float(value) => *value,
            toml::Value::Integer(value) => *value as f64,
            other => bail!("{key} = {other} is no number"),
        };
        Ok((row, value))
    });
    values.collect::<Result<_>>().with_context(|| format!("{name}"))
}

fn diff(json: &Json, settings: &Settings, other: &[(&Parameter, f64)]) -> Result<()> {
    let differ: Vec<_> = other.iter().filter(|(row, value)| row.get(settings) != *value).collect();
    let value: BTreeMap<_, _> =
        differ.iter().map(|(row, value)| (row.name, json!({ "drive": row.get(settings), "other": value }))).collect();
    json.write(&value, || match &differ[..] {
        [] => "no difference\n".to_owned(),
        differ => differ
            .iter()
            .fold(Table::new("", &["parameter", "drive", "other", "unit"]), |table, (row, value)| {
                table.row([row.name, &units::show_number(row.get(settings)), &units::show_number(*value), row.unit])
            })
            .to_text()
            .trim_start()
            .to_owned(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_are_typed_in_any_unit_of_their_dimension() {
        let id = row("niasa_time_constant_s").unwrap().id;
        for (typed, value) in [("0.02", 0.02), ("20ms", 0.02), ("20 ms", 0.02)] {
            assert_eq!(parse("niasa_time_constant_s", typed).unwrap(), (id, value));
        }
        let error = parse("niasa_time_constant_s", "20mm").unwrap_err().to_string();
        assert!(error.starts_with("niasa_time_constant_s: `20mm`"), "{error}");
    }

    #[test]
    fn every_unit_of_the_table_can_be_typed_as_it_is_shown() {
        for row in TABLE {
            assert_eq!(
                units::parse(&format!("{} {}", row.default, row.unit), row.unit, false),
                Ok(row.default),
                "{}",
                row.name
            );
        }
    }
}
