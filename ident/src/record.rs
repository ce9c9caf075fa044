//! Measured friction: force over position, checked, and ready for a fit.

use crate::error::{DataError, within};
use crate::filter::{self, LowPass, median};
use crate::legs::{Leg, legs};

/// Fewest samples that are accepted.
pub const MIN_SAMPLES: usize = 100;
/// Range of moving masses, kg.
pub const MASS_RANGE_KG: [f64; 2] = [1e-3, 1e4];
/// Range of the size of force constants, N/A.
pub const FORCE_CONSTANT_RANGE_N_PER_A: [f64; 2] = [1e-3, 1e4];
/// Equal currents in a row, at the highest or the lowest value, that may be an amplifier at its limit.
const SATURATED_RUN: usize = 5;
/// Corner of the filter that measured force goes through, Hz: the friction of an identification profile has nothing above it that
/// matters, the second difference of the position's noise has.
const FORCE_CORNER_HZ: f64 = 300.0;

/// Friction force and position at equal intervals.
///
/// The force opposes positive motion: positive where the stage moves forwards.
#[derive(Clone, Debug, PartialEq)]
pub struct Record {
    /// Time between samples, s.
    pub sample_s: f64,
    /// Position against the first sample, m, without most of its noise.
    pub position_m: Vec<f64>,
    /// White noise of the measured position, m rms.
    pub position_noise_m: f64,
    /// Friction force, N.
    pub force_n: Vec<f64>,
    /// Parts of the record in which the stage moves in one direction.
    pub legs: Vec<Leg>,
    /// Way back that counts as a reversal, m.
    pub turn_m: f64,
    /// What the force has gone through; a model must go through it as well before the two are compared.
    pub low_pass: Option<LowPass>,
}

impl Record {
    /// From a measured friction force (positive against positive motion).
    ///
    /// # Errors
    /// Data that are not what they should be.
    pub fn from_force(time_s: &[f64], position_m: &[f64], force_n: &[f64]) -> Result<Record, DataError> {
        let sample_s = check(time_s, &[("position_m", position_m), ("force_n", force_n)])?;
        let mean_n = force_n.iter().sum::<f64>() / force_n.len() as f64;
        Record::build(sample_s, position_m, force_n.to_vec(), None, ("force_n", mean_n))
    }

    /// From the motor's current: `F_r = K_t i − m ẍ`, through a filter without phase.
    ///
    /// # Errors
    /// Data that are not what they should be; mass or force constant out of range.
    ///
    /// # Source
    /// Equation 4.3.
    pub fn from_current(
        time_s: &[f64],
        position_m: &[f64],
        current_a: &[f64],
        mass_kg: f64,
        force_constant_n_per_a: f64,
    ) -> Result<Record, DataError> {
        within("mass", mass_kg, MASS_RANGE_KG[0], MASS_RANGE_KG[1])?;
        let [least, greatest] = FORCE_CONSTANT_RANGE_N_PER_A;
        within("force-constant", force_constant_n_per_a.abs(), least, greatest)?;
        let sample_s = check(time_s, &[("position_m", position_m), ("current_a", current_a)])?;
        check_saturation(current_a)?;
        let low_pass = LowPass::new(FORCE_CORNER_HZ.min(0.2 / sample_s), sample_s);
        let acceleration_m_per_s2 = filter::second_derivative(position_m, sample_s);
        let raw_n: Vec<f64> = current_a
            .iter()
            .zip(&acceleration_m_per_s2)
            .map(|(i_a, a)| force_constant_n_per_a * i_a - mass_kg * a)
            .collect();
        let sign = ("force-constant", force_constant_n_per_a);
        Record::build(sample_s, position_m, low_pass.apply(&raw_n), Some(low_pass), sign)
    }

    fn build(
        sample_s: f64,
        position_m: &[f64],
        force_n: Vec<f64>,
        low_pass: Option<LowPass>,
        (sign_of, value): (&'static str, f64),
    ) -> Result<Record, DataError> {
        let relative_m: Vec<f64> = position_m.iter().map(|x| x - position_m[0]).collect();
        let smooth = filter::denoised(&relative_m, sample_s);
        let span_m = span(&relative_m);
        let least_m = (MOTION_NOISES * smooth.noise_before).max(MOTION_STEPS * smallest_step(&relative_m));
        if span_m <= least_m {
            return Err(DataError::NoMotion { span_m, noise_m: smooth.noise_before, least_m });
        }
        let turn_m = (TURN_NOISES * smooth.noise_rms).max(TURN_SHARE * span_m);
        let legs = legs(&smooth.signal, turn_m);
        if legs.len() < 2 {
            return Err(DataError::NoReversal);
        }
        let record = Record {
            sample_s,
            position_m: smooth.signal,
            position_noise_m: smooth.noise_before,
            force_n,
            legs,
            turn_m,
            low_pass,
        };
        let (work_j, size_j) = record.work();
        if record.is_cyclic() && work_j < -WRONG_SIGN_SHARE * size_j {
            return Err(DataError::WrongSign { field: sign_of, value, work_j });
        }
        Ok(record)
    }

    /// Number of samples.
    pub fn samples(&self) -> usize {
        self.position_m.len()
    }

    /// Highest minus lowest position, m.
    pub fn span_m(&self) -> f64 {
        span(&self.position_m)
    }

    /// Work against the force without its mean, J, and what it would be if the force, with its rms, always opposed the motion.
    fn work(&self) -> (f64, f64) {
        let n = self.samples() as f64;
        let mean_n = self.force_n.iter().sum::<f64>() / n;
        let rms_n = (self.force_n.iter().map(|f| (f - mean_n) * (f - mean_n)).sum::<f64>() / n).sqrt();
        let steps = self.position_m.windows(2).zip(self.force_n.windows(2));
        let work_j = steps.map(|(x, f)| (x[1] - x[0]) * (0.5 * (f[0] + f[1]) - mean_n)).sum();
        (work_j, rms_n * self.path_m())
    }

    /// Way there and back, m.
    fn path_m(&self) -> f64 {
        self.legs.iter().map(|leg| (self.position_m[leg.to] - self.position_m[leg.from]).abs()).sum()
    }

    /// Whether the motion ends near where it began: then a constant force has done no work that matters, and the work's sign is that of
    /// friction.
    fn is_cyclic(&self) -> bool {
        let net_m = self.position_m.last().map_or(0.0, |x| (x - self.position_m[0]).abs());
        net_m < CYCLIC_SHARE * self.path_m()
    }

    /// A model's force as the measured force would show it.
    pub(crate) fn seen(&self, force_n: Vec<f64>) -> Vec<f64> {
        match &self.low_pass {
            Some(low_pass) => low_pass.apply(&force_n),
            None => force_n,
        }
    }
}

/// Span of the position that counts as motion, in rms of its noise: white noise alone reaches eight in ten thousand samples.
const MOTION_NOISES: f64 = 12.0;
/// The same in steps of its resolution.
const MOTION_STEPS: f64 = 12.0;
/// Way back that counts as a reversal, in rms of the noise that is left in the position.
const TURN_NOISES: f64 = 3.0;
/// The same as a share of the span.
const TURN_SHARE: f64 = 1e-4;
/// Distance of end and beginning, as a share of the way, up to which a motion is cyclic.
const CYCLIC_SHARE: f64 = 0.2;
/// Work below 0 that shows a wrong sign, as a share of the greatest possible.
const WRONG_SIGN_SHARE: f64 = 0.05;

/// Checks columns: length, number, finite values, time.
///
/// Returns the sample time, s.
///
/// # Errors
/// The first wrong thing found.
pub fn check(time_s: &[f64], columns: &[(&'static str, &[f64])]) -> Result<f64, DataError> {
    for (field, column) in columns {
        if column.len() != time_s.len() {
            return Err(DataError::Length { field, found: column.len(), expected: time_s.len() });
        }
    }
    if time_s.len() < MIN_SAMPLES {
        return Err(DataError::TooFewSamples { found: time_s.len(), least: MIN_SAMPLES });
    }
    let wrong = |(field, column): &(&'static str, &[f64])| {
        let sample = column.iter().position(|value| !value.is_finite())?;
        Some(DataError::NotFinite { field, sample, value: column[sample] })
    };
    if let Some(error) = [("time_s", time_s)].iter().chain(columns).find_map(wrong) {
        return Err(error);
    }
    let steps_s: Vec<f64> = time_s.windows(2).map(|t| t[1] - t[0]).collect();
    if let Some(i) = steps_s.iter().position(|step_s| *step_s <= 0.0) {
        return Err(DataError::TimeBackwards { sample: i + 1, time_s: time_s[i + 1], before_s: time_s[i] });
    }
    let usual_s = median(steps_s.clone());
    if let Some(i) = steps_s.iter().position(|step_s| *step_s > 1.5 * usual_s) {
        return Err(DataError::Gap { sample: i + 1, time_s: time_s[i + 1], step_s: steps_s[i], usual_s });
    }
    Ok((time_s[time_s.len() - 1] - time_s[0]) / steps_s.len() as f64)
}

/// Looks for an amplifier at its limit: equal currents in a row, at the highest or the lowest value, that the current reaches in a
/// corner. The top of a smooth current that is only coarsely resolved is reached without one.
pub(crate) fn check_saturation(current_a: &[f64]) -> Result<(), DataError> {
    let step_a = smallest_step(current_a);
    let bend_a = median(current_a.windows(3).map(|w| (w[2] - 2.0 * w[1] + w[0]).abs()).collect());
    for extreme in [f64::min, f64::max] {
        let value_a = current_a.iter().copied().fold(current_a[0], extreme);
        let runs = current_a.chunk_by(|a, b| a == b);
        let mut sample = 0;
        for run in runs {
            let corner = |inside: usize, before: Option<usize>| {
                let before = before.and_then(|i| current_a.get(i));
                before.is_some_and(|outside| (current_a[inside] - outside).abs() > 8.0 * bend_a + 2.0 * step_a)
            };
            let end = sample + run.len();
            let long = run.len() >= SATURATED_RUN && run[0] == value_a;
            if long
                && (corner(sample, sample.checked_sub(2)) || corner(end - 1, Some(end + 1)) || bend_a > 4.0 * step_a)
            {
                return Err(DataError::Saturated { sample, value_a, samples: run.len() });
            }
            sample = end;
        }
    }
    Ok(())
}

fn span(values: &[f64]) -> f64 {
    let low = values.iter().copied().fold(f64::INFINITY, f64::min);
    values.iter().copied().fold(f64::NEG_INFINITY, f64::max) - low
}

/// The smallest difference of neighbours that is not 0: the resolution, if the values have one; 0 of equal values.
fn smallest_step(values: &[f64]) -> f64 {
    let steps = values.windows(2).map(|w| (w[1] - w[0]).abs()).filter(|step| *step > 0.0);
    let least = steps.fold(f64::INFINITY, f64::min);
    if least.is_finite() { least } else { 0.0 }
}
