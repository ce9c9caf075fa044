//! `servoctl align`.

use std::process::ExitCode;
use std::sync::atomic::Ordering;

use anyhow::Result;
use serde_json::json;

use super::super::interrupt;
use super::Link;
use super::identity::Options;
use crate::link::units::show_length;

/// Looks for the motor's electrical zero and says where it is; Ctrl-C turns the bridge off.
///
/// # Errors
/// A refusal, the fault of an alignment that failed; those of the link.
pub fn run(link: &Link, options: &Options) -> Result<ExitCode> {
    let interrupted = interrupt::flag_saying("turning the bridge off; Ctrl-C again leaves the drive to itself")?;
    let mut drive = link.connect()?.drive;
    let travel_m = drive.parameters()?.alignment_travel_m;
    eprintln!("looking for the electrical zero: some seconds, at most {} away from here", show_length(travel_m));
    if !drive.align(|| !interrupted.load(Ordering::Relaxed))? {
        return Ok(ExitCode::from(interrupt::INTERRUPTED));
    }
    let offset_m = drive.parameters()?.commutation_offset_m;
    options.json.write(&json!({ "commutation_offset_m": offset_m }), || {
        format!("electrical zero at {}; `servoctl params save` keeps it\n", show_length(offset_m))
    })?;
    Ok(ExitCode::SUCCESS)
}
