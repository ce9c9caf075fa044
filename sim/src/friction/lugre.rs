//! The LuGre model: bristles with stiffness and damping.

use serde::{Deserialize, Serialize};

use super::stribeck::Level;
use super::velocity_m_per_s;

/// `dz/dt = v − σ0 |v|/s(v) z`, `F = σ0 z + σ1 dz/dt + σ2 v`.
///
/// # Source
/// Equations 2.7 and 2.8 with the even `s(v)` of 2.4.
///
/// # Passivity
/// With `σ1 = 0` no motion gets more energy back than `σ0 z²/2`. With damping that needs `σ2 ≥ σ1 (F_s/F_C − 1)` (Barabanov
/// and Ortega 2000): the bristles' damping drives while the deflection shrinks in acceleration.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct LuGre {
    parameters: Parameters,
    deflection_m: f64,
    force_n: f64,
}

/// Parameters of [`LuGre`].
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Parameters {
    /// Stiffness of the bristles σ0, N/m, above 0.
    pub stiffness_n_per_m: f64,
    /// Damping of the bristles σ1, N s/m, at least 0.
    pub damping_n_s_per_m: f64,
    /// Viscous friction σ2, N s/m, at least 0.
    pub viscous_n_s_per_m: f64,
    /// The level of sliding friction, `s(v)`.
    pub level: Level,
}

impl LuGre {
    /// A contact without force.
    pub fn new(parameters: Parameters) -> LuGre {
        LuGre { parameters, deflection_m: 0.0, force_n: 0.0 }
    }

    /// Moves the contact by `dx_m` in `dt_s` at constant velocity and returns the force that opposes positive motion, N, with
    /// the mean `dz/dt` of the step.
    ///
    /// At constant velocity the deflection is an exponential in `x`: `z ← ±s/σ0 − (±s/σ0 − z) e^(−σ0|dx|/s)`, exact for a step
    /// of any length.
    pub fn advance(&mut self, dx_m: f64, dt_s: f64) -> f64 {
        let p = &self.parameters;
        let velocity_m_per_s = velocity_m_per_s(dx_m, dt_s);
        let level_n = p.level.at(velocity_m_per_s);
        let goal_m = if dx_m < 0.0 { -level_n } else { level_n } / p.stiffness_n_per_m;
        let moved_m = -libm::expm1(-p.stiffness_n_per_m * dx_m.abs() / level_n) * (goal_m - self.deflection_m);
        self.deflection_m += moved_m;
        self.force_n = p.stiffness_n_per_m * self.deflection_m
            + p.damping_n_s_per_m * self::velocity_m_per_s(moved_m, dt_s)
            + p.viscous_n_s_per_m * velocity_m_per_s;
        self.force_n
    }

    /// The force of the last step, N.
    pub fn force_n(&self) -> f64 {
        self.force_n
    }

    /// Mean deflection of the bristles z, m, within ±F_s/σ0.
    pub fn deflection_m(&self) -> f64 {
        self.deflection_m
    }

    /// The energy in the bristles, `σ0 z² / 2`, J.
    pub fn stored_j(&self) -> f64 {
        0.5 * self.parameters.stiffness_n_per_m * self.deflection_m * self.deflection_m
    }

    /// Changes σ0 (N/m) and F_C (N), both positive, and F_s in proportion; the force keeps its fraction of F_C.
    pub fn set(&mut self, stiffness_n_per_m: f64, coulomb_n: f64) {
        let scale = coulomb_n / self.parameters.level.coulomb_n;
        self.deflection_m *= scale * self.parameters.stiffness_n_per_m / stiffness_n_per_m;
        self.force_n *= scale;
        self.parameters.stiffness_n_per_m = stiffness_n_per_m;
        self.parameters.level = self.parameters.level.with_coulomb(coulomb_n);
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::friction::Dahl;

    const PARAMETERS: Parameters = Parameters {
        stiffness_n_per_m: 8.66e6,
        damping_n_s_per_m: 400.0,
        viscous_n_s_per_m: 300.0,
        level: Level { coulomb_n: 0.64, static_n: 0.9, stribeck_m_per_s: 1e-3, stribeck_shape: 2.0 },
    };

    proptest! {
        #[test]
        fn without_damping_and_stribeck_effect_it_is_dahl(steps_m in prop::collection::vec(-3e-7..3e-7, 1..40), dt_s in 1e-6..1e-3) {
            let level = Level::constant(0.64);
            let mut lugre = LuGre::new(Parameters { damping_n_s_per_m: 0.0, viscous_n_s_per_m: 0.0, level, ..PARAMETERS });
            let mut dahl = Dahl::new(8.66e6, 0.64);
            for dx_m in steps_m {
                let (a_n, b_n) = (lugre.advance(dx_m, dt_s), dahl.advance(dx_m));
                prop_assert!((a_n - b_n).abs() < 1e-14, "{} {}", a_n, b_n);
            }
        }
    }

    #[test]
    fn steady_sliding_gives_the_stribeck_curve_and_the_drag() {
        for velocity_m_per_s in [1e-5, -5e-4, 1e-3, -0.1] {
            let mut lugre = LuGre::new(PARAMETERS);
            for _ in 0..100 {
                lugre.advance(1e-6f64.copysign(velocity_m_per_s), 1e-6 / velocity_m_per_s.abs());
            }
            let expected_n =
                PARAMETERS.level.at(velocity_m_per_s).copysign(velocity_m_per_s) + 300.0 * velocity_m_per_s;
            assert!((lugre.force_n() - expected_n).abs() < 1e-12, "{velocity_m_per_s} m/s: {} N", lugre.force_n());
        }
    }

    #[test]
    fn small_motions_see_a_spring_and_a_damper() {
        let (mut lugre, dt_s) = (LuGre::new(PARAMETERS), 1e-6);
        let velocity_m_per_s = 1e-6; // σ0 v dt is ten millionths of s
        let force_n = lugre.advance(velocity_m_per_s * dt_s, dt_s);
        let expected_n = 8.66e6 * velocity_m_per_s * dt_s + (400.0 + 300.0) * velocity_m_per_s;
        assert!((force_n / expected_n - 1.0).abs() < 1e-5, "{force_n} N, {expected_n} N");
    }

    #[test]
    fn breaking_away_slowly_the_force_passes_static_friction_on_its_way_to_coulomb() {
        let mut lugre = LuGre::new(Parameters { damping_n_s_per_m: 0.0, viscous_n_s_per_m: 0.0, ..PARAMETERS });
        let peak_n = (0..20_000).fold(0.0f64, |peak_n, i| {
            let velocity_m_per_s = 2e-7 * f64::from(i);
            peak_n.max(lugre.advance(velocity_m_per_s * 1e-4, 1e-4))
        });
        assert!((0.85..0.9).contains(&peak_n), "{peak_n} N");
        assert!((lugre.force_n() - 0.64).abs() < 1e-6, "{} N", lugre.force_n());
    }
}
