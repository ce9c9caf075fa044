//! Coulomb and viscous friction: a force that knows the velocity and nothing else.

use serde::{Deserialize, Serialize};

use super::velocity_m_per_s;

/// `F = F_C sgn v + σ2 v`.
///
/// # Source
/// Equations 2.1 and 2.3. `sgn 0` is 0; what holds a mass at rest is [`Coulomb::resist`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Coulomb {
    coulomb_n: f64,
    viscous_n_s_per_m: f64,
    force_n: f64,
}

impl Coulomb {
    /// A contact with the level F_C (N) and the viscous coefficient σ2 (N s/m), both at least 0.
    pub fn new(coulomb_n: f64, viscous_n_s_per_m: f64) -> Coulomb {
        Coulomb { coulomb_n, viscous_n_s_per_m, force_n: 0.0 }
    }

    /// Moves the contact by `dx_m` in `dt_s` and returns the force that opposes positive motion, N.
    pub fn advance(&mut self, dx_m: f64, dt_s: f64) -> f64 {
        let velocity_m_per_s = velocity_m_per_s(dx_m, dt_s);
        let sign = if dx_m == 0.0 { 0.0 } else { dx_m.signum() };
        self.force_n = self.coulomb_n * sign + self.viscous_n_s_per_m * velocity_m_per_s;
        self.force_n
    }

    /// The same for a mass that `stopping_n` would bring to rest in this step: friction is that force, as far as F_C goes.
    ///
    /// A mass in motion feels F_C against it, a mass at rest stays there until more than F_C pulls, without the chatter of
    /// `sgn v` around 0.
    pub fn resist(&mut self, dx_m: f64, dt_s: f64, stopping_n: f64) -> f64 {
        let drag_n = self.viscous_n_s_per_m * velocity_m_per_s(dx_m, dt_s);
        self.force_n = (stopping_n - drag_n).max(-self.coulomb_n).min(self.coulomb_n) + drag_n;
        self.force_n
    }

    /// The force of the last step, N.
    pub fn force_n(&self) -> f64 {
        self.force_n
    }

    /// Changes F_C (N, positive); the force keeps its fraction of it.
    pub fn set(&mut self, coulomb_n: f64) {
        self.force_n *= coulomb_n / self.coulomb_n;
        self.coulomb_n = coulomb_n;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_force_is_the_level_and_the_drag_against_the_motion() {
        let mut friction = Coulomb::new(0.64, 3.0);
        for (dx_m, dt_s, force_n) in
            [(1e-6, 1e-3, 0.643), (-1e-6, 1e-3, -0.643), (0.0, 1e-3, 0.0), (2e-4, 1e-3, 1.24), (-1e-6, 0.0, -0.64)]
        {
            assert!((friction.advance(dx_m, dt_s) - force_n).abs() < 1e-15, "{dx_m} m in {dt_s} s");
        }
    }

    #[test]
    fn a_mass_is_held_as_far_as_the_level_goes() {
        let mut friction = Coulomb::new(0.64, 0.0);
        for (stopping_n, force_n) in [(0.5, 0.5), (-0.5, -0.5), (0.7, 0.64), (-100.0, -0.64)] {
            assert_eq!(friction.resist(0.0, 1e-5, stopping_n), force_n);
        }
    }
}
