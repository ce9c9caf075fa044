//! Ctrl-C: once, and the computation ends after what is under way; twice, and the process ends.

use std::process::ExitCode;
use std::sync::atomic::{AtomicBool, Ordering};

use anyhow::{Context, Result};

/// Exit code of a process that Ctrl-C ended, at once or after what was under way: 128 + SIGINT.
pub const INTERRUPTED: u8 = 130;

static STOP: AtomicBool = AtomicBool::new(false);

/// The flag that the first Ctrl-C sets.
///
/// # Errors
/// When no handler can be installed.
pub fn flag() -> Result<&'static AtomicBool> {
    flag_saying("ending after what is under way; Ctrl-C again ends at once")
}

/// The same, with other words at the first Ctrl-C; those of the first call stay.
///
/// # Errors
/// When no handler can be installed.
pub fn flag_saying(words: &'static str) -> Result<&'static AtomicBool> {
    static INSTALLED: AtomicBool = AtomicBool::new(false);
    if !INSTALLED.swap(true, Ordering::Relaxed) {
        ctrlc::set_handler(move || {
            if STOP.swap(true, Ordering::Relaxed) {
                std::process::exit(INTERRUPTED.into());
            }
            eprintln!("\n{words}");
        })
        .context("cannot listen for Ctrl-C")?;
    }
    Ok(&STOP)
}

/// Exit code of a computation that gave what was finished: after Ctrl-C that is not all of it, and a batch system has to see that.
pub fn exit_code() -> ExitCode {
    if STOP.load(Ordering::Relaxed) { ExitCode::from(INTERRUPTED) } else { ExitCode::SUCCESS }
}
