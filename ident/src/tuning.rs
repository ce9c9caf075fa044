//! From a measured plant to the parameters of the drive.

use std::f64::consts::PI;

use num_complex::Complex64;
use serde::{Deserialize, Serialize};

use crate::error::{DataError, within};
use crate::frf::{self, Margins, Point};

/// Least gain margin of a loop that is accepted, dB.
pub const GAIN_MARGIN_DB: f64 = 6.0;
/// Least phase margin of a loop that is accepted, degrees.
pub const PHASE_MARGIN_DEG: f64 = 30.0;
/// Largest sensitivity peak of a loop that is accepted where its gain stays below 1: what both margins together imply.
pub const SENSITIVITY_PEAK: f64 = 2.0;

/// What a position loop is to be.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Wish {
    /// Crossover frequency, Hz, within the measured range.
    pub crossover_hz: f64,
    /// Phase margin there, degrees, 10 to 80.
    pub phase_margin_deg: f64,
    /// Integral gain as a share of the largest that a cascade has, `k_P²/(4 k_D)`: 0 to 1.
    pub integral_share: f64,
}

/// The thesis' standard tuning, 100 Hz and 45° (9.1).
pub const STANDARD: Wish = Wish { crossover_hz: 100.0, phase_margin_deg: 45.0, integral_share: 0.3 };
/// The thesis' high-performance tuning, 315 Hz and 50° (9.2).
pub const HIGH_PERFORMANCE: Wish = Wish { crossover_hz: 315.0, phase_margin_deg: 50.0, integral_share: 0.3 };

/// Gains of the parallel form.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Pid {
    /// k_P, N/m.
    pub kp_n_per_m: f64,
    /// k_I, N/(m s).
    pub ki_n_per_m_s: f64,
    /// k_D, N s/m.
    pub kd_n_s_per_m: f64,
}

impl Pid {
    /// Its response, N/m, for samples `sample_s` apart: differences backwards, the integral up to the sample before.
    pub fn at(&self, frequency_hz: f64, sample_s: f64) -> Complex64 {
        let [integral, rate] = terms(frequency_hz, sample_s);
        self.kp_n_per_m + self.ki_n_per_m_s * integral + self.kd_n_s_per_m * rate
    }
}

/// Responses of the sum up to the sample before, s, and of the difference, 1/s.
fn terms(frequency_hz: f64, sample_s: f64) -> [Complex64; 2] {
    let before = Complex64::from_polar(1.0, -2.0 * PI * frequency_hz * sample_s);
    [sample_s * before / (1.0 - before), (1.0 - before) / sample_s]
}

/// The gains for a wish on a measured plant (position over force, m/N, as the drive's own ticks show it: delays included).
///
/// `C(jω_c)·P(jω_c) = −e^(j·margin)` are two equations for k_P and k_D; k_I is a share of the most that they allow.
///
/// # Errors
/// A wish out of range; [`DataError::Undetermined`] if no positive gains give it.
pub fn pid(plant: &[Point], wish: &Wish, sample_s: f64) -> Result<Pid, DataError> {
    within("phase_margin_deg", wish.phase_margin_deg, 10.0, 80.0)?;
    within("integral_share", wish.integral_share, 0.0, 1.0)?;
    let wanted = Complex64::from_polar(1.0, wish.phase_margin_deg.to_radians() - PI) / at(plant, wish.crossover_hz)?;
    let [integral, rate] = terms(wish.crossover_hz, sample_s);
    let mut pid = Pid::default();
    // The integral takes a few degrees, which the others give back.
    for _ in 0..20 {
        let rest = wanted - pid.ki_n_per_m_s * integral;
        pid.kd_n_s_per_m = rest.im / rate.im;
        pid.kp_n_per_m = rest.re - pid.kd_n_s_per_m * rate.re;
        if pid.kd_n_s_per_m <= 0.0 || pid.kp_n_per_m <= 0.0 {
            let why = format!(
                "no positive gains give {} Hz with {}°: k_P would be {:.3e} N/m, k_D {:.3e} N s/m",
                wish.crossover_hz, wish.phase_margin_deg, pid.kp_n_per_m, pid.kd_n_s_per_m
            );
            return Err(DataError::Undetermined { what: "gains", why });
        }
        pid.ki_n_per_m_s = wish.integral_share * pid.kp_n_per_m * pid.kp_n_per_m / (4.0 * pid.kd_n_s_per_m);
    }
    Ok(pid)
}

/// A response between two measured frequencies: gain and phase go in straight lines over the logarithm of the frequency.
///
/// # Errors
/// A frequency outside the measured range; fewer than two points.
pub fn at(response: &[Point], frequency_hz: f64) -> Result<Complex64, DataError> {
    let (first, last) = match response {
        [first, .., last] => (first.frequency_hz, last.frequency_hz),
        _ => return Err(DataError::TooFewSamples { found: response.len(), least: 2 }),
    };
    within("frequency_hz", frequency_hz, first, last)?;
    let above = response.iter().position(|p| p.frequency_hz >= frequency_hz).unwrap_or(response.len() - 1).max(1);
    let (low, high) = (response[above - 1], response[above]);
    let share = libm::log(frequency_hz / low.frequency_hz) / libm::log(high.frequency_hz / low.frequency_hz);
    Ok(low.value * (high.value / low.value).powf(share))
}

/// The loop transmission of gains on a measured plant.
pub fn loop_transmission(plant: &[Point], pid: &Pid, sample_s: f64) -> Vec<Point> {
    plant.iter().map(|p| Point { value: p.value * pid.at(p.frequency_hz, sample_s), ..*p }).collect()
}

/// The closed loop `L/(1 + L)` without the zeros of its controller: `k_P P/(1 + L)`, which has the same poles. Those of the derivative part
/// would hide them from a fit of the second order (5.2), whose numerator is constant.
pub fn closed_loop_without_zeros(loop_transmission: &[Point], pid: &Pid, sample_s: f64) -> Vec<Point> {
    let closed = frf::closed_loop(loop_transmission).into_iter();
    closed.map(|p| Point { value: p.value * pid.kp_n_per_m / pid.at(p.frequency_hz, sample_s), ..p }).collect()
}

/// Stability of a loop at one amplitude.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Stability {
    /// Amplitude, N.
    pub amplitude_n: f64,
    /// Margins; nothing if the gain does not fall through 1 in the measured range.
    pub margins: Option<Margins>,
    /// Largest measured `|1/(1 + L)|`.
    pub sensitivity_peak: f64,
}

impl Stability {
    /// Of a loop transmission measured with `amplitude_n`.
    pub fn of(amplitude_n: f64, loop_transmission: &[Point]) -> Stability {
        let peak = loop_transmission.iter().map(|p| 1.0 / (p.value + 1.0).norm()).fold(0.0, f64::max);
        Stability { amplitude_n, margins: frf::margins(loop_transmission).ok(), sensitivity_peak: peak }
    }

    /// Whether the margins are enough; else why not.
    ///
    /// # Errors
    /// The margin that is too small.
    pub fn check(&self) -> Result<(), DataError> {
        match self.margins {
            None => within("sensitivity_peak", self.sensitivity_peak, 0.0, SENSITIVITY_PEAK).map(|_| ()),
            Some(margins) => {
                within("phase_margin_deg", margins.phase_margin_deg, PHASE_MARGIN_DEG, 180.0)?;
                within("gain_margin_db", margins.gain_margin_db.unwrap_or(f64::INFINITY), GAIN_MARGIN_DB, f64::INFINITY)
                    .map(|_| ())
            }
        }
    }
}

/// Parameters of NIASA.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Niasa {
    /// σ̂, N/m.
    pub stiffness_n_per_m: f64,
    /// F̂_C, N.
    pub coulomb_n: f64,
    /// τ_d, s.
    pub time_constant_s: f64,
    /// Largest change of the integral's force in a sample, N.
    pub rate_limit_n: f64,
    /// Way back that counts as a reversal, m.
    pub hysteresis_m: f64,
}

/// σ̂ over the σ found: the thesis' 4 N/µm for 8.66 N/µm (8.1.1).
const CAUTIOUS_STIFFNESS: f64 = 4.0 / 8.66;
/// F̂_C over the F_C found: the thesis' 0.6 N for 0.64 N (8.1.1).
const CAUTIOUS_COULOMB: f64 = 0.6 / 0.64;
/// τ_d, s (8.1.1).
const TIME_CONSTANT_S: f64 = 0.01;
/// Hysteresis in rms of the encoder's noise: white noise crosses it once in 150,000 samples.
const HYSTERESIS_NOISES: f64 = 4.5;
/// Most of it that makes sense, m.
const HYSTERESIS_MAX_M: f64 = 1e-6;

/// NIASA's parameters for what was found: the friction less than found, since with too much the axis would ring; the rate limit by
/// equation 8.1, `2 F̂_C Δt/τ_d`; the hysteresis from `noise_m_rms` of the position.
///
/// # Source
/// Sections 8.1.1 and 8.1.
pub fn niasa(sigma_n_per_m: f64, coulomb_n: f64, noise_m_rms: f64, sample_s: f64) -> Niasa {
    let coulomb_n = CAUTIOUS_COULOMB * coulomb_n;
    Niasa {
        stiffness_n_per_m: CAUTIOUS_STIFFNESS * sigma_n_per_m,
        coulomb_n,
        time_constant_s: TIME_CONSTANT_S,
        rate_limit_n: 2.0 * coulomb_n * sample_s / TIME_CONSTANT_S,
        hysteresis_m: (HYSTERESIS_NOISES * noise_m_rms).min(HYSTERESIS_MAX_M),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SAMPLE_S: f64 = 125e-6;

    /// A mass behind a delay of 90 µs.
    fn mass(mass_kg: f64) -> Vec<Point> {
        (0..60)
            .map(|i| {
                let hz = 20.0 * libm::pow(1000.0 / 20.0, f64::from(i) / 59.0);
                let omega = 2.0 * PI * hz;
                let value = Complex64::from_polar(-1.0 / (mass_kg * omega * omega), -omega * 90e-6);
                Point { frequency_hz: hz, value }
            })
            .collect()
    }

    #[test]
    fn the_loop_is_what_was_wished_for() {
        for mass_kg in [0.8, 1.8, 3.0] {
            for wish in [STANDARD, HIGH_PERFORMANCE] {
                let plant = mass(mass_kg);
                let gains = pid(&plant, &wish, SAMPLE_S).unwrap();
                let margins = frf::margins(&loop_transmission(&plant, &gains, SAMPLE_S)).unwrap();
                assert!((margins.crossover_hz / wish.crossover_hz - 1.0).abs() < 2e-3, "{margins:?}");
                assert!((margins.phase_margin_deg - wish.phase_margin_deg).abs() < 0.3, "{margins:?}");
                assert!(gains.ki_n_per_m_s < gains.kp_n_per_m * gains.kp_n_per_m / (4.0 * gains.kd_n_s_per_m));
            }
        }
    }

    /// A mass with PD swings with ω_d = √(k_P/m − (k_D/2m)²).
    #[test]
    fn the_poles_of_the_closed_loop_are_those_of_its_swing() {
        let plant = mass(1.8);
        let gains = Pid { ki_n_per_m_s: 0.0, ..pid(&plant, &STANDARD, SAMPLE_S).unwrap() };
        let transmission = loop_transmission(&plant, &gains, SAMPLE_S);
        let fit = frf::second_order(&closed_loop_without_zeros(&transmission, &gains, SAMPLE_S)).unwrap();
        let (stiffness, damping) = (gains.kp_n_per_m / 1.8, gains.kd_n_s_per_m / 3.6);
        let half_period_s = PI / (stiffness - damping * damping).sqrt();
        assert!((fit.half_period_s() / half_period_s - 1.0).abs() < 0.1, "{fit:?}, {half_period_s} s");
        // The zero would make it a third too short.
        let with_zero = frf::second_order(&frf::closed_loop(&transmission)).unwrap();
        assert!(with_zero.half_period_s() < 0.8 * half_period_s, "{with_zero:?}");
    }

    #[test]
    fn gains_are_proportional_to_the_mass() {
        let [light, heavy] = [1.0, 2.0].map(|mass_kg| pid(&mass(mass_kg), &STANDARD, SAMPLE_S).unwrap());
        assert!((heavy.kp_n_per_m / light.kp_n_per_m - 2.0).abs() < 1e-9);
        assert!((heavy.kd_n_s_per_m / light.kd_n_s_per_m - 2.0).abs() < 1e-9);
    }

    #[test]
    fn what_cannot_be_is_refused_with_the_reason() {
        let plant = mass(1.8);
        let refused = pid(&plant, &Wish { crossover_hz: 2_000.0, ..STANDARD }, SAMPLE_S);
        assert!(matches!(refused, Err(DataError::OutOfRange { field: "frequency_hz", .. })), "{refused:?}");
        // 80° at 900 Hz need more lead than a difference has.
        let refused = pid(&plant, &Wish { crossover_hz: 900.0, phase_margin_deg: 80.0, ..STANDARD }, SAMPLE_S);
        assert!(matches!(refused, Err(DataError::Undetermined { what: "gains", .. })), "{refused:?}");
        let refused = at(&plant[..1], 100.0);
        assert!(matches!(refused, Err(DataError::TooFewSamples { .. })), "{refused:?}");
    }

    #[test]
    fn a_loop_is_accepted_for_its_margins_and_refused_by_their_name() {
        let plant = mass(1.8);
        let stability = |wish: Wish| {
            let gains = pid(&plant, &wish, SAMPLE_S).unwrap();
            Stability::of(1.0, &loop_transmission(&plant, &gains, SAMPLE_S)).check()
        };
        assert_eq!(stability(STANDARD), Ok(()));
        let refused = stability(Wish { phase_margin_deg: 25.0, ..STANDARD });
        assert!(matches!(refused, Err(DataError::OutOfRange { field: "phase_margin_deg", .. })), "{refused:?}");
    }

    /// The thesis' own numbers (8.1.1): 0.015 N a sample for 10 ms and 0.6 N.
    #[test]
    fn niasa_gets_the_parameters_of_the_thesis_for_the_stage_of_the_thesis() {
        let niasa = niasa(8.66e6, 0.64, 0.44e-9, SAMPLE_S);
        assert!((niasa.stiffness_n_per_m / 4e6 - 1.0).abs() < 1e-9);
        assert!((niasa.coulomb_n / 0.6 - 1.0).abs() < 1e-9);
        assert!((niasa.rate_limit_n / 0.015 - 1.0).abs() < 1e-9);
        assert!((niasa.hysteresis_m / 2e-9 - 1.0).abs() < 0.02);
    }
}
