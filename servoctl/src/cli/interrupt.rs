//! Ctrl-C: once, and the computation ends after what is under way; twice, and the process ends.

use std::sync::atomic::{AtomicBool, Ordering};

use anyhow::{Context, Result};

/// Exit code of a process that the second Ctrl-C ended: 128 + SIGINT.
const INTERRUPTED: i32 = 130;

static STOP: AtomicBool = AtomicBool::new(false);

/// The flag that the first Ctrl-C sets.
///
/// # Errors
/// When no handler can be installed.
pub fn flag() -> Result<&'static AtomicBool> {
    static INSTALLED: AtomicBool = AtomicBool::new(false);
    if !INSTALLED.swap(true, Ordering::Relaxed) {
        ctrlc::set_handler(|| {
            if STOP.swap(true, Ordering::Relaxed) {
                std::process::exit(INTERRUPTED);
            }
            eprintln!("\nending after what is under way; Ctrl-C again ends at once");
        })
        .context("cannot listen for Ctrl-C")?;
    }
    Ok(&STOP)
}
