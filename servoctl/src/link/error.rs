//! What can go wrong between host and drive, in words that say what to do.

use std::fmt;
use std::io;

use servo_core::refusal::Refusal;
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
                match help(refusal) {
                    Some(help) => write!(f, "\n  {help}"),
                    None => Ok(()),
                }
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
pub fn help(refusal: &Refusal) -> Option<&'static str> {
    Some(match refusal {
        Refusal::WrongState(state) => match state {
            State::Fault | State::FaultReactionActive => {
                "`servoctl faults` says what happened, `servoctl faults clear` acknowledges it"
            }
            state if state.has_torque() => "`servoctl disable` turns the bridge off",
            _ => "`servoctl enable` closes the loops",
        },
        Refusal::Moving => "`servoctl stop` brakes the motion",
        Refusal::FaultPersists(servo_core::fault::Fault::ParametersInvalid) => {
            "nobody has saved this drive's parameters yet: set them, then `servoctl params save`"
        }
        Refusal::FaultPersists(_) => "remove the cause, then `servoctl faults clear`",
        Refusal::NothingStored => "`servoctl params save` stores those in use",
        Refusal::UnknownParameter(_) => "`servoctl params list` names them all",
        Refusal::OutOfRange { .. } => "`servoctl params list` shows the limits",
        Refusal::NoPosition => "`servoctl status` shows bad encoder frames: look at the encoder and its cable",
        Refusal::Halted => "the controlword's halt bit is set: clear it where it was set",
        Refusal::NotAligned(_) => "`servoctl align` looks for the electrical zero",
        Refusal::NoSignals | Refusal::Signals(_) => return None,
        Refusal::Aligning | Refusal::Saving | Refusal::Busy => "try again in a moment",
    })
}
