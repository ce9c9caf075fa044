//! Moves with and without NIASA.

use serde::{Deserialize, Serialize};
use servo_core::config::Compensator;
use servo_core::profile::Limits;

use super::link::{Order, Session};
use super::loops::SAMPLE_S;
use super::{Failure, Found, fit};

/// Settling tolerance, ± nm.
pub const TOLERANCE_NM: f64 = 10.0;
/// Least gain of NIASA that is accepted: settling time less than without, as a share.
pub const LEAST_GAIN: f64 = 0.6;
/// Moves of each kind: five up and five back.
const MOVES: u32 = 10;
/// Their length, m, and acceleration, m/s² (9.1).
const MOVE_M: f64 = 5e-3;
const MOVE_M_PER_S2: f32 = 1.0;
/// Time after each without NIASA and with it, s. A move that settles later counts with it: without NIASA too little, so that the gain is
/// stated too small; with NIASA the step refuses.
const DWELL_S: [f64; 2] = [1.0, 0.5];
/// One tick of so many is looked at.
const EVERY: u32 = 2;
/// The end of the dwell in which the stage has to be at rest, s, and its error there, m rms.
const REST_S: f64 = 0.1;
const REST_M: f64 = 5e-9;

/// Settling of the moves of one kind.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Settled {
    /// Time from the end of the profile to the last sample outside the tolerance, each move (ms); the dwell if it never stayed inside.
    pub settling_ms: Vec<f64>,
    /// Moves that had not settled at the end of the dwell.
    pub unsettled: u32,
    /// Mean of the times (ms).
    pub mean_ms: f64,
    /// Error in the end of the dwell, all moves (nm rms).
    pub rest_rms_nm: f64,
    /// Error of the first move (nm), a value per millisecond.
    pub trace_nm: Vec<f64>,
}

/// Makes the moves without and with NIASA; NIASA stays on if it is good enough.
pub fn verification(session: &mut Session, found: &mut Found) -> Result<String, Failure> {
    if found.niasa.is_none() {
        return Err(Failure::Missing("what NIASA is to have"));
    }
    let without = moves(session, Compensator::None, DWELL_S[0], 0)?;
    let with = moves(session, Compensator::Niasa, DWELL_S[1], MOVES)?;
    found.settled = Some([without.clone(), with.clone()]);
    let gain = 1.0 - with.mean_ms / without.mean_ms;
    fit("moves unsettled with NIASA", f64::from(with.unsettled), 0.0, 0.0, "NIASA does not settle")?;
    fit("rest with NIASA / m rms", with.rest_rms_nm * 1e-9, 0.0, REST_M, "the axis is not at rest")?;
    fit("settling time less with NIASA", gain, LEAST_GAIN, 1.0, "NIASA gains too little")?;
    let settings =
        servo_core::parameters::Settings { compensator: f64::from(Compensator::Niasa as u8), ..session.settings };
    session.configure(settings)?;
    Ok(format!(
        "to ±{TOLERANCE_NM} nm in {:.0} ms without and {:.0} ms with NIASA: {:.0} % less; at rest {:.2} and {:.2} nm rms",
        without.mean_ms,
        with.mean_ms,
        100.0 * gain,
        without.rest_rms_nm,
        with.rest_rms_nm
    ))
}

/// The moves with `compensator`; `before` others have been made.
fn moves(session: &mut Session, compensator: Compensator, dwell_s: f64, before: u32) -> Result<Settled, Failure> {
    session.enable()?;
    session.link.order(&Order::Compensator(compensator))?;
    let middle_m = 0.5 * (session.settings.travel_max_m + session.settings.travel_min_m);
    let limits = Limits { velocity_m_per_s: 0.2, acceleration_m_per_s2: MOVE_M_PER_S2, jerk_m_per_s3: None };
    let start_m = middle_m - 2.5 * MOVE_M;
    session.move_to(start_m, limits)?;
    session.wait(1.0)?;
    let mut settled =
        Settled { settling_ms: Vec::new(), unsettled: 0, mean_ms: 0.0, rest_rms_nm: 0.0, trace_nm: Vec::new() };
    let (mut square_m2, mut samples) = (0.0, 0usize);
    let sample_ms = f64::from(EVERY) * SAMPLE_S * 1e3;
    for index in 0..MOVES {
        let steps = if index < 5 { index + 1 } else { 9 - index };
        let order = Order::Move { target_m: start_m + f64::from(steps) * MOVE_M, limits };
        session.done((before + index) as usize, 2 * MOVES as usize);
        let [errors_ct] = session.signals(["error_ct"], &order, dwell_s, EVERY)?;
        let errors_m: Vec<f64> = errors_ct.iter().map(|ct| ct * session.settings.encoder_count_m).collect();
        let outside = errors_m.iter().rposition(|e| e.abs() > TOLERANCE_NM * 1e-9).map_or(0, |last| last + 1);
        let rest = &errors_m[errors_m.len() - (REST_S / SAMPLE_S / f64::from(EVERY)) as usize..];
        settled.unsettled += u32::from(outside > errors_m.len() - rest.len());
        settled.settling_ms.push(outside as f64 * sample_ms);
        square_m2 += rest.iter().map(|e| e * e).sum::<f64>();
        samples += rest.len();
        if index == 0 {
            settled.trace_nm = errors_m.iter().step_by((1.0 / sample_ms) as usize).map(|e| e * 1e9).collect();
        }
    }
    settled.mean_ms = settled.settling_ms.iter().sum::<f64>() / f64::from(MOVES);
    settled.rest_rms_nm = (square_m2 / samples as f64).sqrt() * 1e9;
    Ok(settled)
}
