//! Friction: the force of the guides, one model a file.
//!
//! | model | remembers | thesis |
//! |---|---|---|
//! | [`Coulomb`] | nothing | 2.1, 2.3 |
//! | [`Stribeck`] | nothing | 2.4 |
//! | [`Dahl`] | its force | 2.5 corrected |
//! | [`LuGre`] | a deflection | 2.7, 2.8 |
//! | [`MaxwellSlip`] | the reversals that no larger one has wiped out | A.4 corrected, elements for Dahl's curve |
//! | [`Gms`] | the same; any elements, Stribeck effect, damping | 2.9 to 2.11, A.1 to A.5 corrected |
//!
//! A positive force opposes positive motion. Every model is moved by `advance(dx_m, dt_s)`, with the velocity `dx/dt`; those that
//! do not depend on the rate leave the time away.

mod coulomb;
pub mod curves;
mod dahl;
mod elements;
pub mod gms;
pub mod lugre;
mod maxwell_slip;
mod stribeck;

pub use coulomb::Coulomb;
pub use dahl::Dahl;
pub use elements::{Element, Elements, GMS_TABLE_4, MAX_LISTED};
pub use gms::Gms;
pub use lugre::LuGre;
pub use maxwell_slip::{MAX_ELEMENTS, MaxwellSlip};
pub use stribeck::{Level, Stribeck};

use serde::{Deserialize, Serialize};

use crate::stage::{self, FrictionModel};

/// The friction of the stage, one variant per model.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum Friction {
    /// Velocity's sign only.
    Coulomb(Coulomb),
    /// Velocity only.
    Stribeck(Stribeck),
    /// Local memory; for comparison.
    Dahl(Dahl),
    /// Local memory, Stribeck effect and damping.
    LuGre(LuGre),
    /// Non-local memory; what a stage does.
    MaxwellSlip(MaxwellSlip),
    /// Non-local memory, any elements, Stribeck effect and damping.
    Gms(Gms),
}

impl Friction {
    /// Virgin friction (force 0 N) of the model and parameters in the stage file. The stage's own viscous friction is σ2.
    pub fn new(stage: &stage::Friction) -> Friction {
        let (stiffness_n_per_m, coulomb_n) = (stage.stiffness_n_per_m, stage.coulomb_n);
        let level = stage.level();
        match stage.model {
            FrictionModel::Coulomb => Friction::Coulomb(Coulomb::new(coulomb_n, 0.0)),
            FrictionModel::Stribeck => Friction::Stribeck(Stribeck::new(level, 0.0)),
            FrictionModel::Dahl => {
                Friction::Dahl(Dahl::with_shape(stiffness_n_per_m, coulomb_n, stage.shape.unwrap_or(1.0)))
            }
            FrictionModel::LuGre => Friction::LuGre(LuGre::new(lugre::Parameters {
                stiffness_n_per_m,
                damping_n_s_per_m: stage.damping_n_s_per_m,
                viscous_n_s_per_m: 0.0,
                level,
            })),
            FrictionModel::MaxwellSlip => {
                Friction::MaxwellSlip(MaxwellSlip::new(stage.elements, stiffness_n_per_m, coulomb_n))
            }
            FrictionModel::Gms => Friction::Gms(Gms::new(gms::Parameters {
                elements: stage.scaled_elements(),
                level,
                damping_n_s_per_m: stage.damping_n_s_per_m,
                viscous_n_s_per_m: 0.0,
                law: match stage.shape {
                    Some(shape) => gms::Law::HiddenState { shape },
                    None => {
                        gms::Law::Attraction { attraction_n_per_s: stage.attraction_n_per_s.unwrap_or(f64::INFINITY) }
                    }
                },
            })),
        }
    }

    /// Moves the contact by `dx_m` in `dt_s`, at constant velocity, and returns the force that opposes positive motion, N.
    ///
    /// A `dt_s` of 0 leaves away what depends on the rate.
    #[inline]
    pub fn advance(&mut self, dx_m: f64, dt_s: f64) -> f64 {
        match self {
            Friction::MaxwellSlip(model) => model.advance(dx_m),
            Friction::Dahl(model) => model.advance(dx_m),
            Friction::Coulomb(model) => model.advance(dx_m, dt_s),
            Friction::Stribeck(model) => model.advance(dx_m, dt_s),
            Friction::LuGre(model) => model.advance(dx_m, dt_s),
            Friction::Gms(model) => model.advance(dx_m, dt_s),
        }
    }

    /// [`Friction::advance`] for a mass that a force of `stopping_n` would bring to rest by the end of the step.
    ///
    /// The models without a spring need to know: up to their level they stop the mass and hold it. The others do not.
    #[inline]
    pub fn resist(&mut self, dx_m: f64, dt_s: f64, stopping_n: f64) -> f64 {
        match self {
            Friction::MaxwellSlip(model) => model.advance(dx_m),
            Friction::Dahl(model) => model.advance(dx_m),
            Friction::Coulomb(model) => model.resist(dx_m, dt_s, stopping_n),
            Friction::Stribeck(model) => model.resist(dx_m, dt_s, stopping_n),
            Friction::LuGre(model) => model.advance(dx_m, dt_s),
            Friction::Gms(model) => model.advance(dx_m, dt_s),
        }
    }

    /// The force of the last step, which opposes positive motion, N.
    pub fn force_n(&self) -> f64 {
        match self {
            Friction::Coulomb(model) => model.force_n(),
            Friction::Stribeck(model) => model.force_n(),
            Friction::Dahl(model) => model.force_n(),
            Friction::LuGre(model) => model.force_n(),
            Friction::MaxwellSlip(model) => model.force_n(),
            Friction::Gms(model) => model.force_n(),
        }
    }

    /// The energy in the springs, J: no less than what can be had back from the work done against friction.
    pub fn stored_j(&self) -> f64 {
        match self {
            Friction::Coulomb(_) | Friction::Stribeck(_) => 0.0,
            Friction::Dahl(model) => model.stored_j(),
            Friction::LuGre(model) => model.stored_j(),
            Friction::MaxwellSlip(model) => model.stored_j(),
            Friction::Gms(model) => model.stored_j(),
        }
    }

    /// Changes Dahl's σ (N/m; σ0 of LuGre, half the stiffness of all elements) and F_C (N), both positive, and what belongs to
    /// them in proportion; the force keeps its fraction of F_C, and with it the memory.
    pub fn set(&mut self, stiffness_n_per_m: f64, coulomb_n: f64) {
        match self {
            Friction::Coulomb(model) => model.set(coulomb_n),
            Friction::Stribeck(model) => model.set(coulomb_n),
            Friction::Dahl(model) => model.set(stiffness_n_per_m, coulomb_n),
            Friction::LuGre(model) => model.set(stiffness_n_per_m, coulomb_n),
            Friction::MaxwellSlip(model) => model.set(stiffness_n_per_m, coulomb_n),
            Friction::Gms(model) => model.set(stiffness_n_per_m, coulomb_n),
        }
    }
}

/// The velocity of a step, m/s; 0 for one that takes no time.
#[inline]
fn velocity_m_per_s(dx_m: f64, dt_s: f64) -> f64 {
    if dt_s > 0.0 { dx_m / dt_s } else { 0.0 }
}
