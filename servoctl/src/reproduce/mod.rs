//! The thesis' experiments, repeated: the drive of `servo-core` on the carriage of `servo-sim`.
//!
//! - [`pass`]: five steps up and five back, the unit of work
//! - [`campaign`]: many passes of several configurations, in parallel, in parts
//! - [`experiments`]: which configurations each experiment compares
//! - [`outcome`]: statistics, tables, JSON
//! - [`loop_transmission`]: stepped sines (5.1, 8.2)
//! - [`shard`]: parts of a campaign as files, and their union

pub mod campaign;
pub mod experiments;
pub mod loop_transmission;
pub mod outcome;
pub mod pass;
pub mod shard;
