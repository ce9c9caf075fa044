//! What can go wrong between host and drive, in words that say what to do.

use std::fmt;
use std::io;

use servo_core::fault::Fault;
use servo_core::refusal::{Field, Refusal};
use servo_core::state::State;
use servo_protocol::message::PROTOCOL;

/// What went wrong.
#[derive(Debug)]
pub enum Error {
    /// No connection.
    Open {
        /// To what.
        address: String,
        /// The system's reason.
        reason: String,
        /// What to do.
        help: String,
    },
    /// The line broke.
    Broken(io::Error),
    /// No reply.
    NoReply {
        /// To which request.
        request: &'static str,
        /// How often it was sent.
        attempts: u32,
        /// It may have been carried out.
        unknown: bool,
    },
    /// The firmware speaks another protocol.
    Protocol {
        /// Its number.
        theirs: u16,
    },
    /// The drive refused a command.
    Refused {
        /// Which one.
        request: &'static str,
        /// Why.
        refusal: Refusal,
        /// The drive's state then, if it could be asked.
        state: Option<State>,
    },
    /// The drive went into a fault, or into a state in which nothing of what was asked will happen.
    Interrupted {
        /// What was under way.
        what: &'static str,
        /// What happened.
        why: String,
        /// What to do.
        help: &'static str,
    },
    /// The drive answered something else.
    Unexpected {
        /// To which request.
        request: &'static str,
        /// What.
        reply: &'static str,
    },
    /// The message is longer than a frame.
    TooLong,
    /// What was typed makes no sense.
    Typed(String),
}

impl fmt::Display for Error {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Error::Open { address, reason, help } => write!(f, "{address}: {reason}\n  {help}"),
            Error::Broken(error) => write!(f, "the link broke: {error}"),
            Error::NoReply { request, attempts, unknown } => {
                write!(f, "no reply to {request} (sent {attempts} times)")?;
                if *unknown {
                    f.write_str(": whether it was carried out is not known")?;
                }
                f.write_str("\n  is this the drive's port, is it powered, is the cable in?")
            }
            Error::Protocol { theirs } => {
                let update = if *theirs < PROTOCOL {
                    "flash the firmware of this release (`cargo xtask flash`) or use the servoctl that came with the drive's"
                } else {
                    "use the servoctl that came with the drive's firmware, or flash the firmware of this release (`cargo xtask flash`)"
                };
                write!(f, "the firmware speaks protocol {theirs}, this servoctl protocol {PROTOCOL}\n  {update}")
            }
            Error::Refused { request, refusal, state } => {
                write!(f, "the drive refused {request}: {refusal}")?;
                if let Some(state) = state {
                    write!(f, "\n  state: {state}")?;
                }
                write!(f, "\n  {}", help(refusal))
            }
            Error::Interrupted { what, why, help } => write!(f, "{what}: {why}\n  {help}"),
            Error::Unexpected { request, reply } => write!(f, "{request} was answered by {reply}"),
            Error::Typed(text) => f.write_str(text),
            Error::TooLong => f.write_str("the message is longer than a frame"),
        }
    }
}

impl std::error::Error for Error {}

/// The command that helps.
pub fn help(refusal: &Refusal) -> &'static str {
    match refusal {
        Refusal::WrongState(state) => match state {
            State::Fault | State::FaultReactionActive => {
                "`servoctl faults` says what happened, `servoctl faults clear` acknowledges it"
            }
            state if state.has_torque() => "`servoctl disable` turns the bridge off",
            _ => "`servoctl enable` closes the loops",
        },
        Refusal::Moving => "`servoctl stop` brakes the motion",
        Refusal::FaultPersists(Fault::ParametersInvalid) => {
            "nobody has saved this drive's parameters yet: set them, then `servoctl params save`"
        }
        Refusal::FaultPersists(_) => "remove the cause, then `servoctl faults clear`",
        Refusal::NothingStored => "`servoctl params save` stores those in use",
        Refusal::UnknownParameter(_) => "`servoctl params list` names them all",
        Refusal::OutOfRange { field, .. } => help_with(*field),
        Refusal::NoPosition => "`servoctl status` shows bad encoder frames: look at the encoder and its cable",
        Refusal::Halted => "`servoctl control 0x0f` clears the controlword's halt bit",
        Refusal::NotAligned(_) => "`servoctl align` looks for the electrical zero",
        Refusal::NoSignals => "`servoctl params get encoder_kind` says which encoder is set",
        Refusal::Signals(_) => "`servoctl calibrate-encoder` looks at the signals on a longer way",
        Refusal::Aligning => "`servoctl disable` ends the alignment",
        Refusal::Saving => "`servoctl info` says when it is saved",
        Refusal::Busy => "send it again; `servoctl status` shows whether the drive keeps up",
    }
}

/// The command that knows the limits.
fn help_with(field: Field) -> &'static str {
    match field {
        Field::Parameter(_)
        | Field::Target
        | Field::Velocity
        | Field::Acceleration
        | Field::ProportionalGain
        | Field::IntegralGain
        | Field::DerivativeGain => "`servoctl params list` shows the limits",
        Field::Jerk => "`servoctl move --help` says what a jerk is for; without one there is no limit to it",
        Field::Samples | Field::SamplesBefore | Field::Signals | Field::Decimation => {
            "`servoctl capture --help` says what fits"
        }
        Field::BusVoltage => {
            "is the motor supply on? `servoctl status` shows the bus, `servoctl params list` its limits"
        }
        Field::Amplitude
        | Field::Frequency
        | Field::Periods
        | Field::EndShare
        | Field::Duration
        | Field::Travel
        | Field::Current => "`servoctl measure --help` says what is excited, and how far",
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cli::Arguments;
    use clap::CommandFactory;
    use servo_core::alignment::Reason;
    use servo_core::encoder::sincos::FitError;

    /// One of every kind, and of every field: for a new one the compiler asks in [`help`] and [`help_with`].
    fn every_refusal() -> Vec<Refusal> {
        let fields = [
            Field::Parameter(0x0504),
            Field::Target,
            Field::Velocity,
            Field::Acceleration,
            Field::ProportionalGain,
            Field::IntegralGain,
            Field::DerivativeGain,
            Field::Samples,
            Field::Decimation,
            Field::BusVoltage,
            Field::Signals,
            Field::SamplesBefore,
            Field::Jerk,
            Field::Amplitude,
            Field::Frequency,
            Field::Periods,
            Field::EndShare,
            Field::Duration,
            Field::Travel,
            Field::Current,
        ];
        let out_of_range = fields.map(|field| Refusal::OutOfRange { field, value: 7.0, min: 1.0, max: 2.0 });
        let others = [
            Refusal::UnknownParameter(0xffff),
            Refusal::Moving,
            Refusal::NoPosition,
            Refusal::Busy,
            Refusal::FaultPersists(Fault::ParametersInvalid),
            Refusal::FaultPersists(Fault::OverTemperature),
            Refusal::Saving,
            Refusal::NothingStored,
            Refusal::Halted,
            Refusal::NotAligned(None),
            Refusal::NotAligned(Some(Reason::Blocked)),
            Refusal::Aligning,
            Refusal::NoSignals,
            Refusal::Signals(FitError::NoEllipse),
        ];
        out_of_range.into_iter().chain(State::ALL.map(Refusal::WrongState)).chain(others).collect()
    }

    #[test]
    fn every_refusal_names_the_state_the_reason_and_a_command_that_there_is() {
        for refusal in every_refusal() {
            let error = Error::Refused { request: "Move", refusal, state: Some(State::QuickStopActive) };
            let words = error.to_string();
            let [reason, state, help] = words.lines().collect::<Vec<_>>()[..] else { panic!("{words}") };
            assert_eq!(reason, format!("the drive refused Move: {refusal}"));
            assert_eq!(state, "  state: Quick stop active");
            let commands: Vec<&str> = help.split('`').skip(1).step_by(2).collect();
            assert!(!commands.is_empty(), "no command in {help}");
            for command in commands {
                let mut words = command.split(' ');
                assert_eq!(words.next(), Some("servoctl"), "{command}");
                let mut tree = Arguments::command();
                for word in words.filter(|word| !word.starts_with('-')) {
                    // What is no sub-command is an argument of the last one.
                    if let Some(sub) = tree.find_subcommand(word) {
                        tree = sub.clone();
                    } else {
                        assert!(tree.get_name() != "servoctl" && !tree.has_subcommands(), "{command}");
                    }
                }
            }
        }
    }
}
