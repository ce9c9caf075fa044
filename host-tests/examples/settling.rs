//! Prints settling times of PID and PID + NIASA on the built-in stage: `cargo run --release -p servo-host-tests --example settling [moves]`.

use servo_core::config::Compensator;
use servo_core::settling::TOLERANCES_NM;
use servo_host_tests::{experiment, tuning};
use servo_sim::Stage;

fn main() {
    let moves = std::env::args().nth(1).and_then(|n| n.parse().ok()).unwrap_or(5);
    let stage = Stage::default();
    let settings = tuning::settings(&stage, &tuning::STANDARD).expect("built-in stage");
    println!("{settings:?}");
    let started = std::time::Instant::now();
    for compensator in [Compensator::None, Compensator::Niasa] {
        let made = experiment::run(&stage, &settings, compensator, &experiment::FIVE_MM_SLOW, moves, 1)
            .expect("moves in range");
        println!("{compensator:?}: settling, ms, at ±{TOLERANCES_NM:?} nm");
        for (i, tolerance_nm) in TOLERANCES_NM.into_iter().enumerate() {
            let ms: Vec<f64> = made.iter().filter_map(|m| m.settling.settled_after_s(i)).map(|s| s * 1e3).collect();
            println!("  ±{} nm: mean {:.2} ms of {}", tolerance_nm, ms.iter().sum::<f64>() / ms.len() as f64, ms.len());
        }
        for m in made.iter().take(5) {
            let noise = m.settling.noise_ct2.map(|ct2| f64::from(ct2).sqrt() * settings.encoder_count_m * 1e9);
            let ms: Vec<_> = (0..6).map(|i| m.settling.settled_after_s(i).map(|s| (s * 1e5).round() / 100.0)).collect();
            println!("  {ms:?} noise {noise:.3?} nm, end error {} ct", m.error_ct[0]);
        }
    }
    println!("{:?}", started.elapsed());
}
