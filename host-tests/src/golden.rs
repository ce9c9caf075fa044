//! The run that QEMU repeats, recorded on the simulated stage.

use servo_core::axis::{Axis, ServoSample};
use servo_core::config::Config;
use servo_core::encoder::biss;
use servo_core::position::Position;
use servo_core::refusal::Refusal;
use servo_qemu::digest::Digest;
use servo_qemu::recording::{PERIODS_BETWEEN, Tick};
use servo_qemu::script;
use servo_sim::Stage;

use crate::Bench;

/// What is done to the samples of a tick, besides the simulation; `stuck` is the frame of the tick before.
///
/// Single bad frames are held, three in a row are a fault, as are currents, voltages and positions out of their limits.
fn tamper(tick: u32, sample: &mut ServoSample, stuck: u64) {
    match tick {
        700 => sample.frame ^= 1 << 30,
        1_400..1_402 => sample.frame = u64::MAX,
        3_900..3_903 => sample.frame = 0,
        4_000 => sample.phases.a = u16::MAX,
        4_150 => sample.bus_code = 16_384, // 20 V
        4_310..4_500 => sample.frame = stuck,
        _ if tick >= script::SIN_COS_TICK => {
            let counts = biss::decode(sample.frame).map_or(0, |reading| reading.counts);
            sample.frame = script::signals(Position(i64::from(counts))).to_bits();
        }
        _ => {}
    }
}

/// Runs the script on the default stage.
///
/// Returns what the drive saw, and the digest of that and of what it did.
///
/// # Errors
/// Settings that the drive refuses.
pub fn record() -> Result<(Vec<Tick>, Digest), Refusal> {
    let mut bench = Bench::new(&Stage::default(), &script::settings(), 1)?;
    let mut digest = Digest::default();
    let mut ticks: Vec<Tick> = Vec::with_capacity(script::TICKS as usize);
    for number in 0..script::TICKS {
        if number == script::SIN_COS_TICK {
            bench.axis = Axis::new(script::sin_cos_config()?);
        }
        if number == script::CAPTURE_TICK {
            bench.axis.arm_capture(script::CAPTURE);
        }
        let stuck = ticks.last().map_or(0, |tick| tick.sample.frame);
        let mut seen = None;
        let mut periods = Vec::with_capacity(PERIODS_BETWEEN);
        let output = bench.tick_observed(
            script::command(number)?,
            |sample| {
                tamper(number, sample, stuck);
                seen = Some(*sample);
            },
            |phases, bridge| periods.push((phases, bridge)),
        );
        digest.servo(&output);
        periods.iter().for_each(|(_, bridge)| digest.period(*bridge));
        let sample = seen.expect("the bench shows every sample");
        let tick = Tick { sample, phases: std::array::from_fn(|i| periods[i].0) };
        digest.input(&tick.to_bytes());
        ticks.push(tick);
    }
    Ok((ticks, digest))
}

/// Computes the run once more from its recording alone, as the images in QEMU do.
///
/// # Errors
/// Settings that the drive refuses.
pub fn replay(ticks: &[Tick]) -> Result<Digest, Refusal> {
    let mut axis = Axis::new(Config::new(&script::settings())?);
    let mut digest = Digest::default();
    for (number, tick) in (0..).zip(ticks) {
        if number == script::SIN_COS_TICK {
            axis = Axis::new(script::sin_cos_config()?);
        }
        if number == script::CAPTURE_TICK {
            axis.arm_capture(script::CAPTURE);
        }
        digest.input(&tick.to_bytes());
        digest.servo(&axis.on_servo(&tick.sample, script::command(number)?.as_ref()));
        tick.phases.iter().for_each(|phases| digest.period(axis.on_period(*phases)));
    }
    Ok(digest)
}
