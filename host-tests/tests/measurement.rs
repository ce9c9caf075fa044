//! What the drive measures of its own loop, against what the loop is.

use std::f64::consts::TAU;

use num_complex::Complex64;
use servo_core::cascade::CascadeGains;
use servo_core::drive::Command;
use servo_core::measure::{self, Exceeded, Node, Order, Progress, Reading, Request, Shape};
use servo_core::parameters::Settings;
use servo_core::position::Position;
use servo_core::profile::Limits;
use servo_core::record::flags;
use servo_core::refusal::Refusal;
use servo_core::{PWM_HZ, SERVO_HZ};
use servo_host_tests::FastBench;
use servo_host_tests::tuning::{self, HIGH_PERFORMANCE, STANDARD, Tuning};
use servo_sim::Stage;

/// Bounds that nothing here meets.
const WIDE: Request = Request {
    shape: Shape::Pulse { amplitude: 0.0, length_s: 0.0 },
    node: Node::Force,
    travel_m: 1e-3,
    speed_m_per_s: 0.1,
    current_a: 8.0,
};

fn tone(node: Node, amplitude: f32, frequency_hz: f32) -> Request {
    Request { shape: Shape::Tone { amplitude, frequency_hz, measure_s: 0.25, lead_s: 0.25 }, node, ..WIDE }
}

fn bench(stage: &Stage, tuned: &Tuning) -> (FastBench, Settings) {
    let settings = tuning::settings(stage, tuned).unwrap();
    let mut bench = FastBench::new(stage, &settings, 1).unwrap();
    bench.enable().unwrap();
    (bench, settings)
}

fn order(request: &Request, settings: &Settings) -> Command {
    Command::Excite(Order::new(request, settings.encoder_count_m).unwrap())
}

/// Plays a request to its end.
fn play(bench: &mut FastBench, settings: &Settings, request: &Request) -> Reading {
    bench.command(order(request, settings)).unwrap();
    while bench.drive.measured().progress == Progress::Running {
        bench.tick(None);
    }
    bench.drive.measured()
}

fn complex(value: measure::Complex) -> Complex64 {
    Complex64::new(value.re, value.im)
}

fn loop_transmission(reading: &Reading) -> Complex64 {
    assert_eq!(reading.progress, Progress::Complete);
    -complex(reading.before) / complex(reading.after)
}

/// A stage without noise and with next to no friction: the drive that is tuned for it takes an F̂_C of 1 mN or more.
fn frictionless() -> Stage {
    let mut stage = Stage::default();
    (stage.friction.coulomb_n, stage.encoder.noise_m_rms, stage.friction.spread) = (2e-3, 0.0, None);
    stage
}

/// The loop transmission of a free mass, from the difference equations: the cascade at the servo rate, its force held and sampled by
/// the current loop at the PWM rate, currents in straight lines from one PWM period to the next.
fn analytic(settings: &Settings, mass_kg: f64, hz: f64) -> Complex64 {
    let (omega, pwm_s, servo_s) = (TAU * hz, 1.0 / f64::from(PWM_HZ), 1.0 / f64::from(SERVO_HZ));
    let late = |s: f64| Complex64::from_polar(1.0, -omega * s);
    let gains = CascadeGains {
        position_per_s: settings.position_gain_per_s,
        velocity_n_s_per_m: settings.velocity_gain_n_s_per_m,
        integral_per_s: settings.velocity_integral_per_s,
    };
    let one = Complex64::new(1.0, 0.0);
    let integral = gains.integral_per_s * servo_s * late(servo_s) / (one - late(servo_s));
    let control =
        gains.velocity_n_s_per_m * (gains.position_per_s + (one - late(servo_s)) / servo_s) * (one + integral);
    let hold = (one - late(servo_s)) / (one - late(pwm_s)) / (servo_s / pwm_s);
    let gain = TAU * settings.current_bandwidth_hz * pwm_s;
    let current = gain * late(pwm_s) / (one / late(pwm_s) - one + gain * late(pwm_s));
    let half = 0.5 * omega * pwm_s;
    let straight = (libm::sin(half) / half).powi(2);
    control * hold * current * straight * (-1.0 / (mass_kg * omega * omega))
}

/// Frequency near `hz` at which `magnitude` is 1, and the phase margin there, from three points.
fn crossover(points: &[(f64, Complex64)]) -> (f64, f64) {
    let at = points.windows(2).find(|pair| pair[0].1.norm() >= 1.0 && pair[1].1.norm() < 1.0).expect("a crossover");
    let [(low_hz, low), (high_hz, high)] = [at[0], at[1]];
    let share = low.norm().ln() / (low.norm().ln() - high.norm().ln());
    let hz = low_hz * (high_hz / low_hz).powf(share);
    let turn = |value: Complex64| (-value).arg().to_degrees();
    (hz, turn(low) + share * (turn(high) - turn(low)))
}

#[test]
fn without_friction_crossover_and_margin_are_those_of_the_analytic_loop() {
    let stage = frictionless();
    for tuned in [STANDARD, HIGH_PERFORMANCE] {
        let (mut bench, settings) = bench(&stage, &tuned);
        let grid = [0.85, 0.95, 1.05, 1.15].map(|factor| tuned.crossover_hz * factor);
        let measured: Vec<(f64, Complex64)> = grid
            .iter()
            .map(|hz| play(&mut bench, &settings, &tone(Node::Force, 4.0, *hz as f32)))
            .map(|reading| (reading.frequency_hz, loop_transmission(&reading)))
            .collect();
        let expected: Vec<(f64, Complex64)> =
            measured.iter().map(|(hz, _)| (*hz, analytic(&settings, stage.mechanics.mass_kg, *hz))).collect();
        let ((hz, margin), (expected_hz, expected_margin)) = (crossover(&measured), crossover(&expected));
        println!("{hz:.2} Hz {margin:.2}°, analytic {expected_hz:.2} Hz {expected_margin:.2}°");
        assert!((hz / expected_hz - 1.0).abs() < 0.02, "{hz} Hz, analytic {expected_hz} Hz");
        assert!((margin - expected_margin).abs() < 2.0, "{margin}°, analytic {expected_margin}°");
    }
}

#[test]
fn both_nodes_show_the_same_loop() {
    let (mut bench, settings) = bench(&frictionless(), &STANDARD);
    for hz in [60.0, 120.0, 300.0] {
        let force = loop_transmission(&play(&mut bench, &settings, &tone(Node::Force, 4.0, hz)));
        let velocity = loop_transmission(&play(&mut bench, &settings, &tone(Node::Velocity, 4e-3, hz)));
        assert!((velocity / force - 1.0).norm() < 0.02, "{hz} Hz: {force} {velocity}");
    }
}

/// The plant is what the position does for the force that leaves the node.
#[test]
fn the_mass_shows_in_position_over_force() {
    let stage = frictionless();
    let (mut bench, settings) = bench(&stage, &STANDARD);
    let reading = play(&mut bench, &settings, &tone(Node::Force, 4.0, 150.0));
    let compliance = complex(reading.position_ct) / complex(reading.after) * settings.encoder_count_m;
    let mass_kg = 1.0 / (compliance.norm() * (TAU * reading.frequency_hz).powi(2));
    assert!((mass_kg / stage.mechanics.mass_kg - 1.0).abs() < 0.02, "{mass_kg} kg");
}

/// Small amplitudes see a spring, large ones a mass (5.1, figure 15).
#[test]
fn with_friction_the_amplitude_decides_between_spring_and_mass() {
    let mut stage = Stage::default();
    stage.friction.spread = None;
    let (mut bench, settings) = bench(&stage, &STANDARD);
    let mut compliance = |amplitude_n: f32, hz: f32| {
        let reading = play(&mut bench, &settings, &tone(Node::Force, amplitude_n, hz));
        complex(reading.position_ct) / complex(reading.after) * settings.encoder_count_m
    };
    // A mass: four times less at twice the frequency, in opposition to the force. A spring: the same, with the force.
    let [large, larger] = [40.0, 80.0].map(|hz| compliance(8.0, hz));
    assert!((large.norm() / larger.norm() / 4.0 - 1.0).abs() < 0.2, "{large} {larger}");
    assert!(large.re < 0.0);
    let [small, smaller] = [40.0, 80.0].map(|hz| compliance(0.1, hz));
    assert!((small.norm() / smaller.norm() - 1.0).abs() < 0.2, "{small} {smaller}");
    assert!(small.re > 0.0);
    let stiffness_n_per_m = 1.0 / small.norm();
    assert!((8e6..20e6).contains(&stiffness_n_per_m), "between σ and 2σ: {stiffness_n_per_m}");
}

#[test]
fn a_limit_ends_the_excitation_and_not_the_drive() {
    let (mut bench, settings) = bench(&Stage::default(), &STANDARD);
    for (request, expected) in [
        (Request { travel_m: 0.2e-6, ..tone(Node::Force, 8.0, 20.0) }, Exceeded::Travel),
        (Request { speed_m_per_s: 1e-4, ..tone(Node::Force, 8.0, 20.0) }, Exceeded::Speed),
        (Request { current_a: 0.05, ..tone(Node::Force, 8.0, 20.0) }, Exceeded::Current),
    ] {
        assert_eq!(play(&mut bench, &settings, &request).progress, Progress::Exceeded(expected));
        for _ in 0..4_000 {
            assert_eq!(bench.tick(None).record.flags & flags::EXCITED, 0);
        }
        assert_eq!(bench.command(Command::Stop), Ok(()), "still enabled");
    }
}

#[test]
fn stop_and_disable_end_it_and_without_torque_it_is_refused() {
    let (mut bench, settings) = bench(&Stage::default(), &STANDARD);
    let pulse = Request { shape: Shape::Pulse { amplitude: 0.1, length_s: 10.0 }, ..WIDE };
    for end in [Command::Stop, Command::Disable] {
        bench.command(order(&pulse, &settings)).unwrap();
        bench.tick(None);
        assert_eq!(bench.drive.measured().progress, Progress::Running);
        bench.command(end).unwrap();
        bench.tick(None);
        assert_eq!(bench.drive.measured().progress, Progress::Aborted);
    }
    let refused = bench.command(order(&pulse, &settings));
    assert!(matches!(refused, Err(Refusal::WrongState(_))), "{refused:?}");
}

/// A slow move under the excitation keeps friction sliding: what is left is the mass.
#[test]
fn a_slow_move_carries_the_excitation_through_friction() {
    let stage = Stage::default();
    let (mut bench, settings) = bench(&stage, &STANDARD);
    let target = Position((10e-3 / settings.encoder_count_m) as i64);
    let limits = Limits { velocity_m_per_s: 5e-3, acceleration_m_per_s2: 1.0, jerk_m_per_s3: None };
    bench.command(Command::Move { target, limits }).unwrap();
    let request = Request { travel_m: 20e-3, ..tone(Node::Force, 0.5, 100.0) };
    let reading = play(&mut bench, &settings, &request);
    assert!(bench.is_moving());
    let compliance = complex(reading.position_ct) / complex(reading.after) * settings.encoder_count_m;
    let mass_kg = 1.0 / (compliance.norm() * (TAU * reading.frequency_hz).powi(2));
    assert!((mass_kg / stage.mechanics.mass_kg - 1.0).abs() < 0.05, "{mass_kg} kg");
}
