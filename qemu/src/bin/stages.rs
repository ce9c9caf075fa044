//! The recorded run with the axis taken apart, so that each part is counted by itself.
//!
//! Drive, current loop and capture are wired here once more, as in [`servo_core::axis`]; that the digest is the same proves
//! that they are wired alike. The stages within the tick are counted on copies that follow the run.
#![no_std]
#![no_main]

use core::hint::black_box;

use servo_core::axis::ServoOutput;
use servo_core::black_box::{ENTRY_WORDS, Entry, Recorder};
use servo_core::capture::Capture;
use servo_core::cascade;
use servo_core::compensator::Situation;
use servo_core::compensator::niasa::OnDahl;
use servo_core::config::Config;
use servo_core::current::{CurrentLoop, Demand};
use servo_core::drive::{Drive, Inputs};
use servo_core::encoder::sincos::{self, Interpolator};
use servo_core::encoder::tracker::Tracker;
use servo_core::parameters::Settings;
use servo_core::position::Position;
use servo_core::profile::{Profile, Setpoint};
use servo_core::record::{TickRecord, flags};
use servo_core::settling::Monitor;
use servo_qemu::digest::Digest;
use servo_qemu::image::{self, Failure};
use servo_qemu::recording::Tick;
use servo_qemu::regions::{self, Before, Class};
use servo_qemu::script;

#[cortex_m_rt::entry]
fn main() -> ! {
    image::end(run())
}

fn run() -> Result<Digest, Failure> {
    black_box(regions::calibrate_straight(black_box(1)));
    for passes in [1_000, 2_000, 4_000] {
        regions::calibrate_loop(black_box(passes));
    }

    let mut drive = Drive::new(Config::new(&script::settings())?);
    let mut current = CurrentLoop::default();
    let mut capture = Capture::default();
    let mut stages = Stages::new();
    image::replay(|digest, number, tick| {
        if number == script::SIN_COS_TICK {
            drive = Drive::new(script::sin_cos_config()?);
            (current, capture) = Default::default();
        }
        if number == script::CAPTURE_TICK {
            capture.arm(script::CAPTURE);
        }
        let command = script::command(number)?;
        let before = Before::of(&drive);
        if command.as_ref().is_some_and(|command| drive.is_reset(command)) {
            current.clear_trip();
        }
        let inputs = Inputs::new(&tick.sample, &current);
        let output = regions::servo_tick(&mut drive, &inputs, command.as_ref());
        let k = drive.config().current;
        let bridge = regions::current_loop(&mut current, &k, &output.demand, tick.sample.phases, 0);
        let sample = capture.step(&output.record);
        digest.servo(&ServoOutput { bridge, record: output.record, inputs, outcome: output.outcome, sample });
        let mut is_on = bridge.enabled;
        for (i, phases) in tick.phases.into_iter().enumerate() {
            let bridge = regions::current_loop(&mut current, &k, &output.demand, phases, i as u32 + 1);
            digest.period(bridge);
            is_on = bridge.enabled;
        }
        stages.follow(drive.config(), tick, &inputs, &output.record, &output.demand);
        Class::of(before, drive.config(), &output.record, output.outcome, is_on).tell();
        Ok(())
    })
}

/// The tick's stages, on their own.
struct Stages {
    profile: Profile,
    cascade: cascade::State,
    niasa: OnDahl,
    settling: Monitor,
    recorder: Recorder,
    entries: [Entry; 8],
    tracker: Tracker,
    interpolator: Interpolator,
    sin_cos: sincos::Coefficients,
}

impl Stages {
    fn new() -> Self {
        let at = Position(0);
        Stages {
            profile: Profile::at_rest(at),
            cascade: cascade::State::default(),
            niasa: OnDahl::relaxed(at),
            settling: Monitor::default(),
            recorder: Recorder::recording(),
            entries: [Entry([0; ENTRY_WORDS]); 8],
            tracker: Tracker::default(),
            interpolator: Interpolator::default(),
            sin_cos: sincos::Coefficients {
                correction: sincos::Correction::new(&Settings::default().signals()),
                least2: 0.25,
                most2: 2.0,
            },
        }
    }

    fn follow(&mut self, config: &Config, tick: &Tick, inputs: &Inputs, record: &TickRecord, demand: &Demand) {
        regions::black_box_entry(&mut self.recorder, &mut self.entries, inputs, record);
        let _ = black_box(regions::biss_decode(tick.sample.frame));
        black_box(regions::sin_cos_position(
            &mut self.tracker,
            &mut self.interpolator,
            &self.sin_cos,
            script::signals(record.position),
        ));
        if !demand.enabled {
            return;
        }
        if record.flags & flags::MOVING == 0 {
            // From rest to rest again and again, one profile as long as the recorded moves.
            if self.profile.is_done() {
                self.profile = Profile::between(Position(0), script::FIVE_MM, script::LIMITS, config.count_m);
            }
            regions::settling_update(&mut self.settling, config, record.error_ct);
        }
        let reference = black_box(regions::profile_advance(&mut self.profile));
        black_box(regions::cascade_terms(&mut self.cascade, &config.cascade, record.error_ct));
        let situation = Situation {
            position: record.position,
            step_ct: 0,
            error_ct: record.error_ct,
            reference: Setpoint { done: record.flags & flags::MOVING == 0, ..reference },
            proportional_n_per_m: config.cascade.proportional_n_per_m,
            force_n: record.force_n,
        };
        black_box(regions::niasa_act(&mut self.niasa, config, &situation));
        black_box(regions::sin_cos(demand.turns));
    }
}
