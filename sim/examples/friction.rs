//! What a step of each friction model costs: `cargo run --release -p servo-sim --example friction`.

use std::time::Instant;

use servo_sim::Stage;
use servo_sim::friction::Friction;

const STEPS: u32 = 4_000_000;
const DT_S: f64 = 6.25e-6;

fn main() {
    let tables = [
        ("coulomb", "model = 'coulomb'\ncoulomb_n = 0.64"),
        ("stribeck", "model = 'stribeck'\ncoulomb_n = 0.64\nstatic_n = 0.8\nstribeck_m_per_s = 1e-3"),
        ("dahl", "model = 'dahl'\nstiffness_n_per_m = 8.66e6\ncoulomb_n = 0.64"),
        ("dahl, i = 1.5", "model = 'dahl'\nstiffness_n_per_m = 8.66e6\ncoulomb_n = 0.64\nshape = 1.5"),
        ("lugre", "model = 'lugre'\nstiffness_n_per_m = 8.66e6\ncoulomb_n = 0.64\nstatic_n = 0.8"),
        ("maxwell-slip, 12 elements", "model = 'maxwell-slip'\nstiffness_n_per_m = 8.66e6\ncoulomb_n = 0.64"),
        ("gms, table 4", "model = 'gms'\npreset = 'table-4'"),
        ("gms, table 4, hidden state, n = 1", "model = 'gms'\npreset = 'table-4'\nshape = 1"),
        ("gms, table 4, hidden state, n = 2", "model = 'gms'\npreset = 'table-4'\nshape = 2"),
    ];
    let built_in = servo_sim::stage::BUILT_IN_TOML;
    let (from, to) = (built_in.find("[friction]").unwrap_or(0), built_in.find("[motor]").unwrap_or(0));
    for (name, table) in tables {
        let text = format!("{}[friction]\n{table}\n{}", &built_in[..from], &built_in[to..]);
        let stage = Stage::from_toml(&text).expect("a valid table");
        let mut friction = Friction::new(&stage.friction);
        let start = Instant::now();
        // To and fro by 1 µm, a nanometre a step.
        let sum_n = (0..STEPS).fold(0.0, |sum_n, step| {
            let dx_m = if step / 1_000 % 2 == 0 { 1e-9 } else { -1e-9 };
            sum_n + friction.advance(dx_m, DT_S)
        });
        let ns = start.elapsed().as_secs_f64() * 1e9 / f64::from(STEPS);
        println!("{name:<36}{ns:8.1} ns a step (sum {sum_n:.3} N)");
    }
}
