//! Friction feedforward: a model driven by the reference (4.2.1). It helps while the reference moves and, by construction, does
//! nothing after.

use super::{Action, Situation};
use crate::SERVO_DT_S;
use crate::friction::gms::{self, Gms};
use crate::friction::lugre::{self, LuGre};
use crate::friction::shaped_dahl::{self, ShapedDahl};
use crate::friction::{coulomb, stribeck};

/// Which model.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum Model {
    /// Coulomb and viscous.
    Coulomb,
    /// Stribeck.
    Stribeck,
    /// Dahl.
    Dahl,
    /// LuGre.
    Lugre,
    /// Generalised Maxwell slip.
    Gms,
}

impl Model {
    /// All of them; the index is the value of the parameter `feedforward_model`.
    pub const ALL: [Model; 5] = [Model::Coulomb, Model::Stribeck, Model::Dahl, Model::Lugre, Model::Gms];
}

/// Coefficients of the tick.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Coefficients {
    /// Which model.
    pub model: Model,
    /// For [`Model::Coulomb`].
    pub coulomb: coulomb::Coefficients,
    /// For [`Model::Stribeck`].
    pub stribeck: stribeck::Coefficients,
    /// For [`Model::Dahl`].
    pub dahl: shaped_dahl::Coefficients,
    /// For [`Model::Lugre`].
    pub lugre: lugre::Coefficients,
    /// For [`Model::Gms`].
    pub gms: gms::Coefficients,
}

/// The models' memory.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct State {
    dahl: ShapedDahl,
    lugre: LuGre,
    gms: Gms,
    force_n: f32,
}

impl State {
    /// Relaxed.
    pub const RELAXED: State =
        State { dahl: ShapedDahl::RELAXED, lugre: LuGre::RELAXED, gms: Gms::RELAXED, force_n: 0.0 };

    /// The model's force for the reference's motion; at rest it stays what it was.
    ///
    /// Coulomb's and Stribeck's force depend on the speed alone and would drop to 0 when the reference stops, which would kick the
    /// stage: they too keep their last value.
    #[inline]
    pub fn act(&mut self, k: &Coefficients, tick: &Situation) -> Action {
        let velocity = tick.reference.velocity_m_per_s;
        if velocity != 0.0 {
            self.force_n = match k.model {
                Model::Coulomb => coulomb::step(&k.coulomb, velocity),
                Model::Stribeck => stribeck::step(&k.stribeck, velocity),
                Model::Dahl => self.dahl.step(&k.dahl, velocity, SERVO_DT_S),
                Model::Lugre => self.lugre.step(&k.lugre, velocity, SERVO_DT_S),
                Model::Gms => self.gms.step(&k.gms, velocity, SERVO_DT_S),
            };
        }
        Action { direct_n: self.force_n, friction_n: self.force_n, ..Action::NONE }
    }
}
