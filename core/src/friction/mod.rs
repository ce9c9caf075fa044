//! Friction models as compensators use them: `f32`, one step per tick.
//!
//! The simulation has its own, finer and in `f64`, that share no code with these; parameters have the same names in both.
//!
//! | module | model | thesis |
//! |---|---|---|
//! | [`coulomb`] | Coulomb and viscous | 2.1, 2.3 |
//! | [`stribeck`] | Stribeck curve | 2.4 |
//! | [`dahl`] | Dahl with shape factor 1, from one reversal of the measured position to the next | 2.5 corrected, 7.5 |
//! | [`shaped_dahl`] | Dahl with any shape factor | 2.5 corrected |
//! | [`lugre`] | LuGre, with the driving term of an observer | 2.7, 2.8, 4.4 corrected, 4.5 |
//! | [`maxwell_slip`] | Maxwell slip, from one reversal of the measured position to the next | A.3, A.4 corrected, A.5 |
//! | [`gms`] | generalised Maxwell slip | 2.9 to 2.11 corrected |
//!
//! A positive force opposes positive motion. Coefficients are apart from state. All but the two that follow the measured position
//! take one step by `step(&coefficients, velocity_m_per_s, dt_s)`, with the velocity of a set-point (feedforward) or a measured one
//! (observer), and give the force in N. A step may be of any length: none of them can become unstable.

pub mod coulomb;
pub mod dahl;
pub mod gms;
pub mod lugre;
pub mod maxwell_slip;
mod reversal;
pub mod shaped_dahl;
pub mod stribeck;
