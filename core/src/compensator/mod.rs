//! What acts beside the PID to settle faster.

pub mod niasa;
