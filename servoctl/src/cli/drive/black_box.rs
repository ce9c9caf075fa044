//! `servoctl faults blackbox`: the ticks around the fault, and the same ticks computed once more by this program.

use std::cell::Cell;
use std::path::PathBuf;

use anyhow::{Result, ensure};
use serde::Serialize;
use serde_json::json;
use servo_core::SERVO_HZ;
use servo_core::black_box::{ENTRY_WORDS, Entry};
use servo_core::fault::Fault;
use servo_core::record::{COLUMNS, Kind, flags};
use servo_protocol::black_box::BlackBox;

use super::super::output::Json;
use super::Link;
use super::record_file::{Head, write};
use crate::link::units::show_length;
use crate::table::Table;

/// Options of `faults blackbox`.
#[derive(Debug, Default, clap::Args)]
pub struct Options {
    /// Write every tick to this file: its record and all that the drive was told
    #[arg(short, long, value_name = "FILE.csv")]
    output: Option<PathBuf>,
}

/// Ticks that are shown from before the fault, or from before the reset.
const SHOWN_BEFORE: usize = 12;
/// Ticks that are shown from the fault on.
const SHOWN_AFTER: usize = 4;

/// What an entry has beyond its record.
const TOLD: [&str; ENTRY_WORDS - COLUMNS.len()] =
    ["encoder_frame_low", "encoder_frame_high", "bus_and_temperature_code", "signals", "command_number"];

/// What the black box says.
#[derive(Debug, PartialEq, Serialize)]
pub struct Report {
    /// The first fault in it; none if a reset ended the recording.
    fault: Option<u16>,
    /// The fault in words.
    explanation: String,
    /// The tick that time is counted from: the first with the fault, else the last.
    tick: u32,
    /// Version of the firmware that wrote it.
    firmware: String,
    /// Ticks before that one.
    ticks_before: usize,
    /// Ticks from it on.
    ticks_from_it_on: usize,
    /// The last ticks before it and the first ones from it on.
    ticks: Vec<Tick>,
    /// How many ticks this program computed again with the same result, to the last bit; none if they came out differently.
    replayed_ticks: Option<u32>,
    /// The same in words.
    replay: String,
}

/// One tick, as it is shown.
#[derive(Debug, PartialEq, Serialize)]
struct Tick {
    time_ms: f64,
    position_m: f64,
    error_m: f64,
    force_n: f64,
    iq_a: f64,
    bus_v: f64,
    /// What is not as in every tick.
    remarks: String,
}

impl Report {
    /// From a black box, and the length of a count, m.
    ///
    /// # Errors
    /// One that holds no recording.
    pub fn new(memory: &[Cell<u32>], count_m: f64) -> Result<Report> {
        let black_box = BlackBox(memory);
        let entries: Vec<Entry> = black_box.entries().collect();
        ensure!(
            black_box.is_intact() && !entries.is_empty(),
            "the black box holds no fault: it keeps the ticks around the first one, until the bridge is next turned on"
        );
        let faulty = entries.iter().position(|entry| entry.fault_number() != 0);
        let zero = faulty.unwrap_or(entries.len() - 1);
        let fault = faulty.and_then(|at| Fault::by_number(entries[at].fault_number()));
        let shown = zero.saturating_sub(SHOWN_BEFORE)..entries.len().min(zero + SHOWN_AFTER);
        let (replayed_ticks, replay) = match black_box.replay() {
            Ok(ticks) => (Some(ticks), format!("{ticks} of these ticks computed again: the same, to the last bit")),
            Err(reason) => {
                let [major, minor, patch] = black_box.firmware();
                let ours = env!("CARGO_PKG_VERSION");
                let hint = format!("firmware {major}.{minor}.{patch} wrote it, this program computes as {ours} does");
                (None, format!("the ticks computed again differ: {reason} ({hint})"))
            }
        };
        Ok(Report {
            fault: fault.map(Fault::number),
            explanation: fault.map_or("a reset ended the recording".to_owned(), |fault| fault.explanation().to_owned()),
            tick: entries[zero].sequence(),
            firmware: black_box.firmware().map(|number| number.to_string()).join("."),
            ticks_before: zero,
            ticks_from_it_on: entries.len() - zero,
            ticks: shown.map(|at| Tick::new(&entries[at], time_s(&entries, zero, at), count_m)).collect(),
            replayed_ticks,
            replay,
        })
    }

    /// For a person.
    pub fn to_text(&self) -> String {
        let head = match self.fault {
            Some(number) => format!("fault {number}: {}", self.explanation),
            None => self.explanation.clone(),
        };
        let caption = format!(
            "firmware {} · tick {} is 0 ms · {} ticks before it, {} from it on",
            self.firmware, self.tick, self.ticks_before, self.ticks_from_it_on
        );
        let header = ["ms", "position", "error", "force", "current", "bus", "remarks"];
        let table = self.ticks.iter().fold(Table::new(caption, &header), |table, tick| {
            table.row([
                format!("{:.3}", tick.time_ms),
                show_length(tick.position_m),
                show_length(tick.error_m),
                format!("{:.3} N", tick.force_n),
                format!("{:.3} A", tick.iq_a),
                format!("{:.1} V", tick.bus_v),
                tick.remarks.clone(),
            ])
        });
        format!("{head}\n{}{}\n", table.to_text(), self.replay)
    }
}

/// Time of entry `at` from entry `zero` on, s.
fn time_s(entries: &[Entry], zero: usize, at: usize) -> f64 {
    f64::from(entries[at].sequence().wrapping_sub(entries[zero].sequence()) as i32) / f64::from(SERVO_HZ)
}

/// Value of a word of the record by its name in [`COLUMNS`].
fn value(entry: &Entry, name: &str) -> f64 {
    let column = COLUMNS.iter().zip(entry.record()).find(|(column, _)| column.0 == name);
    column.map_or(f64::NAN, |((_, kind), word)| kind.value(*word))
}

impl Tick {
    fn new(entry: &Entry, time_s: f64, count_m: f64) -> Tick {
        let record = entry.record();
        let position_ct = i64::from(record[1]) | i64::from(record[2] as i32) << 32;
        let flags = record[14] as u16;
        let mut remarks = Vec::new();
        remarks.extend(entry.command_number().map(|number| format!("command {number}")));
        remarks.extend((flags & flags::FRAME_BAD != 0).then(|| "bad frame".to_owned()));
        let limits = flags::LIMITS.iter().filter(|(bit, ..)| flags & bit != 0);
        remarks.extend(limits.map(|(_, name, _)| (*name).to_owned()));
        remarks.extend((flags & flags::BRIDGE_ON == 0).then(|| "bridge off".to_owned()));
        remarks.extend((entry.fault_number() != 0).then(|| format!("fault {}", entry.fault_number())));
        Tick {
            time_ms: time_s * 1e3,
            position_m: position_ct as f64 * count_m,
            error_m: value(entry, "error_ct") * count_m,
            force_n: value(entry, "force_n"),
            iq_a: value(entry, "iq_a"),
            bus_v: value(entry, "bus_v"),
            remarks: remarks.join(", "),
        }
    }
}

/// Reads, computes again, shows.
///
/// # Errors
/// Nothing in it, a file that cannot be written; those of the link.
pub fn run(link: &Link, options: &Options, json: &Json) -> Result<()> {
    let mut drive = link.connect()?.drive;
    let settings = drive.parameters()?;
    let memory = drive.read_black_box()?;
    let report = Report::new(&memory, settings.encoder_count_m)?;
    let mut wrote = None;
    if let Some(file) = &options.output {
        let entries: Vec<Entry> = BlackBox(&memory[..]).entries().collect();
        let cause = report.fault.map_or("reset after".to_owned(), |number| format!("fault {number} at"));
        let head = Head::new(&drive, &settings, 1, &format!("{cause} tick {}, time 0", report.tick));
        let times_s: Vec<f64> = (0..entries.len()).map(|at| time_s(&entries, report.ticks_before, at)).collect();
        let kinds = COLUMNS.iter().map(|(_, kind)| *kind).chain([Kind::Unsigned; TOLD.len()]);
        let column =
            |(at, kind): (usize, Kind)| -> Vec<f64> { entries.iter().map(|entry| kind.value(entry.0[at])).collect() };
        let names: Vec<&str> = COLUMNS.iter().map(|(name, _)| *name).chain(TOLD).collect();
        write(file, &head, &names, &times_s, &kinds.enumerate().map(column).collect::<Vec<_>>())?;
        wrote = Some(format!("{}: {} ticks\n", file.display(), entries.len()));
    }
    let mut value = serde_json::to_value(&report)?;
    value["file"] = json!(options.output);
    json.write(&value, || report.to_text() + wrote.as_deref().unwrap_or_default())
}

#[cfg(test)]
mod tests {
    use super::*;
    use servo_protocol::black_box::WORDS;

    #[test]
    fn memory_without_a_recording_is_said_to_be_that() {
        for word in [0, u32::MAX] {
            let error = Report::new(&vec![Cell::new(word); WORDS], 1e-9).unwrap_err();
            assert!(error.to_string().starts_with("the black box holds no fault"), "{error}");
        }
    }
}
