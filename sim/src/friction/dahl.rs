//! Dahl's model with any shape factor, stepped exactly.

use serde::{Deserialize, Serialize};

/// `dF/dx = σ |1 − F/F_C · sgn ẋ|^i sgn(1 − F/F_C · sgn ẋ)`.
///
/// # Source
/// Equation 2.5 (corrected: the factor `sgn ẋ`), solved as in equation 7.5 for `i = 1`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Dahl {
    stiffness_n_per_m: f64,
    coulomb_n: f64,
    shape: f64,
    force_n: f64,
}

impl Dahl {
    /// A contact with shape factor 1 and without force; both arguments must be positive.
    pub fn new(stiffness_n_per_m: f64, coulomb_n: f64) -> Dahl {
        Dahl::with_shape(stiffness_n_per_m, coulomb_n, 1.0)
    }

    /// A contact with shape factor `shape` (i, at least 0) and without force; the other arguments must be positive.
    ///
    /// 0 is a single spring and slider, below 1 the force reaches F_C after a finite distance, above 1 it creeps towards it
    /// more slowly than an exponential.
    pub fn with_shape(stiffness_n_per_m: f64, coulomb_n: f64, shape: f64) -> Dahl {
        Dahl { stiffness_n_per_m, coulomb_n, shape, force_n: 0.0 }
    }

    /// Moves the contact by `dx_m` and returns the force in N. A step may be of any length; two steps in one direction are
    /// exactly one.
    ///
    /// With `u = 1 − F/F_C · sgn dx` and `a = σ|dx|/F_C`, separation of variables gives `u ← u e^(−a)` for `i = 1` and
    /// `u ← u (1 + (i−1) a u^(i−1))^(−1/(i−1))` otherwise; where the bracket is not positive (`i < 1`), F_C is reached.
    #[inline]
    pub fn advance(&mut self, dx_m: f64) -> f64 {
        let goal_n = if dx_m < 0.0 { -self.coulomb_n } else { self.coulomb_n };
        let path = self.stiffness_n_per_m * dx_m.abs() / self.coulomb_n;
        let progress =
            if self.shape == 1.0 { -libm::expm1(-path) } else { self.progress(1.0 - self.force_n / goal_n, path) };
        self.force_n += (goal_n - self.force_n) * progress;
        self.force_n
    }

    /// The share of `left` (u) that a path of `path` (a) takes away, for a shape factor other than 1.
    fn progress(&self, left: f64, path: f64) -> f64 {
        if left <= 0.0 || path == 0.0 {
            return 0.0;
        }
        let power = self.shape - 1.0;
        let bracket_minus_1 = power * path * libm::pow(left, power);
        if bracket_minus_1 <= -1.0 { 1.0 } else { -libm::expm1(-libm::log1p(bracket_minus_1) / power) }
    }

    /// The force that opposes positive motion, N.
    pub fn force_n(&self) -> f64 {
        self.force_n
    }

    /// `F² / 2σ`, J: at least the energy that can be had back.
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

    const STIFFNESS_N_PER_M: f64 = 8.66e6;
    const COULOMB_N: f64 = 0.64;

    proptest! {
        #[test]
        fn two_steps_in_one_direction_are_one(
            start_m in -1e-6..1e-6, first_m in 0.0..1e-6, second_m in 0.0..1e-6, up: bool,
            shape in prop::sample::select(vec![0.0, 0.5, 0.999_999, 1.0, 1.000_001, 1.5, 2.0, 4.0]),
        ) {
            let sign = if up { 1.0 } else { -1.0 };
            let mut twice = Dahl::with_shape(STIFFNESS_N_PER_M, COULOMB_N, shape);
            twice.advance(start_m);
            let mut once = twice.clone();
            twice.advance(sign * first_m);
            twice.advance(sign * second_m);
            once.advance(sign * (first_m + second_m));
            let tolerance_n = if shape == 1.0 { 1e-15 } else { 1e-12 };
            prop_assert!((twice.force_n() - once.force_n()).abs() < tolerance_n, "{} {}", twice.force_n(), once.force_n());
        }

        #[test]
        fn a_small_step_follows_the_differential_equation(
            start_m in -3e-7..3e-7, up: bool, shape in prop::sample::select(vec![0.0, 0.5, 1.0, 1.5, 2.0, 4.0]),
        ) {
            let mut dahl = Dahl::with_shape(STIFFNESS_N_PER_M, COULOMB_N, shape);
            let before_n = dahl.advance(start_m);
            let direction = if up { 1.0 } else { -1.0 };
            let slope = (dahl.advance(direction * 1e-13) - before_n) / (direction * 1e-13);
            let left = 1.0 - before_n / COULOMB_N * direction;
            // At saturation with i < 1 the slope jumps to 0.
            prop_assume!(left == 0.0 || left > 1e-3);
            let expected = if left == 0.0 { 0.0 } else { STIFFNESS_N_PER_M * libm::pow(left, shape) };
            prop_assert!((slope - expected).abs() < 1e-4 * STIFFNESS_N_PER_M, "{} {}", slope, expected);
        }
    }

    #[test]
    fn the_shape_factor_0_is_a_spring_and_slider() {
        let mut dahl = Dahl::with_shape(STIFFNESS_N_PER_M, COULOMB_N, 0.0);
        for (dx_nm, force_n) in [(50.0, 0.433), (50.0, 0.64), (-40.0, 0.2936), (-200.0, -0.64), (10.0, -0.5534)] {
            assert!((dahl.advance(dx_nm * 1e-9) - force_n).abs() < 1e-12, "{dx_nm} nm: {} N", dahl.force_n());
        }
    }

    #[test]
    fn below_shape_factor_1_the_force_arrives_and_above_it_creeps() {
        // From rest, i = 0.5 arrives after 2 F_C/σ; i = 2 has gone a/(1+a) of the way, i = 1 1 − e^(−a).
        let after = |shape, path: f64| {
            Dahl::with_shape(STIFFNESS_N_PER_M, COULOMB_N, shape).advance(path * COULOMB_N / STIFFNESS_N_PER_M)
                / COULOMB_N
        };
        for path in [0.1f64, 1.0, 1.999] {
            assert!((after(0.5, path) - (1.0 - (1.0 - 0.5 * path) * (1.0 - 0.5 * path))).abs() < 1e-13);
            assert!((after(2.0, path) - path / (1.0 + path)).abs() < 1e-13);
            assert!((after(1.0, path) - (1.0 - libm::exp(-path))).abs() < 1e-15);
        }
        assert_eq!(after(0.5, 2.0), 1.0);
    }

    #[test]
    fn an_inner_loop_does_not_close_because_the_memory_is_local() {
        let mut dahl = Dahl::new(STIFFNESS_N_PER_M, COULOMB_N);
        dahl.advance(1e-3);
        dahl.advance(-60e-9);
        let left_n = dahl.advance(30e-9);
        dahl.advance(-15e-9);
        let back_n = dahl.advance(15e-9);
        assert!((back_n - left_n).abs() > 0.01, "{left_n} N, {back_n} N");
    }
}
