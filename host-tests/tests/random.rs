//! Whatever the drive is told and whatever it is shown: no torque where there may be none, no duty outside its limits, nothing that is
//! not a number, no panic. `SERVO_RANDOM_TICKS` sets how long, `SERVO_RANDOM_SEED` the first sequence; a failure names the seed of its
//! sequence.

use servo_core::axis::{Axis, ServoSample};
use servo_core::compensator::Compensator;
use servo_core::config::Config;
use servo_core::current::{Bridge, DUTY_MAX, DUTY_MIN, PhaseCodes};
use servo_core::drive::Command;
use servo_core::encoder::sincos::{self, Correction, Signals};
use servo_core::fault::Reaction;
use servo_core::measure::{self, Node, Shape};
use servo_core::parameters::{Access, Settings, TABLE};
use servo_core::position::Position;
use servo_core::profile::Limits;
use servo_core::record::{TickRecord, flags};
use servo_core::state::{ControlWord, State};
use servo_core::{PERIODS_PER_TICK, PWM_TOP};
use servo_sim::encoder;

const DEFAULT_TICKS: u64 = 10_000_000;
const TICKS_PER_SEQUENCE: u64 = 4_000;

/// SplitMix64.
struct Random(u64);

impl Random {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let z = (self.0 ^ self.0 >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let z = (z ^ z >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ z >> 31
    }

    /// Below `n`.
    fn below(&mut self, n: u64) -> u64 {
        self.next() % n
    }

    /// `0.0..1.0`.
    fn unit(&mut self) -> f64 {
        (self.next() >> 11) as f64 / (1u64 << 53) as f64
    }

    fn chance(&mut self, probability: f64) -> bool {
        self.unit() < probability
    }
}

/// Settings that the drive takes: some parameters anywhere in their range, most near their default; the motor mostly aligned.
fn settings(random: &mut Random, encoder_kind: f64) -> Settings {
    let commutation_identity = if random.chance(0.9) { 0.0 } else { -1.0 };
    let mut settings = Settings { encoder_kind, commutation_identity, ..Settings::default() };
    for row in TABLE {
        // The encoder's counts are what this test makes its frames from.
        if row.id >> 8 == 0x01 || row.name == "commutation_identity" || !random.chance(0.2) {
            continue;
        }
        let (low, high) = (row.min, row.max);
        let value = if random.chance(0.2) {
            low + random.unit() * (high - low)
        } else {
            row.default * (10.0f64).powf(2.0 * random.unit() - 1.0)
        };
        let before = row.get(&settings);
        row.set(&mut settings, value.clamp(low, high)).unwrap();
        if settings.validate().is_err() {
            row.set(&mut settings, before).unwrap();
        }
    }
    // Otherwise hardly any sequence gets anywhere.
    if random.chance(0.7) {
        settings.following_error_max_m = 1.0;
        settings.runaway_m_per_s = 20.0;
    }
    settings
}

/// What the drive computes with. An incremental encoder counts as aligned where it is switched on: looking for the electrical zero takes
/// a stage that follows, and longer than a sequence.
fn config(settings: &Settings) -> Option<Config> {
    let config = Config::new(settings).ok()?;
    Some(Config { commutation_stored: config.commutation_stored || config.sin_cos.is_some(), ..config })
}

/// An excitation that the drive may take.
fn excitation(random: &mut Random) -> measure::Request {
    let wild = [f32::NAN, f32::INFINITY, -1.0, 0.0, 1e-30, 1e30];
    let mut pick = |usual: f32| {
        if random.chance(0.03) { wild[random.below(6) as usize] } else { usual * random.unit() as f32 }
    };
    let (amplitude, frequency_hz, length_s, lead_s, end_share) =
        (pick(30.0), pick(2_000.0), pick(0.3), pick(0.1), pick(1.0));
    let (travel_m, speed_m_per_s, current_a) = (pick(1.0), pick(10.0), pick(20.0));
    let shape = match random.below(3) {
        0 => Shape::Tone { amplitude, frequency_hz, measure_s: length_s, lead_s },
        1 => Shape::DecayingSine { amplitude, frequency_hz, periods: 1 + random.below(20) as u32, end_share },
        _ => Shape::Pulse { amplitude, length_s },
    };
    let node = if random.chance(0.5) { Node::Force } else { Node::Velocity };
    measure::Request { shape, node, travel_m, speed_m_per_s, current_a }
}

fn limits(random: &mut Random) -> Limits {
    let wild = [f32::NAN, f32::INFINITY, -1.0, 0.0, 1e-30, 1e30];
    let mut pick = |usual: f32| {
        if random.chance(0.1) { wild[random.below(6) as usize] } else { usual * random.unit() as f32 }
    };
    let (velocity_m_per_s, acceleration_m_per_s2, jerk) = (pick(0.5), pick(20.0), pick(1e4));
    Limits { velocity_m_per_s, acceleration_m_per_s2, jerk_m_per_s3: (jerk > 5e3 || jerk.is_nan()).then_some(jerk) }
}

/// A command, and the settings it brings if it does.
fn command(random: &mut Random, now: &Settings) -> (Command, Option<Settings>) {
    let words = [0x00, 0x02, 0x06, 0x07, 0x0f, 0x0f, 0x8f, 0x80, 0x10f, random.next() as u16];
    let command = match random.below(25) {
        0..=4 => Command::Enable,
        5 => Command::Disable,
        6 | 7 => Command::ResetFault,
        8 | 9 => Command::Control(ControlWord(words[random.below(10) as usize])),
        10 | 11 => {
            let target =
                if random.chance(0.05) { random.next() as i64 } else { random.below(1 << 22) as i64 - (1 << 21) };
            Command::Move { target: Position(target), limits: limits(random) }
        }
        12 => Command::Stop,
        13 => Command::Compensator(Compensator::ALL[random.below(8) as usize]),
        14 => Command::KeepAlive,
        15 => Command::Align,
        16 => Command::CollectSignals,
        17 | 18 => match measure::Order::new(&excitation(random), now.encoder_count_m) {
            Ok(order) => Command::Excite(order),
            Err(_) => Command::KeepAlive,
        },
        19 => {
            let mut near = |centre: f64| centre + 0.2 * (random.unit() - 0.5);
            let (amplitude, gain) = (near(0.6), near(1.0));
            let [cos_offset, sin_offset, phase_rad] = [near(0.0), near(0.0), near(0.0)];
            Command::CorrectSignals(Correction::new(&Signals { amplitude, cos_offset, sin_offset, gain, phase_rad }))
        }
        20 => Command::BeginSave,
        21..=23 => Command::EndSave,
        _ => {
            let mut settings = settings(random, now.encoder_kind);
            let needs_bridge_off = random.chance(0.5);
            if !needs_bridge_off {
                for row in TABLE.iter().filter(|row| matches!(row.access, Access::BridgeOff)) {
                    row.set(&mut settings, row.get(now)).unwrap();
                }
            }
            let Some(config) = config(&settings) else { return (Command::KeepAlive, None) };
            return (Command::Configure { config, needs_bridge_off }, Some(settings));
        }
    };
    (command, None)
}

/// A world that mostly behaves: a carriage that drifts, currents near zero; with `trouble`, each of its signals does anything.
struct World {
    /// Encoder with sine and cosine, in place of one with frames.
    sin_cos: bool,
    counts: u32,
    speed: i32,
    trouble: f64,
}

impl World {
    fn phases(&mut self, random: &mut Random) -> PhaseCodes {
        if random.chance(self.trouble) {
            let bits = random.next();
            return PhaseCodes { a: bits as u16, b: (bits >> 16) as u16 };
        }
        let bits = random.next();
        PhaseCodes { a: 32_768 + (bits & 1023) as u16 - 512, b: 32_768 + (bits >> 16 & 1023) as u16 - 512 }
    }

    fn sample(&mut self, random: &mut Random) -> ServoSample {
        self.speed = (self.speed + random.below(2001) as i32 - 1000).clamp(-100_000, 100_000);
        self.counts = self.counts.wrapping_add(self.speed as u32);
        let frame = if self.sin_cos { self.signals(random) } else { self.frame(random) };
        let wild = |random: &mut Random, usual: u32, trouble: f64| {
            if random.chance(trouble) { random.next() as u32 } else { usual }
        };
        ServoSample {
            phases: self.phases(random),
            frame,
            bus_code: wild(random, 39_321, self.trouble) as u16,
            temperature_code: wild(random, 15_887, self.trouble) as u16,
            signals: if random.chance(self.trouble) { random.next() as u32 & random.next() as u32 } else { 0 },
            last_tick_cycles: wild(random, 4_000, self.trouble),
        }
    }

    /// What an encoder with sine and cosine shows.
    fn signals(&self, random: &mut Random) -> u64 {
        let healthy = |counts: u32| {
            let turns = f64::from(counts as u16) / f64::from(sincos::PERIOD_CT);
            let code = |share: f64| (32_768.0 + 0.75 * 32_768.0 * share).round() as u16;
            let (sin, cos) = (turns * std::f64::consts::TAU).sin_cos();
            sincos::Sample { sin: code(sin), cos: code(cos), edges: (counts >> 14) as u16 }
        };
        let sample = healthy(self.counts);
        match random.below(6) {
            _ if !random.chance(3.0 * self.trouble) => sample.to_bits(),
            0 => sincos::Sample { sin: 32_768, cos: 32_768, ..sample }.to_bits(),
            1 => sincos::Sample { sin: u16::MAX, cos: 0, ..sample }.to_bits(),
            2 => sincos::Sample { edges: random.next() as u16, ..sample }.to_bits(),
            3 => healthy(random.next() as u32).to_bits(),
            4 => healthy(self.counts.wrapping_sub(self.speed as u32)).to_bits(),
            _ => random.next(),
        }
    }

    /// What an encoder with frames sends.
    fn frame(&self, random: &mut Random) -> u64 {
        let healthy = encoder::frame(self.counts, false, random.chance(0.01), 2);
        match random.below(8) {
            _ if !random.chance(3.0 * self.trouble) => healthy,
            0 => u64::MAX,
            1 => 0,
            2 => random.next(),
            3 => healthy ^ 1 << random.below(64),
            4 => encoder::frame(random.next() as u32, false, false, 2),
            5 => encoder::frame(self.counts, true, false, 2),
            6 => healthy >> random.below(64),
            _ => encoder::frame(self.counts.wrapping_sub(self.speed as u32), false, false, 2),
        }
    }
}

/// Whether the bridge may be on after a tick with this record.
fn may_be_on(record: &TickRecord, config: &Config) -> bool {
    match record.state {
        State::OperationEnabled => record.fault.is_none(),
        State::QuickStopActive => record.fault.is_none() && config.options.quick_stop_m_per_s2.is_some(),
        State::FaultReactionActive => {
            config.options.fault_m_per_s2.is_some() && record.fault.is_some_and(|f| f.reaction() == Reaction::MayBrake)
        }
        _ => false,
    }
}

fn check_bridge(bridge: Bridge, on: bool) {
    assert!(on || !bridge.enabled, "the bridge is on");
    let [least, most] = [DUTY_MIN, DUTY_MAX].map(|duty| (duty * f32::from(PWM_TOP)).round() as u16);
    assert!(bridge.compare.iter().all(|ct| (least..=most).contains(ct)), "{bridge:?}");
}

/// Ticks in which something was going on.
#[derive(Clone, Copy, Default)]
struct Seen {
    /// The bridge was on.
    on: u64,
    /// With an encoder with sine and cosine.
    sin_cos: u64,
    /// An excitation acted.
    excited: u64,
    /// The motor was being aligned.
    aligning: u64,
    /// The flash was being written, with the bridge off.
    saving: u64,
}

impl std::ops::AddAssign for Seen {
    fn add_assign(&mut self, other: Seen) {
        self.on += other.on;
        self.sin_cos += other.sin_cos;
        self.excited += other.excited;
        self.aligning += other.aligning;
        self.saving += other.saving;
    }
}

/// What was going on in a sequence.
fn sequence(seed: u64) -> Seen {
    let random = &mut Random(seed);
    let sin_cos = seed.is_multiple_of(4);
    let mut now = settings(random, if sin_cos { 1.0 } else { 0.0 });
    let mut axis = Axis::new(config(&now).unwrap());
    let mut world = World {
        sin_cos,
        counts: 0x8000_0000 + random.below(1 << 20) as u32,
        speed: 0,
        trouble: [0.0, 1e-5, 1e-4, 1e-3, 1e-2][random.below(5) as usize],
    };
    let mut seen = Seen::default();
    let mut saving = false;
    for tick in 0..TICKS_PER_SEQUENCE {
        let often = if tick < 100 { 0.2 } else { 0.02 };
        let (command, brings) = if random.chance(often) {
            let (command, brings) = command(random, &now);
            (Some(command), brings)
        } else {
            (None, None)
        };
        let sample = world.sample(random);
        let output = axis.on_servo(&sample, command.as_ref());
        if let (Some(settings), Some(Ok(()))) = (brings, output.outcome) {
            now = settings;
        }
        match (command, output.outcome) {
            (Some(Command::BeginSave), Some(Ok(()))) => saving = true,
            (Some(Command::EndSave), Some(Ok(()))) => saving = false,
            _ => {}
        }
        assert!(!(saving && output.bridge.enabled), "tick {tick}: the flash is written with torque on");
        seen.saving += u64::from(saving);
        let config = axis.drive().config();
        let record = output.record;
        let on = may_be_on(&record, config);
        assert!(on || !output.bridge.enabled, "tick {tick}: the bridge is on: {record:?}");
        check_bridge(output.bridge, on);
        let force =
            [record.proportional_n, record.integral_n, record.compensator_n, record.feedforward_n, record.force_n];
        let other = [record.friction_n, record.slope_n_per_m, record.iq_set_a, record.iq_a, record.bus_v];
        assert!(force.iter().chain(&other).all(|x| x.is_finite()), "tick {tick}: {record:?}");
        assert!(record.force_n.abs() <= config.force_limit_n, "tick {tick}: {record:?}");
        let most_a = config.force_limit_n * config.amps_per_newton * 1.000_001;
        assert!(record.iq_set_a.abs() <= most_a, "tick {tick}: {record:?}");
        let on = output.bridge.enabled;
        let flagged = |flag: u16| u64::from(on && record.flags & flag != 0);
        seen.on += u64::from(on);
        seen.sin_cos += u64::from(on && sin_cos);
        seen.excited += flagged(flags::EXCITED);
        seen.aligning += flagged(flags::ALIGNING);
        for _ in 1..PERIODS_PER_TICK {
            let bridge = axis.on_period(world.phases(random));
            check_bridge(bridge, on);
        }
    }
    seen
}

#[test]
fn nothing_ever_gives_torque_where_there_may_be_none_or_a_number_that_is_none() {
    let ticks: u64 = match std::env::var("SERVO_RANDOM_TICKS") {
        Ok(ticks) => ticks.parse().expect("SERVO_RANDOM_TICKS is a number"),
        Err(_) => DEFAULT_TICKS,
    };
    let first: u64 = match std::env::var("SERVO_RANDOM_SEED") {
        Ok(seed) => seed.parse().expect("SERVO_RANDOM_SEED is a whole number"),
        Err(_) => 0,
    };
    let mut seen = Seen::default();
    let sequences = ticks.div_ceil(TICKS_PER_SEQUENCE);
    for seed in first..first + sequences {
        if (seed - first).is_multiple_of(2_500) {
            eprintln!("sequence {} of {sequences}", seed - first);
        }
        match std::panic::catch_unwind(|| sequence(seed)) {
            Ok(more) => seen += more,
            Err(_) => panic!("sequence with seed {seed}"),
        }
    }
    let Seen { on, sin_cos, excited, aligning, saving } = seen;
    eprintln!(
        "of {ticks} ticks {on} with the bridge on: {sin_cos} with sine and cosine, {excited} excited, {aligning} aligning; \
         {saving} while saving"
    );
    assert!(on > ticks / 20, "the bridge was on in only {on} ticks of {ticks}");
    assert!(saving > ticks / 100, "the flash was written in only {saving} ticks of {ticks}");
    for (what, ticks) in [("sine and cosine", sin_cos), ("an excitation", excited), ("an alignment", aligning)] {
        assert!(ticks > on / 100, "{what} in only {ticks} ticks of {on} with the bridge on");
    }
}
