//! Generalised Maxwell slip (2.9 to 2.11), stepped by velocity.
//!
//! [`super::maxwell_slip`] follows the measured position and has neither Stribeck effect nor damping; this one is for
//! feedforward and for observers.

use super::maxwell_slip::{Elements, MAX_ELEMENTS};
use super::stribeck::Level;

/// Parameters.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Coefficients {
    /// Stiffnesses k_i and saturations F_i^sat of the hysteresis.
    pub elements: Elements,
    /// Level of sliding friction, s(v).
    pub level: Level,
    /// Micro-damping σ1, N s/m, at least 0.
    pub damping_n_s_per_m: f32,
    /// Coefficient of viscous friction σ2, N s/m, at least 0.
    pub viscous_n_s_per_m: f32,
    /// How sliding friction comes to s(v).
    pub law: Law,
}

/// How sliding friction comes to s(v).
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum Law {
    /// (2.9) corrected: `dz/dt = v (1 − sgn(F_h/(s sgn v)) |F_h/s|^n)` for the deflection of all elements, which saturate at their own
    /// F_i^sat.
    HiddenState {
        /// Shape factor n, at least 1. 1 is exact for any step; others take up to [`MOST_PIECES`] pieces.
        shape: f32,
    },
    /// `dz = v dt`; each element slides at its share of the level, `F_i^sat s(v)/F_C`, which it approaches with
    /// `dF_i/dt = C (F_i^sat/F_C − F_i/s(v))` in the direction of motion, but never faster than its spring.
    Attraction {
        /// Attraction parameter C, N/s, above 0; infinite: at its share at once.
        attraction_n_per_s: f32,
    },
}

/// The most pieces a step is divided into by [`Law::HiddenState`].
pub const MOST_PIECES: usize = 96;
/// Largest change of F_h/s in a piece; it is also at most a quarter of what is left to 1.
const PIECE: f32 = 1.0 / 16.0;
/// An element this near to its saturation, relative to it, slides.
const NEARLY: f32 = 5e-7;
/// A rate this near to 0 is none.
const NO_RATE: f32 = 1e-7;

/// The forces of the elements.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Gms {
    element_n: [f32; MAX_ELEMENTS],
    sliding: [bool; MAX_ELEMENTS],
    forward: bool,
}

impl Gms {
    /// No force in any element.
    pub const RELAXED: Self = Gms { element_n: [0.0; MAX_ELEMENTS], sliding: [false; MAX_ELEMENTS], forward: true };

    /// The hysteresis force F_h, N (2.11).
    #[inline]
    pub fn hysteresis_n(&self) -> f32 {
        self.element_n.iter().sum()
    }

    /// Slope dF_h/dz for motion in `direction` (its sign): the stiffness of the elements below their saturation, N/m.
    pub fn slope_n_per_m(&self, k: &Coefficients, direction: f32) -> f32 {
        self.room(&k.elements, if direction < 0.0 { -1.0 } else { 1.0 }).0
    }

    /// Moves at `velocity_m_per_s` for `dt_s`; the force, N, with the mean dz/dt of the step.
    ///
    /// # Source
    /// (2.10), (2.11); the laws are at [`Law`].
    pub fn step(&mut self, k: &Coefficients, velocity_m_per_s: f32, dt_s: f32) -> f32 {
        let path_m = velocity_m_per_s * dt_s;
        let mut deflected_m = 0.0;
        if path_m != 0.0 {
            let level_n = k.level.at(velocity_m_per_s);
            deflected_m = match k.law {
                Law::HiddenState { shape: 1.0 } => self.fill_exactly(&k.elements, path_m, level_n),
                Law::HiddenState { shape } => self.fill(&k.elements, path_m, level_n, shape),
                Law::Attraction { attraction_n_per_s } => {
                    let kept = if attraction_n_per_s < f32::INFINITY {
                        libm::expf(-attraction_n_per_s * dt_s / level_n)
                    } else {
                        0.0
                    };
                    self.slide(&k.elements, path_m, level_n / k.level.coulomb_n, kept)
                }
            };
        }
        let rate_m_per_s = if dt_s > 0.0 { deflected_m / dt_s } else { 0.0 };
        self.hysteresis_n() + k.damping_n_s_per_m * rate_m_per_s + k.viscous_n_s_per_m * velocity_m_per_s
    }

    /// [`Law::Attraction`]: elements slide at `share` of their saturation and keep the fraction `kept` of what they are off it.
    /// The deflection of those that stick, weighted with their stiffness, m.
    fn slide(&mut self, elements: &Elements, path_m: f32, share: f32, kept: f32) -> f32 {
        let forward = path_m > 0.0;
        if forward != self.forward {
            self.sliding = [false; MAX_ELEMENTS];
            self.forward = forward;
        }
        let direction = if forward { 1.0 } else { -1.0 };
        let (mut loaded_n, mut total_n_per_m) = (0.0, 0.0);
        let list = elements.stiffness_n_per_m.iter().zip(&elements.saturation_n);
        for ((stiffness, saturation), (element_n, sliding)) in
            list.zip(self.element_n.iter_mut().zip(&mut self.sliding))
        {
            let limit_n = saturation * share;
            let before_n = direction * *element_n;
            let stuck_n = before_n + stiffness * libm::fabsf(path_m);
            let relaxed_n = limit_n - (limit_n - before_n) * kept;
            let after_n = if *sliding {
                relaxed_n.min(stuck_n)
            } else {
                *sliding = stuck_n > limit_n;
                // Above the limit already: only a level that has dropped does that.
                let arrived_n = if *sliding { relaxed_n.max(limit_n) } else { stuck_n };
                loaded_n += (arrived_n - before_n).max(0.0);
                arrived_n
            };
            total_n_per_m += stiffness;
            *element_n = direction * after_n;
        }
        direction * loaded_n / total_n_per_m.max(f32::MIN_POSITIVE)
    }

    /// [`Law::HiddenState`] with n = 1: from corner to corner what is left to the level is an exponential in x. The deflection, m.
    fn fill_exactly(&mut self, elements: &Elements, path_m: f32, level_n: f32) -> f32 {
        let direction = if path_m > 0.0 { 1.0 } else { -1.0 };
        let (mut left_m, mut deflected_m) = (libm::fabsf(path_m), 0.0);
        // Each pass but the last saturates an element.
        for _ in 0..=MAX_ELEMENTS {
            let rest = 1.0 - direction * self.hysteresis_n() / level_n;
            let towards = if rest < 0.0 { -direction } else { direction };
            let (stiffness_n_per_m, corner_m) = self.room(elements, towards);
            if stiffness_n_per_m == 0.0 || libm::fabsf(rest) < NO_RATE {
                break;
            }
            let length_m = level_n / stiffness_n_per_m;
            let goal_m = libm::fabsf(rest) * length_m;
            let free_m = -goal_m * libm::expm1f(-left_m / length_m);
            let dz_m = free_m.min(corner_m);
            self.deflect(elements, towards * dz_m);
            deflected_m += towards * dz_m;
            if free_m <= corner_m {
                break;
            }
            left_m = (left_m + length_m * libm::log1pf(-corner_m / goal_m)).max(0.0);
        }
        deflected_m
    }

    /// [`Law::HiddenState`] with any n, in pieces of z whose path `∫dz/rate(z)` is taken by Simpson's rule. The deflection, m.
    fn fill(&mut self, elements: &Elements, path_m: f32, level_n: f32, shape: f32) -> f32 {
        let direction = if path_m > 0.0 { 1.0 } else { -1.0 };
        let (mut left_m, mut deflected_m) = (libm::fabsf(path_m), 0.0);
        for _ in 0..MOST_PIECES {
            let filled = direction * self.hysteresis_n() / level_n;
            let start = rate(filled, shape);
            let way = if start < 0.0 { -1.0 } else { 1.0 };
            let (stiffness_n_per_m, corner_m) = self.room(elements, way * direction);
            if stiffness_n_per_m == 0.0 || libm::fabsf(start) < NO_RATE {
                break;
            }
            let length_m = level_n / stiffness_n_per_m;
            let rate_at = |dz_m: f32| libm::fabsf(rate(filled + way * dz_m / length_m, shape)).max(1e-9);
            let path_of =
                |dz_m: f32| dz_m / 6.0 * (1.0 / libm::fabsf(start) + 4.0 / rate_at(0.5 * dz_m) + 1.0 / rate_at(dz_m));
            let mut dz_m = corner_m.min(length_m * PIECE.min(0.25 * libm::fabsf(1.0 - filled)));
            let mut taken_m = path_of(dz_m);
            let last = taken_m >= left_m;
            if last {
                // Newton's method; the derivative of the path is 1/rate.
                for _ in 0..3 {
                    dz_m = (dz_m + (left_m - taken_m) * rate_at(dz_m)).max(0.0);
                    taken_m = path_of(dz_m);
                }
            }
            self.deflect(elements, way * direction * dz_m);
            deflected_m += way * direction * dz_m;
            if last {
                break;
            }
            left_m -= taken_m;
        }
        deflected_m
    }

    /// The stiffness of the elements with room left in a direction (±1), N/m, and how far the first of them has, m.
    fn room(&self, elements: &Elements, direction: f32) -> (f32, f32) {
        let (mut stiffness_n_per_m, mut corner_m) = (0.0, f32::INFINITY);
        let list = elements.stiffness_n_per_m.iter().zip(&elements.saturation_n).zip(&self.element_n);
        for ((stiffness, saturation), element_n) in list {
            let held_n = direction * element_n;
            if held_n < (1.0 - NEARLY) * saturation && *stiffness > 0.0 {
                stiffness_n_per_m += stiffness;
                corner_m = f32::min(corner_m, (saturation - held_n) / stiffness);
            }
        }
        (stiffness_n_per_m, corner_m)
    }

    /// Moves the deflection of all elements (A.4 corrected).
    fn deflect(&mut self, elements: &Elements, dz_m: f32) {
        let list = elements.stiffness_n_per_m.iter().zip(&elements.saturation_n);
        for ((stiffness, saturation), element_n) in list.zip(&mut self.element_n) {
            *element_n = (*element_n + stiffness * dz_m).min(*saturation).max(-saturation);
        }
    }
}

/// `dz/dx = 1 − sgn(h) |h|^n` where h is F_h/s in the direction of motion.
#[inline]
fn rate(filled: f32, shape: f32) -> f32 {
    let power = if shape == 2.0 { filled * filled } else { libm::powf(libm::fabsf(filled), shape) };
    if filled < 0.0 { 1.0 + power } else { 1.0 - power }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::friction::lugre::{self, LuGre};
    use crate::friction::maxwell_slip::{self, GMS_TABLE_4, MaxwellSlip};
    use crate::position::Position;
    use proptest::prelude::*;

    const DT_S: f32 = 125e-6;
    const COUNT_M: f32 = 4e-6 / 65536.0;
    const LEVEL: Level = Level { coulomb_n: 0.6, static_n: 0.8, stribeck_m_per_s: 1e-3, stribeck_shape: 2.0 };

    fn coefficients(law: Law, level: Level) -> Coefficients {
        Coefficients { elements: GMS_TABLE_4, level, damping_n_s_per_m: 0.0, viscous_n_s_per_m: 0.0, law }
    }

    fn laws() -> impl Strategy<Value = Law> {
        prop_oneof![
            (1.0f32..10.0).prop_map(|shape| Law::HiddenState { shape }),
            Just(Law::HiddenState { shape: 1.0 }),
            (1e-3f32..1e6).prop_map(|attraction_n_per_s| Law::Attraction { attraction_n_per_s }),
            Just(Law::Attraction { attraction_n_per_s: f32::INFINITY }),
        ]
    }

    proptest! {
        #[test]
        fn one_endless_element_that_follows_the_hidden_state_is_lugre(path in proptest::collection::vec(-5e-3f32..5e-3, 1..200)) {
            let mut elements = Elements { stiffness_n_per_m: [0.0; MAX_ELEMENTS], saturation_n: [0.0; MAX_ELEMENTS] };
            (elements.stiffness_n_per_m[0], elements.saturation_n[0]) = (4e6, f32::INFINITY);
            let k = Coefficients {
                elements,
                damping_n_s_per_m: 300.0,
                viscous_n_s_per_m: 2.0,
                ..coefficients(Law::HiddenState { shape: 1.0 }, LEVEL)
            };
            let lugre_k = lugre::Coefficients {
                stiffness_n_per_m: 4e6,
                damping_n_s_per_m: 300.0,
                viscous_n_s_per_m: 2.0,
                level: LEVEL,
            };
            let (mut gms, mut lugre) = (Gms::RELAXED, LuGre::RELAXED);
            for velocity in path {
                let (a, b) = (gms.step(&k, velocity, DT_S), lugre.step(&lugre_k, velocity, DT_S));
                prop_assert!((a - b).abs() < 5e-6, "{} {}", a, b);
            }
        }

        #[test]
        fn at_once_and_at_a_constant_level_it_is_maxwell_slip(path in proptest::collection::vec(-20_000i64..20_000, 1..200)) {
            let k = coefficients(Law::Attraction { attraction_n_per_s: f32::INFINITY }, Level::constant(0.4301));
            let slip_k = maxwell_slip::Coefficients { elements: GMS_TABLE_4, count_m: COUNT_M, hysteresis_ct: 0 };
            let (mut gms, mut slip, mut at_ct) = (Gms::RELAXED, MaxwellSlip::relaxed(Position(0)), 0);
            for moved_ct in path {
                at_ct += moved_ct;
                slip.update(&slip_k, Position(at_ct));
                let force_n = gms.step(&k, moved_ct as f32 * COUNT_M / DT_S, DT_S);
                prop_assert!((force_n - slip.force_n()).abs() < 2e-6, "{} {}", force_n, slip.force_n());
            }
        }

        #[test]
        fn no_step_is_too_long(
            law in laws(), steps in proptest::collection::vec((-1e3f32..1e3, prop_oneof![Just(0.0f32), 1e-9f32..10.0]), 1..50),
        ) {
            let (k, mut gms) = (coefficients(law, LEVEL), Gms::RELAXED);
            for (velocity, dt) in steps {
                let force_n = gms.step(&k, velocity, dt);
                prop_assert!(force_n.abs() <= 0.800_01, "{} N", force_n);
                let slope = gms.slope_n_per_m(&k, velocity);
                prop_assert!((0.0..=1.000_001 * k.elements.total_stiffness_n_per_m()).contains(&slope));
            }
        }
    }

    #[test]
    fn what_is_not_a_number_does_no_harm_but_to_the_force() {
        for law in [
            Law::HiddenState { shape: 1.0 },
            Law::HiddenState { shape: 3.0 },
            Law::Attraction { attraction_n_per_s: 1.0 },
        ] {
            let mut gms = Gms::RELAXED;
            assert!(gms.step(&coefficients(law, LEVEL), f32::NAN, DT_S).is_nan());
        }
    }
}
