//! Generalised Maxwell slip: any elements, Stribeck effect, damping.

use serde::{Deserialize, Serialize};

use super::elements::{Elements, MAX_LISTED};
use super::stribeck::Level;
use super::velocity_m_per_s;

/// `F = F_h + σ1 dz/dt + σ2 v`, with the hysteresis `F_h = Σ F_i` of parallel spring-slider elements.
///
/// # Source
/// Equations 2.9 to 2.11 and A.1 to A.5, corrected: `s(v)` carries the sign of the velocity in 2.9, and the elements of A.4
/// have memory, `F_i ← clip(F_i + k_i dz, ±F_i^sat)`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Gms {
    /// As given: what [`Gms::set`] scales.
    nominal: Parameters,
    now: Parameters,
    element_n: [f64; MAX_LISTED],
    sliding: [bool; MAX_LISTED],
    forward: bool,
    force_n: f64,
}

/// Parameters of [`Gms`].
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Parameters {
    /// Stiffnesses k_i and saturations F_i^sat.
    pub elements: Elements,
    /// The level of sliding friction, `s(v)`.
    pub level: Level,
    /// Micro-damping σ1, N s/m, at least 0.
    pub damping_n_s_per_m: f64,
    /// Viscous friction σ2, N s/m, at least 0.
    pub viscous_n_s_per_m: f64,
    /// How sliding friction comes to `s(v)`.
    pub law: Law,
}

/// How sliding friction comes to `s(v)`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum Law {
    /// The elements share one deflection, which lags behind: `dz/dx = 1 − sgn(F_h sgn v) |F_h/s(v)|^n` (2.9 corrected). Every
    /// element saturates at its own F_i^sat, whatever `s(v)` is.
    HiddenState {
        /// Shape factor n, at least 1.
        shape: f64,
    },
    /// Each element follows the motion, `dz = dx`, and slides at its share of the level, `F_i^sat s(v)/F_C`, which a sliding
    /// element approaches by `dF_i/dt = sgn(v) C (α_i − |F_i|/s(v))`, `α_i = F_i^sat/F_C`, but never by more than its spring
    /// could do. With a constant level this is the Maxwell-slip model of A.3 to A.5.
    ///
    /// Al-Bender, Lampaert and Swevers 2005; the bound is added so that no energy is created.
    Attraction {
        /// Attraction parameter C, N/s, above 0; infinite: sliding elements are always at their share.
        attraction_n_per_s: f64,
    },
}

/// Largest change of `F_h/s` in one linearised step of [`Law::HiddenState`] with `n ≠ 1`.
const LARGEST_CHANGE: f64 = 1.0 / 256.0;
/// The same, relative to what is left to the level.
const LARGEST_SHARE: f64 = 1.0 / 20.0;
/// Steps after which what is left of the path is gone in one.
const MOST_STEPS: usize = 2_000;
/// An element this near to its saturation, relative to it, has arrived.
const ARRIVED: f64 = 1.0 - 1e-12;

impl Gms {
    /// A contact without force.
    pub fn new(parameters: Parameters) -> Gms {
        Gms {
            nominal: parameters,
            now: parameters,
            element_n: [0.0; MAX_LISTED],
            sliding: [false; MAX_LISTED],
            forward: true,
            force_n: 0.0,
        }
    }

    /// Moves the contact by `dx_m` in `dt_s` at constant velocity and returns the force that opposes positive motion, N, with
    /// the mean `dz/dt` of the step.
    ///
    /// [`Law::HiddenState`] with `n = 1` is exact for a step of any length: from one saturation of an element to the next the
    /// deflection is an exponential in `x`. With another `n` the law is linearised over pieces in which `F_h/s` changes by at
    /// most 1/256, within 1e-5 of the level. [`Law::Attraction`] takes the velocity of the step for `s(v)`.
    pub fn advance(&mut self, dx_m: f64, dt_s: f64) -> f64 {
        let velocity_m_per_s = velocity_m_per_s(dx_m, dt_s);
        let level_n = self.now.level.at(velocity_m_per_s);
        let deflected_m = if dx_m == 0.0 {
            0.0
        } else {
            match self.now.law {
                Law::HiddenState { shape } => self.follow_hidden_state(dx_m, level_n, shape),
                Law::Attraction { attraction_n_per_s } => self.slide(dx_m, dt_s, level_n, attraction_n_per_s),
            }
        };
        self.force_n = self.hysteresis_n()
            + self.now.damping_n_s_per_m * self::velocity_m_per_s(deflected_m, dt_s)
            + self.now.viscous_n_s_per_m * velocity_m_per_s;
        self.force_n
    }

    /// The force of the last step, N.
    pub fn force_n(&self) -> f64 {
        self.force_n
    }

    /// The hysteresis force F_h, N (2.11).
    pub fn hysteresis_n(&self) -> f64 {
        self.element_n.iter().sum()
    }

    /// The energy in the springs, `Σ F_i² / 2 k_i`, J.
    pub fn stored_j(&self) -> f64 {
        let elements = self.now.elements;
        let springs = self.element_n.iter().zip(elements.as_slice());
        springs.map(|(force_n, element)| 0.5 * force_n * force_n / element.stiffness_n_per_m).sum()
    }

    /// Changes the elements so that `Σ k_i / 2` is `stiffness_n_per_m` (Dahl's σ) and the level's F_C is `coulomb_n`, both
    /// positive, all others in proportion; every element keeps its fraction of saturation.
    pub fn set(&mut self, stiffness_n_per_m: f64, coulomb_n: f64) {
        let stiffer = 2.0 * stiffness_n_per_m / self.nominal.elements.stiffness_n_per_m();
        let stronger = coulomb_n / self.nominal.level.coulomb_n;
        let scale = coulomb_n / self.now.level.coulomb_n;
        self.element_n.iter_mut().for_each(|force_n| *force_n *= scale);
        self.force_n *= scale;
        self.now.elements = self.nominal.elements.scaled(stiffer, stronger);
        self.now.level = self.nominal.level.with_coulomb(coulomb_n);
    }

    /// [`Law::Attraction`]; the mean deflection of the elements that stick, weighted with their stiffness, m.
    fn slide(&mut self, dx_m: f64, dt_s: f64, level_n: f64, attraction_n_per_s: f64) -> f64 {
        let Parameters { elements, level, .. } = self.now;
        if self.forward != (dx_m > 0.0) {
            self.forward = dx_m > 0.0;
            self.sliding = [false; MAX_LISTED];
        }
        let sign = dx_m.signum();
        let share = level_n / level.coulomb_n;
        // An infinite C needs no time.
        let kept = if attraction_n_per_s.is_finite() { libm::exp(-attraction_n_per_s * dt_s / level_n) } else { 0.0 };
        let (mut sprung_n, mut stiffness_n_per_m) = (0.0, 0.0);
        for (i, element) in elements.as_slice().iter().enumerate() {
            let limit_n = element.saturation_n * share;
            let held_n = sign * self.element_n[i];
            let tried_n = held_n + element.stiffness_n_per_m * dx_m.abs();
            let relaxed_n = limit_n + (held_n - limit_n) * kept;
            let sticks = !self.sliding[i];
            let next_n = if !sticks {
                tried_n.min(relaxed_n)
            } else if tried_n <= limit_n {
                tried_n
            } else {
                self.sliding[i] = true;
                limit_n.max(relaxed_n) // the level may have dropped below what the element held
            };
            if sticks {
                sprung_n += (next_n - held_n).max(0.0);
            }
            stiffness_n_per_m += element.stiffness_n_per_m;
            self.element_n[i] = sign * next_n;
        }
        sign * sprung_n / stiffness_n_per_m
    }

    /// [`Law::HiddenState`]; the change of z, m.
    fn follow_hidden_state(&mut self, dx_m: f64, level_n: f64, shape: f64) -> f64 {
        let sign = dx_m.signum();
        let (mut left_m, mut deflected_m) = (dx_m.abs(), 0.0);
        for step in 1..=MOST_STEPS {
            // dz/dx = rate, and how it changes with z.
            let filled = sign * self.hysteresis_n() / level_n;
            let rate = 1.0 - filled.signum() * libm::pow(filled.abs(), shape);
            let towards = if rate < 0.0 { -sign } else { sign };
            let (stiffness_n_per_m, reach_m) = self.next_corner(towards);
            if stiffness_n_per_m == 0.0 || rate == 0.0 {
                // Nothing can change any more: all elements slide, or F_h is at the level.
                break;
            }
            let fade_per_m = shape * libm::pow(filled.abs(), shape - 1.0) * stiffness_n_per_m / level_n;
            // z(x) = rate (1 − e^(−fade x)) / fade up to the next corner, the largest change or the end of the path.
            let largest_m = if shape == 1.0 || step == MOST_STEPS {
                f64::INFINITY
            } else {
                level_n / stiffness_n_per_m * LARGEST_CHANGE.min(LARGEST_SHARE * (1.0 - filled).abs().max(1e-6))
            };
            let free_m = rate.abs() * ratio_of_rise(fade_per_m * left_m) * left_m;
            let dz_m = free_m.min(reach_m).min(largest_m);
            self.deflect(towards * dz_m);
            deflected_m += towards * dz_m;
            if dz_m == free_m {
                break;
            }
            // The path that this deflection took: the inverse of z(x).
            let lag = fade_per_m * dz_m / rate.abs();
            let path_m = if lag < 1e-8 { dz_m / rate.abs() } else { -libm::log1p(-lag) / fade_per_m };
            left_m = (left_m - path_m).max(0.0);
        }
        deflected_m
    }

    /// The stiffness of the elements that a deflection in this direction loads, N/m, and how far to the next saturation, m.
    fn next_corner(&self, direction: f64) -> (f64, f64) {
        let elements = self.now.elements.as_slice().iter().zip(&self.element_n);
        elements.fold((0.0, f64::INFINITY), |(stiffness_n_per_m, reach_m), (element, force_n)| {
            let held_n = direction * force_n;
            if held_n >= ARRIVED * element.saturation_n {
                return (stiffness_n_per_m, reach_m);
            }
            let here_m = (element.saturation_n - held_n) / element.stiffness_n_per_m;
            (stiffness_n_per_m + element.stiffness_n_per_m, reach_m.min(here_m))
        })
    }

    /// Moves the elements' common deflection (A.4 corrected).
    fn deflect(&mut self, dz_m: f64) {
        for (element, force_n) in self.now.elements.as_slice().iter().zip(&mut self.element_n) {
            let tried_n = *force_n + element.stiffness_n_per_m * dz_m;
            *force_n = tried_n.min(element.saturation_n).max(-element.saturation_n);
        }
    }
}

/// `(1 − e^(−y)) / y`, 1 at 0.
fn ratio_of_rise(y: f64) -> f64 {
    if y == 0.0 { 1.0 } else { -libm::expm1(-y) / y }
}
