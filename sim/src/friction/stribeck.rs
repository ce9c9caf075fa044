//! The Stribeck curve, and friction that follows it.

use serde::{Deserialize, Serialize};

use super::velocity_m_per_s;

/// The level of sliding friction over speed: `s(v) = F_C + (F_s − F_C) exp(−|v/V_s|^δ)`, even in `v`.
///
/// # Source
/// Equation 2.4.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Level {
    /// Level of kinetic (Coulomb) friction F_C, N, above 0.
    pub coulomb_n: f64,
    /// Level of static friction F_s, N, at least F_C.
    pub static_n: f64,
    /// Stribeck velocity V_s, m/s, above 0.
    pub stribeck_m_per_s: f64,
    /// Shape factor δ, above 0; typically 1.
    pub stribeck_shape: f64,
}

impl Level {
    /// Without Stribeck effect: `s(v) = F_C`, exactly.
    pub const fn constant(coulomb_n: f64) -> Level {
        Level { coulomb_n, static_n: coulomb_n, stribeck_m_per_s: 1.0, stribeck_shape: 1.0 }
    }

    /// `s(v)`, N.
    #[inline]
    pub fn at(&self, velocity_m_per_s: f64) -> f64 {
        let more_n = self.static_n - self.coulomb_n;
        if more_n == 0.0 {
            return self.coulomb_n;
        }
        let speed = (velocity_m_per_s / self.stribeck_m_per_s).abs();
        self.coulomb_n + more_n * libm::exp(-libm::pow(speed, self.stribeck_shape))
    }

    /// The curve with F_C and F_s in the same proportion and another F_C (N, positive).
    pub fn with_coulomb(self, coulomb_n: f64) -> Level {
        Level { coulomb_n, static_n: coulomb_n * (self.static_n / self.coulomb_n), ..self }
    }
}

/// `F = s(v) sgn v + σ2 v`.
///
/// # Source
/// Equation 2.4 with the sign of the motion, and 2.1. `sgn 0` is 0; what holds a mass at rest is [`Stribeck::resist`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Stribeck {
    level: Level,
    viscous_n_s_per_m: f64,
    force_n: f64,
}

impl Stribeck {
    /// A contact with the given curve and the viscous coefficient σ2 (N s/m, at least 0).
    pub fn new(level: Level, viscous_n_s_per_m: f64) -> Stribeck {
        Stribeck { level, viscous_n_s_per_m, force_n: 0.0 }
    }

    /// Moves the contact by `dx_m` in `dt_s` and returns the force that opposes positive motion, N.
    pub fn advance(&mut self, dx_m: f64, dt_s: f64) -> f64 {
        let velocity_m_per_s = velocity_m_per_s(dx_m, dt_s);
        let sign = if dx_m == 0.0 { 0.0 } else { dx_m.signum() };
        self.force_n = self.level.at(velocity_m_per_s) * sign + self.viscous_n_s_per_m * velocity_m_per_s;
        self.force_n
    }

    /// The same for a mass that `stopping_n` would bring to rest in this step: friction is that force, as far as `s(v)`
    /// goes. At rest that is F_s.
    pub fn resist(&mut self, dx_m: f64, dt_s: f64, stopping_n: f64) -> f64 {
        let velocity_m_per_s = velocity_m_per_s(dx_m, dt_s);
        let (limit_n, drag_n) = (self.level.at(velocity_m_per_s), self.viscous_n_s_per_m * velocity_m_per_s);
        self.force_n = (stopping_n - drag_n).max(-limit_n).min(limit_n) + drag_n;
        self.force_n
    }

    /// The force of the last step, N.
    pub fn force_n(&self) -> f64 {
        self.force_n
    }

    /// Changes F_C (N, positive), and F_s in proportion; the force keeps its fraction of F_C.
    pub fn set(&mut self, coulomb_n: f64) {
        self.force_n *= coulomb_n / self.level.coulomb_n;
        self.level = self.level.with_coulomb(coulomb_n);
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::friction::Coulomb;

    const LEVEL: Level = Level { coulomb_n: 0.6, static_n: 0.9, stribeck_m_per_s: 1e-3, stribeck_shape: 2.0 };

    #[test]
    fn the_curve_falls_from_static_to_coulomb_around_the_stribeck_velocity() {
        assert_eq!((LEVEL.at(0.0), LEVEL.at(1.0)), (0.9, 0.6));
        for velocity_m_per_s in [1e-3, -1e-3] {
            assert!((LEVEL.at(velocity_m_per_s) - (0.6 + 0.3 * libm::exp(-1.0))).abs() < 1e-15);
        }
        let half = Level { stribeck_shape: 1.0, ..LEVEL }.at(2e-3);
        assert!((half - (0.6 + 0.3 * libm::exp(-2.0))).abs() < 1e-15, "and the shape factor is the exponent");
    }

    #[test]
    fn a_mass_at_rest_is_held_by_static_friction_and_one_in_motion_feels_less() {
        let mut friction = Stribeck::new(LEVEL, 0.0);
        assert_eq!(friction.resist(0.0, 1e-5, 0.89), 0.89);
        assert_eq!(friction.resist(0.0, 1e-5, 0.91), 0.9);
        assert_eq!(friction.resist(1e-5, 1e-5, 0.91), 0.6);
    }

    proptest! {
        #[test]
        fn without_excess_static_friction_it_is_coulomb(dx_m in -1e-6..1e-6, dt_s in 1e-6..1e-3, stopping_n in -2.0..2.0) {
            let (mut stribeck, mut coulomb) = (Stribeck::new(Level::constant(0.6), 2.0), Coulomb::new(0.6, 2.0));
            prop_assert_eq!(stribeck.advance(dx_m, dt_s), coulomb.advance(dx_m, dt_s));
            prop_assert_eq!(stribeck.resist(dx_m, dt_s, stopping_n), coulomb.resist(dx_m, dt_s, stopping_n));
        }
    }
}
