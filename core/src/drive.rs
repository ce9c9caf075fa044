//! The servo tick: everything the drive decides, 8,000 times a second.

use crate::PERIODS_PER_TICK;
use crate::cascade;
use crate::compensator::{Compensator, Memory, Situation};
use crate::config::Config;
use crate::current::Demand;
use crate::encoder::tracker::{Tracker, Update};
use crate::fault::Fault;
use crate::position::{Position, saturate};
use crate::profile::{Limits, Profile, Setpoint};
use crate::record::{TickRecord, flags};
use crate::refusal::{Field, Refusal};
use crate::settling::{Monitor, Settling};
use crate::state::{self, State};

/// What the tick knows of the world.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Inputs {
    /// Line bits of the encoder frame, see [`crate::encoder::biss::decode`].
    pub frame: u64,
    /// Measured force-making current, A.
    pub iq_a: f32,
    /// The current loop has tripped.
    pub over_current: bool,
    /// ADC code of the bus voltage.
    pub bus_code: u16,
    /// The power stage's fault output has turned the bridge off.
    pub bridge_fault: bool,
    /// Duration of the previous tick, CPU cycles.
    pub last_tick_cycles: u32,
}

/// What a person, or a program, can ask of the drive.
#[derive(Clone, Copy, Debug, PartialEq)]
#[expect(clippy::large_enum_variant, reason = "there is no allocator to box with, and a command is rare")]
pub enum Command {
    /// Close the loops at the present position.
    Enable,
    /// Bridge off.
    Disable,
    /// Acknowledge a fault.
    ResetFault,
    /// Move to a position.
    Move {
        /// Where to.
        target: Position,
        /// How fast.
        limits: Limits,
    },
    /// Brake the motion under way to rest.
    Stop,
    /// Choose the compensator, without a bump.
    Compensator(Compensator),
    /// Take over new coefficients, without a bump.
    Configure {
        /// The coefficients.
        config: Config,
        /// Some of what differs may only change with the bridge off.
        needs_bridge_off: bool,
    },
    /// The flash is going to be written: refused with torque on, and from then on torque is refused.
    BeginSave,
    /// The flash has been written, or could not be.
    EndSave {
        /// Valid parameters are stored.
        stored: bool,
    },
}

/// The answer to a command.
pub type Outcome = Result<(), Refusal>;

/// What the tick decides.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Output {
    /// For the current loop.
    pub demand: Demand,
    /// For the log.
    pub record: TickRecord,
    /// The answer, if there was a command.
    pub outcome: Option<Outcome>,
}

/// Counts and extremes since start.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Counters {
    /// Servo ticks.
    pub ticks: u32,
    /// Ticks longer than their limit.
    pub overruns: u32,
    /// Longest tick, CPU cycles.
    pub longest_tick_cycles: u32,
    /// Unusable encoder frames.
    pub bad_frames: u32,
}

/// The drive: configuration, and state apart from it.
#[derive(Clone, Debug)]
pub struct Drive {
    config: Config,
    state: State,
    fault: Option<Fault>,
    enable: bool,
    tracker: Tracker,
    electrical_ct: i32,
    electrical_at: Position,
    profile: Profile,
    reference: Setpoint,
    error_ct: i32,
    /// Force of the last tick, N.
    force_n: f32,
    was_moving: bool,
    cascade: cascade::State,
    compensator: Memory,
    /// Force of the compensator's integrator, N.
    nonlinear_n: f64,
    /// What holds the stage where it is, N: the last tick's force without the part that follows the rate of the error.
    static_n: f32,
    /// The next tick keeps `static_n`, whatever has been changed.
    absorb: bool,
    settling: Monitor,
    bus_v: f32,
    counters: Counters,
    /// Nobody has ever stored the parameters in use: no torque on them.
    uncommissioned: bool,
    /// The flash is being written: no torque meanwhile.
    saving: bool,
}

impl Drive {
    /// A drive at rest with the bridge off.
    pub fn new(config: Config) -> Self {
        let origin = Position(0);
        Drive {
            config,
            state: State::default(),
            fault: None,
            enable: false,
            tracker: Tracker::default(),
            electrical_ct: 0,
            electrical_at: config.commutation_zero,
            profile: Profile::at_rest(origin),
            reference: Profile::at_rest(origin).advance(),
            error_ct: 0,
            force_n: 0.0,
            was_moving: false,
            cascade: cascade::State::default(),
            compensator: Memory::None,
            nonlinear_n: 0.0,
            static_n: 0.0,
            absorb: false,
            settling: Monitor::default(),
            bus_v: 0.0,
            counters: Counters::default(),
            uncommissioned: false,
            saving: false,
        }
    }

    /// A drive whose parameters are defaults that nobody has stored: in a fault until [`Command::EndSave`] says that somebody has.
    pub fn uncommissioned(config: Config) -> Self {
        Drive { uncommissioned: true, ..Self::new(config) }
    }

    /// Coefficients in use.
    pub fn config(&self) -> &Config {
        &self.config
    }

    /// Power state.
    pub fn state(&self) -> State {
        self.state
    }

    /// First fault since the last reset.
    pub fn fault(&self) -> Option<Fault> {
        self.fault
    }

    /// How the last move settled, so far.
    pub fn settling(&self) -> Settling {
        self.settling.settling()
    }

    /// Counts since start.
    pub fn counters(&self) -> Counters {
        self.counters
    }

    /// One servo tick: position → command → reference → error → monitors → state → force → current set-point.
    ///
    /// Whatever is wrong, the bridge is off in the output of the tick that sees it.
    #[inline]
    pub fn tick(&mut self, inputs: &Inputs, command: Option<&Command>) -> Output {
        let update = self.tracker.update(inputs.frame, self.config.origin);
        self.bus_v = f32::from(inputs.bus_code) * self.config.bus_v_per_code;
        self.count(inputs);

        let reset = matches!(command, Some(Command::ResetFault));
        let outcome = command.map(|command| self.obey(command));

        if self.state.has_torque() {
            self.reference = self.profile.advance();
            if update != Update::Measured {
                // Hold the error: the force then stays what it was, at rest and in motion.
                self.tracker.assume(self.reference.position.plus(-i64::from(self.error_ct)));
            }
        }
        let position = self.tracker.position();
        let step_ct = self.follow_electrical_angle(position);
        let error_ct = self.reference.position.minus(position);
        let fault = self.look_for_faults(inputs, update, error_ct);
        if self.fault.is_none() || reset {
            self.fault = fault;
        }
        let outcome = match fault {
            Some(fault) if reset => Some(Err(Refusal::FaultPersists(fault))),
            _ => outcome,
        };
        if fault.is_some() {
            self.enable = false;
        }
        let before = self.state;
        self.state = state::next(before, state::Inputs { enable: self.enable, fault: fault.is_some(), reset });

        let mut record = TickRecord {
            sequence: self.counters.ticks,
            position,
            iq_a: inputs.iq_a,
            bus_v: self.bus_v,
            state: self.state,
            fault: self.fault,
            tick_cycles: inputs.last_tick_cycles.min(u32::from(u16::MAX)) as u16,
            flags: if update == Update::Measured { 0 } else { flags::FRAME_BAD }
                | if self.tracker.warning() { flags::ENCODER_WARNING } else { 0 },
            ..TickRecord::default()
        };
        if !self.state.has_torque() {
            return Output { demand: Demand::OFF, record, outcome };
        }
        if !before.has_torque() {
            self.close_loops(position);
        }
        self.error_ct = self.reference.position.minus(position);
        record.error_ct = self.error_ct;
        self.control(&mut record, step_ct);
        let demand = Demand {
            enabled: true,
            iq_a: record.iq_set_a,
            turns: self.electrical_ct as f32 * self.config.turns_per_ct,
            turns_per_period: step_ct as f32 * self.config.turns_per_ct * (1.0 / PERIODS_PER_TICK as f32),
            per_bus_v: 1.0 / self.bus_v,
        };
        Output { demand, record, outcome }
    }

    /// Set-point at the measured position, no force, no memory: nothing jumps.
    fn close_loops(&mut self, position: Position) {
        self.profile = Profile::at_rest(position);
        self.reference = self.profile.advance();
        self.was_moving = false;
        self.cascade.reset(0);
        self.nonlinear_n = 0.0;
        self.force_n = 0.0;
        self.absorb = false;
        (self.compensator, _) = Memory::start(self.config.compensator.kind, position, 0.0);
    }

    /// From error to current set-point.
    #[inline]
    fn control(&mut self, record: &mut TickRecord, step_ct: i32) {
        let k = &self.config;
        let moving = !self.reference.done;
        let terms = self.cascade.terms(&k.cascade, record.error_ct);
        let situation = Situation {
            position: record.position,
            step_ct,
            error_ct: record.error_ct,
            reference: self.reference,
            proportional_n_per_m: k.cascade.proportional_n_per_m,
            force_n: self.force_n,
        };
        let action = self.compensator.act(&k.compensator, &situation);
        let feedforward_n = k.feedforward_mass_kg * self.reference.acceleration_m_per_s2;
        let proportional_n = terms.proportional_n * action.gain;
        let rate_n = terms.rate_n * action.gain;

        let mut wanted_n =
            proportional_n + (self.cascade.integral_n + self.nonlinear_n) as f32 + action.direct_n + feedforward_n;
        if core::mem::take(&mut self.absorb) {
            let bump_n = wanted_n - rate_n - self.static_n;
            self.cascade.integral_n -= f64::from(bump_n);
            wanted_n -= bump_n;
        }
        self.static_n = wanted_n - rate_n;
        let force_n = wanted_n.clamp(-k.force_limit_n, k.force_limit_n);
        let limited = force_n != wanted_n;
        self.force_n = force_n;

        // At the limit an integrator may only turn back.
        let linear_n = if action.replaces_integral { 0.0 } else { terms.increment_n };
        if !limited || linear_n * wanted_n < 0.0 {
            self.cascade.integrate(linear_n);
        }
        if !limited || action.increment_n * wanted_n < 0.0 {
            self.nonlinear_n += f64::from(action.increment_n);
        }

        if moving {
            if !self.was_moving {
                self.settling.restart(self.profile.target() >= record.position);
            }
        } else {
            self.settling.update(record.error_ct, &k.tolerances_ct);
        }
        self.was_moving = moving;

        record.proportional_n = proportional_n;
        record.integral_n = self.cascade.integral_n as f32;
        record.compensator_n = self.nonlinear_n as f32 + action.direct_n;
        record.feedforward_n = feedforward_n;
        record.force_n = force_n;
        record.friction_n = action.friction_n;
        record.slope_n_per_m = action.slope_n_per_m;
        record.iq_set_a = force_n * k.amps_per_newton;
        record.flags |= flags::BRIDGE_ON
            | if moving { flags::MOVING } else { 0 }
            | if limited { flags::FORCE_LIMITED } else { 0 }
            | if matches!(self.compensator, Memory::None) { 0 } else { flags::COMPENSATED }
            | if action.limited { flags::RATE_LIMITED } else { 0 };
    }

    /// Keeps the electrical angle as counts within one turn and returns the counts moved since the last tick: positions differ by
    /// little from tick to tick, so that no division is needed after the first.
    #[inline]
    fn follow_electrical_angle(&mut self, position: Position) -> i32 {
        let turn_ct = self.config.turn_ct;
        let moved = position.0.wrapping_sub(self.electrical_at.0);
        self.electrical_at = position;
        let moved_ct = saturate(moved);
        // A turn has at most 1e9 counts, so that these sums stay within 32 bits.
        self.electrical_ct = if moved_ct > turn_ct || moved_ct < -turn_ct {
            let angle_ct = i64::from(self.electrical_ct).wrapping_add(moved);
            angle_ct.checked_rem_euclid(i64::from(turn_ct)).unwrap_or(0) as i32
        } else {
            let angle_ct = self.electrical_ct + moved_ct;
            if angle_ct < 0 {
                angle_ct + turn_ct
            } else if angle_ct >= turn_ct {
                angle_ct - turn_ct
            } else {
                angle_ct
            }
        };
        moved_ct
    }

    #[inline]
    fn count(&mut self, inputs: &Inputs) {
        let c = &mut self.counters;
        c.ticks = c.ticks.wrapping_add(1);
        c.longest_tick_cycles = c.longest_tick_cycles.max(inputs.last_tick_cycles);
        c.overruns = c.overruns.saturating_add(u32::from(inputs.last_tick_cycles > self.config.tick_limit_cycles));
        c.bad_frames = self.tracker.bad_frames();
    }

    /// The first thing that is wrong in this tick.
    #[inline]
    fn look_for_faults(&self, inputs: &Inputs, update: Update, error_ct: i32) -> Option<Fault> {
        let k = &self.config;
        let torque = self.state.has_torque();
        if inputs.over_current {
            Some(Fault::OverCurrent)
        } else if inputs.bridge_fault {
            Some(Fault::BridgeFault)
        } else if self.bus_v > k.bus_max_v {
            Some(Fault::BusOverVoltage)
        } else if !torque {
            self.uncommissioned.then_some(Fault::ParametersInvalid)
        } else if self.bus_v < k.bus_min_v {
            Some(Fault::BusUnderVoltage)
        } else if matches!(update, Update::Lost(_)) {
            Some(Fault::EncoderLost)
        } else if error_ct.unsigned_abs() > k.following_error_max_ct.unsigned_abs() {
            Some(Fault::FollowingError)
        } else if inputs.last_tick_cycles > k.tick_limit_cycles {
            Some(Fault::TickOverrun)
        } else {
            None
        }
    }

    fn obey(&mut self, command: &Command) -> Outcome {
        match *command {
            Command::Enable => self.enable(),
            Command::Disable => {
                self.enable = false;
                Ok(())
            }
            Command::ResetFault => Ok(()),
            Command::Move { target, limits } => self.start_move(target, limits),
            Command::Stop => {
                if self.state.has_torque() && !self.profile.is_done() {
                    let from = self.reference;
                    let deceleration = self.config.acceleration_max_m_per_s2;
                    self.profile =
                        Profile::stopping(from.position, from.velocity_m_per_s, deceleration, self.config.count_m);
                }
                Ok(())
            }
            Command::Compensator(compensator) => {
                self.choose(compensator);
                Ok(())
            }
            Command::Configure { ref config, needs_bridge_off } => self.configure(config, needs_bridge_off),
            Command::BeginSave => {
                if self.enable || self.state.has_torque() {
                    return Err(Refusal::WrongState(self.state));
                }
                self.saving = true;
                Ok(())
            }
            Command::EndSave { stored } => {
                (self.saving, self.uncommissioned) = (false, !stored);
                Ok(())
            }
        }
    }

    fn enable(&mut self) -> Outcome {
        if matches!(self.state, State::Fault | State::FaultReactionActive) {
            return Err(Refusal::WrongState(self.state));
        }
        if self.saving {
            return Err(Refusal::Saving);
        }
        if !self.tracker.is_valid() {
            return Err(Refusal::NoPosition);
        }
        let (min, max) = (f64::from(self.config.bus_min_v), f64::from(self.config.bus_max_v));
        Refusal::check(Field::BusVoltage, f64::from(self.bus_v), min, max)?;
        self.enable = true;
        Ok(())
    }

    fn start_move(&mut self, target: Position, limits: Limits) -> Outcome {
        if !self.state.has_torque() {
            return Err(Refusal::WrongState(self.state));
        }
        if !self.profile.is_done() {
            return Err(Refusal::Moving);
        }
        let k = &self.config;
        if target < k.travel_min || target > k.travel_max {
            // Metres for a person: to the picometre, so that a limit is shown as it was set.
            let in_m = |position: Position| libm::round(position.0 as f64 * k.count_m * 1e12) / 1e12;
            let (value, min, max) = (in_m(target), in_m(k.travel_min), in_m(k.travel_max));
            return Err(Refusal::OutOfRange { field: Field::Target, value, min, max });
        }
        // The lowest: what makes the longest distance take a day, in ticks that fit their counter.
        Refusal::check(Field::Velocity, f64::from(limits.velocity_m_per_s), 1e-6, f64::from(k.velocity_max_m_per_s))?;
        let acceleration = f64::from(limits.acceleration_m_per_s2);
        Refusal::check(Field::Acceleration, acceleration, 1e-9, f64::from(k.acceleration_max_m_per_s2))?;
        if let Some(jerk) = limits.jerk_m_per_s3 {
            Refusal::check(Field::Jerk, f64::from(jerk), 1e-6, 1e9)?;
        }
        self.profile = Profile::between(self.reference.position, target, limits, k.count_m);
        // What the last move's settling took becomes the linear integrator's, or the two would drift apart move by move.
        self.merge_integrals();
        Ok(())
    }

    /// The next tick's force is this one's: what the old compensator gave and the new one does not give is the linear integrator's.
    fn choose(&mut self, kind: Compensator) {
        self.config.compensator.kind = kind;
        self.merge_integrals();
        (self.compensator, self.cascade.integral_n) =
            Memory::start(kind, self.tracker.position(), self.cascade.integral_n);
        self.absorb = true;
    }

    /// Hands the force of the compensator's integrator to the linear one; their sum stays.
    fn merge_integrals(&mut self) {
        self.cascade.integral_n += self.nonlinear_n;
        self.nonlinear_n = 0.0;
    }

    fn configure(&mut self, config: &Config, needs_bridge_off: bool) -> Outcome {
        if needs_bridge_off && self.state.has_torque() {
            return Err(Refusal::WrongState(self.state));
        }
        let kind = config.compensator.kind;
        let switch = kind != self.config.compensator.kind;
        self.config = *config;
        self.absorb = true;
        if switch {
            self.choose(kind);
        }
        if needs_bridge_off {
            // Origin, count or commutation may differ: begin again from the next good frame.
            self.tracker = Tracker::default();
            self.electrical_ct = 0;
            self.electrical_at = self.config.commutation_zero;
        }
        Ok(())
    }
}
