//! Dahl's model with shape factor 1, stepped exactly.

use serde::{Deserialize, Serialize};

/// `dF/dx = σ (1 − F/F_C · sgn ẋ)`.
///
/// # Source
/// Equation 2.5 (corrected: the factor `sgn ẋ`), solved as in equation 7.5.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Dahl {
    stiffness_n_per_m: f64,
    coulomb_n: f64,
    force_n: f64,
}

impl Dahl {
    /// A contact without force; both arguments must be positive.
    pub fn new(stiffness_n_per_m: f64, coulomb_n: f64) -> Dahl {
        Dahl { stiffness_n_per_m, coulomb_n, force_n: 0.0 }
    }

    /// Moves the contact by `dx_m` and returns the force in N: `F ← ±F_C − (±F_C − F) e^(−σ|dx|/F_C)`, the sign being
    /// that of `dx_m`. A step may be of any length; two steps in one direction are exactly one.
    #[inline]
    pub fn advance(&mut self, dx_m: f64) -> f64 {
        let goal_n = if dx_m < 0.0 { -self.coulomb_n } else { self.coulomb_n };
        let progress = -libm::expm1(-self.stiffness_n_per_m * dx_m.abs() / self.coulomb_n);
        self.force_n += (goal_n - self.force_n) * progress;
        self.force_n
    }

    /// The force that opposes positive motion, N.
    pub fn force_n(&self) -> f64 {
        self.force_n
    }

    /// The energy in the spring, `F² / 2σ`, J.
    pub fn stored_j(&self) -> f64 {
        0.5 * self.force_n * self.force_n / self.stiffness_n_per_m
    }

    /// Changes σ (N/m) and F_C (N), both positive; the force keeps its fraction of F_C.
    pub fn set(&mut self, stiffness_n_per_m: f64, coulomb_n: f64) {
        self.force_n *= coulomb_n / self.coulomb_n;
        self.stiffness_n_per_m = stiffness_n_per_m;
        self.coulomb_n = coulomb_n;
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn two_steps_in_one_direction_are_one(start_m in -1e-6..1e-6, first_m in 0.0..1e-6, second_m in 0.0..1e-6, up: bool) {
            let sign = if up { 1.0 } else { -1.0 };
            let mut twice = Dahl::new(8.66e6, 0.64);
            twice.advance(start_m);
            let mut once = twice.clone();
            twice.advance(sign * first_m);
            twice.advance(sign * second_m);
            once.advance(sign * (first_m + second_m));
            prop_assert!((twice.force_n() - once.force_n()).abs() < 1e-15);
        }

        #[test]
        fn a_small_step_follows_the_differential_equation(start_m in -1e-6..1e-6, up: bool) {
            let (stiffness_n_per_m, coulomb_n) = (8.66e6, 0.64);
            let mut dahl = Dahl::new(stiffness_n_per_m, coulomb_n);
            let before_n = dahl.advance(start_m);
            let direction = if up { 1.0 } else { -1.0 };
            let slope = (dahl.advance(direction * 1e-13) - before_n) / (direction * 1e-13);
            let expected = stiffness_n_per_m * (1.0 - before_n / coulomb_n * direction);
            prop_assert!((slope - expected).abs() < 1e-5 * stiffness_n_per_m, "{} {}", slope, expected);
        }
    }
}
