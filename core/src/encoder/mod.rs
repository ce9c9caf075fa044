//! From what an encoder tells to a continuous position: frames ([`biss`]), or sine and cosine ([`sincos`]), and the tracker that
//! survives bad ones ([`tracker`]).

pub mod biss;
pub mod sincos;
pub mod tracker;
