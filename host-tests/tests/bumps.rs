//! Whatever is changed and whenever: the force of the tick that takes the change is, to a hundredth of full scale, between that of the tick
//! before and the one that it would have had without. Where the force changes by more than that hundredth in one tick anyway (the reference's
//! acceleration steps, or these gains make the loop swing), there is nothing to be seen.

use servo_core::config::{Compensator, Config};
use servo_core::drive::Command;
use servo_core::fault::Fault;
use servo_core::parameters::Settings;
use servo_core::position::Position;
use servo_core::profile::Limits;
use servo_core::record::flags;
use servo_host_tests::{FastBench, tuning};
use servo_sim::Stage;
use servo_sim::random::{Noise, Purpose};

const DRIVES: u64 = 60;
const CHANGES: u32 = 60;
/// Ticks from one change to the next, at most.
const BETWEEN: f64 = 900.0;
/// 1 % of the force that 10 A make.
const ONE_PERCENT_N: f32 = 0.78;

/// `low..high`, uniform.
fn between(noise: &mut Noise, low: f64, high: f64) -> f64 {
    let (a, b) = (noise.normal(), noise.normal());
    low + (high - low) * (a.atan2(b) / std::f64::consts::TAU + 0.5)
}

/// `now` with other gains and other models of friction, each between half and one and a half times the usual.
fn changed(usual: &Settings, now: &Settings, noise: &mut Noise) -> Settings {
    let niasa_with_proportional = between(noise, 0.0, 1.0).round();
    let feedforward_mass_kg = between(noise, 0.0, 1.0).round() * usual.disturbance_mass_kg;
    let mut near = |usual: f64| usual * between(noise, 0.5, 1.5);
    let friction_coulomb_n = near(usual.friction_coulomb_n);
    Settings {
        position_gain_per_s: near(usual.position_gain_per_s),
        velocity_gain_n_s_per_m: near(usual.velocity_gain_n_s_per_m),
        velocity_integral_per_s: near(usual.velocity_integral_per_s),
        niasa_stiffness_n_per_m: near(usual.niasa_stiffness_n_per_m),
        niasa_coulomb_n: near(usual.niasa_coulomb_n),
        niasa_time_constant_s: near(usual.niasa_time_constant_s),
        niasa_with_proportional,
        friction_stiffness_n_per_m: near(usual.friction_stiffness_n_per_m),
        friction_coulomb_n,
        friction_static_n: near(1.0) * 2.0 * friction_coulomb_n,
        disturbance_mass_kg: near(usual.disturbance_mass_kg),
        feedforward_mass_kg,
        ..*now
    }
}

#[test]
fn no_change_of_gains_or_compensator_steps_the_force_at_rest_in_motion_or_under_a_load() {
    let stage = Stage::default();
    let usual = tuning::settings(&stage, &tuning::STANDARD).unwrap();
    let (mut in_motion, mut at_rest, mut unseen, mut largest_n) = (0, 0, 0, 0.0_f32);
    'drives: for seed in 0..DRIVES {
        let noise = &mut Noise::new(seed, Purpose::Friction, 99);
        let mut now = usual;
        let mut bench = FastBench::new(&stage, &now, seed).unwrap();
        bench.redraw(seed);
        bench.enable().unwrap();
        for change in 0..CHANGES {
            if change % 4 == 0 {
                bench.carriage.set_external_force_n(between(noise, -2.0, 2.0));
                let target = Position((between(noise, -5e-3, 5e-3) / now.encoder_count_m) as i64);
                let limits = Limits {
                    velocity_m_per_s: between(noise, 0.02, 0.5) as f32,
                    acceleration_m_per_s2: between(noise, 0.1, 5.0) as f32,
                    jerk_m_per_s3: (between(noise, 0.0, 1.0) < 0.5).then_some(1e3),
                };
                // Refused while the last one is under way.
                let _ = bench.command(Command::Move { target, limits });
            }
            let mut before_n = 0.0;
            for _ in 0..between(noise, 1.0, BETWEEN) as u32 {
                let record = bench.tick(None).record;
                if record.fault.is_some() {
                    // Some of these gains with some of these moves and loads follow too badly.
                    assert_eq!(record.fault, Some(Fault::FollowingError), "seed {seed}");
                    continue 'drives;
                }
                before_n = record.force_n;
            }
            let command = if between(noise, 0.0, 1.0) < 0.5 {
                let kind = Compensator::ALL[between(noise, 0.0, 7.999) as usize];
                now.compensator = f64::from(kind as u8);
                Command::Compensator(kind)
            } else {
                now = changed(&usual, &now, noise);
                Command::Configure { config: Config::new(&now).unwrap(), needs_bridge_off: false }
            };
            let without = bench.clone().tick(None).record;
            let with = bench.tick(Some(command));
            assert_eq!((with.outcome, with.record.fault), (Some(Ok(())), None));
            if (without.force_n - before_n).abs() > ONE_PERCENT_N {
                unseen += 1;
                continue;
            }
            let (low_n, high_n) = (before_n.min(without.force_n), before_n.max(without.force_n));
            let step_n = (with.record.force_n - high_n).max(low_n - with.record.force_n);
            assert!(step_n < ONE_PERCENT_N, "seed {seed}, change {change}, {step_n} N: {command:?} {without:?}");
            largest_n = largest_n.max(step_n);
            *if with.record.flags & flags::MOVING != 0 { &mut in_motion } else { &mut at_rest } += 1;
        }
    }
    eprintln!("{in_motion} changes in motion, {at_rest} at rest, {unseen} unseen, largest step {largest_n} N");
    assert!(in_motion > 500 && at_rest > 500 && unseen < 100, "{in_motion} {at_rest} {unseen}");
}
