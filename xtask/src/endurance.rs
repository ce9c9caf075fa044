//! `cargo xtask endurance`: the long forms of tests that `cargo xtask test` runs in short.

use anyhow::Result;

use crate::{host, process};

/// How long.
#[derive(clap::Args)]
pub struct Options {
    /// Simulated seconds of motion with lost frames and a load
    #[arg(long, default_value_t = 3600)]
    motion_s: u32,
    /// What is drawn for it: moves, loads, lost frames, friction and noise
    #[arg(long, default_value_t = 1)]
    motion_seed: u64,
    /// Ticks of random commands and samples
    #[arg(long, default_value_t = 1_000_000_000)]
    random_ticks: u64,
}

/// Runs them, optimised, one after the other.
///
/// # Errors
/// When one fails.
pub fn run(options: &Options) -> Result<()> {
    let long = [
        ("endurance", "SERVO_MOTION_S", u64::from(options.motion_s)),
        ("random", "SERVO_RANDOM_TICKS", options.random_ticks),
    ];
    for (test, variable, value) in long {
        let mut tests = host::cargo("test");
        tests.args(["--release", "--package", "servo-host-tests", "--test", test, "--", "--nocapture"]);
        tests.env(variable, value.to_string()).env("SERVO_MOTION_SEED", options.motion_seed.to_string());
        process::run(&mut tests, test)?;
    }
    Ok(())
}
