//! The thesis beside the simulation: every number that it states, ours, and a verdict; every figure and table.
//!
//! - [`targets`]: what the thesis prints
//! - [`verdict`]: how its statements are judged: pure functions of the data
//! - [`section`]: a section of the page as plain data
//! - [`sections`]: one file per section: data in, section out
//! - [`index`]: where every figure and table of the thesis is
//! - [`run`]: computes everything, with progress, and ends early when asked to
//! - [`page`]: the page and its JSON
//! - [`pictures`]: the pictures that the read-me shows

pub mod index;
pub mod page;
pub mod pictures;
pub mod run;
pub mod section;
pub mod sections;
pub mod targets;
pub mod verdict;
