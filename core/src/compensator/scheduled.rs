//! PD gains scheduled by the slope of modelled friction (4.2.3): stiffer where the bearings are stiff, no integral action.

use super::{Action, Situation};
use crate::friction::dahl::{self, Dahl};
use crate::position::Position;

/// Coefficients of the tick.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Coefficients {
    /// The friction model.
    pub friction: dahl::Coefficients,
    /// How much of the modelled slope joins k_P; 0 is plain PD, 1 the whole of it.
    pub share: f32,
}

/// The model's memory.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct State {
    model: Dahl,
}

impl State {
    /// Relaxed at `position`.
    pub fn relaxed(position: Position) -> Self {
        State { model: Dahl::relaxed(position) }
    }

    /// `k_P ← k_P + share·dF̂/dx`, k_D in proportion; the integrators stand still.
    #[inline]
    pub fn act(&mut self, k: &Coefficients, tick: &Situation) -> Action {
        self.model.update(&k.friction, tick.position);
        Action {
            gain: self.gain(k, tick.proportional_n_per_m),
            replaces_integral: true,
            friction_n: self.model.force_n(),
            slope_n_per_m: self.model.slope_n_per_m(),
            ..Action::NONE
        }
    }

    /// The factor on k_P and k_D as of the last tick.
    #[inline]
    pub fn gain(&self, k: &Coefficients, proportional_n_per_m: f32) -> f32 {
        1.0 + k.share * self.model.slope_n_per_m() / proportional_n_per_m.max(1.0)
    }
}
