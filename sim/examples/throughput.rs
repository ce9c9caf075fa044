//! How many seconds the plant simulates in one: `cargo run --release -p servo-sim --example throughput`.
//!
//! A stage in motion, advanced and read as a drive does it: forty bridge states and current readings and eight encoder
//! frames per millisecond.

use std::time::Instant;

use servo_sim::{BridgeState, Plant, SUBSTEP_MAX_NS, Stage};

const PERIOD_NS: u64 = 25_000;
const PERIODS: u64 = 40_000 * 20;

fn main() {
    let mut plant = Plant::new(&Stage::default(), 1);
    plant.redraw_friction(0);
    let start = Instant::now();
    let mut checksum = 0u64;
    for period in 0..PERIODS {
        // Plus and minus 0.48 V in turn, 100 times a second: some millimetres to and fro.
        let swing = if period / 200 % 2 == 0 { 0.005 } else { -0.005 };
        plant.advance(
            PERIOD_NS,
            &BridgeState { duty: [0.5, 0.5 + swing, 0.5 - swing], enabled: true, dead_time_s: 0.5e-6 },
        );
        checksum = checksum.wrapping_add(u64::from(plant.phase_codes()[0]));
        if period % 5 == 0 {
            checksum = checksum.wrapping_add(plant.encoder_frame()).wrapping_add((plant.bus_adc() * 65_536.0) as u64);
        }
    }
    let simulated_s = (PERIODS * PERIOD_NS) as f64 * 1e-9;
    println!(
        "{simulated_s} s in {:.3} s of wall time: {:.0} s/s on one core, {} internal steps per 125 us (checksum {checksum:016x})",
        start.elapsed().as_secs_f64(),
        simulated_s / start.elapsed().as_secs_f64(),
        5 * PERIOD_NS.div_ceil(SUBSTEP_MAX_NS),
    );
}
