//! LuGre friction (2.7, 2.8) and its observer (4.4, 4.5).

use super::stribeck::Level;

/// Parameters.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Coefficients {
    /// Stiffness of the bristles σ0, N/m, above 0.
    pub stiffness_n_per_m: f32,
    /// Damping of the bristles σ1, N s/m, at least 0.
    pub damping_n_s_per_m: f32,
    /// Coefficient of viscous friction σ2, N s/m, at least 0.
    pub viscous_n_s_per_m: f32,
    /// Level of sliding friction, s(v).
    pub level: Level,
}

/// The bristles' deflection.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct LuGre {
    /// z, m. Within ±F_s/σ0 without a driving term.
    pub deflection_m: f32,
}

impl LuGre {
    /// No deflection, no force.
    pub const RELAXED: Self = LuGre { deflection_m: 0.0 };

    /// Moves at `velocity_m_per_s` for `dt_s`; the force, N.
    ///
    /// # Source
    /// (2.7), (2.8) with the even s(v) of (2.4).
    #[inline]
    pub fn step(&mut self, k: &Coefficients, velocity_m_per_s: f32, dt_s: f32) -> f32 {
        self.step_driven(k, velocity_m_per_s, 0.0, dt_s)
    }

    /// The same with a driving term `k·e`, m/s, which moves the bristles although nothing slides: the friction observer. The
    /// force F̂, N, with the mean dẑ/dt of the step.
    ///
    /// `dẑ/dt = v + k e − σ0 |v|/s(v) ẑ` with constant v and e is linear in ẑ, and solved as such: `ẑ ← ẑ g + (v + k e) dt (1−g)/y`,
    /// `y = σ0 |v| dt/s(v)`, `g = e^(−y)`. Stable for every step; without motion the driving term integrates.
    ///
    /// # Range
    /// ẑ has no bound while it is driven; whoever drives it limits [`LuGre::deflection_m`] or the force.
    ///
    /// # Source
    /// (4.4) corrected (the factor σ0 ẑ), (4.5).
    #[inline]
    pub fn step_driven(&mut self, k: &Coefficients, velocity_m_per_s: f32, drive_m_per_s: f32, dt_s: f32) -> f32 {
        let speed_m_per_s = libm::fabsf(velocity_m_per_s);
        let y = k.stiffness_n_per_m * speed_m_per_s * dt_s / k.level.at(velocity_m_per_s);
        let before_m = self.deflection_m;
        let pushed_m = (velocity_m_per_s + drive_m_per_s) * dt_s;
        let gone = -libm::expm1f(-y); // 1 − g with all its digits, however small
        let share = if y > 0.0 { gone / y } else { 1.0 };
        self.deflection_m = before_m - before_m * gone + pushed_m * share;
        let rate_m_per_s = if dt_s > 0.0 { (self.deflection_m - before_m) / dt_s } else { 0.0 };
        k.stiffness_n_per_m * self.deflection_m
            + k.damping_n_s_per_m * rate_m_per_s
            + k.viscous_n_s_per_m * velocity_m_per_s
    }

    /// Slope dF/dx of the bristles for motion in `direction` (its sign) at `velocity_m_per_s`, N/m: `σ0 (1 − σ0 z/s sgn)`.
    #[inline]
    pub fn slope_n_per_m(&self, k: &Coefficients, direction: f32, velocity_m_per_s: f32) -> f32 {
        let filled = k.stiffness_n_per_m * self.deflection_m / k.level.at(velocity_m_per_s);
        k.stiffness_n_per_m * (1.0 - if direction < 0.0 { -filled } else { filled })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::friction::shaped_dahl::{self, ShapedDahl};
    use proptest::prelude::*;

    const DT_S: f32 = 125e-6;

    fn coefficients() -> Coefficients {
        Coefficients {
            stiffness_n_per_m: 4e6,
            damping_n_s_per_m: 300.0,
            viscous_n_s_per_m: 2.0,
            level: Level { coulomb_n: 0.6, static_n: 0.8, stribeck_m_per_s: 1e-3, stribeck_shape: 2.0 },
        }
    }

    #[test]
    fn without_motion_the_driving_term_integrates() {
        let (k, mut observer) = (coefficients(), LuGre::RELAXED);
        for _ in 0..800 {
            observer.step_driven(&k, 0.0, 1e-6, DT_S);
        }
        assert!((observer.deflection_m / 1e-7 - 1.0).abs() < 1e-4, "0.1 s at 1 µm/s: {} m", observer.deflection_m);
        let force = observer.step_driven(&k, 0.0, 1e-6, DT_S);
        assert!((force - (4e6 * observer.deflection_m + 300e-6)).abs() < 1e-6);
    }

    #[test]
    fn in_motion_the_driving_term_moves_the_balance() {
        // σ0 |v| ẑ/s = v + k e.
        let (k, mut observer) = (coefficients(), LuGre::RELAXED);
        for _ in 0..100 {
            observer.step_driven(&k, 0.02, 0.005, DT_S);
        }
        assert!((4e6 * observer.deflection_m - 0.6 * 1.25).abs() < 1e-5, "{} N", 4e6 * observer.deflection_m);
    }

    #[test]
    fn sliding_gives_the_stribeck_curve_and_the_drag() {
        for velocity in [1e-4f32, -1e-3, 0.1] {
            let (k, mut model) = (coefficients(), LuGre::RELAXED);
            let force = (0..2_000).map(|_| model.step(&k, velocity, DT_S)).last().unwrap_or(0.0);
            let expected = k.level.at(velocity) * velocity.signum() + 2.0 * velocity;
            assert!((force - expected).abs() < 1e-5, "{velocity} m/s: {force} N, {expected} N");
        }
    }

    proptest! {
        #[test]
        fn without_damping_and_stribeck_effect_it_is_dahl(path in proptest::collection::vec(-2e-3f32..2e-3, 1..200)) {
            let k = Coefficients { damping_n_s_per_m: 0.0, viscous_n_s_per_m: 0.0, level: Level::constant(0.6), ..coefficients() };
            let dahl = shaped_dahl::Coefficients { stiffness_n_per_m: 4e6, coulomb_n: 0.6, shape: 1.0 };
            let (mut lugre, mut reference) = (LuGre::RELAXED, ShapedDahl::RELAXED);
            for velocity in path {
                let force = lugre.step(&k, velocity, DT_S);
                prop_assert!((force - reference.step(&dahl, velocity, DT_S)).abs() < 2e-6);
                let slopes = (lugre.slope_n_per_m(&k, velocity, velocity), reference.slope_n_per_m(&dahl, velocity));
                prop_assert!((slopes.0 - slopes.1).abs() < 20.0, "{:?}", slopes);
            }
        }

        #[test]
        fn no_step_is_too_long(velocity in -1e3f32..1e3, dt in 0.0f32..10.0, deflection in -2e-7f32..2e-7) {
            let (k, mut model) = (coefficients(), LuGre { deflection_m: deflection });
            model.step(&k, velocity, dt);
            prop_assert!(model.deflection_m.abs() <= 2.000_1e-7);
        }
    }
}
