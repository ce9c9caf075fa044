//! The sections of the page, a file each: plain data in, a [`Section`](super::section::Section) out.

pub mod closed_loop;
pub mod compensators;
pub mod first_experiment;
pub mod frequency;
pub mod identification;
pub mod in_position;
pub mod length_scale;
pub mod models;
pub mod rate_limit;
pub mod second_experiment;
pub mod sensitivity;
pub mod settling;
mod small_amplitude;
pub mod small_steps;
pub mod stage;
pub mod theory_mass;
pub mod theory_massless;
pub mod traces;
