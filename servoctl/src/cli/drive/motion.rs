//! `servoctl move`: one move and how it settled.

use std::process::ExitCode;
use std::sync::atomic::Ordering;

use anyhow::{Result, anyhow, ensure};
use serde::Serialize;
use servo_core::parameters::Settings;
use servo_core::profile::Limits;
use servo_core::state::State;
use servo_protocol::message::{Request, Status};

use super::super::interrupt;
use super::super::output::Json;
use super::settled::Report;
use super::{Connected, Link};
use crate::link::Error;
use crate::link::units::{self, show_length};

/// Acceleration of a move that names none, m/s²: that of the thesis' first experiment.
const ACCELERATION_M_PER_S2: f64 = 1.0;

/// Where to, and how fast.
#[derive(Debug, Clone, clap::Args)]
pub struct Motion {
    /// Target with its unit: 1.5mm, 200µm, -3nm
    #[arg(value_parser = units::length, allow_hyphen_values = true)]
    target: f64,
    /// The target is a distance from the present set-point
    #[arg(long, short)]
    relative: bool,
    /// Highest speed [default: the drive's velocity_max_m_per_s]
    #[arg(long, value_parser = units::speed)]
    velocity: Option<f64>,
    /// Acceleration [default: 1 m/s², or the drive's limit if that is lower]
    #[arg(long, value_parser = units::acceleration)]
    acceleration: Option<f64>,
    /// Jerk, for a profile with rounded corners [default: none, a trapezoid of speed]
    #[arg(long, value_parser = units::jerk)]
    jerk: Option<f64>,
}

/// Options of `move`.
#[derive(Debug, clap::Args)]
pub struct Options {
    #[command(flatten)]
    motion: Motion,
    /// End when the profile does, without a settling report
    #[arg(long)]
    no_report: bool,
    #[command(flatten)]
    json: Json,
}

/// What a move was and how it settled, for a program.
#[derive(Debug, Serialize)]
pub struct Moved {
    /// The drive is a virtual one.
    simulated: bool,
    /// Set-point before, m.
    from_m: f64,
    /// Target, m.
    target_m: f64,
    /// Limits asked for.
    velocity_m_per_s: f32,
    acceleration_m_per_s2: f32,
    jerk_m_per_s3: Option<f32>,
    /// Number of the compensator, see `params list`.
    compensator: f64,
    /// How it settled; `null` where that was not waited for.
    settling: Option<Report>,
}

/// How a motion ended.
pub enum End {
    /// At its target.
    Arrived(Box<Moved>),
    /// Ctrl-C: braked.
    Stopped,
}

/// Moves, waits, reports.
///
/// # Errors
/// A refusal, a fault on the way; those of the link.
pub fn run(link: &Link, options: &Options) -> Result<ExitCode> {
    let mut connected = link.connect()?;
    let settings = connected.drive.parameters()?;
    match go(&mut connected, &settings, &options.motion, !options.no_report)? {
        End::Stopped => Ok(ExitCode::from(interrupt::INTERRUPTED)),
        End::Arrived(moved) => {
            options.json.write(&*moved, || moved.to_text())?;
            Ok(ExitCode::SUCCESS)
        }
    }
}

/// Moves; Ctrl-C brakes. A virtual drive that is not enabled is enabled first.
///
/// # Errors
/// A refusal, a fault on the way; those of the link.
pub fn go(connected: &mut Connected, settings: &Settings, motion: &Motion, report: bool) -> Result<End> {
    let interrupted = interrupt::flag_saying("braking; Ctrl-C again leaves the drive to itself")?;
    let status = enable_if_virtual(connected)?;
    let drive = &mut connected.drive;
    let count_m = settings.encoder_count_m;
    let from_ct = status.position_ct + i64::from(status.error_ct);
    let distance_ct = motion.target / count_m;
    ensure!(distance_ct.abs() < 1e15, "{} is further than any stage", show_length(motion.target));
    let target_ct = distance_ct.round() as i64 + if motion.relative { from_ct } else { 0 };
    let limits = Limits {
        velocity_m_per_s: motion.velocity.unwrap_or(settings.velocity_max_m_per_s) as f32,
        acceleration_m_per_s2: motion
            .acceleration
            .unwrap_or(ACCELERATION_M_PER_S2.min(settings.acceleration_max_m_per_s2))
            as f32,
        jerk_m_per_s3: motion.jerk.map(|jerk| jerk as f32),
    };
    let go_on = || !interrupted.load(Ordering::Relaxed);
    if !go_on() {
        return Ok(End::Stopped);
    }
    drive.order(&Request::Move { target_ct, limits })?;
    eprintln!("moving to {}", show_length(target_ct as f64 * count_m));
    drive
        .wait_until("moving", u32::MAX / 2, |_| go_on(), |status| !status.moving)
        .map_err(|error| left_alone(error, settings))?;
    if !go_on() {
        drive.order(&Request::Stop)?;
        let status = drive.wait_until("braking", u32::MAX / 2, |_| true, |status| !status.moving)?;
        eprintln!("stopped at {}", show_length(status.position_ct as f64 * count_m));
        return Ok(End::Stopped);
    }
    let settling = match report {
        true => Some(Report::wait(drive, count_m, go_on)?),
        false => None,
    };
    Ok(End::Arrived(Box::new(Moved {
        simulated: connected.is_virtual,
        from_m: from_ct as f64 * count_m,
        target_m: target_ct as f64 * count_m,
        velocity_m_per_s: limits.velocity_m_per_s,
        acceleration_m_per_s2: limits.acceleration_m_per_s2,
        jerk_m_per_s3: limits.jerk_m_per_s3,
        compensator: settings.compensator,
        settling,
    })))
}

/// The drive's status, behind enabling it if it is a virtual one that is not.
///
/// # Errors
/// A refusal, a fault on the way; those of the link.
pub fn enable_if_virtual(connected: &mut Connected) -> Result<Status> {
    let status = connected.drive.status()?;
    if !connected.is_virtual || status.fault.is_some() || status.state == State::OperationEnabled {
        return Ok(status);
    }
    eprintln!("enabling the virtual drive (a real one wants `servoctl enable`)");
    Ok(connected.drive.enable()?)
}

/// The error, and what the drive does now if it cannot be reached any more.
fn left_alone(error: Error, settings: &Settings) -> anyhow::Error {
    if !matches!(error, Error::Broken(_) | Error::NoReply { .. }) {
        return error.into();
    }
    let timeout_s = settings.command_timeout_s;
    if timeout_s > 0.0 {
        anyhow!("{error}\n  the drive ends the move by itself: its command_timeout_s is {timeout_s} s")
    } else {
        anyhow!("{error}\n  the drive finishes the move and holds its target: its command_timeout_s is 0")
    }
}

impl Moved {
    /// For a person.
    pub fn to_text(&self) -> String {
        let origin = match self.simulated {
            true => "simulated (firmware on the virtual STM32H743)",
            false => "measured by the drive",
        };
        let jerk = self.jerk_m_per_s3.map_or(String::new(), |jerk| format!(", {jerk} m/s³"));
        let compensator = compensator_name(self.compensator);
        let caption = format!(
            "{origin} · from {} to {}, at most {} m/s, {} m/s²{jerk} · compensator {compensator} · one move",
            show_length(self.from_m),
            show_length(self.target_m),
            self.velocity_m_per_s,
            self.acceleration_m_per_s2
        );
        match &self.settling {
            Some(report) => report.to_text(&caption),
            None => format!("{caption}\n"),
        }
    }
}

/// The parameter `compensator` in words.
pub fn compensator_name(number: f64) -> String {
    match number as u32 {
        0 => "none (PID alone)".to_owned(),
        1 => "NIASA".to_owned(),
        number => format!("number {number}"),
    }
}
