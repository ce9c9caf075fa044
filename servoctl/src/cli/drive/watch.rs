//! `servoctl watch`: chosen signals, line by line.

use std::sync::atomic::Ordering;

use anyhow::Result;
use clap::ValueEnum;
use servo_core::SERVO_HZ;
use servo_protocol::message::Status;

use super::super::interrupt;
use super::super::output::Json;
use super::Link;
use crate::link::units;

/// Options of `watch`.
#[derive(Debug, clap::Args)]
pub struct Options {
    /// Signals
    #[arg(value_enum, default_values_t = [Signal::Position, Signal::Error, Signal::Force])]
    signals: Vec<Signal>,
    /// Time between two lines, on the drive's clock
    #[arg(long, default_value = "100ms", value_parser = units::time)]
    every: f64,
    /// End after so many lines [default: at Ctrl-C]
    #[arg(long)]
    lines: Option<u64>,
    #[command(flatten)]
    json: Json,
}

/// What can be watched.
#[derive(Debug, Clone, Copy, ValueEnum)]
enum Signal {
    /// Measured position, mm
    Position,
    /// Set-point − position, nm
    Error,
    /// Force, N
    Force,
    /// Bus voltage, V
    Bus,
    /// 1 while a profile moves the set-point
    Moving,
    /// Number of the state
    State,
}

impl Signal {
    /// Name with unit, as JSON and the head line have it, and the value in that unit.
    fn of(self, status: &Status, count_m: f64) -> (&'static str, f64) {
        match self {
            Signal::Position => ("position_mm", status.position_ct as f64 * count_m * 1e3),
            Signal::Error => ("error_nm", f64::from(status.error_ct) * count_m * 1e9),
            Signal::Force => ("force_n", status.force_n.into()),
            Signal::Bus => ("bus_v", status.bus_v.into()),
            Signal::Moving => ("moving", f64::from(u8::from(status.moving))),
            Signal::State => ("state", f64::from(status.state as u8)),
        }
    }
}

/// Prints until Ctrl-C.
///
/// # Errors
/// Those of the link.
pub fn run(link: &Link, options: &Options) -> Result<()> {
    let ended = interrupt::flag()?;
    let mut drive = link.connect()?.drive;
    let count_m = drive.parameters()?.encoder_count_m;
    let every_ticks = (options.every * f64::from(SERVO_HZ)).max(1.0) as u32;
    let mut out = options.json.lines()?;
    let mut due = drive.status()?.tick;
    let mut lines = 0;
    while !ended.load(Ordering::Relaxed) && options.lines.is_none_or(|most| lines < most) {
        let status = drive.status()?;
        if (status.tick.wrapping_sub(due) as i32) < 0 {
            continue;
        }
        due = status.tick.wrapping_add(every_ticks);
        let values: Vec<_> = options.signals.iter().map(|signal| signal.of(&status, count_m)).collect();
        let time_s = f64::from(status.tick) / f64::from(SERVO_HZ);
        let mut object = serde_json::Map::from_iter([("time_s".to_owned(), time_s.into())]);
        object.extend(values.iter().map(|(name, value)| ((*name).to_owned(), (*value).into())));
        let wanted = out.write(&object.into(), || {
            let head: String = values.iter().map(|(name, _)| format!("{name:>16}")).collect();
            let row: String = values.iter().map(|(_, value)| format!("{value:>16.4}")).collect();
            let head = if lines == 0 { format!("{:>12}{head}\n", "time_s") } else { String::new() };
            format!("{head}{time_s:>12.4}{row}\n")
        })?;
        if !wanted {
            return Ok(());
        }
        lines += 1;
    }
    Ok(())
}
