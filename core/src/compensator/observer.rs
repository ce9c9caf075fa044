//! Friction observers: a modelled friction force is added to the control, and an error term drives the model to the truth.

use super::{Action, Situation};
use crate::SERVO_DT_S;
use crate::friction::dahl::{self, Dahl};
use crate::friction::lugre::{self, LuGre};
use crate::position::Position;

/// Largest force of the driven bristles, in units of static friction.
const DEFLECTION_LIMIT: f32 = 8.0;

/// Coefficients of the tick.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Coefficients {
    /// The LuGre model of (4.4), (4.5).
    pub lugre: lugre::Coefficients,
    /// Driving term of (4.4), m/s per count of position error: k·count.
    pub drive_m_per_s_per_ct: f32,
    /// Speed per count of movement in a tick, m/s.
    pub speed_m_per_s_per_ct: f32,
    /// The Dahl model of (7.20).
    pub dahl: dahl::Coefficients,
    /// dt/τ_d and count in one, m: k_P · error · this is the increment of the integral action with `k_I = k_P/τ_d` (7.23).
    pub integral_m_per_ct: f32,
}

/// Observer on the LuGre model.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct OnLugre {
    model: LuGre,
}

impl OnLugre {
    /// `F̂ = σ_0 ẑ + σ_1 dẑ/dt + σ_2 v` with `dẑ/dt = v − σ_0 |v|/s(v)·ẑ + k e`: its driving term is the integral action.
    ///
    /// # Source
    /// (4.4) corrected (ẑ in the second term; the sign of `k e` follows from e = r − x), (4.5).
    #[inline]
    pub fn act(&mut self, k: &Coefficients, tick: &Situation) -> Action {
        let speed_m_per_s = tick.step_ct as f32 * k.speed_m_per_s_per_ct;
        let drive_m_per_s = tick.error_ct as f32 * k.drive_m_per_s_per_ct;
        let friction_n = self.model.step_driven(&k.lugre, speed_m_per_s, drive_m_per_s, SERVO_DT_S);
        // Driven, the bristles have no bound of their own; several times what friction can do is enough for any other force.
        let limit_m = DEFLECTION_LIMIT * k.lugre.level.static_n / k.lugre.stiffness_n_per_m;
        self.model.deflection_m = self.model.deflection_m.clamp(-limit_m, limit_m);
        Action { direct_n: friction_n, friction_n, replaces_integral: true, ..Action::NONE }
    }
}

/// Observer on the Dahl model.
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

    /// `u = F̂(x) + k_P e + k_D ė + ∫ (k_P/τ_d) e dt`: the model's force in full, the integral as driving term.
    ///
    /// # Source
    /// (7.20), (7.23).
    #[inline]
    pub fn act(&mut self, k: &Coefficients, tick: &Situation) -> Action {
        self.model.update(&k.dahl, tick.position);
        Action {
            direct_n: self.model.force_n(),
            increment_n: tick.proportional_n_per_m * (tick.error_ct as f32 * k.integral_m_per_ct),
            replaces_integral: true,
            friction_n: self.model.force_n(),
            slope_n_per_m: self.model.slope_n_per_m(),
            ..Action::NONE
        }
    }
}
