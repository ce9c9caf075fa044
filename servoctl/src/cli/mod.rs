//! The command line: one module per sub-command.
//!
//! To add a command: a module here with a `clap::Args` or `clap::Subcommand` type `Options` and a function
//! `run(&Options) -> anyhow::Result<()>`, then one line each in the list of modules, in [`Command`] and in [`run`].
//! Everything that prints numbers takes [`output::Json`] as `#[command(flatten)]` and ends with
//! [`output::Json::write`]; progress goes to standard error.

pub mod commission;
pub mod drive;
pub mod fit;
pub mod interrupt;
pub mod merge;
pub mod output;
pub mod parameter_page;
pub mod progress;
pub mod reference;
pub mod report;
pub mod reproduce;
pub mod stage;
pub mod theory;

use clap::{CommandFactory, Parser, Subcommand};
use std::process::ExitCode;

use drive::{
    Link, align, calibrate_encoder, capture, control, faults, identity, log, measure, motion, params, scope, sequence,
    stream, virtual_drive, watch,
};

/// Talks to a servo drive, runs its experiments and reports them.
#[derive(Debug, Parser)]
#[command(name = "servoctl", version)]
pub struct Arguments {
    /// Which drive.
    #[command(flatten)]
    pub link: Link,
    /// What to do.
    #[command(subcommand)]
    pub command: Command,
}

/// The sub-commands.
#[derive(Debug, Subcommand)]
pub enum Command {
    /// Who the drive is: board, firmware, parameters
    Info(identity::Options),
    /// What the drive is doing
    Status(identity::Options),
    /// Close the loops at the present position
    Enable(identity::Options),
    /// Turn the bridge off
    Disable(identity::Options),
    /// Send a controlword of CiA 402 and show the statusword
    Control(control::Options),
    /// Look for the motor's electrical zero
    Align(identity::Options),
    /// Find offsets, gain and phase of an encoder with sine and cosine, on a move of 0.1 mm to and fro
    CalibrateEncoder(identity::Options),
    /// Move, and report how the stage settled
    Move(motion::Options),
    /// Carry out the commands of a file
    Sequence(sequence::Options),
    /// Brake to rest
    Stop(identity::Options),
    /// Show, change, store and compare parameters
    Params(params::Options),
    /// Show the fault, or acknowledge it
    Faults(faults::Options),
    /// Print signals line by line
    Watch(watch::Options),
    /// Record every servo tick in the drive and write it to a file
    Capture(capture::Options),
    /// Excite the loop, and show what answers: stepped sine, identification profile, pulse
    #[command(subcommand)]
    Measure(measure::Options),
    /// Write signals of every servo tick to a file as they come
    Stream(stream::Options),
    /// Serve a page on this computer: live traces, moves, settling, parameters
    Scope(scope::Options),
    /// Print the firmware's log
    Log(log::Options),
    /// Start the firmware anew (bridge off)
    Restart(identity::Options),
    /// List serial ports that may be drives
    Ports(identity::Options),
    /// Start or end the virtual drive of this computer
    Virtual(virtual_drive::Options),
    /// Print a script that completes this program's commands in a shell
    Completions {
        /// Which shell
        shell: clap_complete::Shell,
    },
    /// Print a page of docs/
    #[command(hide = true)]
    Reference {
        /// Which one
        page: reference::Page,
    },
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

/// Parses the process' arguments and does what they say; errors go to standard error, with exit code 1 (2 from clap, 130 after
/// Ctrl-C).
pub fn main() -> ExitCode {
    match run(&Arguments::parse()) {
        Ok(code) => code,
        Err(error) => {
            eprintln!("error: {error:#}");
            ExitCode::FAILURE
        }
    }
}

/// Does what the arguments say.
///
/// # Errors
/// What a person can do something about, in words.
pub fn run(arguments: &Arguments) -> anyhow::Result<ExitCode> {
    let link = &arguments.link;
    match &arguments.command {
        Command::Info(options) => identity::info(link, options),
        Command::Status(options) => identity::status(link, options),
        Command::Enable(options) => identity::enable(link, options),
        Command::Disable(options) => identity::disable(link, options),
        Command::Control(options) => control::run(link, options),
        Command::Align(options) => return align::run(link, options),
        Command::CalibrateEncoder(options) => return calibrate_encoder::run(link, options),
        Command::Move(options) => return motion::run(link, options),
        Command::Sequence(options) => return sequence::run(link, options),
        Command::Stop(options) => identity::stop(link, options),
        Command::Params(options) => params::run(link, options),
        Command::Faults(options) => faults::run(link, options),
        Command::Watch(options) => watch::run(link, options),
        Command::Capture(options) => return capture::run(link, options),
        Command::Measure(options) => return measure::run(link, options),
        Command::Stream(options) => return stream::run(link, options),
        Command::Scope(options) => scope::run(link, options),
        Command::Log(options) => log::run(link, options),
        Command::Restart(options) => identity::restart(link, options),
        Command::Ports(options) => identity::ports(options),
        Command::Virtual(options) => virtual_drive::run(options),
        Command::Completions { shell } => {
            let mut script = Vec::new();
            clap_complete::generate(*shell, &mut Arguments::command(), "servoctl", &mut script);
            output::print(&String::from_utf8_lossy(&script))
        }
        Command::Reference { page } => output::print(&page.text()),
        Command::Theory(options) => theory::run(options),
        Command::Reproduce(options) => return reproduce::run(options).map(|()| interrupt::exit_code()),
        Command::Fit(options) => fit::run(options),
        Command::Commission(options) => return commission::run(link, options),
        Command::Report(options) => return report::run(options).map(|()| interrupt::exit_code()),
        Command::Merge(options) => merge::run(options),
    }
    .map(|()| ExitCode::SUCCESS)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_command_tree_is_consistent() {
        Arguments::command().debug_assert();
    }
}
