//! The command line: one module per sub-command.
//!
//! To add a command: a module here with a `clap::Args` or `clap::Subcommand` type `Options` and a function
//! `run(&Options) -> anyhow::Result<()>`, then one line each in the list of modules, in [`Command`] and in [`run`].
//! Everything that prints numbers takes [`output::Json`] as `#[command(flatten)]` and ends with
//! [`output::Json::write`]; progress goes to standard error.

pub mod commission;
pub mod fit;
pub mod interrupt;
pub mod merge;
pub mod output;
pub mod progress;
pub mod report;
pub mod reproduce;
pub mod theory;

use clap::{Parser, Subcommand};
use std::process::ExitCode;

/// Talks to a servo drive, runs its experiments and reports them.
#[derive(Debug, Parser)]
#[command(name = "servoctl", version)]
pub struct Arguments {
    /// What to do.
    #[command(subcommand)]
    pub command: Command,
}

/// The sub-commands.
#[derive(Debug, Subcommand)]
pub enum Command {
    /// Settling in theory (chapter 7 of the thesis): friction observer against NIASA, with a wrong friction model
    #[command(subcommand)]
    Theory(theory::Options),
    /// An experiment of the thesis, simulated: the drive of the firmware on a simulated stage
    Reproduce(reproduce::Options),
    /// Friction models fitted to measured force or current over position
    #[command(subcommand)]
    Fit(fit::Options),
    /// From an unknown stage to a tuned axis that settles with NIASA: measure, tune, identify, verify
    Commission(commission::Options),
    /// The thesis beside the simulation: every figure, table and number of it, on one page
    Report(report::Options),
    /// Join the parts of an experiment that `reproduce --shard` computed
    Merge(merge::Options),
}

/// Parses the process' arguments and does what they say; errors go to standard error, with exit code 1 (2 from clap).
pub fn main() -> ExitCode {
    match run(&Arguments::parse().command) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {error:#}");
            ExitCode::FAILURE
        }
    }
}

/// Does what a command says.
///
/// # Errors
/// What a person can do something about, in words.
pub fn run(command: &Command) -> anyhow::Result<()> {
    match command {
        Command::Theory(options) => theory::run(options),
        Command::Reproduce(options) => reproduce::run(options),
        Command::Fit(options) => fit::run(options),
        Command::Commission(options) => commission::run(options),
        Command::Report(options) => report::run(options),
        Command::Merge(options) => merge::run(options),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::CommandFactory;

    #[test]
    fn the_command_tree_is_consistent() {
        Arguments::command().debug_assert();
    }
}
