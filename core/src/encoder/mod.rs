//! From line bits to a continuous position: frame decoding ([`biss`]) and the tracker that survives bad frames ([`tracker`]).

pub mod biss;
pub mod sincos;
pub mod tracker;
