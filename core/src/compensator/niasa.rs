//! NIASA: integral action scheduled by the slope of modelled pre-rolling friction (7.55).
//!
//! ```text
//! u = ∫ (1/τ_d)(dF̂/dx [+ k_P]) e dt + k_P e + k_D ė
//! ```
//! Right after a velocity reversal the bearings are a stiff spring, the modelled slope is high and the integrator fast; as the
//! stage rolls on, the slope and with it the extra action vanish.

use super::{Action, Situation};
use crate::friction::dahl::{self, Dahl};
use crate::friction::maxwell_slip::{self, MaxwellSlip};
use crate::position::Position;

/// What happens while the profile moves (8.1.2).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum DuringProfile {
    /// The compensator runs always; the rate limit keeps large motions stable (App. E as it ended).
    Active,
    /// The integrator keeps its value and the model is held relaxed at the measured position until the profile ends (App. E as it began).
    Frozen,
}

/// What the schedule multiplies with the error.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Schedule {
    /// `dF̂/dx` alone, beside the linear integral of the cascade (App. E).
    Slope,
    /// `dF̂/dx + k_P`, instead of the linear integral (7.54, 7.55): the cascade's integrator keeps its value meanwhile, so that
    /// together with [`DuringProfile::Frozen`] nothing integrates while the profile moves.
    SlopeAndProportional,
}

/// Coefficients of the tick.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Coefficients {
    /// The Dahl model: σ̂, F̂_C and the reversal hysteresis.
    pub friction: dahl::Coefficients,
    /// The Maxwell-slip model of the same σ̂, F̂_C and hysteresis.
    pub maxwell: maxwell_slip::Coefficients,
    /// Force per tick, count of error and unit of slope: count·dt/τ_d, m (so that slope · error · this is N).
    pub gain_m_per_ct: f32,
    /// Largest change of the integrator in one tick, N. The thesis' choice is `2 F̂_C dt/τ_d` (8.1): a force per sample, kept as it
    /// is when τ_d shrinks.
    pub rate_limit_n: f32,
    /// See [`DuringProfile`].
    pub during_profile: DuringProfile,
    /// See [`Schedule`].
    pub schedule: Schedule,
}

/// NIASA on the Dahl model.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct OnDahl {
    model: Dahl,
}

impl OnDahl {
    /// Relaxed at `position`.
    pub fn relaxed(position: Position) -> Self {
        OnDahl { model: Dahl::relaxed(position) }
    }

    /// Follows the measured position and gives the increment of this tick.
    ///
    /// # Source
    /// (7.55), App. E corrected (increment in SI with dt; clamp on the slope is the model's own bound 2σ), (8.1).
    #[inline]
    pub fn act(&mut self, k: &Coefficients, tick: &Situation) -> Action {
        let frozen = k.is_frozen(tick);
        if frozen {
            self.model = Dahl::relaxed(tick.position);
        }
        self.model.update(&k.friction, tick.position);
        k.increment(tick, frozen, self.model.force_n(), self.model.slope_n_per_m())
    }
}

/// NIASA on the Maxwell-slip model.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct OnMaxwell {
    model: MaxwellSlip,
}

impl OnMaxwell {
    /// Relaxed at `position`.
    pub fn relaxed(position: Position) -> Self {
        OnMaxwell { model: MaxwellSlip::relaxed(position) }
    }

    /// As [`OnDahl::act`]. The slope is that of a model with non-local memory: after a small loop it goes on as if the loop had not been.
    #[inline]
    pub fn act(&mut self, k: &Coefficients, tick: &Situation) -> Action {
        let frozen = k.is_frozen(tick);
        if frozen {
            self.model = MaxwellSlip::relaxed(tick.position);
        }
        self.model.update(&k.maxwell, tick.position);
        k.increment(tick, frozen, self.model.force_n(), self.model.slope_n_per_m())
    }
}

impl Coefficients {
    #[inline]
    fn is_frozen(&self, tick: &Situation) -> bool {
        !tick.reference.done && self.during_profile == DuringProfile::Frozen
    }

    #[inline]
    fn increment(&self, tick: &Situation, frozen: bool, friction_n: f32, slope_n_per_m: f32) -> Action {
        let (with_proportional, scheduled) = match self.schedule {
            Schedule::Slope => (false, slope_n_per_m),
            Schedule::SlopeAndProportional => (true, slope_n_per_m + tick.proportional_n_per_m),
        };
        let wanted = if frozen { 0.0 } else { scheduled * (tick.error_ct as f32 * self.gain_m_per_ct) };
        let increment_n = wanted.clamp(-self.rate_limit_n, self.rate_limit_n);
        Action {
            increment_n,
            limited: increment_n != wanted,
            // A schedule that includes k_P is all the integral action there is (7.55).
            replaces_integral: with_proportional,
            friction_n,
            slope_n_per_m,
            ..Action::NONE
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::SERVO_DT_S;
    use crate::profile::Setpoint;
    use proptest::prelude::*;

    const COUNT_M: f64 = 4e-6 / 65536.0;
    const TAU_S: f64 = 0.01;

    fn coefficients() -> Coefficients {
        Coefficients {
            friction: dahl::Coefficients {
                stiffness_n_per_m: 4e6,
                coulomb_n: 0.6,
                exponent_per_ct: (4e6 / 0.6 * COUNT_M) as f32,
                hysteresis_ct: 16,
            },
            maxwell: maxwell_slip::Coefficients {
                elements: maxwell_slip::Elements::like_dahl(12, 4e6, 0.6),
                count_m: COUNT_M as f32,
                hysteresis_ct: 16,
            },
            gain_m_per_ct: (COUNT_M * f64::from(SERVO_DT_S) / TAU_S) as f32,
            rate_limit_n: 0.015,
            during_profile: DuringProfile::Active,
            schedule: Schedule::Slope,
        }
    }

    fn tick(position: i64, error_ct: i32, moving: bool) -> Situation {
        let position = Position(position);
        let reference = Setpoint {
            position: position.plus(i64::from(error_ct)),
            velocity_m_per_s: 0.0,
            acceleration_m_per_s2: 0.0,
            done: !moving,
        };
        Situation { position, step_ct: 0, error_ct, reference, proportional_n_per_m: 4.31e5, force_n: 0.0 }
    }

    #[test]
    fn the_increment_is_slope_times_error_times_dt_over_tau() {
        // Relaxed and at rest: slope σ. 100 counts are 6.1 nm.
        let action = OnDahl::relaxed(Position(0)).act(&coefficients(), &tick(0, 100, false));
        let expected = 4e6 * (100.0 * COUNT_M) * 125e-6 / TAU_S;
        assert!((f64::from(action.increment_n) / expected - 1.0).abs() < 1e-5 && !action.limited);
        assert!(!action.replaces_integral && action.direct_n == 0.0 && action.gain == 1.0);
    }

    #[test]
    fn k_p_joins_the_schedule_when_asked_and_replaces_the_linear_integral() {
        let k = Coefficients { schedule: Schedule::SlopeAndProportional, ..coefficients() };
        let action = OnDahl::relaxed(Position(0)).act(&k, &tick(0, 100, false));
        let expected = (4e6 + 4.31e5) * (100.0 * COUNT_M) * 125e-6 / TAU_S;
        assert!((f64::from(action.increment_n) / expected - 1.0).abs() < 1e-5);
        assert!(action.replaces_integral);
    }

    #[test]
    fn a_large_error_moves_the_integrator_by_the_rate_limit_and_says_so() {
        let action = OnDahl::relaxed(Position(0)).act(&coefficients(), &tick(0, -100_000, false));
        assert_eq!((action.increment_n, action.limited), (-0.015, true));
    }

    #[test]
    fn frozen_during_the_profile_it_adds_nothing_and_starts_relaxed_where_the_profile_ends() {
        let k = Coefficients { during_profile: DuringProfile::Frozen, ..coefficients() };
        let mut niasa = OnDahl::relaxed(Position(0));
        for step in 1..1000 {
            let action = niasa.act(&k, &tick(step * 500, 300, true));
            assert_eq!((action.increment_n, action.limited), (0.0, false));
        }
        let first = niasa.act(&k, &tick(500_000, 100, false));
        assert!(first.increment_n > 0.0 && first.friction_n.abs() < 0.6);
    }

    #[test]
    fn after_a_long_way_in_one_direction_nothing_is_left_to_schedule() {
        let action = OnDahl::relaxed(Position(0)).act(&coefficients(), &tick(1_000_000, 1_000, true));
        assert!(action.increment_n.abs() < 1e-12 && (action.friction_n - 0.6).abs() < 1e-6);
        let action = OnMaxwell::relaxed(Position(0)).act(&coefficients(), &tick(1_000_000, 1_000, true));
        assert!(action.increment_n.abs() < 1e-12 && (action.friction_n - 0.6).abs() < 1e-5);
    }

    proptest! {
        #[test]
        fn no_tick_adds_more_than_the_rate_limit(path in proptest::collection::vec((-10_000_000i64..10_000_000, any::<i32>()), 1..100)) {
            let k = coefficients();
            let (mut dahl, mut maxwell) = (OnDahl::relaxed(Position(0)), OnMaxwell::relaxed(Position(0)));
            for (position, error_ct) in path {
                prop_assert!(dahl.act(&k, &tick(position, error_ct, false)).increment_n.abs() <= k.rate_limit_n);
                prop_assert!(maxwell.act(&k, &tick(position, error_ct, false)).increment_n.abs() <= k.rate_limit_n);
            }
        }
    }
}
