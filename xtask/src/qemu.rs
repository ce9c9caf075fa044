//! The control loops on a bare Cortex-M7 in QEMU: the host's bits, and instruction counts within a budget.

use anyhow::Result;

use crate::setup;

/// Builds plug-in and images, runs them, compares.
///
/// # Errors
/// When a build fails, a bit differs or a budget is exceeded.
pub fn run() -> Result<()> {
    setup::qemu()
}
