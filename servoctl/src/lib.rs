//! The host tool's library: what a settling experiment says, what theory says, and how both are shown.
//!
//! - [`settling`]: types and statistics of settling experiments, and their JSON
//! - [`table`]: tables, and the settling table, for terminals and pages
//! - [`plot`]: line, dot and error-bar plots as small inline SVG
//! - [`report`]: one self-contained HTML page out of text, plots and tables
//! - [`demo_report`]: the page that `cargo xtask demo` writes
//! - [`reproduce`]: the thesis' experiments, repeated in simulation
//! - [`theory`]: chapter 7 of the thesis as functions: settling without and with mass
//! - [`csv`]: measured columns from a file
//! - [`thesis`]: the thesis beside the simulation: every number, figure and table, with a verdict
//! - [`commission`]: from an unknown stage to a tuned axis, step by step
//! - [`link`]: a drive at the other end of a line
//! - [`program`]: which firmware an ELF is
//! - [`scope`]: the page that shows a drive live
//! - [`cli`]: the command line, a module per sub-command

pub mod cli;
pub mod commission;
pub mod csv;
pub mod demo_report;
pub mod link;
pub mod plot;
pub mod program;
pub mod report;
pub mod reproduce;
pub mod scope;
pub mod settling;
pub mod table;
pub mod theory;
pub mod thesis;
mod typeset;
