//! `servoctl capture`: a full-rate recording in the drive, read out to a file.

use std::fmt::Write;
use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::atomic::Ordering;

use anyhow::{Context, Result, ensure};
use serde_json::json;
use servo_core::SERVO_HZ;
use servo_core::capture::{Order, Progress};
use servo_core::parameters::{Settings, TABLE};
use servo_protocol::program::Fingerprint;

use super::super::interrupt;
use super::super::output::Json;
use super::super::progress;
use super::motion::{self, End, Motion};
use super::{Connected, Link};
use crate::link::{Captured, Drive, units};

/// Options of `capture`.
#[derive(Debug, clap::Args)]
pub struct Options {
    /// Length of the recording
    #[arg(long, default_value = "500ms", value_parser = units::time)]
    length: f64,
    /// One sample every so many servo ticks, 1 to 80
    #[arg(long, default_value_t = 1)]
    every: u32,
    /// The file
    #[arg(short, long, value_name = "FILE.csv")]
    output: PathBuf,
    /// Make this move; without it the recording waits for the end of somebody's next one
    #[command(flatten)]
    motion: Option<Motion>,
    #[command(flatten)]
    json: Json,
}

/// Orders, moves, waits, reads, writes.
///
/// # Errors
/// A refusal, a fault on the way, a file that cannot be written; those of the link.
pub fn run(link: &Link, options: &Options) -> Result<ExitCode> {
    let interrupted = interrupt::flag_saying("braking; Ctrl-C again leaves the drive to itself")?;
    let mut connected = link.connect()?;
    let settings = connected.drive.parameters()?;
    let rate_hz = f64::from(SERVO_HZ) / f64::from(options.every.max(1));
    let samples = (options.length * rate_hz).round();
    ensure!((1.0..1e6).contains(&samples), "--length: {samples} samples; it must be between 1 and 1e6");
    connected.drive.arm_capture(Order { samples: samples as u32, every_ticks: options.every })?;
    if let Some(motion) = &options.motion
        && let End::Stopped = motion::go(&mut connected, &settings, motion, false)?
    {
        return Ok(ExitCode::from(interrupt::INTERRUPTED));
    }
    let Connected { mut drive, .. } = connected;
    let go_on = || !interrupted.load(Ordering::Relaxed);
    let complete = |capture| matches!(capture, Progress::Complete(_));
    let status = drive.wait_until("capturing", u32::MAX / 2, |_| go_on(), |status| complete(status.capture))?;
    if !complete(status.capture) {
        return Ok(ExitCode::from(interrupt::INTERRUPTED));
    }
    let mut bar = None;
    let read = drive.read_capture(|total, block| {
        let bar = bar.get_or_insert_with(|| progress::Progress::new("reading out", total.into(), "samples"));
        bar.advance(block.into());
    })?;
    drop(bar);
    let text = csv(&drive, &settings, &read, rate_hz);
    let name = options.output.display().to_string();
    std::fs::write(&options.output, text).with_context(|| format!("writing {name}"))?;
    options.json.write(&json!({ "file": name, "samples": read.len(), "rate_hz": rate_hz }), || {
        format!("{name}: {} samples at {rate_hz} Hz\n", read.len())
    })?;
    Ok(ExitCode::SUCCESS)
}

/// Fingerprint of parameters by ids and bits.
pub fn parameter_hash(settings: &Settings) -> u64 {
    let bytes =
        TABLE.iter().flat_map(|row| row.id.to_le_bytes().into_iter().chain(row.get(settings).to_bits().to_le_bytes()));
    Fingerprint::default().with(&bytes.collect::<Vec<u8>>()).0
}

fn csv(drive: &Drive, settings: &Settings, samples: &[Captured], rate_hz: f64) -> String {
    let identity = drive.identity();
    let [major, minor, patch] = identity.firmware;
    let mut text = format!(
        "# servoctl {}, firmware {major}.{minor}.{patch} (program {:016x}) on {}\n\
         # parameters {:016x}\n# rate {rate_hz} Hz\n# trigger: end of the profile, in the first row\n\
         # units: s, m, m, N; counts of {:e} m beside them\n\
         time_s,error_m,position_m,force_n,error_ct,position_ct_low\n",
        env!("CARGO_PKG_VERSION"),
        identity.program,
        identity.board,
        parameter_hash(settings),
        settings.encoder_count_m,
    );
    for (index, sample) in samples.iter().enumerate() {
        let Captured { error_ct, position_ct, force_n } = *sample;
        // The low 32 bits are those of a signed position: 26 cm of a 61 pm encoder.
        let position_m = f64::from(position_ct as i32) * settings.encoder_count_m;
        let error_m = f64::from(error_ct) * settings.encoder_count_m;
        let time_s = index as f64 / rate_hz;
        let _ = writeln!(text, "{time_s},{error_m:e},{position_m:.12},{force_n},{error_ct},{position_ct}");
    }
    text
}
