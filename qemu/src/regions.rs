//! What is counted: one function each, never inlined, so that it has a symbol, an entry and a return.
//!
//! A count runs from the first instruction of the function to its return, calls included. The `class_…` functions do
//! nothing; that they are called tells the counting side what kind of tick the calls before belong to.

use core::hint::black_box;

use servo_core::axis::{Axis, ServoOutput, ServoSample};
use servo_core::black_box::{Entry, Recorder};
use servo_core::cascade;
use servo_core::compensator::niasa::OnDahl;
use servo_core::compensator::{Action, Situation};
use servo_core::config::{Compensator, Config};
use servo_core::current::{self, Bridge, CurrentLoop, Demand, PhaseCodes};
use servo_core::drive::{Command, Drive, Inputs, Outcome, Output};
use servo_core::encoder::biss::{self, FrameError, Reading};
use servo_core::encoder::sincos::{self, Interpolator};
use servo_core::encoder::tracker::{Tracker, Update};
use servo_core::math;
use servo_core::profile::{Profile, Setpoint};
use servo_core::record::{TickRecord, flags};
use servo_core::settling::Monitor;

/// What kind of tick it was.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Class {
    /// Nothing but control: bridge on before and after, a good frame, no command.
    On,
    /// The same with NIASA on a Maxwell-slip model: twelve elements a tick.
    Maxwell,
    /// Nothing but control with an encoder of sine and cosine.
    SinCos,
    /// Anything else with such an encoder.
    SinCosOther,
    /// A command was answered.
    Command,
    /// The bridge was turned on or off, the frame was bad or one shortly before was, or the drive brakes.
    Event,
    /// Bridge off before and after.
    Off,
}

/// What there was before a tick.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Before {
    /// The bridge is on.
    on: bool,
    /// See [`Drive::is_steady`].
    steady: bool,
}

impl Before {
    /// Before the next tick of `drive`.
    pub fn of(drive: &Drive) -> Before {
        Before { on: drive.state().has_torque(), steady: drive.is_steady() }
    }
}

impl Class {
    /// The class of a tick from the drive before it, what it gave, and the bridge after it.
    pub fn of(before: Before, config: &Config, record: &TickRecord, outcome: Option<Outcome>, is_on: bool) -> Class {
        let steady = before.steady && record.flags & flags::FRAME_BAD == 0;
        match (before.on, is_on) {
            (true, true) if config.sin_cos.is_some() && steady && outcome.is_none() => Class::SinCos,
            _ if config.sin_cos.is_some() => Class::SinCosOther,
            _ if outcome.is_some() => Class::Command,
            (false, false) => Class::Off,
            (true, true) if steady => match config.compensator.kind {
                Compensator::NiasaMaxwell => Class::Maxwell,
                _ => Class::On,
            },
            _ => Class::Event,
        }
    }

    /// Calls the `class_…` function.
    pub fn tell(self) {
        match self {
            Class::On => class_on(),
            Class::Maxwell => class_maxwell(),
            Class::SinCos => class_sincos(),
            Class::SinCosOther => class_sincos_other(),
            Class::Command => class_command(),
            Class::Event => class_event(),
            Class::Off => class_off(),
        }
    }
}

/// See [`Class::On`].
#[inline(never)]
pub fn class_on() {
    black_box(1);
}

/// See [`Class::Maxwell`].
#[inline(never)]
pub fn class_maxwell() {
    black_box(5);
}

/// See [`Class::SinCos`].
#[inline(never)]
pub fn class_sincos() {
    black_box(6);
}

/// See [`Class::SinCosOther`].
#[inline(never)]
pub fn class_sincos_other() {
    black_box(7);
}

/// See [`Class::Command`].
#[inline(never)]
pub fn class_command() {
    black_box(2);
}

/// See [`Class::Event`].
#[inline(never)]
pub fn class_event() {
    black_box(3);
}

/// See [`Class::Off`].
#[inline(never)]
pub fn class_off() {
    black_box(4);
}

/// The servo period as the firmware runs it.
#[inline(never)]
pub fn on_servo(axis: &mut Axis, sample: &ServoSample, command: Option<&Command>) -> ServoOutput {
    axis.on_servo(sample, command)
}

/// Any other period as the firmware runs it: the current loop.
#[inline(never)]
pub fn on_period(axis: &mut Axis, phases: PhaseCodes) -> Bridge {
    axis.on_period(phases)
}

/// The servo tick alone.
#[inline(never)]
pub fn servo_tick(drive: &mut Drive, inputs: &Inputs, command: Option<&Command>) -> Output {
    drive.tick(inputs, command)
}

/// The current loop alone.
#[inline(never)]
pub fn current_loop(
    current: &mut CurrentLoop,
    k: &current::Coefficients,
    demand: &Demand,
    phases: PhaseCodes,
    periods: u32,
) -> Bridge {
    current.step(k, demand, phases, periods)
}

/// Decoding one encoder frame.
#[inline(never)]
pub fn biss_decode(frame: u64) -> Result<Reading, FrameError> {
    biss::decode(frame)
}

/// One sample of sine and cosine to a position.
#[inline(never)]
pub fn sin_cos_position(
    tracker: &mut Tracker,
    interpolator: &mut Interpolator,
    k: &sincos::Coefficients,
    sample: sincos::Sample,
) -> Update {
    tracker.update_sin_cos(interpolator, k, sample)
}

/// One set-point of a profile.
#[inline(never)]
pub fn profile_advance(profile: &mut Profile) -> Setpoint {
    profile.advance()
}

/// Position and velocity loop.
#[inline(never)]
pub fn cascade_terms(state: &mut cascade::State, k: &cascade::Coefficients, error_ct: i32) -> cascade::Terms {
    state.terms(k, error_ct)
}

/// NIASA: friction model and schedule.
#[inline(never)]
pub fn niasa_act(state: &mut OnDahl, config: &Config, situation: &Situation) -> Action {
    state.act(&config.compensator.niasa, situation)
}

/// Settling statistics.
#[inline(never)]
pub fn settling_update(monitor: &mut Monitor, config: &Config, error_ct: i32) {
    monitor.update(error_ct, &config.tolerances_ct, config.window_ct);
}

/// The tick's entry in the black box.
#[inline(never)]
pub fn black_box_entry(recorder: &mut Recorder, memory: &mut [Entry; 8], inputs: &Inputs, record: &TickRecord) {
    if let Some(index) = recorder.step(record) {
        memory[index as usize % 8] = Entry::new(inputs, 0, record);
    }
}

/// Sine and cosine.
#[inline(never)]
pub fn sin_cos(turns: f32) -> (f32, f32) {
    math::sin_cos_turns(turns)
}

/// For calibration: no branch but the return, so that it executes as many instructions as it has.
#[inline(never)]
pub fn calibrate_straight(x: u32) -> u32 {
    let y = black_box(x.rotate_left(3)) ^ x;
    black_box(y.wrapping_add(x)) ^ y
}

/// For calibration: the same few instructions in each of `passes` passes, and a constant.
#[inline(never)]
pub fn calibrate_loop(passes: u32) {
    let mut left = passes;
    while left > 0 {
        left = black_box(left) - 1;
    }
}
