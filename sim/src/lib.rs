//! The simulated truth: a linear stage with its friction, motor, bridge, encoder and converters, in `f64`.
//!
//! This crate knows nothing of the controller. What both sides have to agree on (frame layout, signs, the meaning of a
//! duty cycle) is written down here a second time, so that a mistake in one of them shows.
//!
//! # Signs
//! Positive q current gives positive force, positive force accelerates towards positive position. Position 0 is
//! mid-travel. The electrical angle is `2π (position + offset) / pitch`, the d axis is aligned with phase A at angle 0,
//! and the q axis leads it by 90°: `i_q = −i_α sin θ + i_β cos θ`, amplitude-invariant.
//!
//! # Time
//! [`Plant`] is everything; [`Carriage`] is its mechanical half, for who has a force instead of a bridge.
//! [`Plant::advance`] takes any number of nanoseconds and divides it into equal internal steps of at most
//! [`SUBSTEP_MAX_NS`].
//!
//! # Repeatability
//! Same stage, seed and calls: same bits, on every platform and at every optimisation level. Transcendental functions
//! come from `libm` by name, and every random stream is a [`rand_pcg::Pcg64`] keyed by (seed, purpose, move).

pub mod adc;
pub mod carriage;
pub mod encoder;
pub mod friction;
pub mod motor;
mod plant;
pub mod random;
pub mod stage;

pub use carriage::Carriage;
pub use motor::BridgeState;
pub use plant::{Plant, SUBSTEP_MAX_NS};
pub use stage::{Stage, StageError};
