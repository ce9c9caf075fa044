//! Identification: friction, mass and loop from measured samples. `f64`, slices in, plain data out, no I/O.
//!
//! | from | comes | thesis |
//! |---|---|---|
//! | position and force or current | [`Record`]: friction force, checked, in legs of one direction | 4.3 |
//! | a record | [`dahl`]: σ and F_C with 95 % intervals; [`genetic`]: the same by the thesis' algorithm | 5.5, App. B |
//! | a record | [`maxwell`]: parallel elements; [`choice`]: whether they are needed | App. A |
//! | a loop transmission | [`frf`]: margins, second-order closed loop | 5.1, 5.2 |
//! | a plant's response | [`frf`]: mass, resonances | 5.1 |
//! | a plant's response and friction | [`tuning`]: gains, margins, parameters of NIASA | 8.1 |
//! | a step response | [`length_scale`]: where friction begins to rule | 5.3 |
//! | a long move | [`move_check`]: mass, viscous and Coulomb friction, force constant | 4.1 |
//!
//! Friction is positive against positive motion, as everywhere. Bad data are refused by name ([`DataError`]), never repaired.

pub mod choice;
pub mod confidence;
pub mod dahl;
mod error;
pub mod filter;
pub mod frf;
pub mod genetic;
pub mod legs;
pub mod length_scale;
mod linear;
pub mod maxwell;
pub mod move_check;
pub mod record;
pub mod tuning;

pub use error::DataError;
pub use record::Record;
