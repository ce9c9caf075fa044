//! NIASA: integral action scheduled by the slope of modelled pre-rolling friction (7.55).
//!
//! ```text
//! u = ∫ (1/τ_d)(dF̂/dx [+ k_P]) e dt + k_P e + k_D ė
//! ```
//! Right after a velocity reversal the bearings are a stiff spring, the modelled slope is high and the integrator fast; as the
//! stage rolls on, the slope and with it the extra action vanish.

use crate::friction::dahl::{self, Dahl};
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
pub struct Coefficients {
    /// The friction model: σ̂, F̂_C and the reversal hysteresis.
    pub friction: dahl::Coefficients,
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

/// The compensator's memory.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Niasa {
    model: Dahl,
    /// Force of the nonlinear integrator, N.
    pub integral_n: f64,
}

/// What the compensator wants to add in one tick.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Increment {
    /// Change of the integrator, N, within the rate limit.
    pub force_n: f32,
    /// The rate limit acts.
    pub limited: bool,
}

impl Niasa {
    /// Relaxed at `position`, no force.
    pub fn at_rest(position: Position) -> Self {
        Niasa { model: Dahl::relaxed(position), integral_n: 0.0 }
    }

    /// Modelled friction force, N.
    pub fn friction_n(&self) -> f32 {
        self.model.force_n()
    }

    /// Modelled slope, N/m.
    pub fn slope_n_per_m(&self) -> f32 {
        self.model.slope_n_per_m()
    }

    /// Follows the measured position and gives the increment of this tick; [`Niasa::integrate`] applies it.
    ///
    /// The model runs whether the compensator acts or not, so that switching on finds it in step.
    ///
    /// # Source
    /// (7.55), App. E corrected (increment in SI with dt; clamp on the slope is the model's own bound 2σ), (8.1).
    #[inline]
    pub fn update(
        &mut self,
        k: &Coefficients,
        position: Position,
        error_ct: i32,
        moving: bool,
        proportional_n_per_m: f32,
    ) -> Increment {
        let frozen = moving && k.during_profile == DuringProfile::Frozen;
        if frozen {
            self.model = Dahl::relaxed(position);
        }
        self.model.update(&k.friction, position);
        if frozen {
            return Increment { force_n: 0.0, limited: false };
        }
        let scheduled = match k.schedule {
            Schedule::Slope => self.model.slope_n_per_m(),
            Schedule::SlopeAndProportional => self.model.slope_n_per_m() + proportional_n_per_m,
        };
        let wanted = scheduled * (error_ct as f32 * k.gain_m_per_ct);
        let force_n = wanted.clamp(-k.rate_limit_n, k.rate_limit_n);
        Increment { force_n, limited: force_n != wanted }
    }

    /// Adds an increment to the integrator.
    #[inline]
    pub fn integrate(&mut self, force_n: f32) {
        self.integral_n += f64::from(force_n);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::SERVO_DT_S;
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
            gain_m_per_ct: (COUNT_M * f64::from(SERVO_DT_S) / TAU_S) as f32,
            rate_limit_n: 0.015,
            during_profile: DuringProfile::Active,
            schedule: Schedule::Slope,
        }
    }

    #[test]
    fn the_increment_is_slope_times_error_times_dt_over_tau() {
        let k = coefficients();
        let mut niasa = Niasa::at_rest(Position(0));
        // Relaxed and at rest: slope σ. 100 counts are 6.1 nm.
        let increment = niasa.update(&k, Position(0), 100, false, 0.0);
        let expected = 4e6 * (100.0 * COUNT_M) * 125e-6 / TAU_S;
        assert!((f64::from(increment.force_n) / expected - 1.0).abs() < 1e-5 && !increment.limited);
    }

    #[test]
    fn k_p_joins_the_schedule_when_asked() {
        let k = Coefficients { schedule: Schedule::SlopeAndProportional, ..coefficients() };
        let increment = Niasa::at_rest(Position(0)).update(&k, Position(0), 100, false, 4.31e5);
        let expected = (4e6 + 4.31e5) * (100.0 * COUNT_M) * 125e-6 / TAU_S;
        assert!((f64::from(increment.force_n) / expected - 1.0).abs() < 1e-5);
    }

    #[test]
    fn a_large_error_moves_the_integrator_by_the_rate_limit_and_says_so() {
        let increment = Niasa::at_rest(Position(0)).update(&coefficients(), Position(0), -100_000, false, 0.0);
        assert_eq!(increment, Increment { force_n: -0.015, limited: true });
    }

    #[test]
    fn frozen_during_the_profile_it_adds_nothing_and_starts_relaxed_where_the_profile_ends() {
        let k = Coefficients { during_profile: DuringProfile::Frozen, ..coefficients() };
        let mut niasa = Niasa::at_rest(Position(0));
        for tick in 1..1000 {
            assert_eq!(
                niasa.update(&k, Position(tick * 500), 300, true, 0.0),
                Increment { force_n: 0.0, limited: false }
            );
        }
        let first = niasa.update(&k, Position(500_000), 100, false, 0.0);
        assert!(first.force_n > 0.0 && niasa.friction_n().abs() < 0.6);
    }

    #[test]
    fn after_a_long_way_in_one_direction_nothing_is_left_to_schedule() {
        let k = coefficients();
        let mut niasa = Niasa::at_rest(Position(0));
        let increment = niasa.update(&k, Position(1_000_000), 1_000, true, 0.0);
        assert!(increment.force_n.abs() < 1e-12 && (niasa.friction_n() - 0.6).abs() < 1e-6);
    }

    proptest! {
        #[test]
        fn no_tick_adds_more_than_the_rate_limit(path in proptest::collection::vec((-10_000_000i64..10_000_000, any::<i32>()), 1..100)) {
            let k = coefficients();
            let mut niasa = Niasa::at_rest(Position(0));
            for (position, error_ct) in path {
                let increment = niasa.update(&k, Position(position), error_ct, false, 0.0);
                prop_assert!(increment.force_n.abs() <= k.rate_limit_n);
            }
        }
    }
}
