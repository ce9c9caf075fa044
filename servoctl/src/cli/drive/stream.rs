//! `servoctl stream`: signals of every servo tick to a file, for as long as one likes, with every loss counted.

use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::atomic::Ordering;

use anyhow::{Result, ensure};
use serde_json::json;
use servo_core::SERVO_HZ;
use servo_core::record::COLUMNS;
use servo_protocol::stream::{Order, Tally};

use super::super::interrupt;
use super::super::output::Json;
use super::Link;
use super::record_file::{Head, selection, write};
use crate::link::units;

/// So often the drive is asked something while it streams, ticks.
const ASK_TICKS: u32 = SERVO_HZ / 50;

/// Options of `stream`.
#[derive(Debug, clap::Args)]
pub struct Options {
    /// Signals by the names in docs/protocol.md; the line carries four of every tick
    #[arg(long, value_delimiter = ',', default_value = "error_ct,position_low_ct,force_n,iq_a")]
    signals: Vec<String>,
    /// End after so much of the drive's time [default: at Ctrl-C]
    #[arg(long, value_parser = units::time)]
    length: Option<f64>,
    /// One sample every so many servo ticks
    #[arg(long, default_value_t = 1)]
    every: u16,
    /// The file
    #[arg(short, long, value_name = "FILE.csv")]
    output: PathBuf,
    #[command(flatten)]
    json: Json,
}

/// Streams and writes; lost samples are missing rows, and are counted.
///
/// # Errors
/// A refusal, a file that cannot be written; those of the link.
pub fn run(link: &Link, options: &Options) -> Result<ExitCode> {
    let ended = interrupt::flag()?;
    let words = selection(&options.signals)?;
    ensure!((1..=8000).contains(&options.every), "--every {}: it must be between 1 and 8000", options.every);
    let mut drive = link.connect()?.drive;
    let settings = drive.parameters()?;
    let order = Order { words, every_ticks: options.every };
    let numbers: Vec<usize> = words.numbers().collect();
    let most = options.length.map(|length_s| (length_s * f64::from(SERVO_HZ) / f64::from(options.every)) as u64);
    let (mut tally, mut times_s) = (Tally::default(), Vec::new());
    let mut columns = vec![Vec::new(); numbers.len()];
    let (mut first_tick, mut asked) = (None, drive.status()?.tick);
    drive.stream(order)?;
    while !ended.load(Ordering::Relaxed) && most.is_none_or(|most| tally.samples + tally.lost_samples < most) {
        let Some(block) = drive.next_block()? else {
            // Samples that are far apart, or nobody there: that an answer tells.
            asked = drive.status()?.tick;
            continue;
        };
        tally.count(&order, &block);
        // Who only listens is not there, as its command time-out sees it.
        if block.first_tick.wrapping_sub(asked) > ASK_TICKS {
            asked = drive.status()?.tick;
        }
        let first = *first_tick.get_or_insert(block.first_tick);
        for (index, sample) in block.samples(words).enumerate() {
            let tick = block.first_tick.wrapping_sub(first) + index as u32 * u32::from(options.every);
            times_s.push(f64::from(tick) / f64::from(SERVO_HZ));
            for ((column, number), word) in columns.iter_mut().zip(&numbers).zip(sample) {
                column.push(COLUMNS[*number].1.value(word));
            }
        }
    }
    drive.stream(Order { words: Default::default(), every_ticks: 1 })?;
    let head =
        Head::new(&drive, &settings, options.every.into(), &format!("none; {} samples lost", tally.lost_samples));
    let names: Vec<&str> = numbers.iter().map(|number| COLUMNS[*number].0).collect();
    write(&options.output, &head, &names, &times_s, &columns)?;
    let name = options.output.display().to_string();
    let value = json!({ "file": name, "samples": tally.samples, "lost_samples": tally.lost_samples, "lost_blocks": tally.lost_blocks });
    options.json.write(&value, || {
        format!("{name}: {} samples, {} lost ({} blocks)\n", tally.samples, tally.lost_samples, tally.lost_blocks)
    })?;
    Ok(ExitCode::SUCCESS)
}
