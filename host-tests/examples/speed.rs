//! How fast the experiments run: `cargo run --release -p servo-host-tests --example speed [FILE.json]`, one core (`-`: JSON instead
//! of words).
//!
//! The plant of the first experiment (twelve elements, ten internal steps a tick) moves 5 mm and dwells, once on the fast bench and
//! once written straightforwardly, in the same process; then the full bench with motor and bridge, for comparison.
//!
//! The straightforward plant asks every element in every step. Otherwise it does less: Euler's rule of first order instead of a step of
//! second order, no back-EMF and no limit of the bridge, no latency of the encoder, no hard stops. That the fast bench does more in less
//! time is what its friction buys, which asks the elements only where one of them begins or ceases to slide.

use std::time::Instant;

use servo_core::config::Config;
use servo_core::drive::{Command, Drive, Inputs};
use servo_core::parameters::Settings;
use servo_core::position::Position;
use servo_core::{PERIODS_PER_TICK, PWM_HZ, SERVO_HZ};
use servo_host_tests::experiment::FIVE_MM_SLOW;
use servo_host_tests::fast::STEPS_PER_PERIOD;
use servo_host_tests::tuning::{self, STANDARD};
use servo_host_tests::{Bench, FastBench};
use servo_sim::friction::{Element, MaxwellSlip};
use servo_sim::random::{BEFORE_FIRST_MOVE, Noise, Purpose};
use servo_sim::{Stage, encoder};

/// Moves and time of each.
const MOVES: u64 = 10;
const MOVE_S: f64 = 4.14;
/// Each is measured so often; the fastest counts.
const ROUNDS: usize = 3;
/// What the experiments are held to, simulated seconds per second and core.
const WANTED: f64 = 200.0;

/// One tick of a bench: its command in, its true position out.
type Tick<'a> = Box<dyn FnMut(Option<Command>) -> f64 + 'a>;

/// The plant as one would write it at first: a loop over spring-slider elements, a current loop of first order, Euler's rule.
struct Straightforward {
    drive: Drive,
    elements: Vec<Element>,
    stretch_n: Vec<f64>,
    position_m: f64,
    velocity_m_per_s: f64,
    current_a: f64,
    encoder_noise: Noise,
    current_noise: Noise,
}

impl Straightforward {
    fn new(stage: &Stage, settings: &Settings) -> Self {
        let friction = &stage.friction;
        let elements: Vec<Element> =
            MaxwellSlip::new(friction.elements, friction.stiffness_n_per_m, friction.coulomb_n).elements().collect();
        Straightforward {
            drive: Drive::new(Config::new(settings).expect("valid settings")),
            stretch_n: vec![0.0; elements.len()],
            elements,
            position_m: 0.0,
            velocity_m_per_s: 0.0,
            current_a: 0.0,
            encoder_noise: Noise::new(1, Purpose::Encoder, BEFORE_FIRST_MOVE),
            current_noise: Noise::new(1, Purpose::PhaseAdc, BEFORE_FIRST_MOVE),
        }
    }

    fn tick(&mut self, stage: &Stage, settings: &Settings, command: Option<Command>) {
        let seen_m = self.position_m + stage.encoder.noise_m_rms * self.encoder_noise.normal();
        let count = encoder::counts(seen_m, stage.encoder.count_m);
        let inputs = Inputs {
            frame: encoder::frame(count, false, false, 1),
            iq_a: self.current_a as f32,
            bus_code: (stage.amplifier.bus_v / stage.adc.bus_full_scale_v * 65_536.0) as u16,
            temperature_code: 15_000,
            signals: 0,
            last_tick_cycles: 4_000,
        };
        let demand = self.drive.tick(&inputs, command.as_ref()).demand;
        let dt_s = 1.0 / f64::from(PWM_HZ * STEPS_PER_PERIOD);
        for _ in 0..PERIODS_PER_TICK {
            let noise_a = stage.amplifier.full_scale_a / 32_768.0 * self.current_noise.normal();
            for _ in 0..STEPS_PER_PERIOD {
                let wanted_a = if demand.enabled { f64::from(demand.iq_a) + noise_a } else { 0.0 };
                let rate_per_s = std::f64::consts::TAU * settings.current_bandwidth_hz;
                self.current_a += (wanted_a - self.current_a) * (1.0 - (-rate_per_s * dt_s).exp());
                let dx_m = self.velocity_m_per_s * dt_s;
                self.position_m += dx_m;
                let mut friction_n = 0.0;
                for (element, stretch_n) in self.elements.iter().zip(&mut self.stretch_n) {
                    *stretch_n = (*stretch_n + element.stiffness_n_per_m * dx_m)
                        .clamp(-element.saturation_n, element.saturation_n);
                    friction_n += *stretch_n;
                }
                let force_n = self.current_a * stage.motor.force_constant_n_per_a;
                let drag_n = stage.mechanics.viscous_n_s_per_m * self.velocity_m_per_s;
                self.velocity_m_per_s += (force_n - friction_n - drag_n) / stage.mechanics.mass_kg * dt_s;
            }
        }
    }
}

/// Time that this thread has had a processor, s, where the system tells (Linux): other programs do not count. Elsewhere time itself.
fn processor_s(clock: &Instant) -> f64 {
    let told = std::fs::read_to_string("/proc/thread-self/schedstat").ok();
    let ns = told.and_then(|text| text.split_whitespace().next()?.parse::<f64>().ok());
    ns.map_or_else(|| clock.elapsed().as_secs_f64(), |ns| ns * 1e-9)
}

/// Simulated seconds per second, and where the stage is at the end of the first move, m.
fn measure(settings: &Settings, mut tick: Tick) -> (f64, f64) {
    for _ in 0..5 {
        tick(None);
    }
    tick(Some(Command::Enable));
    for _ in 0..800 {
        tick(None);
    }
    let clock = Instant::now();
    let ticks = (MOVE_S * f64::from(SERVO_HZ)) as u32;
    let (mut fastest_s, mut first_m) = (f64::INFINITY, None);
    for round in 0..ROUNDS {
        let start_s = processor_s(&clock);
        for index in 0..MOVES {
            let target = FIVE_MM_SLOW.target(Position(0), index, settings.encoder_count_m);
            tick(Some(Command::Move { target, limits: FIVE_MM_SLOW.limits(settings) }));
            let end_m = (1..ticks).fold(0.0, |_, _| tick(None));
            first_m.get_or_insert(end_m);
        }
        fastest_s = fastest_s.min(processor_s(&clock) - start_s);
        eprintln!("  {} of {ROUNDS}", round + 1);
    }
    (MOVES as f64 * MOVE_S / fastest_s, first_m.unwrap_or(f64::NAN))
}

fn main() -> std::io::Result<()> {
    let stage = Stage::default();
    let settings = tuning::settings(&stage, &STANDARD).expect("the built-in stage");
    let mut fast = FastBench::new(&stage, &settings, 1).expect("valid settings");
    let mut plain = Straightforward::new(&stage, &settings);
    let mut full = Bench::new(&stage, &settings, 1).expect("valid settings");
    let benches: [(&str, &str, Tick); 3] = [
        (
            "fast",
            "fast bench (as the experiments use it)",
            Box::new(|command| {
                fast.tick(command);
                fast.carriage.position_m()
            }),
        ),
        (
            "straightforward",
            "straightforward baseline (loop over 12 elements)",
            Box::new(|command| {
                plain.tick(&stage, &settings, command);
                plain.position_m
            }),
        ),
        (
            "full",
            "full bench (dq current loop, motor, bridge)",
            Box::new(|command| {
                full.tick(command);
                full.plant.position_m()
            }),
        ),
    ];
    let mut found = Vec::new();
    for (key, name, tick) in benches {
        eprintln!("{name}");
        found.push((key, name, measure(&settings, tick)));
    }
    let (fast, base) = (found[0].2.0, found[1].2.0);
    let fields: Vec<String> =
        found.iter().map(|(key, _, (speed, _))| format!("\"{key}_simulated_s_per_s\":{speed:.1}")).collect();
    let json = format!("{{{},\"wanted_simulated_s_per_s\":{WANTED},\"ratio\":{:.3}}}\n", fields.join(","), fast / base);
    if fast < WANTED {
        eprintln!("{fast:.0} simulated seconds per second: below the wanted {WANTED}");
    }
    match std::env::args().nth(1) {
        Some(file) if file == "-" => {
            print!("{json}");
            return Ok(());
        }
        Some(file) => {
            if let Some(directory) = std::path::Path::new(&file).parent() {
                std::fs::create_dir_all(directory)?;
            }
            std::fs::write(file, json)?;
        }
        None => {}
    }
    println!(
        "Simulated seconds per second on one core, plant of exp1 (12 elements, {} steps a tick), PID, {MOVES} moves of {MOVE_S} s:",
        PERIODS_PER_TICK * STEPS_PER_PERIOD
    );
    for (_, name, (speed, first_m)) in &found {
        // All three must have made the move, or the comparison is of nothing.
        let off_nm = (first_m - 5e-3) * 1e9;
        println!("  {name:<52}{speed:7.0}   {:5.2} × baseline   {off_nm:+6.1} nm from the first target", speed / base);
    }
    println!(
        "  wanted of the fast bench: at least {WANTED}; the baseline is Euler's rule without bridge, latency and hard stops"
    );
    Ok(())
}
