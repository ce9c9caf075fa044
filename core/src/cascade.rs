//! Position and velocity loop in cascade, and their equivalence to the thesis' parallel PID (7.51).
//!
//! ```text
//! velocity error  w = K_p·e + de/dt            K_p: position gain, 1/s
//! force           F = K_v·w + ∫ K_v·K_i·w dt   K_v: velocity gain, N s/m;  K_i: velocity integral rate, 1/s
//! ```
//! Multiplied out this is the parallel form with `k_D = K_v`, `k_P = K_v (K_p + K_i)`, `k_I = K_v K_p K_i`.
//! Back again, `K_p` and `K_i` are the roots of `s² − (k_P/k_D) s + k_I/k_D`; they are real, and the conversion possible, if
//! and only if `k_P² ≥ 4 k_I k_D`. The larger root is taken as position gain.

use crate::SERVO_DT_S;
use crate::refusal::{Field, Refusal};

/// Gains of the parallel form, as the thesis gives them.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct ParallelGains {
    /// k_P, N/m.
    pub kp_n_per_m: f64,
    /// k_I, N/(m s).
    pub ki_n_per_m_s: f64,
    /// k_D, N s/m.
    pub kd_n_s_per_m: f64,
}

/// Gains of the cascade.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CascadeGains {
    /// K_p, 1/s.
    pub position_per_s: f64,
    /// K_v, N s/m.
    pub velocity_n_s_per_m: f64,
    /// K_i, 1/s.
    pub integral_per_s: f64,
}

impl CascadeGains {
    /// The cascade equal to parallel gains.
    ///
    /// # Errors
    /// `k_D` must be above 0 (and at most 1e6), `k_P` in `0..=1e9`, `k_I` in `0..=k_P²/(4 k_D)` (the condition above).
    pub fn from_parallel(gains: ParallelGains) -> Result<Self, Refusal> {
        let kd = Refusal::check(Field::DerivativeGain, gains.kd_n_s_per_m, 1e-3, 1e6)?;
        let kp = Refusal::check(Field::ProportionalGain, gains.kp_n_per_m, 0.0, 1e9)?;
        let half = kp / kd / 2.0;
        let ki = Refusal::check(Field::IntegralGain, gains.ki_n_per_m_s, 0.0, half * half * kd)?;
        let spread = libm::sqrt((half * half - ki / kd).max(0.0));
        let position = half + spread;
        // The small root from the product of both: subtracting would lose its digits.
        let integral = if position > 0.0 { ki / kd / position } else { 0.0 };
        Ok(CascadeGains { position_per_s: position, velocity_n_s_per_m: kd, integral_per_s: integral })
    }

    /// The parallel gains of this cascade.
    pub fn to_parallel(self) -> ParallelGains {
        let (p, v, i) = (self.position_per_s, self.velocity_n_s_per_m, self.integral_per_s);
        ParallelGains { kp_n_per_m: v * (p + i), ki_n_per_m_s: v * p * i, kd_n_s_per_m: v }
    }
}

/// Cascade coefficients of the tick.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Coefficients {
    /// Velocity error per count of position error, m/s.
    pub position_m_per_s_per_ct: f32,
    /// Velocity error per count of change of the position error from tick to tick, m/s.
    pub rate_m_per_s_per_ct: f32,
    /// K_v, N s/m.
    pub velocity_n_s_per_m: f32,
    /// K_i · dt.
    pub integral_per_tick: f32,
    /// k_P of the parallel form, N/m: what NIASA may add to its schedule.
    pub proportional_n_per_m: f32,
}

impl Coefficients {
    /// Coefficients for encoder counts of `count_m` metres.
    pub fn new(gains: CascadeGains, count_m: f64) -> Self {
        let dt = f64::from(SERVO_DT_S);
        Coefficients {
            position_m_per_s_per_ct: (gains.position_per_s * count_m) as f32,
            rate_m_per_s_per_ct: (count_m / dt) as f32,
            velocity_n_s_per_m: gains.velocity_n_s_per_m as f32,
            integral_per_tick: (gains.integral_per_s * dt) as f32,
            proportional_n_per_m: gains.to_parallel().kp_n_per_m as f32,
        }
    }
}

/// The loop's memory.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct State {
    /// Force of the velocity integrator, N.
    pub integral_n: f64,
    /// Position error of the last tick, counts.
    last_error_ct: i32,
}

/// One tick's result.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Terms {
    /// K_v·w, N: proportional and derivative part of the parallel form together.
    pub proportional_n: f32,
    /// The share of it that follows the rate of the error, N.
    pub rate_n: f32,
    /// What the integrator wants to add in this tick, N; [`State::integrate`] does it.
    pub increment_n: f32,
}

impl State {
    /// Starts at rest with error `error_ct` and no force.
    pub fn reset(&mut self, error_ct: i32) {
        *self = State { integral_n: 0.0, last_error_ct: error_ct };
    }

    /// Forces for the position error of this tick. The integrator is not moved yet: whether it may depends on the limits that
    /// the sum of all terms meets.
    #[inline]
    pub fn terms(&mut self, k: &Coefficients, error_ct: i32) -> Terms {
        let change_ct = error_ct.wrapping_sub(self.last_error_ct);
        self.last_error_ct = error_ct;
        let rate_n = change_ct as f32 * k.rate_m_per_s_per_ct * k.velocity_n_s_per_m;
        let proportional_n = error_ct as f32 * k.position_m_per_s_per_ct * k.velocity_n_s_per_m + rate_n;
        Terms { proportional_n, rate_n, increment_n: proportional_n * k.integral_per_tick }
    }

    /// Adds an increment to the integrator.
    #[inline]
    pub fn integrate(&mut self, increment_n: f32) {
        self.integral_n += f64::from(increment_n);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const COUNT_M: f64 = 4e-6 / 65536.0;
    const STANDARD: ParallelGains = ParallelGains { kp_n_per_m: 4.31e5, ki_n_per_m_s: 1.6e7, kd_n_s_per_m: 912.0 };

    #[test]
    fn gains_that_no_cascade_has_are_refused_with_the_bound() {
        let refused = CascadeGains::from_parallel(ParallelGains { ki_n_per_m_s: 6e7, ..STANDARD }).unwrap_err();
        let Refusal::OutOfRange { field: Field::IntegralGain, value, min, max } = refused else {
            panic!("{refused:?}")
        };
        assert_eq!((value, min), (6e7, 0.0));
        assert!((max / (4.31e5 * 4.31e5 / (4.0 * 912.0)) - 1.0).abs() < 1e-12);
    }

    #[test]
    fn a_gain_that_is_not_a_number_is_refused() {
        for gains in [
            ParallelGains { kp_n_per_m: f64::NAN, ..STANDARD },
            ParallelGains { ki_n_per_m_s: f64::NAN, ..STANDARD },
            ParallelGains { kd_n_s_per_m: f64::NAN, ..STANDARD },
            ParallelGains { kd_n_s_per_m: 0.0, ..STANDARD },
            ParallelGains { kp_n_per_m: -1.0, ..STANDARD },
        ] {
            assert!(matches!(CascadeGains::from_parallel(gains), Err(Refusal::OutOfRange { .. })), "{gains:?}");
        }
    }

    #[test]
    fn one_nanometre_held_for_a_second_integrates_to_the_right_force() {
        let k = Coefficients::new(CascadeGains::from_parallel(STANDARD).unwrap(), COUNT_M);
        let error_ct = 16; // 0.977 nm
        for already_there_n in [0.0, 0.6, 40.0] {
            let mut state = State::default();
            state.reset(error_ct);
            state.integral_n = already_there_n;
            for _ in 0..crate::SERVO_HZ {
                let terms = state.terms(&k, error_ct);
                state.integrate(terms.increment_n);
            }
            let expected_n = STANDARD.ki_n_per_m_s * f64::from(error_ct) * COUNT_M;
            assert!(((state.integral_n - already_there_n) / expected_n - 1.0).abs() < 1e-3);
        }
    }

    proptest! {
        #[test]
        fn converting_to_a_cascade_and_back_is_the_identity(kp in 1e3f64..1e7, kd in 1.0f64..1e4, share in 0.0f64..1.0) {
            let gains = ParallelGains { kp_n_per_m: kp, kd_n_s_per_m: kd, ki_n_per_m_s: share * kp * kp / (4.0 * kd) };
            let back = CascadeGains::from_parallel(gains).unwrap().to_parallel();
            prop_assert!((back.kp_n_per_m / kp - 1.0).abs() < 1e-7);
            prop_assert!((back.ki_n_per_m_s - gains.ki_n_per_m_s).abs() <= 1e-9 * (kp * kp / kd));
            prop_assert_eq!(back.kd_n_s_per_m, kd);
        }

        #[test]
        fn the_cascade_gives_the_force_of_the_parallel_pid(errors in proptest::collection::vec(-40_000i32..40_000, 1..200)) {
            let k = Coefficients::new(CascadeGains::from_parallel(STANDARD).unwrap(), COUNT_M);
            let dt = f64::from(SERVO_DT_S);
            let mut state = State::default();
            state.reset(0);
            let (mut integral, mut last) = (0.0, 0.0);
            for error_ct in errors {
                let terms = state.terms(&k, error_ct);
                state.integrate(terms.increment_n);
                let force = f64::from(terms.proportional_n) + state.integral_n;
                let e = f64::from(error_ct) * COUNT_M;
                integral += STANDARD.ki_n_per_m_s * e * dt;
                let parallel = STANDARD.kp_n_per_m * e + integral + STANDARD.kd_n_s_per_m * (e - last) / dt;
                last = e;
                prop_assert!((force - parallel).abs() < 1e-5 * (1.0 + parallel.abs() + 40.0), "{force} {parallel}");
            }
        }
    }
}
