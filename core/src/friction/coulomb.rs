//! Coulomb and viscous friction (2.1, 2.3).

/// Parameters.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Coefficients {
    /// Level of Coulomb friction F_C, N, at least 0.
    pub coulomb_n: f32,
    /// Coefficient of viscous friction σ2, N s/m, at least 0.
    pub viscous_n_s_per_m: f32,
}

/// `F = F_C sgn v + σ2 v`, N; without motion 0. There is no state.
#[inline]
pub fn step(k: &Coefficients, velocity_m_per_s: f32) -> f32 {
    k.coulomb_n * sign(velocity_m_per_s) + k.viscous_n_s_per_m * velocity_m_per_s
}

/// −1, 0 or 1; 0 for what is not a number.
#[inline]
pub(super) fn sign(value: f32) -> f32 {
    if value > 0.0 {
        1.0
    } else if value < 0.0 {
        -1.0
    } else {
        0.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_force_is_odd_in_velocity_and_zero_without() {
        let k = Coefficients { coulomb_n: 0.6, viscous_n_s_per_m: 2.0 };
        for (velocity, force) in [(0.1, 0.8), (-0.1, -0.8), (1e-9, 0.6), (0.0, 0.0), (-0.0, 0.0)] {
            assert!((step(&k, velocity) - force).abs() < 1e-7, "{velocity} m/s");
        }
    }
}
