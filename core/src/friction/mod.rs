//! Friction models as compensators use them: `f32`, one step per tick.
//!
//! The simulation has its own, finer and in `f64`, that share no code with these.

pub mod dahl;
