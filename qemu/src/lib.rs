//! One recorded run of the drive, computed on the host and on a bare Cortex-M7 in QEMU.
//!
//! The host records what the drive saw on the simulated stage ([`recording`]); [`script`] says what it was told. Both sides
//! compute the same run from that and must come to the same [`digest`], bit by bit. In QEMU, a plug-in counts the
//! instructions of the functions in [`regions`].
#![no_std]

pub mod digest;
#[cfg(target_os = "none")]
pub mod image;
pub mod recording;
pub mod regions;
pub mod script;
