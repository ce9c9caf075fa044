//! What can go wrong on the host's side.

use std::path::PathBuf;

/// Why the virtual board could not do what it was asked.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// No firmware was named.
    #[error(
        "no firmware: give the path of its ELF file or set {} (build it with `cargo xtask firmware`)",
        crate::ELF_VARIABLE
    )]
    NoElf,
    /// The firmware cannot be used.
    #[error("firmware {}: {reason}", path.display())]
    Elf {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        reason: String,
    },
    /// The firmware has no such symbol.
    #[error("{reason}")]
    Symbol {
        /// Which one, and whether it is missing or ambiguous.
        reason: String,
    },
    /// The emulator could not assemble the part.
    #[error("emulated part: {0}")]
    Part(#[from] rigless::soc::Error),
    /// The emulator refused or failed.
    #[error("emulator: {0}")]
    Emulator(#[from] rigless::emulator::Error),
    /// The emulator could not write or load a snapshot.
    #[error("snapshot: {0}")]
    State(#[from] rigless::snapshot::Error),
    /// A snapshot could not be kept in a temporary file.
    #[error("snapshot: {reason}")]
    Snapshot {
        /// Why.
        reason: String,
    },
    /// The run is over.
    #[error("the virtual board has stopped: {reason}")]
    Ended {
        /// Why.
        reason: String,
    },
    /// A request does not fit a frame.
    #[error("the request does not fit a frame of {} bytes", servo_protocol::frame::MAX_FRAME)]
    TooLong,
    /// The firmware did not reply.
    #[error("the firmware did not reply to {request}")]
    NoReply {
        /// What it was asked.
        request: String,
    },
    /// The drive refused a request.
    #[error("{request} was refused: {reason}")]
    Refused {
        /// What it was asked.
        request: String,
        /// Its reason.
        reason: String,
    },
    /// The drive did not get where it was sent.
    #[error("the drive did not reach {what}: {status}")]
    NotReached {
        /// What was waited for.
        what: String,
        /// Where it stands.
        status: String,
    },
    /// The emulator remarked on something that nobody has explained.
    #[error("the emulator remarks on something unexplained:\n  {}", lines.join("\n  "))]
    Unexplained {
        /// The remarks.
        lines: Vec<String>,
    },
}
