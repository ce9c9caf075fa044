//! The length scale of pre-rolling friction, from the spacing of extremes in a step response.

use serde::Serialize;

use crate::error::{DataError, within};
use crate::filter;
use crate::legs::legs;
use crate::record::check;

/// Spacing of extremes, against the linear loop's, from which on friction rules. A tunable parameter, says the thesis.
pub const USUAL_FACTOR: f64 = 1.5;
/// Way back that makes an extreme, in rms of the noise left.
const TURN_NOISES: f64 = 8.0;

/// An extreme of a step response.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Extreme {
    /// Time, s.
    pub time_s: f64,
    /// Distance from the target, m.
    pub error_m: f64,
}

/// Where a linear loop stops to describe the settling.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct LengthScale {
    /// Distance from the target of the extreme from which the stage takes too long to the next, m.
    pub length_m: f64,
    /// Distance of the extreme before, the last one that the next followed in time, m.
    pub linear_from_m: f64,
    /// Time between extremes of the linear loop, s.
    pub expected_s: f64,
    /// Time to the first late extreme, s.
    pub late_s: f64,
    /// All extremes.
    pub extremes: Vec<Extreme>,
}

/// Finds the length scale in a step response: the first pair of extremes that are more than `factor` times `expected_s` (the
/// linear loop's, [`crate::frf::SecondOrder::half_period_s`]) apart.
///
/// # Errors
/// Data that are not what they should be; `factor` or `expected_s` out of range; [`DataError::Undetermined`] if extremes are missing
/// or none is late.
///
/// # Source
/// Section 5.3; its worked example is 8 ms expected, 23 ms from −637 nm to 115 nm: about 600 nm.
pub fn find(
    time_s: &[f64],
    position_m: &[f64],
    target_m: f64,
    expected_s: f64,
    factor: f64,
) -> Result<LengthScale, DataError> {
    let sample_s = check(time_s, &[("position_m", position_m)])?;
    within("target", target_m, f64::MIN, f64::MAX)?;
    within("expected", expected_s, 2.0 * sample_s, 1e3)?;
    within("factor", factor, 1.05, 10.0)?;
    let error_m: Vec<f64> = position_m.iter().map(|x| x - target_m).collect();
    let smooth = filter::denoised(&error_m, sample_s);
    let turns = legs(&smooth.signal, TURN_NOISES * smooth.noise_rms);
    let extremes: Vec<Extreme> = turns
        .iter()
        .skip(1)
        .map(|leg| Extreme { time_s: time_s[leg.from], error_m: smooth.signal[leg.from] })
        .collect();
    let undetermined = |why: String| DataError::Undetermined { what: "length_m", why };
    if extremes.len() < 3 {
        return Err(undetermined(format!(
            "{} extremes; 3 or more are needed, with a step that overshoots",
            extremes.len()
        )));
    }
    let late = (1..extremes.len()).find(|i| extremes[*i].time_s - extremes[i - 1].time_s > factor * expected_s);
    let Some(late) = late else {
        return Err(undetermined(format!(
            "all {} extremes follow within {factor} times the linear loop's {expected_s} s",
            extremes.len()
        )));
    };
    if late == 1 {
        return Err(undetermined(
            "the second extreme is late already: the step is too small, or the linear loop is not that".to_owned(),
        ));
    }
    Ok(LengthScale {
        length_m: extremes[late - 1].error_m.abs(),
        linear_from_m: extremes[late - 2].error_m.abs(),
        expected_s,
        late_s: extremes[late].time_s - extremes[late - 1].time_s,
        extremes,
    })
}
