//! The host tool. It has no commands yet beyond `--help` and `--version`.

use clap::Parser;

/// Talks to a servo drive, runs its experiments and reports them.
#[derive(Parser)]
#[command(name = "servoctl", version)]
struct Arguments {}

fn main() {
    Arguments::parse();
}
