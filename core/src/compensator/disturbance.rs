//! Disturbance observer: what an engineer would otherwise take.
//!
//! The mass is nominal, everything else is disturbance: `d̂ = Q(s)·(u − m·a)` with `Q = L/(s + L)`, and `u = u_PD + d̂`. Written with
//! the momentum `p = m·v` instead of the acceleration, `d̂ = L·(∫(u − d̂) dt − p)`, no difference of differences is needed.
//!
//! # Source
//! Not in the thesis, which mentions it in 4.2.1 ([15, 19] there).

use super::{Action, Situation};
use crate::SERVO_DT_S;

/// Coefficients of the tick.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Coefficients {
    /// Bandwidth L of the filter, 1/s, above 0.
    pub bandwidth_per_s: f32,
    /// Momentum per count of movement in a tick, N s: m·count/dt.
    pub momentum_n_s_per_ct: f32,
}

/// The observer's memory.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct State {
    /// ∫(u − d̂) dt, N s.
    expected_n_s: f64,
    estimate_n: f32,
    /// Estimate that [`State::expected_n_s`] has yet to be set for: the bandwidth is not known before the first tick.
    initial_n: Option<f64>,
}

impl State {
    /// Begins with an estimate of `force_n`.
    pub fn estimating(force_n: f64) -> Self {
        State { expected_n_s: 0.0, estimate_n: force_n as f32, initial_n: Some(force_n) }
    }

    /// The estimate, added at once; it does what an integrator does, so that the cascade's own stands still.
    #[inline]
    pub fn act(&mut self, k: &Coefficients, tick: &Situation) -> Action {
        let momentum_n_s = f64::from(tick.step_ct as f32 * k.momentum_n_s_per_ct);
        if let Some(force_n) = self.initial_n.take() {
            self.expected_n_s = momentum_n_s + force_n / f64::from(k.bandwidth_per_s);
        } else {
            self.expected_n_s += f64::from((tick.force_n - self.estimate_n) * SERVO_DT_S);
        }
        self.estimate_n = k.bandwidth_per_s * (self.expected_n_s - momentum_n_s) as f32;
        Action { direct_n: self.estimate_n, friction_n: self.estimate_n, replaces_integral: true, ..Action::NONE }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::position::Position;
    use crate::profile::Profile;

    fn tick(step_ct: i32, force_n: f32) -> Situation {
        let reference = Profile::at_rest(Position(0)).advance();
        Situation { position: Position(0), step_ct, error_ct: 0, reference, proportional_n_per_m: 0.0, force_n }
    }

    #[test]
    fn a_force_that_moves_nothing_is_all_disturbance_after_a_few_time_constants() {
        let k = Coefficients { bandwidth_per_s: 400.0, momentum_n_s_per_ct: 1e-6 };
        let mut observer = State::estimating(0.0);
        let mut estimate = 0.0;
        // 1 N on a stage that stands still; one time constant is 20 ticks.
        for ticks in 0..200 {
            estimate = observer.act(&k, &tick(0, 1.0)).direct_n;
            if ticks == 20 {
                assert!((estimate - 0.63).abs() < 0.02, "{estimate}");
            }
        }
        assert!((estimate - 1.0).abs() < 1e-3);
    }

    #[test]
    fn a_free_mass_that_moves_as_it_should_has_no_disturbance() {
        let (mass_kg, count_m) = (1.8, 4e-6 / 65536.0);
        let k = Coefficients { bandwidth_per_s: 400.0, momentum_n_s_per_ct: (mass_kg * count_m * 8000.0) as f32 };
        let mut observer = State::estimating(0.0);
        let (mut velocity, mut position, mut worst) = (0.0f64, 0.0f64, 0.0f32);
        for _ in 0..2000 {
            let before = (position / count_m).round() as i64;
            velocity += 2.0 / mass_kg / 8000.0;
            position += velocity / 8000.0;
            let after = (position / count_m).round() as i64;
            worst = worst.max(observer.act(&k, &tick((after - before) as i32, 2.0)).direct_n.abs());
        }
        // Sampling: the velocity between two samples is that half a tick ago, the force that of the last tick.
        assert!(worst < 2.0 * 400.0 / 8000.0 + 0.01, "{worst}");
    }

    #[test]
    fn it_begins_with_the_estimate_it_is_given() {
        let k = Coefficients { bandwidth_per_s: 400.0, momentum_n_s_per_ct: 1e-6 };
        assert!((State::estimating(0.4).act(&k, &tick(3, 0.4)).direct_n - 0.4).abs() < 1e-6);
    }
}
