//! The length scale of pre-rolling friction, from the spacing of extremes in a step response.

use serde::{Deserialize, Serialize};

use crate::error::{DataError, within};
use crate::filter;
use crate::legs::legs;
use crate::record::check;

/// Spacing of extremes, against the linear loop's, from which on friction rules. A tunable parameter, says the thesis.
pub const USUAL_FACTOR: f64 = 1.5;
/// Way back that makes an extreme, in rms of the noise: a loop at rest follows it, and wanders by several times as much.
const TURN_NOISES: f64 = 10.0;

/// An extreme of a step response.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Extreme {
    /// Time, s.
    pub time_s: f64,
    /// Distance from the target, m.
    pub error_m: f64,
}

/// Where a linear loop stops to describe the settling.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct LengthScale {
    /// Distance from the target of the last extreme that the linear loop predicts, m.
    pub length_m: f64,
    /// Distance of the extreme before, m: so far the settling was linear.
    pub linear_from_m: f64,
    /// Which extreme of the swing it is, from 0.
    pub at: usize,
    /// Time between extremes of the linear loop, s.
    pub expected_s: f64,
    /// Time to the next extreme, s; if none follows, to the target or the end of the data.
    pub leg_s: f64,
    /// How this leg is not the linear loop's.
    pub end: End,
}

/// The end of the first leg that is not the linear loop's.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum End {
    /// An extreme that comes too late or too early.
    Untimely,
    /// An extreme on the same side of the target: friction stopped the swing before it got there.
    Short,
    /// No extreme follows: the stage creeps to the target.
    Creeps,
}

/// The extremes of a step response, beginning with the first overshoot, and when it last comes within the noise of the target, s.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Swing {
    /// Extremes.
    pub extremes: Vec<Extreme>,
    /// When the rest begins; the end of the data if there is none.
    pub settled_s: f64,
}

impl Swing {
    /// Of a position over time, around its target.
    ///
    /// # Errors
    /// Data that are not what they should be.
    pub fn of(time_s: &[f64], position_m: &[f64], target_m: f64) -> Result<Swing, DataError> {
        let sample_s = check(time_s, &[("position_m", position_m)])?;
        within("target", target_m, f64::MIN, f64::MAX)?;
        let error_m: Vec<f64> = position_m.iter().map(|x| x - target_m).collect();
        let smooth = filter::denoised(&error_m, sample_s);
        let turn_m = TURN_NOISES * smooth.noise_before;
        let turns = legs(&smooth.signal, turn_m);
        let extreme = |at: usize| Extreme { time_s: time_s[at], error_m: smooth.signal[at] };
        let outside = smooth.signal.iter().rposition(|e| e.abs() > turn_m).unwrap_or(0);
        Ok(Swing { extremes: turns.iter().skip(1).map(|leg| extreme(leg.from)).collect(), settled_s: time_s[outside] })
    }

    /// Times from extreme to extreme, s.
    pub fn legs_s(&self) -> impl Iterator<Item = f64> {
        self.extremes.windows(2).map(|pair| pair[1].time_s - pair[0].time_s)
    }
}

/// Finds the length scale in a swing: its first leg, from one extreme to the next or from the last one to the target, that is not the linear
/// loop's. That swings to and fro across the target, from extreme to extreme in `expected_s`
/// ([`crate::frf::SecondOrder::half_period_s`]). Where friction rules, a leg takes `factor` times as long or that many times less (friction holds
/// the stage back, or throws it back), or ends on the side where it began.
///
/// # Errors
/// `factor` or `expected_s` out of range; [`DataError::Undetermined`] if the swing has no leg as the linear loop predicts it, or no other.
///
/// # Source
/// Section 5.3: the last extreme that the linear loop predicts, "in terms of magnitude and temporal location". Its worked example is 8 ms
/// expected, 23 ms from −637 nm to 115 nm: about 600 nm. It looks at the times alone; the side makes no difference there, but where the swing
/// ends short of the target it does: whether the stage then rings by a few nanometres, in the time of a linear leg, decides nothing.
pub fn find(swing: &Swing, expected_s: f64, factor: f64) -> Result<LengthScale, DataError> {
    let undetermined = |why: String| DataError::Undetermined { what: "length_m", why };
    within("factor", factor, 1.05, 10.0)?;
    if expected_s == f64::INFINITY {
        return Err(undetermined("the linear loop does not swing".to_owned()));
    }
    within("expected", expected_s, 1e-6, 1e3)?;
    let extremes = &swing.extremes;
    let Some(last) = extremes.last() else {
        return Err(undetermined("the step does not overshoot".to_owned()));
    };
    let legs_s: Vec<f64> = swing.legs_s().chain([swing.settled_s - last.time_s]).collect();
    let (least_s, most_s) = (expected_s / factor, expected_s * factor);
    let end = |i: usize| match extremes.get(i + 1) {
        // The target may be near.
        None => (legs_s[i] > most_s).then_some(End::Creeps),
        Some(next) if next.error_m * extremes[i].error_m > 0.0 => Some(End::Short),
        Some(_) => (!(least_s..=most_s).contains(&legs_s[i])).then_some(End::Untimely),
    };
    match (0..legs_s.len()).find_map(|i| Some((i, end(i)?))) {
        None => Err(undetermined(format!(
            "all {} legs take as long as those of the linear loop, {:.1} ms, up to a factor of {factor}",
            legs_s.len(),
            expected_s * 1e3
        ))),
        Some((0, end)) => Err(undetermined(format!(
            "the leg from the first extreme, {:.0} nm from the target, takes {:.1} ms{} already, and the linear loop's {:.1} ms: friction \
             rules from there on, or the step is too small",
            extremes[0].error_m * 1e9,
            legs_s[0] * 1e3,
            if end == End::Short { " and ends short of the target" } else { "" },
            expected_s * 1e3
        ))),
        Some((at, end)) => Ok(LengthScale {
            length_m: extremes[at].error_m.abs(),
            linear_from_m: extremes[at - 1].error_m.abs(),
            at,
            expected_s,
            leg_s: legs_s[at],
            end,
        }),
    }
}
