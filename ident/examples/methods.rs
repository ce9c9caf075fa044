//! Time and result of the two ways to fit Dahl's model, in one run:
//! `cargo run --release -p servo-ident --example methods`.

use std::time::Instant;

use servo_ident::{Record, dahl, genetic};
use servo_sim::friction::Dahl;
use servo_sim::random::{Noise, Purpose};

const SIGMA_N_PER_M: f64 = 8.66e6;
const COULOMB_N: f64 = 0.64;
const RATE_HZ: f64 = 8_000.0;

fn main() {
    println!("simulated: a second of a decaying sine of 1 µm at 8 kHz, 20 mN rms of noise; truth 8.66 N/µm, 0.64 N");
    for hz in [8.0, 16.0, 32.0] {
        let mut noise = Noise::new(1, Purpose::Friction, hz as u64);
        let mut friction = Dahl::new(SIGMA_N_PER_M, COULOMB_N);
        let time_s: Vec<f64> = (0..8_000).map(|i| f64::from(i) / RATE_HZ).collect();
        let position_m: Vec<f64> =
            time_s.iter().map(|t| 1e-6 * libm::exp(-1.2 * t) * libm::sin(std::f64::consts::TAU * hz * t)).collect();
        let steps_m = std::iter::once(0.0).chain(position_m.windows(2).map(|x| x[1] - x[0]));
        let force_n: Vec<f64> = steps_m.map(|dx_m| friction.advance(dx_m) + 20e-3 * noise.normal()).collect();
        let record = Record::from_force(&time_s, &position_m, &force_n).expect("good data");

        let started = Instant::now();
        let searched = dahl::fit(&record).expect("determined");
        let search_s = started.elapsed().as_secs_f64();
        let started = Instant::now();
        let bred = genetic::fit(&record, &genetic::Search::default());
        let genetic_s = started.elapsed().as_secs_f64();
        let line = |name, sigma: f64, coulomb, mse: f64, s: f64| {
            println!("  {name:8} {:7.4} N/µm  {coulomb:.5} N  mse {mse:.6e} N²  {:8.2} ms", sigma * 1e-6, s * 1e3);
        };
        println!("{hz} Hz: {:.0} times faster", genetic_s / search_s);
        line("search", searched.sigma_n_per_m, searched.coulomb_n, searched.mse_n2, search_s);
        line("genetic", bred.sigma_n_per_m, bred.coulomb_n, bred.mse_n2, genetic_s);
    }
}
