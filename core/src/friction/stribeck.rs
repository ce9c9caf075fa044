//! The Stribeck curve (2.4).

use super::coulomb::sign;

/// The level of sliding friction, even in velocity: `s(v) = F_C + (F_s − F_C) exp(−|v/V_s|^δ)`.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Level {
    /// Level of kinetic (Coulomb) friction F_C, N, above 0.
    pub coulomb_n: f32,
    /// Level of static friction F_s, N, at least F_C.
    pub static_n: f32,
    /// Stribeck velocity V_s, m/s, above 0.
    pub stribeck_m_per_s: f32,
    /// Shape factor δ, above 0; 1 and 2 cost an exponential, others a power as well.
    pub stribeck_shape: f32,
}

/// Parameters.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Coefficients {
    /// The curve.
    pub level: Level,
    /// Coefficient of viscous friction σ2, N s/m, at least 0.
    pub viscous_n_s_per_m: f32,
}

impl Level {
    /// Without Stribeck effect: F_C at every speed, and no exponential to compute.
    pub const fn constant(coulomb_n: f32) -> Self {
        Level { coulomb_n, static_n: coulomb_n, stribeck_m_per_s: 1.0, stribeck_shape: 1.0 }
    }

    /// `s(v)`, N, within `F_C..=F_s`.
    #[inline]
    pub fn at(&self, velocity_m_per_s: f32) -> f32 {
        if self.static_n == self.coulomb_n {
            return self.coulomb_n;
        }
        let speed = libm::fabsf(velocity_m_per_s) / self.stribeck_m_per_s;
        let exponent = if self.stribeck_shape == 1.0 {
            speed
        } else if self.stribeck_shape == 2.0 {
            speed * speed
        } else {
            libm::powf(speed, self.stribeck_shape)
        };
        self.coulomb_n + (self.static_n - self.coulomb_n) * libm::expf(-exponent)
    }
}

/// `F = s(v) sgn v + σ2 v`, N; without motion 0. There is no state.
#[inline]
pub fn step(k: &Coefficients, velocity_m_per_s: f32) -> f32 {
    k.level.at(velocity_m_per_s) * sign(velocity_m_per_s) + k.viscous_n_s_per_m * velocity_m_per_s
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::friction::coulomb;

    #[test]
    fn the_level_falls_from_static_to_coulomb() {
        for shape in [1.0, 2.0, 0.7] {
            let level = Level { coulomb_n: 0.6, static_n: 0.9, stribeck_m_per_s: 1e-3, stribeck_shape: shape };
            assert_eq!((level.at(0.0), level.at(10.0)), (0.9, 0.6));
            for velocity in [1e-3, -1e-3] {
                assert!((level.at(velocity) - (0.6 + 0.3 * 0.367_879_44)).abs() < 1e-6);
            }
            let (slow, fast) = (level.at(0.5e-3), level.at(2e-3));
            assert!(slow > level.at(1e-3) && fast < level.at(1e-3));
        }
    }

    #[test]
    fn without_excess_static_friction_it_is_coulomb() {
        let k = Coefficients { level: Level::constant(0.6), viscous_n_s_per_m: 2.0 };
        let plain = coulomb::Coefficients { coulomb_n: 0.6, viscous_n_s_per_m: 2.0 };
        for velocity in [0.0, 1e-9, -3e-4, 0.2] {
            assert_eq!(step(&k, velocity), coulomb::step(&plain, velocity));
        }
    }
}
