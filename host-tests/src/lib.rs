//! The drive of `servo-core` on the stage of `servo-sim`, period by period as the firmware runs them.
//!
//! A [`Bench`] is the pair, wired as on the board: phase currents and encoder are sampled at the PWM update, the bridge takes
//! new duties one period later. A [`FastBench`] is the same drive on the carriage alone, for experiments of many moves.
//! [`experiment`] makes the moves of the settling experiments, [`tuning`] turns a stage into settings, [`golden`] records the run
//! that QEMU repeats.

pub mod bench;
pub mod experiment;
pub mod fast;
pub mod frequency_response;
pub mod golden;
pub mod tuning;

pub use bench::Bench;
pub use fast::FastBench;
