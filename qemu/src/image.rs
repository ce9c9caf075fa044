//! What the images have in common: reading the recording through semihosting, telling the result.

use semihosting::fs::File;
use semihosting::io::Read;
use servo_core::refusal::Refusal;

use crate::digest::Digest;
use crate::recording::{TICK_BYTES, Tick};
use crate::script;

/// Name of the recording in QEMU's working directory.
const RECORDING: &core::ffi::CStr = c"recording.bin";

/// Why a run ended early.
#[derive(Debug)]
pub enum Failure {
    /// The recording could not be read to its end.
    Recording,
    /// The drive refused the script's settings.
    Settings(Refusal),
}

impl From<Refusal> for Failure {
    fn from(refusal: Refusal) -> Failure {
        Failure::Settings(refusal)
    }
}

/// Hands every tick of the recording to `run`, with its number.
///
/// # Errors
/// When the recording is missing or too short, or `run` fails.
pub fn replay(mut run: impl FnMut(&mut Digest, u32, &Tick) -> Result<(), Failure>) -> Result<Digest, Failure> {
    let mut digest = Digest::default();
    let mut recording = File::open(RECORDING).map_err(|_| Failure::Recording)?;
    let mut bytes = [0; TICK_BYTES];
    for number in 0..script::TICKS {
        recording.read_exact(&mut bytes).map_err(|_| Failure::Recording)?;
        digest.input(&bytes);
        run(&mut digest, number, &Tick::from_bytes(&bytes))?;
    }
    Ok(digest)
}

/// Prints the digest, or why there is none, and ends the emulation.
pub fn end(result: Result<Digest, Failure>) -> ! {
    match result {
        Ok(digest) => {
            semihosting::print!("{digest}");
            semihosting::process::exit(0)
        }
        Err(failure) => {
            semihosting::eprintln!("{failure:?}");
            semihosting::process::exit(1)
        }
    }
}
