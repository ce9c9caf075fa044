//! Dahl friction with any shape factor (2.5), stepped by velocity.
//!
//! [`super::dahl`] follows the measured position and needs no step; this one is for feedforward and for observers.

/// Parameters.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Coefficients {
    /// Initial contact stiffness σ, N/m, above 0.
    pub stiffness_n_per_m: f32,
    /// Level of Coulomb friction F_C, N, above 0.
    pub coulomb_n: f32,
    /// Shape factor i, at least 0. 1 costs an exponential; others a power and, but for 2, a second one.
    pub shape: f32,
}

/// Friction as a fraction of F_C, so that new coefficients keep what is remembered.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct ShapedDahl {
    /// F/F_C, within ±1.
    fraction: f32,
}

impl ShapedDahl {
    /// No friction force.
    pub const RELAXED: Self = ShapedDahl { fraction: 0.0 };

    /// The force, N, within ±F_C.
    #[inline]
    pub fn force_n(&self, k: &Coefficients) -> f32 {
        self.fraction * k.coulomb_n
    }

    /// Replaces the force, N, limited to ±F_C: the driving term of an observer.
    pub fn set_force(&mut self, k: &Coefficients, force_n: f32) {
        self.fraction = (force_n / k.coulomb_n).clamp(-1.0, 1.0);
    }

    /// Slope dF/dx for motion in `direction` (its sign), N/m, within `0..=2^i σ`.
    #[inline]
    pub fn slope_n_per_m(&self, k: &Coefficients, direction: f32) -> f32 {
        let rest = if direction < 0.0 { 1.0 + self.fraction } else { 1.0 - self.fraction };
        let power = if k.shape == 1.0 { rest } else { libm::powf(rest, k.shape) };
        k.stiffness_n_per_m * power
    }

    /// Moves at `velocity_m_per_s` for `dt_s`; the force, N.
    ///
    /// With `w = 1 − F/F_C sgn v`, what is left, (2.5) is `dw/da = −w^i` along `a = σ|v|dt/F_C`, so that
    /// `w ← w e^(−a)` for i = 1 and `w ← (w^(1−i) + (i−1) a)^(1/(1−i))` otherwise: exact for any `a`.
    ///
    /// # Source
    /// (2.5) corrected (the factor `sgn v`).
    #[inline]
    pub fn step(&mut self, k: &Coefficients, velocity_m_per_s: f32, dt_s: f32) -> f32 {
        let direction = if velocity_m_per_s < 0.0 { -1.0 } else { 1.0 };
        let rest = 1.0 - direction * self.fraction;
        let path = k.stiffness_n_per_m / k.coulomb_n * libm::fabsf(velocity_m_per_s) * dt_s;
        self.fraction = direction * (1.0 - left(rest, path, k.shape));
        self.force_n(k)
    }
}

/// What is left of `rest` (0 to 2) after `path`, for shape factor `shape`.
#[inline]
fn left(rest: f32, path: f32, shape: f32) -> f32 {
    if shape == 1.0 {
        return rest * libm::expf(-path);
    }
    if shape == 2.0 {
        return rest / (1.0 + path * rest);
    }
    // Nothing left stays so; and 1/(1 − i) has no place for shape factors next to 1, which are 1 to an f32.
    if rest <= 0.0 || libm::fabsf(shape - 1.0) < 1e-4 {
        return rest.max(0.0) * libm::expf(-path);
    }
    let inner = libm::powf(rest, 1.0 - shape) + (shape - 1.0) * path;
    // For i < 1 the rest is used up after a finite path; for i > 1 a huge inner value leaves nothing, as it should.
    if inner <= 0.0 { 0.0 } else { libm::powf(inner, 1.0 / (1.0 - shape)).min(rest) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn coefficients(shape: f32) -> Coefficients {
        Coefficients { stiffness_n_per_m: 4e6, coulomb_n: 0.6, shape }
    }

    #[test]
    fn the_closed_forms_follow_the_differential_equation_through_reversals() {
        for shape in [0.0, 0.5, 1.0, 1.5, 2.0, 3.0] {
            let k = coefficients(shape);
            let (mut model, mut truth) = (ShapedDahl::RELAXED, 0.0f64);
            // 125 µs at these velocities, m/s: between 25 nm and 0.5 µm.
            for velocity in [1e-3f32, -2e-4, 3e-4, -4e-3, 2e-4, 2e-4] {
                model.step(&k, velocity, 125e-6);
                let (steps, dx) = (100_000, f64::from(velocity) * 125e-6 / 1e5);
                for _ in 0..steps {
                    let rest = (1.0 - truth / 0.6 * dx.signum()).max(0.0);
                    truth += 4e6 * libm::pow(rest, f64::from(shape)) * dx * f64::from(u8::from(rest > 0.0));
                }
                let force = f64::from(model.force_n(&k));
                assert!((force - truth).abs() < 2e-5, "i = {shape}, {velocity} m/s: {force} {truth}");
            }
        }
    }

    #[test]
    fn the_slope_is_sigma_from_rest_and_2_to_the_i_sigma_after_a_reversal() {
        for (shape, after) in [(1.0, 2.0), (2.0, 4.0), (0.0, 1.0)] {
            let (k, mut model) = (coefficients(shape), ShapedDahl::RELAXED);
            assert_eq!(model.slope_n_per_m(&k, 1.0), 4e6);
            model.set_force(&k, 5.0);
            assert_eq!(model.force_n(&k), 0.6);
            assert!((model.slope_n_per_m(&k, -1.0) / 4e6 - after).abs() < 1e-6);
        }
    }

    #[test]
    fn new_coefficients_keep_the_fraction() {
        let mut model = ShapedDahl::RELAXED;
        model.step(&coefficients(1.0), 1e-3, 125e-6);
        let before = model.force_n(&coefficients(1.0)) / 0.6;
        let other = Coefficients { stiffness_n_per_m: 8e6, coulomb_n: 0.3, shape: 2.0 };
        assert!((model.force_n(&other) / 0.3 - before).abs() < 1e-6);
    }

    proptest! {
        #[test]
        fn the_force_keeps_its_bounds_and_moves_against_the_motion(
            path in proptest::collection::vec(-0.5f32..0.5, 1..100), shape in 0.0f32..5.0,
        ) {
            let (k, mut model) = (coefficients(shape), ShapedDahl::RELAXED);
            for velocity in path {
                let before = model.force_n(&k);
                let force = model.step(&k, velocity, 125e-6);
                prop_assert!(force.abs() <= 0.600_000_1);
                prop_assert!((force - before) * velocity >= -1e-8, "{} {}", before, force);
            }
        }
    }
}
