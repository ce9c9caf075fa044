//! What a frequency response says: margins, a second-order closed loop, mass and resonances.

pub use num_complex::Complex64;
use serde::{Deserialize, Serialize};

use crate::error::{DataError, within};
use crate::filter::median;
use crate::linear::Normal;

/// One frequency of a response.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Point {
    /// Frequency, Hz, above 0.
    pub frequency_hz: f64,
    /// Response.
    pub value: Complex64,
}

/// How far a loop is from instability.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Margins {
    /// Highest frequency at which the loop transmission falls through 1, Hz.
    pub crossover_hz: f64,
    /// How far the phase there is from ±180°, degrees: −90 to 180. Up to 90° a phase is lead, as that of a stage held by its friction;
    /// beyond, it is counted as lag that has passed −180°.
    pub phase_margin_deg: f64,
    /// Least distance to 0 dB where the phase falls through −180° above the crossover, dB; nothing if it does not in the measured range.
    pub gain_margin_db: Option<f64>,
    /// Largest measured `|1/(1 + L)|`.
    pub sensitivity_peak: f64,
    /// Where, Hz.
    pub sensitivity_peak_hz: f64,
}

/// Crossover, margins and sensitivity peak of a loop transmission `L`, by interpolation in logarithms of frequency and gain.
///
/// # Errors
/// Points that are not in order of frequency or not finite; [`DataError::Undetermined`] if the gain does not fall through 1.
pub fn margins(loop_transmission: &[Point]) -> Result<Margins, DataError> {
    check(loop_transmission)?;
    let phase_deg = unwrapped_deg(loop_transmission);
    let log_gain: Vec<f64> = loop_transmission.iter().map(|p| libm::log(p.value.norm())).collect();
    let pairs = || (1..loop_transmission.len()).map(|i| (i - 1, i));
    let between = |i: usize, j: usize, share: f64, of: &dyn Fn(usize) -> f64| of(i) + share * (of(j) - of(i));
    let log_hz = |i: usize| libm::log(loop_transmission[i].frequency_hz);
    let (i, j) = pairs().rfind(|(i, j)| log_gain[*i] >= 0.0 && log_gain[*j] < 0.0).ok_or_else(|| {
        let [first, last] =
            [loop_transmission.first(), loop_transmission.last()].map(|p| p.map_or(0.0, |p| p.frequency_hz));
        let why = format!("the gain does not fall through 1 between {first} and {last} Hz");
        DataError::Undetermined { what: "crossover_hz", why }
    })?;
    let share = log_gain[i] / (log_gain[i] - log_gain[j]);
    let crossover_hz = libm::exp(between(i, j, share, &log_hz));
    // Counted from the sheet in which the phase is −270° to 90°.
    let at_crossover_deg = between(i, j, share, &|k| phase_deg[k]);
    let sheet_deg = 360.0 * libm::floor((at_crossover_deg + 270.0) / 360.0);
    let phase_deg: Vec<f64> = phase_deg.iter().map(|deg| deg - sheet_deg).collect();
    let margin_db = pairs().skip(i).filter(|(i, j)| phase_deg[*i] > -180.0 && phase_deg[*j] <= -180.0).map(|(i, j)| {
        let share = (phase_deg[i] + 180.0) / (phase_deg[i] - phase_deg[j]);
        -20.0 / std::f64::consts::LN_10 * between(i, j, share, &|k| log_gain[k])
    });
    let sensitivity = |p: &Point| 1.0 / (p.value + 1.0).norm();
    let peak = loop_transmission.iter().max_by(|a, b| sensitivity(a).total_cmp(&sensitivity(b)));
    Ok(Margins {
        crossover_hz,
        phase_margin_deg: 180.0 - (at_crossover_deg - sheet_deg).abs(),
        gain_margin_db: margin_db.filter(|db| *db > 0.0).min_by(f64::total_cmp),
        sensitivity_peak: peak.map_or(0.0, sensitivity),
        sensitivity_peak_hz: peak.map_or(0.0, |p| p.frequency_hz),
    })
}

/// `T = L / (1 + L)`, the closed loop.
///
/// # Source
/// Equation 5.1.
pub fn closed_loop(loop_transmission: &[Point]) -> Vec<Point> {
    loop_transmission.iter().map(|p| Point { value: p.value / (p.value + 1.0), ..*p }).collect()
}

/// A closed loop as a mass on a spring and a damper.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct SecondOrder {
    /// Natural frequency ω_n/2π, Hz.
    pub natural_hz: f64,
    /// Damping ratio ζ.
    pub damping: f64,
    /// Root mean square of the difference of the responses, of the points that were used.
    pub rms: f64,
}

impl SecondOrder {
    /// Response at `frequency_hz`.
    pub fn at(&self, frequency_hz: f64) -> Complex64 {
        let relative = frequency_hz / self.natural_hz;
        1.0 / Complex64::new(1.0 - relative * relative, 2.0 * self.damping * relative)
    }

    /// Time between the extremes of its step response, s; infinite if it has none.
    pub fn half_period_s(&self) -> f64 {
        0.5 / (self.natural_hz * libm::sqrt((1.0 - self.damping * self.damping).max(0.0)))
    }
}

/// The second-order loop nearest to a closed loop.
///
/// Multiplied out, `ω_n² (T − 1) + 2ζω_n jω T = ω² T` is linear in both unknowns; dividing by the last solution's denominator and
/// repeating makes it least squares of the responses themselves. Points above twice the natural frequency do not count: there the
/// delay and the zeros of the true loop rule.
///
/// # Errors
/// As for [`margins`]; [`DataError::Undetermined`] if no stable loop fits.
///
/// # Source
/// Equation 5.2; Sanathanan and Koerner 1963.
pub fn second_order(closed_loop: &[Point]) -> Result<SecondOrder, DataError> {
    check(closed_loop)?;
    let undetermined =
        || DataError::Undetermined { what: "natural_hz", why: "no stable loop of second order fits".to_owned() };
    // The loop falls below the diagonal of the unit square at about its natural frequency.
    let start = closed_loop.iter().find(|p| p.value.re < 0.0).or(closed_loop.last()).ok_or_else(undetermined)?;
    let mut fit = SecondOrder { natural_hz: start.frequency_hz, damping: 0.5, rms: 0.0 };
    for _ in 0..30 {
        let used = closed_loop.iter().filter(|p| p.frequency_hz <= 2.0 * fit.natural_hz);
        let (mut square, mut rate, mut right) = (Vec::new(), Vec::new(), Vec::new());
        for p in used {
            // In units of the last natural frequency.
            let relative = p.frequency_hz / fit.natural_hz;
            let weight = fit.at(p.frequency_hz);
            let parts = [
                (p.value - 1.0) * weight,
                Complex64::I * relative * p.value * weight,
                relative * relative * p.value * weight,
            ];
            for part in [|c: Complex64| c.re, |c: Complex64| c.im] {
                square.push(part(parts[0]));
                rate.push(part(parts[1]));
                right.push(part(parts[2]));
            }
        }
        let solution = Normal::new(&[&square, &rate], &right).solve().ok_or_else(undetermined)?;
        if solution[0] <= 0.0 || solution[1] <= 0.0 {
            return Err(undetermined());
        }
        let factor = solution[0].sqrt();
        fit = SecondOrder { natural_hz: fit.natural_hz * factor, damping: 0.5 * solution[1] / factor, rms: 0.0 };
    }
    let used: Vec<&Point> = closed_loop.iter().filter(|p| p.frequency_hz <= 2.0 * fit.natural_hz).collect();
    let square: f64 = used.iter().map(|p| (p.value - fit.at(p.frequency_hz)).norm_sqr()).sum();
    Ok(SecondOrder { rms: (square / used.len().max(1) as f64).sqrt(), ..fit })
}

/// Mass of a plant from its response position over force, m/N, between two frequencies: `1/((2πf)² |P|)`, the median.
///
/// # Errors
/// As for [`margins`]; a band without points; [`DataError::Undetermined`] if the gain does not fall by 40 dB a decade there: a
/// spring, as friction is for small motions, or a resonance.
pub fn mass_kg(plant: &[Point], band_hz: [f64; 2]) -> Result<f64, DataError> {
    check(plant)?;
    let used: Vec<&Point> = plant.iter().filter(|p| (band_hz[0]..=band_hz[1]).contains(&p.frequency_hz)).collect();
    within("points of the band", used.len() as f64, 3.0, f64::INFINITY)?;
    let omega = |p: &Point| std::f64::consts::TAU * p.frequency_hz;
    let ones = vec![1.0; used.len()];
    let log_hz: Vec<f64> = used.iter().map(|p| libm::log(p.frequency_hz)).collect();
    let log_gain: Vec<f64> = used.iter().map(|p| libm::log(p.value.norm())).collect();
    let slope = Normal::new(&[&log_hz, &ones], &log_gain).solve().map_or(0.0, |line| line[0]);
    if !(-2.3..=-1.7).contains(&slope) {
        let why = format!(
            "from {} to {} Hz the gain changes by {:.1} dB a decade, a mass would give -40 dB",
            band_hz[0],
            band_hz[1],
            20.0 * slope
        );
        return Err(DataError::Undetermined { what: "mass_kg", why });
    }
    Ok(median(used.iter().map(|p| 1.0 / (omega(p) * omega(p) * p.value.norm())).collect()))
}

/// A peak of a plant's response above its mass.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Resonance {
    /// Frequency, Hz.
    pub frequency_hz: f64,
    /// Height over the lower of the valleys beside it, dB.
    pub prominence_db: f64,
}

/// The resonances of a plant's response position over force: peaks of the acceleration over force, `(2πf)² |P|`, that stand out by
/// `prominence_db` or more on both sides (or up to the end of the range).
///
/// # Errors
/// As for [`margins`].
pub fn resonances(plant: &[Point], prominence_db: f64) -> Result<Vec<Resonance>, DataError> {
    check(plant)?;
    let db: Vec<f64> =
        plant.iter().map(|p| 20.0 * libm::log10(p.frequency_hz * p.frequency_hz * p.value.norm())).collect();
    let peaks = (1..db.len().saturating_sub(1)).filter(|i| db[*i] >= db[i - 1] && db[*i] > db[i + 1]);
    let valley = |values: &mut dyn Iterator<Item = &f64>, top: f64| {
        values.take_while(|v| **v <= top).copied().fold(top, f64::min)
    };
    let found = peaks.map(|i| {
        let left = valley(&mut db[..i].iter().rev(), db[i]);
        let right = valley(&mut db[i + 1..].iter(), db[i]);
        Resonance { frequency_hz: plant[i].frequency_hz, prominence_db: db[i] - left.max(right) }
    });
    Ok(found.filter(|resonance| resonance.prominence_db >= prominence_db).collect())
}

fn check(points: &[Point]) -> Result<(), DataError> {
    for (sample, p) in points.iter().enumerate() {
        for (field, value) in [("frequency_hz", p.frequency_hz), ("re", p.value.re), ("im", p.value.im)] {
            if !value.is_finite() {
                return Err(DataError::NotFinite { field, sample, value });
            }
        }
    }
    if points.len() < 3 {
        return Err(DataError::TooFewSamples { found: points.len(), least: 3 });
    }
    let mut before_hz = 0.0;
    for p in points {
        if p.frequency_hz <= before_hz {
            return Err(DataError::OutOfRange {
                field: "frequency_hz",
                value: p.frequency_hz,
                min: before_hz,
                max: f64::INFINITY,
            });
        }
        before_hz = p.frequency_hz;
    }
    Ok(())
}

/// Phases without jumps, degrees; the first within −360..0.
fn unwrapped_deg(points: &[Point]) -> Vec<f64> {
    let mut before_deg = -180.0;
    points
        .iter()
        .map(|p| {
            let deg = p.value.arg().to_degrees();
            before_deg = deg - 360.0 * libm::round((deg - before_deg) / 360.0);
            before_deg
        })
        .collect()
}
