//! How the variants of NIASA compare: `cargo run --release -p servo-host-tests --example variants [moves] [seeds]`.
//!
//! For each variant the mean settling time per tolerance over all seeds, and, over series of `moves` moves, how often the mean
//! reduction against PID fell below 70 % at some tolerance, and the worst.

use servo_core::config::Compensator;
use servo_core::parameters::Settings;
use servo_core::settling::{TOLERANCES, TOLERANCES_NM};
use servo_host_tests::experiment::{self, FIVE_MM_SLOW};
use servo_host_tests::tuning;
use servo_sim::Stage;

type Change = fn(&mut Settings);

const VARIANTS: [(&str, Change); 8] = [
    ("slope, always (App. E)", |s| (s.niasa_with_proportional, s.niasa_frozen_in_profile) = (0.0, 0.0)),
    ("slope, frozen", |s| (s.niasa_with_proportional, s.niasa_frozen_in_profile) = (0.0, 1.0)),
    ("slope + k_P, always", |s| (s.niasa_with_proportional, s.niasa_frozen_in_profile) = (1.0, 0.0)),
    ("slope + k_P, frozen", |_| ()),
    ("  hysteresis halved", |s| s.niasa_hysteresis_m *= 0.5),
    ("  hysteresis doubled", |s| s.niasa_hysteresis_m *= 2.0),
    ("  hysteresis tripled", |s| s.niasa_hysteresis_m *= 3.0),
    ("  rate limit doubled", |s| s.niasa_rate_limit_n *= 2.0),
];

fn main() {
    let mut arguments = std::env::args().skip(1).filter_map(|a| a.parse::<u64>().ok());
    let (moves, seeds) = (arguments.next().unwrap_or(5), arguments.next().unwrap_or(24));
    let stage = Stage::default();
    let settings = tuning::settings(&stage, &tuning::STANDARD).expect("built-in stage");
    println!("simulated: {moves} moves of 5 mm at 1 m/s² per series, {seeds} series, built-in stage, 100 Hz / 45°");
    println!("mean settling time, ms, at ±{TOLERANCES_NM:?} nm; series below 70 %; worst reduction");
    let pid: Vec<_> = (1..=seeds).map(|seed| means_s(&stage, &settings, Compensator::None, moves, seed)).collect();
    report("PID", &pid, &pid);
    for (name, change) in VARIANTS {
        let mut settings = settings;
        change(&mut settings);
        let niasa: Vec<_> =
            (1..=seeds).map(|seed| means_s(&stage, &settings, Compensator::Niasa, moves, seed)).collect();
        report(name, &niasa, &pid);
    }
}

/// Mean settling time of one series at each tolerance over its settled moves, s.
fn means_s(stage: &Stage, settings: &Settings, compensator: Compensator, moves: u64, seed: u64) -> [f64; TOLERANCES] {
    let made = experiment::run(stage, settings, compensator, &FIVE_MM_SLOW, moves, seed).expect("moves in range");
    std::array::from_fn(|i| {
        let settled: Vec<f64> = made.iter().filter_map(|m| m.settling.settled_after_s(i)).collect();
        settled.iter().sum::<f64>() / settled.len() as f64
    })
}

fn report(name: &str, series: &[[f64; TOLERANCES]], pid: &[[f64; TOLERANCES]]) {
    let mean_ms = |i: usize| series.iter().map(|s| s[i] * 1e3).sum::<f64>() / series.len() as f64;
    let worst_of = |(s, p): (&[f64; TOLERANCES], &[f64; TOLERANCES])| {
        (0..TOLERANCES).map(|i| 1.0 - s[i] / p[i]).fold(f64::INFINITY, f64::min)
    };
    let worst: Vec<f64> = series.iter().zip(pid).map(worst_of).collect();
    let below = worst.iter().filter(|w| **w < 0.7).count();
    let means: Vec<String> = (0..TOLERANCES).map(|i| format!("{:6.1}", mean_ms(i))).collect();
    let lowest = worst.iter().copied().fold(f64::INFINITY, f64::min);
    println!("{name:24} {}   {below:3}   {:5.1} %", means.join(" "), lowest * 100.0);
}
