//! Motion without end: random moves, a load that comes and goes, frames lost now and then. No fault without a cause, no lost count, no
//! drift. `SERVO_MOTION_S` sets the simulated time, `SERVO_MOTION_SEED` what is drawn; `cargo xtask endurance` makes it an hour.

use servo_core::compensator::Compensator;
use servo_core::drive::Command;
use servo_core::position::Position;
use servo_core::profile::Limits;
use servo_core::record::flags;
use servo_core::{SERVO_DT_S, SERVO_HZ};
use servo_host_tests::{FastBench, tuning};
use servo_sim::Stage;
use servo_sim::random::{Noise, Purpose};

const DEFAULT_S: f64 = 60.0;
/// Share of the frames that do not arrive.
const LOST: f64 = 1e-5;

/// `0.0..1.0` from two normal numbers.
fn unit(noise: &mut Noise) -> f64 {
    let (a, b) = (noise.normal(), noise.normal());
    (a.atan2(b) / std::f64::consts::TAU + 0.5).clamp(0.0, 1.0 - 1e-12)
}

#[test]
fn motion_goes_on_without_a_fault_a_lost_count_or_a_drift() {
    let seconds: f64 = match std::env::var("SERVO_MOTION_S") {
        Ok(seconds) => seconds.parse().expect("SERVO_MOTION_S is a number"),
        Err(_) => DEFAULT_S,
    };
    let seed: u64 = match std::env::var("SERVO_MOTION_SEED") {
        Ok(seed) => seed.parse().expect("SERVO_MOTION_SEED is a whole number"),
        Err(_) => 1,
    };
    let stage = Stage::default();
    let settings = tuning::settings(&stage, &tuning::STANDARD).unwrap();
    let count_m = settings.encoder_count_m;
    let noise_ct = stage.encoder.noise_m_rms / count_m;
    let mut bench = FastBench::new(&stage, &settings, seed).unwrap();
    bench.enable().unwrap();
    bench.command(Command::Compensator(Compensator::Niasa)).unwrap();

    let random = &mut Noise::new(seed, Purpose::Friction, 77);
    let ticks = (seconds * f64::from(SERVO_HZ)) as u64;
    let (mut moves, mut lost, mut wait, mut say) = (0u32, 0u32, 0u32, 0u64);
    // Reading minus truth, counts: sum and number, in the first and in the second half.
    let mut offset = [(0.0, 0u64); 2];
    for tick in 0..ticks {
        let mut command = None;
        if wait == 0 && !bench.is_moving() {
            // From nanometres to the whole travel, log-uniform, anywhere inside ±45 mm.
            let length_m = 50e-9 * (1.8e6f64).powf(unit(random));
            let at_m = bench.carriage.position_m();
            let sign = if (at_m > 0.0) == (unit(random) < 0.8) { -1.0 } else { 1.0 };
            let target_m = (at_m + sign * length_m).clamp(-45e-3, 45e-3);
            let limits = Limits {
                velocity_m_per_s: (0.05 + 0.45 * unit(random)) as f32,
                acceleration_m_per_s2: (0.1 * 100f64.powf(unit(random))) as f32,
                jerk_m_per_s3: (unit(random) < 0.5).then_some(1e4),
            };
            command = Some(Command::Move { target: Position((target_m / count_m) as i64), limits });
            // A load of up to 2 N, some of the time.
            bench.carriage.set_external_force_n(if unit(random) < 0.5 { 4.0 * unit(random) - 2.0 } else { 0.0 });
            wait = (unit(random) * 0.2 * f64::from(SERVO_HZ)) as u32;
            moves += 1;
        } else if !bench.is_moving() {
            wait = wait.saturating_sub(1);
        }
        let drop = unit(random) < LOST;
        lost += u32::from(drop);
        let truth_ct = bench.carriage.position_m() / count_m;
        let output = bench.tick_altered(command, |frame| if drop { u64::MAX } else { frame });
        let at_s = tick as f64 * f64::from(SERVO_DT_S);
        assert_eq!(output.record.fault, None, "after {at_s} s and {moves} moves: {:?}", output.record);
        assert!(!matches!(output.outcome, Some(Err(_))), "{:?}", output.outcome);
        if output.record.flags & flags::FRAME_BAD == 0 {
            let apart_ct = output.record.position.0 as f64 - truth_ct;
            assert!(apart_ct.abs() < 8.0 * noise_ct + 1.0, "a lost count after {at_s} s: {apart_ct}");
            let (sum, number) = &mut offset[usize::from(tick >= ticks / 2)];
            *sum += apart_ct;
            *number += 1;
        }
        if tick >= say {
            say = tick + 60 * u64::from(SERVO_HZ);
            eprintln!("{at_s:.0} s of {seconds:.0} s, {moves} moves, {lost} frames lost");
        }
    }
    assert_eq!(bench.drive.counters().bad_frames, lost);
    assert!(f64::from(moves) > seconds, "{moves} moves");
    let means = offset.map(|(sum, number)| sum / number as f64);
    let allowed_ct = 5.0 * noise_ct / (offset[0].1 as f64).sqrt();
    assert!((means[0] - means[1]).abs() < 2.0 * allowed_ct, "a drift: {means:?} counts");
    // Half a count is the rounding of readings down to whole ones.
    eprintln!("{moves} moves, {lost} frames lost, readings off by {means:?} counts in the two halves");
}
