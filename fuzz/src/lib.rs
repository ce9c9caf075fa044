//! What must hold for any bytes at all, wherever bytes come from outside: the serial link, the flash, the encoder's line, a file.
//!
//! Each target is a function that panics where something is wrong. `cargo xtask fuzz` lets libFuzzer look for bytes that do it;
//! `tests/replay.rs` goes through the inputs that it found worth keeping (`corpus/`, one folder a target), with any compiler.

pub mod biss;
pub mod frame;
pub mod image;
pub mod stage;

/// One target.
#[derive(Clone, Copy, Debug)]
pub struct Target {
    /// Name of its program and of its folder.
    pub name: &'static str,
    /// Panics where something is wrong with these bytes.
    pub check: fn(&[u8]),
    /// Inputs to begin with.
    pub seeds: fn() -> Vec<Vec<u8>>,
}

/// All targets.
pub const TARGETS: [Target; 4] = [
    Target { name: "frame", check: frame::check, seeds: frame::seeds },
    Target { name: "image", check: image::check, seeds: image::seeds },
    Target { name: "biss", check: biss::check, seeds: biss::seeds },
    Target { name: "stage", check: stage::check, seeds: stage::seeds },
];
