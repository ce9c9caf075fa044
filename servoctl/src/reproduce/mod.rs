//! The thesis' experiments, repeated: the drive of `servo-core` on the carriage of `servo-sim`.
//!
//! - [`pass`]: five steps up and five back, the unit of work
//! - [`campaign`]: many passes of several configurations, in parallel, in parts
//! - [`experiments`]: which configurations each experiment compares
//! - [`outcome`]: statistics, tables, JSON
//! - [`identification`], [`identification_study`]: σ and F_C from profiles and from settling (6.2, 6.3)
//! - [`compensators`]: how each compensator is tuned before they are compared (chapter 4)
//! - [`claims`]: what chapter 4 says of the compensators, held against the numbers
//! - [`sensitivity`]: parameters of NIASA, and stages that are not what the model says
//! - [`loop_transmission`]: stepped sines (5.1, 8.2)
//! - [`step_100um`]: where the stage ceases to be linear (5.3)
//! - [`models`]: friction models fitted to the same data (chapter 2)
//! - [`shard`]: parts of a campaign as files, and their union

pub mod campaign;
pub mod claims;
pub mod compensators;
pub mod experiments;
pub mod identification;
pub mod identification_study;
pub mod loop_transmission;
pub mod models;
pub mod outcome;
pub mod pass;
pub mod sensitivity;
pub mod shard;
pub mod step_100um;
pub mod words;
