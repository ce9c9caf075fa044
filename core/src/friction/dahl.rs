//! Dahl friction (2.5 with shape factor 1) from one velocity reversal to the next, in closed form.

use super::reversal::Branch;
use crate::position::Position;

/// Parameters, in the units of the tick.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Coefficients {
    /// Initial contact stiffness σ, N/m.
    pub stiffness_n_per_m: f32,
    /// Level of Coulomb friction F_C, N, above 0.
    pub coulomb_n: f32,
    /// σ/F_C per encoder count: the exponent's slope.
    pub exponent_per_ct: f32,
    /// How far the position must come back from its extreme to count as a velocity reversal, counts.
    pub hysteresis_ct: i32,
}

/// The model's memory: friction since the last reversal is a function of the distance from there (7.5).
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Dahl {
    branch: Branch,
    /// Friction force where it began, N.
    anchor_force_n: f32,
    force_n: f32,
    slope_n_per_m: f32,
}

impl Dahl {
    /// Relaxed (no friction force) at `position`.
    pub fn relaxed(position: Position) -> Self {
        Dahl { branch: Branch::starting_at(position), anchor_force_n: 0.0, force_n: 0.0, slope_n_per_m: 0.0 }
    }

    /// Modelled friction force F̂, N, within ±F_C.
    #[inline]
    pub fn force_n(&self) -> f32 {
        self.force_n
    }

    /// Modelled slope dF̂/dx, N/m, within `0..=2σ`.
    #[inline]
    pub fn slope_n_per_m(&self) -> f32 {
        self.slope_n_per_m
    }

    /// Takes the measured position of this tick.
    ///
    /// `F̂ = s·F_C − (s·F_C − F_0) e^(−σ/F_C·s·(x − x_0))`, `dF̂/dx = σ (1 − s·F_0/F_C) e^(…)` with `s = ±1` the direction,
    /// `x_0`, `F_0` place and force of the last reversal. `x` is the extreme reached since (see `reversal`).
    ///
    /// # Source
    /// (7.5), (7.39)/(7.40) corrected (factor σ), App. E corrected: measured position instead of position error, reversal with
    /// hysteresis instead of the sign of the raw velocity.
    #[inline]
    pub fn update(&mut self, k: &Coefficients, position: Position) {
        if self.branch.follow(position, k.hysteresis_ct).is_some() {
            self.anchor_force_n = self.force_n.clamp(-k.coulomb_n, k.coulomb_n);
        }
        let direction = self.branch.direction();
        let decay = libm::expf(-k.exponent_per_ct * self.branch.travel_ct() as f32);
        // s·F_C − F_0, turned into the direction of motion: what is left to Coulomb friction at the reversal.
        let left_n = (k.coulomb_n - direction * self.anchor_force_n) * decay;
        self.force_n = direction * (k.coulomb_n - left_n);
        self.slope_n_per_m = left_n * (k.stiffness_n_per_m / k.coulomb_n);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const COUNT_M: f64 = 4e-6 / 65536.0;

    fn coefficients(hysteresis_ct: i32) -> Coefficients {
        Coefficients {
            stiffness_n_per_m: 4e6,
            coulomb_n: 0.6,
            exponent_per_ct: (4e6 / 0.6 * COUNT_M) as f32,
            hysteresis_ct,
        }
    }

    /// Dahl's differential equation, (2.5) corrected, in small explicit steps of a tenth of a count.
    fn integrate(force_n: f64, from: i64, to: i64) -> f64 {
        let steps = (to - from).abs() * 10;
        let dx = (to - from).signum() as f64 * COUNT_M / 10.0;
        (0..steps).fold(force_n, |f, _| f + 4e6 * (1.0 - f / 0.6 * dx.signum()) * dx)
    }

    #[test]
    fn the_closed_form_is_the_differential_equation_through_reversals() {
        let k = coefficients(0);
        let mut model = Dahl::relaxed(Position(0));
        model.update(&k, Position(0));
        let (mut at, mut truth) = (0i64, 0.0f64);
        for to in [3_000, 1_500, 2_700, -4_000, 0, 6_000] {
            while at != to {
                let next = at + (to - at).clamp(-50, 50);
                truth = integrate(truth, at, next);
                at = next;
                model.update(&k, Position(at));
            }
            assert!((f64::from(model.force_n()) - truth).abs() < 1e-4, "{} {truth} at {at}", model.force_n());
        }
    }

    #[test]
    fn the_slope_is_twice_the_stiffness_right_after_a_reversal_from_full_friction() {
        let k = coefficients(0);
        let mut model = Dahl::relaxed(Position(0));
        model.update(&k, Position(1_000_000));
        assert!(model.slope_n_per_m() < 1.0 && model.force_n() == 0.6);
        model.update(&k, Position(999_999));
        assert!((model.slope_n_per_m() / 8e6 - 1.0).abs() < 1e-3);
    }

    #[test]
    fn noise_below_the_hysteresis_is_no_reversal() {
        let k = coefficients(16);
        let mut model = Dahl::relaxed(Position(0));
        model.update(&k, Position(5_000));
        let (force, slope) = (model.force_n(), model.slope_n_per_m());
        for offset in [-1, -16, -3, 0, -9] {
            model.update(&k, Position(5_000 + offset));
            assert_eq!((model.force_n(), model.slope_n_per_m()), (force, slope));
        }
        model.update(&k, Position(5_000 - 17));
        assert!(model.slope_n_per_m() > slope);
    }

    proptest! {
        #[test]
        fn force_and_slope_keep_their_bounds_on_any_path(path in proptest::collection::vec(-2_000_000_000i64..2_000_000_000, 1..300)) {
            let k = coefficients(16);
            let mut model = Dahl::relaxed(Position(0));
            for position in path {
                model.update(&k, Position(position));
                prop_assert!(model.force_n().abs() <= 0.6);
                prop_assert!((0.0..=8.000_1e6).contains(&model.slope_n_per_m()));
            }
        }
    }
}
