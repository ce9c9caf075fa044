//! The second kind of encoder on the simulated stage: 2 % of offset and gain and 2° of phase, noise and quantisation of the converters,
//! comparators with hysteresis, and a counter that is read late.

use servo_core::config::Compensator;
use servo_core::drive::Command;
use servo_core::encoder::sincos::{Correction, Sample};
use servo_core::encoder::tracker::LOST_AFTER;
use servo_core::fault::Fault;
use servo_core::parameters::Settings;
use servo_core::position::Position;
use servo_core::profile::Limits;
use servo_core::refusal::Refusal;
use servo_host_tests::experiment::FIVE_MM_SLOW;
use servo_host_tests::{Bench, experiment, tuning};
use servo_sim::Stage;

const PERIOD_M: f64 = 4e-6;

fn stage() -> Stage {
    Stage::from_toml(include_str!("../../sim/stages/sin-cos.toml")).unwrap()
}

fn calibrated() -> Settings {
    tuning::settings(&stage(), &tuning::STANDARD).unwrap()
}

fn enabled(settings: &Settings) -> Bench {
    let mut bench = Bench::new(&stage(), settings, 3).unwrap();
    bench.enable().unwrap();
    bench
}

fn go(to_m: f64, velocity_m_per_s: f32, acceleration_m_per_s2: f32) -> Command {
    let limits = Limits { velocity_m_per_s, acceleration_m_per_s2, jerk_m_per_s3: None };
    Command::Move { target: Position((to_m / PERIOD_M * 65_536.0) as i64), limits }
}

/// What repeats with every signal period of measured less true position, half of peak to peak, m: the mean in each 32nd of a period
/// over 200 periods of slow motion, 190 samples each, so that 0.44 nm of noise leave 0.03 nm rms.
fn subdivisional_error_m(bench: &mut Bench) -> f64 {
    let mut bins = [(0.0, 0u32); 32];
    bench.command(go(0.8e-3, 0.97e-3, 0.1)).unwrap();
    bench.run(400, |_| ());
    for _ in 0..6_000 {
        let true_m = bench.plant.position_m();
        let position = bench.tick(None).record.position;
        let bin = &mut bins[((true_m / PERIOD_M).rem_euclid(1.0) * 32.0) as usize];
        *bin = (bin.0 + position.0 as f64 * PERIOD_M / 65_536.0 - true_m, bin.1 + 1);
    }
    let means_m = bins.map(|(sum_m, n)| sum_m / f64::from(n));
    0.5 * (means_m.iter().copied().fold(f64::MIN, f64::max) - means_m.iter().copied().fold(f64::MAX, f64::min))
}

#[test]
fn a_calibrating_move_takes_the_subdivisional_error_from_tens_of_nanometres_to_below_a_third_of_one() {
    let raw = tuning::uncalibrated(&stage(), &tuning::STANDARD).unwrap();
    let mut bench = enabled(&raw);
    assert_eq!(bench.axis.drive().subdivisional_error_m(), None);
    bench.command(go(0.06e-3, 1e-3, 0.1)).unwrap();
    bench.run(600, |_| ());
    let health_m = bench.axis.drive().subdivisional_error_m().unwrap();
    assert!((15e-9..40e-9).contains(&health_m), "{health_m} m");

    let left_m = subdivisional_error_m(&mut enabled(&calibrated()));
    println!("{health_m:e} m before, {left_m:e} m after");
    assert!(left_m < 0.3e-9, "{left_m} m");
}

/// Taken over with the bridge on, at rest: the position changes by what the error was, and the force by less than 1 % of its 78 N.
#[test]
fn a_correction_is_taken_over_without_a_bump() {
    let raw = tuning::uncalibrated(&stage(), &tuning::STANDARD).unwrap();
    let mut bench = enabled(&raw);
    bench.command(Command::CollectSignals).unwrap();
    bench.command(go(0.1e-3, 0.97e-3, 0.1)).unwrap();
    bench.run(1_200, |_| ());
    let signals = bench.axis.drive().signal_fit().unwrap().solve().unwrap();
    // Back to what the data sheet says: the drive has learnt meanwhile.
    bench.command(Command::CorrectSignals(Correction::new(&raw.signals()))).unwrap();
    bench.run(1_200, |_| ());
    let mut before_n = bench.tick(None).record.force_n;
    let taken = bench.tick(Some(Command::CorrectSignals(Correction::new(&signals))));
    assert_eq!(taken.outcome, Some(Ok(())));
    let mut bump_n = 0.0_f32;
    bench.run(80, |output| {
        bump_n = bump_n.max((output.record.force_n - before_n).abs());
        before_n = output.record.force_n;
    });
    println!("{bump_n} N");
    assert!(bump_n < 0.78, "{bump_n} N");
    let left_m = subdivisional_error_m(&mut bench);
    assert!(left_m < 0.3e-9, "{left_m} m");
}

#[test]
fn signals_that_were_never_calibrated_are_learnt_on_the_way() {
    let raw = tuning::uncalibrated(&stage(), &tuning::STANDARD).unwrap();
    let mut bench = enabled(&raw);
    for to_m in [2e-3, 0.0, 2e-3, 0.0] {
        bench.command(go(to_m, 2e-3, 0.1)).unwrap();
        bench.run(9_000, |_| ());
    }
    let left_m = subdivisional_error_m(&mut bench);
    println!("{left_m:e} m");
    assert!(left_m < 0.3e-9, "{left_m} m");
    let health_m = bench.axis.drive().subdivisional_error_m().unwrap();
    assert!(health_m < 0.3e-9, "{health_m} m");
}

#[test]
fn moves_settle_as_with_an_absolute_encoder() {
    let mean_s = |stage: &Stage, compensator| {
        let settings = tuning::settings(stage, &tuning::STANDARD).unwrap();
        let moves = experiment::run(stage, &settings, compensator, &FIVE_MM_SLOW, 5, 1).unwrap();
        // Tolerance 1 is 10 nm.
        let settled_s: Vec<f64> = moves.iter().map(|m| m.settling.settled_after_s(1).unwrap()).collect();
        settled_s.iter().sum::<f64>() / settled_s.len() as f64
    };
    for compensator in [Compensator::None, Compensator::Niasa] {
        let ratio = mean_s(&stage(), compensator) / mean_s(&Stage::default(), compensator);
        println!("{compensator:?}: {ratio}");
        assert!((0.8..1.2).contains(&ratio), "{compensator:?}: {ratio}");
    }
}

#[test]
fn no_period_is_lost_at_the_highest_speed() {
    let settings = Settings { feedforward_mass_kg: 1.8, ..calibrated() };
    let mut bench = enabled(&settings);
    let most = (settings.velocity_max_m_per_s as f32, settings.acceleration_max_m_per_s2 as f32);
    let mut fastest_m_per_s: f64 = 0.0;
    for to_m in [45e-3, -45e-3, 0.0] {
        bench.command(go(to_m, most.0, most.1)).unwrap();
        for _ in 0..6_000 {
            let position = bench.plant.position_m();
            let record = bench.tick(None).record;
            let off_m = record.position.0 as f64 * PERIOD_M / 65_536.0 - position;
            assert!(off_m.abs() < 0.1e-6, "{off_m} m");
            fastest_m_per_s = fastest_m_per_s.max(bench.plant.velocity_m_per_s().abs());
        }
        assert_eq!(bench.axis.drive().fault(), None);
    }
    assert!(fastest_m_per_s > 0.49, "{fastest_m_per_s} m/s: thirty times what an arctangent alone can follow");
}

#[test]
fn signals_out_of_their_window_turn_the_bridge_off_within_three_ticks() {
    type Tamper = fn(&mut Sample);
    let cases: [(&str, Tamper); 6] = [
        ("both wires broken", |s| (s.sin, s.cos) = (32_768, 32_768)),
        ("half the amplitude", |s| {
            for code in [&mut s.sin, &mut s.cos] {
                *code = 16_384 + *code / 2;
            }
        }),
        ("sine stuck at the upper end", |s| s.sin = u16::MAX),
        ("cosine stuck at the lower end", |s| s.cos = 0),
        ("both at their ends", |s| (s.sin, s.cos) = (0, u16::MAX)),
        ("counter runs away", |s| s.edges = s.edges.wrapping_add(2)),
    ];
    for (what, tamper) in cases {
        let mut bench = enabled(&calibrated());
        // Where each of both is far from its ends.
        bench.command(go(10.625e-6, 1e-3, 0.1)).unwrap();
        bench.run(1_000, |_| ());
        let mut ticks = 0;
        let record = loop {
            let output = bench.tick_with(None, |sample| {
                let mut signals = Sample::from_bits(sample.frame);
                tamper(&mut signals);
                sample.frame = signals.to_bits();
            });
            ticks += 1;
            assert_eq!(output.bridge.enabled, output.record.fault.is_none(), "{what}");
            if output.record.fault.is_some() || ticks > 10 {
                break output.record;
            }
        };
        assert_eq!((record.fault, ticks), (Some(Fault::EncoderSignal), u32::from(LOST_AFTER)), "{what}");
    }
}

#[test]
fn two_bad_samples_in_a_row_are_bridged_in_motion() {
    let mut bench = enabled(&calibrated());
    bench.command(go(5e-3, 0.1, 1.0)).unwrap();
    for tick in 0..8_000 {
        let position_m = bench.plant.position_m();
        let dropped = tick % 100 < 2;
        let record = bench
            .tick_with(None, |sample| {
                if dropped {
                    sample.frame &= 0xffff;
                }
            })
            .record;
        assert_eq!(record.fault, None);
        if !dropped {
            let off_m = record.position.0 as f64 * PERIOD_M / 65_536.0 - position_m;
            assert!(off_m.abs() < 50e-9, "{off_m} m");
        }
    }
}

#[test]
fn an_absolute_encoder_has_nothing_to_collect_or_correct() {
    let settings = tuning::settings(&Stage::default(), &tuning::STANDARD).unwrap();
    let mut bench = Bench::new(&Stage::default(), &settings, 3).unwrap();
    bench.enable().unwrap();
    assert_eq!(bench.command(Command::CollectSignals), Err(Refusal::NoSignals));
    let correction = Correction::new(&settings.signals());
    assert_eq!(bench.command(Command::CorrectSignals(correction)), Err(Refusal::NoSignals));
    assert_eq!(Refusal::NoSignals.to_string(), "the encoder has no sine and cosine: see encoder_kind");
}
