//! Boots a firmware on the virtual board, streams its log and says how fast it went.

use std::path::PathBuf;
use std::time::{Duration, Instant};

use anyhow::Result;
use clap::Parser;
use servo_virtual_board::{Config, Elf, VirtualBoard};

/// Boots a firmware ELF on the virtual board and streams its log.
#[derive(Parser)]
#[command(version)]
struct Arguments {
    /// The firmware; without it the variable SERVO_ELF names it.
    elf: Option<PathBuf>,
    /// Virtual seconds to run.
    #[arg(long, default_value_t = 1.0)]
    seconds: f64,
    /// Seed of the plant's random numbers.
    #[arg(long, default_value_t = 1)]
    seed: u64,
}

/// How much virtual time passes between two looks at the log.
const SLICE: Duration = Duration::from_millis(10);

fn main() -> Result<()> {
    let arguments = Arguments::parse();
    let elf = Elf::find(arguments.elf.as_deref())?;
    let config = Config { seed: arguments.seed, ..Config::default() };
    let mut board = VirtualBoard::boot(&elf, &config)?;
    let end_ns = Duration::try_from_secs_f64(arguments.seconds)?.as_nanos() as u64;
    let started = Instant::now();
    while board.time_ns() < end_ns {
        board.run_until_ns(end_ns.min(board.time_ns() + SLICE.as_nanos() as u64))?;
        for line in board.log()? {
            println!("{line}");
        }
    }
    let wall_s = started.elapsed().as_secs_f64();
    for told in board.told()? {
        println!("{told}");
    }
    let counts = board.counts()?;
    println!(
        "{:.0} accesses, {:.0} stops, {:.0} plant steps per virtual second; {} PWM periods",
        counts.accesses as f64 / arguments.seconds,
        counts.stops as f64 / arguments.seconds,
        counts.plant_steps as f64 / arguments.seconds,
        counts.updates,
    );
    for (name, latency) in [("servo tick", counts.servo_tick), ("current loop", counts.current_loop)] {
        println!(
            "{name}: update to compares {:.0} ns mean, {} ns max, {} times",
            latency.mean_ns(),
            latency.max_ns,
            latency.count,
        );
    }
    println!("{:.2} s of wall time per virtual second", wall_s / arguments.seconds);
    Ok(())
}
