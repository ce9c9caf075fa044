//! Dahl's model fitted by a search in one dimension.

use serde::Serialize;

use crate::confidence::{self, Interval};
use crate::error::{DataError, within};
use crate::filter;
use crate::legs::legs;
use crate::linear::{Normal, minimum};
use crate::record::Record;

/// Coarse steps of the search.
const COARSE: usize = 28;
/// The search for x_c begins at this share of the span of the motion,
const SHORTEST_SHARE: f64 = 5e-4;
/// and ends at this one.
const LONGEST_SHARE: f64 = 3.0;
/// Relative tolerance on ln x_c: 2e-6 of x_c.
const TOLERANCE: f64 = 1e-7;
/// Shares of the span that [`fit_any_memory`] tries.
const INNER_SHARES: [f64; 3] = [0.0, 0.01, 0.04];
/// Largest error of the time between current and position, in samples: the current is read in one of five PWM periods.
const TIME_DOUBT: f64 = 0.2;
/// F_C must be at least so many of its standard errors.
const SIGNIFICANT: f64 = 4.0;

/// Dahl's model (shape factor 1) as it fits a record best.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct DahlFit {
    /// Initial contact stiffness σ, N/m: slope of the force where it crosses 0.
    pub sigma_n_per_m: f64,
    /// Level of Coulomb friction F_C, N.
    pub coulomb_n: f64,
    /// Intervals that contain the true value in 95 of 100 records.
    pub ci95: DahlIntervals,
    /// Mean square of what the model leaves, N².
    pub mse_n2: f64,
    /// Number of samples.
    pub samples: usize,
    /// Friction force at the first sample, N.
    pub initial_n: f64,
    /// Constant force beside friction, N: an offset of the current, a slope of the ground.
    pub offset_n: f64,
}

/// 95 % confidence intervals.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct DahlIntervals {
    /// Of σ, N/m.
    pub sigma_n_per_m: Interval,
    /// Of F_C, N.
    pub coulomb_n: Interval,
}

impl DahlFit {
    /// The model's force at every sample of the record, offset included, as measured force would show it, N.
    pub fn force_n(&self, record: &Record) -> Vec<f64> {
        record.seen(self.friction_n(record)).iter().map(|friction_n| friction_n + self.offset_n).collect()
    }

    /// The model's friction at every sample of the record, N.
    pub fn friction_n(&self, record: &Record) -> Vec<f64> {
        let [coulomb, initial] = responses(record, self.coulomb_n / self.sigma_n_per_m);
        coulomb.iter().zip(&initial).map(|(c, i)| self.coulomb_n * c + self.initial_n * i).collect()
    }
}

/// What is known beforehand, and what counts.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Assumptions {
    /// There is no constant force beside friction: the current's offset has been measured, the axis is level. Needed where the motion
    /// reverses only once or twice, as in settling: an offset cannot be told from F_C there.
    pub no_offset: bool,
    /// Swings smaller than this share of the span (0 to 0.5) are part of the larger motion around them. Parallel elements, whose memory
    /// is not local, close such loops and go on as if they had not been; Dahl's model would not.
    pub inner_share: f64,
}

/// Fits σ, F_C, the initial force and an offset.
///
/// With `x_c = F_C/σ` fixed the model is linear in the other three, so that a search in x_c alone, coarse and then by golden
/// sections, finds the least squares. Within a leg (motion in one direction from `x_t`) the solution of Dahl's equation is
/// exact, `F = ±F_C + (F_t ∓ F_C) e^(−|x − x_t|/x_c)`, and noise within a leg does not wear the force down as it does in a step
/// by step integration. The intervals allow for residuals that are correlated ([`confidence`]).
///
/// # Errors
/// [`DataError::Undetermined`] if the motion is too small or too large to show both σ and F_C, or the force is not friction.
///
/// # Source
/// Equation 5.3 (corrected: `1 − F/F_C · sgn ẋ`) with i = 1, section 5.5; the offset is what appendix B centres away.
pub fn fit(record: &Record) -> Result<DahlFit, DataError> {
    fit_assuming(record, Assumptions::default())
}

/// [`fit`] with assumptions.
///
/// # Errors
/// As for [`fit`]; `inner_share` out of range; [`DataError::NoReversal`] if no swing is larger.
pub fn fit_assuming(record: &Record, assumptions: Assumptions) -> Result<DahlFit, DataError> {
    let Assumptions { no_offset, inner_share } = assumptions;
    within("inner_share", inner_share, 0.0, 0.5)?;
    if inner_share == 0.0 {
        return search(record, no_offset);
    }
    let legs = legs(&record.position_m, inner_share * record.span_m());
    if legs.len() < 2 {
        return Err(DataError::NoReversal);
    }
    search(&Record { legs, turn_m: inner_share * record.span_m(), ..record.clone() }, no_offset)
}

/// [`fit_assuming`] with each of some shares of inner swings, and of these the fit that leaves least: whether a stage's memory is
/// local, as in Dahl's model, or closes inner loops, as parallel elements do, shows in the data.
///
/// # Errors
/// That of the fit without inner swings, if none succeeds.
pub fn fit_any_memory(record: &Record, no_offset: bool) -> Result<DahlFit, DataError> {
    let fits = INNER_SHARES.map(|inner_share| fit_assuming(record, Assumptions { no_offset, inner_share }));
    let best = fits.iter().flatten().min_by(|a, b| a.mse_n2.total_cmp(&b.mse_n2)).cloned();
    let [local, ..] = fits;
    best.map_or(local, Ok)
}

/// The search, see [`fit`].
fn search(record: &Record, no_offset: bool) -> Result<DahlFit, DataError> {
    let ones = vec![1.0; if no_offset { 0 } else { record.samples() }];
    let linear = |log_m: f64| {
        let [coulomb, initial] = seen_responses(record, libm::exp(log_m));
        let mut columns: Vec<&[f64]> = vec![&coulomb, &initial];
        columns.extend((!no_offset).then_some(&ones[..]));
        let normal = Normal::new(&columns, &record.force_n);
        let solution = normal.solve()?;
        Some((normal.left(&solution), solution))
    };
    let left = |log_m: f64| linear(log_m).map_or(f64::INFINITY, |(left, _)| left);

    let span_m = record.span_m();
    let (low, high) = (libm::log(SHORTEST_SHARE * span_m), libm::log(LONGEST_SHARE * span_m));
    let at = |i: usize| low + (high - low) * i as f64 / COARSE as f64;
    let coarse: Vec<f64> = (0..=COARSE).map(|i| left(at(i))).collect();
    let best = (0..=COARSE).min_by(|i, j| coarse[*i].total_cmp(&coarse[*j])).unwrap_or(0);
    if best == 0 || best == COARSE {
        let side = if best == 0 { "short: a sample steps over the transition" } else { "long: nothing slides" };
        let why = format!(
            "x_c = F_C/sigma is too {side} at {:e} m, with a motion of {span_m:e} m; {SHORTEST_SHARE:e} to {LONGEST_SHARE} of \
             the motion can be fitted",
            libm::exp(at(best))
        );
        return Err(DataError::Undetermined { what: "sigma_n_per_m", why });
    }
    let log_m = minimum(at(best - 1), at(best + 1), TOLERANCE, left);
    let undetermined = |why: String| DataError::Undetermined { what: "coulomb_n", why };
    let Some((_, solution)) = linear(log_m) else {
        return Err(undetermined("its effect is that of an offset".to_owned()));
    };
    let (coulomb_n, initial_n) = (solution[0], solution[1]);
    let offset_n = solution.get(2).copied().unwrap_or(0.0);
    let length_m = libm::exp(log_m);
    let mut fit = DahlFit {
        sigma_n_per_m: coulomb_n / length_m,
        coulomb_n,
        ci95: DahlIntervals { sigma_n_per_m: Interval::NONE, coulomb_n: Interval::NONE },
        mse_n2: 0.0,
        samples: record.samples(),
        initial_n,
        offset_n,
    };
    let model_n = fit.force_n(record);
    let left_n: Vec<f64> = record.force_n.iter().zip(&model_n).map(|(f, m)| f - m).collect();
    fit.mse_n2 = left_n.iter().map(|r| r * r).sum::<f64>() / fit.samples as f64;
    let Some(errors) = standard_errors(record, &fit, &ones, &left_n) else {
        return Err(undetermined("its effect is that of the other parameters".to_owned()));
    };
    let [coulomb_se_n, log_sigma_se] = errors.standard;
    if coulomb_n < SIGNIFICANT * coulomb_se_n {
        return Err(undetermined(format!("{coulomb_n} N with a standard error of {coulomb_se_n} N is not above 0")));
    }
    let reach = libm::exp(errors.quantile * log_sigma_se);
    fit.ci95.sigma_n_per_m = Interval([fit.sigma_n_per_m / reach, fit.sigma_n_per_m * reach]);
    fit.ci95.coulomb_n =
        Interval([coulomb_n - errors.quantile * coulomb_se_n, coulomb_n + errors.quantile * coulomb_se_n]);
    Ok(fit)
}

/// Standard errors of F_C and of ln σ; `ones` is empty without offset.
fn standard_errors(record: &Record, fit: &DahlFit, ones: &[f64], left_n: &[f64]) -> Option<Errors> {
    const STEP: f64 = 1e-4;
    let length_m = fit.coulomb_n / fit.sigma_n_per_m;
    let [coulomb, initial] = seen_responses(record, length_m);
    let [longer, shorter] = [1.0 + STEP, 1.0 - STEP].map(|factor| seen_responses(record, length_m * factor));
    // With respect to ln x_c.
    let slope: Vec<f64> = (0..left_n.len())
        .map(|i| {
            let (dc, di) = (longer[0][i] - shorter[0][i], longer[1][i] - shorter[1][i]);
            (fit.coulomb_n * dc + fit.initial_n * di) / (2.0 * STEP)
        })
        .collect();
    let mut columns: Vec<&[f64]> = vec![&coulomb, &slope, &initial];
    columns.extend((!ones.is_empty()).then_some(ones));
    let covariance = confidence::covariance_of_legs(&columns, left_n, record)?;
    let (n, c) = (columns.len(), &covariance.matrix);
    // ln σ = ln F_C − ln x_c.
    let per_n = 1.0 / fit.coulomb_n;
    let log_sigma = c[0] * per_n * per_n - 2.0 * c[1] * per_n + c[n + 1];
    let (mut coulomb_n2, mut log_sigma2) = (c[0].max(0.0), log_sigma.max(0.0));
    for doubt_n in doubts(record, fit) {
        let change = Normal::new(&columns, &doubt_n).solve()?;
        // Bounds of a rectangular distribution: a third of their square is its variance.
        coulomb_n2 += change[0] * change[0] / 3.0;
        let log_change = change[0] * per_n - change[1];
        log_sigma2 += log_change * log_change / 3.0;
    }
    Some(Errors { standard: [coulomb_n2.sqrt(), log_sigma2.sqrt()], quantile: covariance.quantile })
}

/// By how much the model's force would differ, N, if turning points were resolved half as finely, and if the current had been read at
/// another time: errors that are the same in all legs, so that the residuals do not tell them.
fn doubts(record: &Record, fit: &DahlFit) -> Vec<Vec<f64>> {
    let model_n = fit.force_n(record);
    let coarse = legs(&record.position_m, 2.0 * record.turn_m);
    let coarse_n = fit.force_n(&Record { legs: coarse, ..record.clone() });
    let mut doubts = vec![coarse_n.iter().zip(&model_n).map(|(a, b)| a - b).collect()];
    if record.low_pass.is_some() {
        let late_n = filter::derivative(&model_n, record.sample_s);
        doubts.push(late_n.iter().map(|n_per_s| TIME_DOUBT * record.sample_s * n_per_s).collect());
    }
    doubts
}

/// Standard errors of F_C (N) and of ln σ, and the factor that makes 95 % intervals of them.
struct Errors {
    standard: [f64; 2],
    quantile: f64,
}

/// [`responses`] as measured force would show them.
fn seen_responses(record: &Record, length_m: f64) -> [Vec<f64>; 2] {
    responses(record, length_m).map(|response| record.seen(response))
}

/// What F_C = 1 N without initial force, and an initial force of 1 N without F_C, give along the record's motion.
fn responses(record: &Record, length_m: f64) -> [Vec<f64>; 2] {
    let x = &record.position_m;
    let mut coulomb = vec![0.0; x.len()];
    let mut initial = vec![1.0; x.len()];
    let per_m = 1.0 / length_m;
    for leg in &record.legs {
        let goal = if leg.forward { 1.0 } else { -1.0 };
        let (turn_m, from_coulomb, from_initial) = (x[leg.from], coulomb[leg.from], initial[leg.from]);
        for i in leg.from + 1..=leg.to {
            let left = libm::exp(-goal * (x[i] - turn_m) * per_m);
            coulomb[i] = goal + (from_coulomb - goal) * left;
            initial[i] = from_initial * left;
        }
    }
    [coulomb, initial]
}
