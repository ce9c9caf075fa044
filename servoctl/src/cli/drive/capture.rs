//! `servoctl capture`: a full-rate recording in the drive around a trigger, read out to a file.

use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::atomic::Ordering;

use anyhow::{Context, Result, ensure};
use clap::ValueEnum;
use serde_json::json;
use servo_core::SERVO_HZ;
use servo_core::capture::{Order, Progress, Trigger};
use servo_core::parameters::Settings;
use servo_core::record::COLUMNS;

use super::super::interrupt;
use super::super::output::Json;
use super::super::progress;
use super::motion::{self, End, Motion};
use super::record_file::{Head, selection, write};
use super::{Connected, Link};
use crate::link::{Capture, Drive, units};

/// Options of `capture`.
#[derive(Debug, clap::Args)]
pub struct Options {
    /// Signals, up to 8, by the names in docs/protocol.md
    #[arg(long, value_delimiter = ',', default_value = "error_ct,position_low_ct,force_n")]
    signals: Vec<String>,
    /// Length of the recording
    #[arg(long, default_value = "500ms", value_parser = units::time)]
    length: f64,
    /// How much of it is from before the trigger
    #[arg(long, default_value = "0ms", value_parser = units::time)]
    before: f64,
    /// One sample every so many servo ticks, 1 to 80
    #[arg(long, default_value_t = 1)]
    every: u32,
    /// What to wait for
    #[arg(long, value_enum, default_value_t = On::MoveEnd)]
    trigger: On,
    /// For `--trigger error`: size of the error
    #[arg(long, default_value = "1µm", value_parser = units::length)]
    level: f64,
    /// The file
    #[arg(short, long, value_name = "FILE.csv")]
    output: PathBuf,
    /// Make this move; without it the recording waits for what others do
    #[command(flatten)]
    motion: Option<Motion>,
    #[command(flatten)]
    json: Json,
}

/// What a recording waits for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum On {
    /// Nothing
    Now,
    /// The start of a move
    MoveStart,
    /// The end of a move's profile
    MoveEnd,
    /// A fault
    Fault,
    /// An error of the size of `--level`
    Error,
}

impl Options {
    fn order(&self, settings: &Settings) -> Result<Order> {
        let rate_hz = f64::from(SERVO_HZ) / f64::from(self.every.max(1));
        let [samples, before] = [self.length, self.before].map(|time_s| (time_s * rate_hz).round());
        ensure!((1.0..1e6).contains(&samples), "--length: {samples} samples; it must be between 1 and 1e6");
        ensure!((0.0..samples).contains(&before), "--before: {before} samples of {samples}; it must be less than all");
        let trigger = match self.trigger {
            On::Now => Trigger::Now,
            On::MoveStart => Trigger::MoveStart,
            On::MoveEnd => Trigger::MoveEnd,
            On::Fault => Trigger::Fault,
            On::Error => Trigger::Error((self.level / settings.encoder_count_m).round() as u32),
        };
        let words = selection(&self.signals)?;
        Ok(Order { words, samples: samples as u32, before: before as u32, every_ticks: self.every, trigger })
    }
}

/// Orders, moves, waits, reads, writes.
///
/// # Errors
/// A refusal, a fault on the way, a file that cannot be written; those of the link.
pub fn run(link: &Link, options: &Options) -> Result<ExitCode> {
    let mut connected = link.connect()?;
    let interrupted = interrupt::flag_saying("braking; Ctrl-C again leaves the drive to itself")?;
    let settings = connected.drive.parameters()?;
    let order = options.order(&settings)?;
    connected.drive.arm_capture(order)?;
    if let Some(motion) = &options.motion
        && let End::Stopped = motion::go(&mut connected, &settings, motion, false)?
    {
        return Ok(ExitCode::from(interrupt::INTERRUPTED));
    }
    let Connected { mut drive, .. } = connected;
    let go_on = || !interrupted.load(Ordering::Relaxed);
    // Not `wait_until`: a fault may be what is waited for.
    while !matches!(drive.status()?.capture, Progress::Complete(_)) {
        if !go_on() {
            return Ok(ExitCode::from(interrupt::INTERRUPTED));
        }
    }
    let capture = read(&mut drive)?;
    let trigger = options.trigger.to_possible_value();
    let trigger = trigger.as_ref().map_or("", |value| value.get_name());
    let trigger = format!("{trigger} at tick {}, time 0", capture.complete.tick);
    let head = Head::new(&drive, &settings, options.every, &trigger);
    let names: Vec<&str> = order.words.numbers().map(|number| COLUMNS[number].0).collect();
    let columns = names.iter().map(|name| capture.column(name).unwrap_or_default()).collect::<Vec<_>>();
    write(&options.output, &head, &names, &capture.times_s(), &columns)?;
    let name = options.output.display().to_string();
    options.json.write(&json!({ "file": name, "samples": order.samples, "signals": names }), || {
        format!("{name}: {} samples of {}\n", order.samples, names.join(", "))
    })?;
    Ok(ExitCode::SUCCESS)
}

fn read(drive: &mut Drive) -> Result<Capture> {
    let mut bar = None;
    let capture = drive.read_capture(|total, block| {
        bar.get_or_insert_with(|| progress::Progress::new("reading out", total as u64, "words")).advance(block as u64);
    });
    capture.context("reading the capture")
}
