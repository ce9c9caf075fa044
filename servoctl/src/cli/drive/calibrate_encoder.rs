//! `servoctl calibrate-encoder`.

use std::process::ExitCode;
use std::sync::atomic::Ordering;

use anyhow::Result;
use serde::Serialize;
use servo_core::encoder::sincos::Signals;
use servo_core::parameters::Settings;
use servo_core::profile::Limits;
use servo_protocol::message::Request;

use super::super::interrupt;
use super::identity::Options;
use super::{Link, motion};
use crate::link::Drive;
use crate::link::units::{show_error, show_length};

/// Length of the calibrating move, m: 25 periods of 4 µm.
const DISTANCE_M: f64 = 0.1e-3;
/// Its speed, m/s: every tick shows another part of the period.
const VELOCITY_M_PER_S: f64 = 0.97e-3;
/// Its acceleration, m/s².
const ACCELERATION_M_PER_S2: f64 = 0.1;

/// What was found, for a program.
#[derive(Debug, Serialize)]
struct Calibrated {
    sincos_amplitude: f64,
    sincos_cos_offset: f64,
    sincos_sin_offset: f64,
    sincos_gain: f64,
    sincos_phase_rad: f64,
    /// Estimated sub-divisional error, peak, m; `null` where the move was too short for an estimate.
    error_before_m: Option<f32>,
    error_after_m: Option<f32>,
}

/// Moves to and fro and corrects sine and cosine by what was seen, then moves once more to see what is left; Ctrl-C brakes.
///
/// # Errors
/// Another kind of encoder, a refusal, a fault on the way; those of the link.
pub fn run(link: &Link, options: &Options) -> Result<ExitCode> {
    let interrupted = interrupt::flag_saying("braking; Ctrl-C again leaves the drive to itself")?;
    let go_on = || !interrupted.load(Ordering::Relaxed);
    let mut connected = link.connect()?;
    let settings = connected.drive.parameters()?;
    // Whether there are signals at all, the drive says before anything moves.
    connected.drive.order(&Request::CollectSignals)?;
    motion::enable_if_virtual(&mut connected)?;
    let drive = &mut connected.drive;
    drive.order(&Request::CollectSignals)?;
    let Some(error_before_m) = sweep(drive, &settings, go_on)? else { return Ok(stopped()) };
    drive.order(&Request::CorrectSignals)?;
    let Some(error_after_m) = sweep(drive, &settings, go_on)? else { return Ok(stopped()) };
    let Signals { amplitude, cos_offset, sin_offset, gain, phase_rad } = drive.parameters()?.signals();
    let found = Calibrated {
        sincos_amplitude: amplitude,
        sincos_cos_offset: cos_offset,
        sincos_sin_offset: sin_offset,
        sincos_gain: gain,
        sincos_phase_rad: phase_rad,
        error_before_m,
        error_after_m,
    };
    options.json.write(&found, || found.to_text())?;
    Ok(ExitCode::SUCCESS)
}

fn stopped() -> ExitCode {
    ExitCode::from(interrupt::INTERRUPTED)
}

/// Moves away and back; the estimated error at the end, or nothing if it was interrupted and has braked.
fn sweep(drive: &mut Drive, settings: &Settings, go_on: impl Fn() -> bool) -> Result<Option<Option<f32>>> {
    let count_m = settings.encoder_count_m;
    let status = drive.status()?;
    let from_ct = status.position_ct + i64::from(status.error_ct);
    let up_m = from_ct as f64 * count_m + DISTANCE_M;
    let distance_m = if up_m <= settings.travel_max_m { DISTANCE_M } else { -DISTANCE_M };
    let limits = Limits {
        velocity_m_per_s: VELOCITY_M_PER_S.min(settings.velocity_max_m_per_s) as f32,
        acceleration_m_per_s2: ACCELERATION_M_PER_S2.min(settings.acceleration_max_m_per_s2) as f32,
        jerk_m_per_s3: None,
    };
    for target_ct in [from_ct + (distance_m / count_m) as i64, from_ct] {
        drive.order(&Request::Move { target_ct, limits })?;
        eprintln!("moving to {}", show_length(target_ct as f64 * count_m));
        drive.wait_until("calibrating", u32::MAX / 2, |_| go_on(), |status| !status.moving)?;
        if !go_on() {
            drive.order(&Request::Stop)?;
            drive.wait_until("braking", u32::MAX / 2, |_| true, |status| !status.moving)?;
            return Ok(None);
        }
    }
    Ok(Some(drive.status()?.subdivisional_error_m))
}

impl Calibrated {
    fn to_text(&self) -> String {
        let shown = |error_m: Option<f32>| error_m.map_or("not estimated".to_owned(), show_error);
        format!(
            "amplitude   {:.4} of half the converters' range\n\
             offset      cosine {:+.3} %, sine {:+.3} % of it\n\
             gain        {:.5} (sine / cosine)\n\
             phase       {:+.3}°\n\
             error       {} before, {} after (sub-divisional, peak, estimated)\n\
             in use from now on; `servoctl disable` and `servoctl params save` keep it\n",
            self.sincos_amplitude,
            100.0 * self.sincos_cos_offset,
            100.0 * self.sincos_sin_offset,
            self.sincos_gain,
            self.sincos_phase_rad.to_degrees(),
            shown(self.error_before_m),
            shown(self.error_after_m),
        )
    }
}
