//! The servo tick: everything the drive decides, 8,000 times a second.

mod align;
mod excite;
mod obey;

pub use align::Commutation;
use excite::Excited;

use crate::alignment::Alignment;
use crate::cascade;
use crate::compensator::{Compensator, Memory, Situation};
use crate::config::Config;
use crate::current::Demand;
use crate::encoder::sincos::{self, Interpolator, Sample};
use crate::encoder::tracker::{FROZEN_AFTER, Tracker, Update};
use crate::fault::{Fault, Reaction};
use crate::measure::{self, Excitation};
use crate::monitor::Monitor;
use crate::position::{Position, saturate};
use crate::profile::{Limits, Profile, Setpoint};
use crate::record::{TickRecord, flags};
use crate::refusal::Refusal;
use crate::settling::{self, Settling};
use crate::state::{self, ControlWord, Request, State, status};
use crate::{PERIODS_PER_TICK, SERVO_HZ};

/// Ticks after the end of a ramp that the stage is given to come to rest: 20 ms, two periods of a 100 Hz loop.
const REST_TICKS: u32 = SERVO_HZ / 50;

/// What the tick knows of the world.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Inputs {
    /// What the encoder told, see [`crate::axis::ServoSample::frame`].
    pub frame: u64,
    /// Measured force-making current, A.
    pub iq_a: f32,
    /// ADC code of the bus voltage.
    pub bus_code: u16,
    /// ADC code of the power stage's temperature.
    pub temperature_code: u16,
    /// What board and current loop tell beside: bits of [`crate::monitor::signals`].
    pub signals: u32,
    /// Duration of the previous tick, CPU cycles.
    pub last_tick_cycles: u32,
}

/// What a person, or a program, can ask of the drive.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[expect(clippy::large_enum_variant, reason = "there is no allocator to box with, and a command is rare")]
pub enum Command {
    /// Close the loops at the present position, one state per tick up to Operation enabled.
    Enable,
    /// Look for the motor's electrical zero, from state Switch on disabled back to it; see [`crate::alignment`].
    Align,
    /// Bridge off at once.
    Disable,
    /// Acknowledge a fault.
    ResetFault,
    /// A controlword of CiA 402, for masters that walk through the states themselves.
    Control(ControlWord),
    /// Nothing but a sign that the host is there.
    KeepAlive,
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
    /// Play an excitation, in place of one under way.
    Excite(measure::Order),
    /// Take over new coefficients, without a bump.
    Configure {
        /// The coefficients.
        config: Config,
        /// Some of what differs may only change with the bridge off.
        needs_bridge_off: bool,
    },
    /// Collect sine and cosine from now on, while the stage moves, for [`Drive::signal_fit`].
    CollectSignals,
    /// The flash is going to be written: refused with torque on, and from then on torque is refused.
    BeginSave,
    /// The flash has been written, or could not be.
    EndSave,
    /// Correct sine and cosine in this way from now on, and learn from there. The position changes by what the error was.
    CorrectSignals(sincos::Correction),
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
///
/// In the order of the fields: what every tick needs comes first, within the reach of a load from the drive's address, what few
/// ticks need comes last. It saves 3 % of a tick.
#[derive(Clone, Debug)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[repr(C)]
pub struct Drive {
    state: State,
    fault: Option<Fault>,
    /// Loops closed: the bridge is on.
    torque: bool,
    request: Request,
    /// Operation enabled, nothing else is asked for, and no frame was lost shortly before.
    steady: bool,
    /// [`Command::Enable`] is on its way up.
    climbing: bool,
    /// An excitation acts.
    exciting: bool,
    was_moving: bool,
    /// The next tick keeps `static_n`, and the damping by `absorbed_share`, whatever has been changed.
    absorb: bool,
    /// The flash is being written: no torque meanwhile.
    saving: bool,
    control_word: ControlWord,
    electrical_ct: i32,
    electrical_at: Position,
    error_ct: i32,
    bus_v: f32,
    /// Force of the last tick, N.
    force_n: f32,
    /// What holds the stage where it is, N: the last tick's force without the part that follows the rate of the error.
    static_n: f32,
    /// Force of the compensator's integrator, N.
    nonlinear_n: f64,
    tracker: Tracker,
    monitor: Monitor,
    reference: Setpoint,
    profile: Profile,
    cascade: cascade::State,
    settling: settling::Monitor,
    counters: Counters,
    config: Config,
    compensator: Memory,
    interpolator: Interpolator,
    commutation: Commutation,
    /// An alignment under way, or about to begin.
    aligning: Option<Alignment>,
    /// Its electrical angle, turns, and amplitude, A.
    vector: Option<[f32; 2]>,
    excitation: Excitation,
    /// Derivative gain before a change, as a share of that after it.
    absorbed_share: f32,
}

impl Drive {
    /// A drive at rest with the bridge off.
    pub fn new(config: Config) -> Self {
        let origin = Position(0);
        Drive {
            config,
            state: State::default(),
            fault: None,
            torque: false,
            request: Request::default(),
            steady: false,
            climbing: false,
            exciting: false,
            control_word: ControlWord::default(),
            monitor: Monitor::default(),
            tracker: Tracker::default(),
            interpolator: Interpolator::default(),
            electrical_ct: 0,
            electrical_at: config.commutation_zero,
            commutation: if config.commutation_stored { Commutation::Stored } else { Commutation::Unknown },
            aligning: None,
            vector: None,
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
            settling: settling::Monitor::default(),
            bus_v: 0.0,
            counters: Counters::default(),
            excitation: Excitation::default(),
            absorbed_share: 1.0,
            saving: false,
        }
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

    /// The next tick has nothing to do but to control, if all stays well: Operation enabled, nothing else is asked for, and no frame
    /// was lost shortly before.
    pub fn is_steady(&self) -> bool {
        self.steady
    }

    /// How the last move settled, so far.
    pub fn settling(&self) -> Settling {
        self.settling.settling()
    }

    /// Counts since start.
    pub fn counters(&self) -> Counters {
        Counters { bad_frames: self.tracker.bad_frames(), ..self.counters }
    }

    /// Mean square of the current as the thermal model has it, A².
    pub fn heat_a2(&self) -> f32 {
        self.monitor.heat_a2()
    }

    /// Sine and cosine as collected since [`Command::CollectSignals`]; `None` before it.
    pub fn signal_fit(&self) -> Option<&sincos::Fit> {
        self.interpolator.fit()
    }

    /// Health of sine and cosine: estimated sub-divisional error, peak, m; see [`sincos::Interpolator::error_periods`].
    pub fn subdivisional_error_m(&self) -> Option<f64> {
        self.config.sin_cos.as_ref()?;
        let period_m = f64::from(sincos::PERIOD_CT) * self.config.count_m;
        self.interpolator.error_periods().map(|periods| f64::from(periods) * period_m)
    }

    /// The statusword (object 6041) after a tick; `record` is what the tick gave.
    pub fn status_word(&self, record: &TickRecord) -> u16 {
        let limits = flags::LIMITS.iter().fold(0, |bits, (bit, ..)| bits | bit);
        let bits = [
            (status::VOLTAGE_ENABLED, self.bus_is_good()),
            (status::WARNING, record.flags & flags::ENCODER_WARNING != 0),
            (status::REMOTE, true),
            (status::TARGET_REACHED, self.target_reached()),
            (status::INTERNAL_LIMIT, record.flags & limits != 0),
            (status::FOLLOWING_ERROR, self.fault == Some(Fault::FollowingError)),
        ];
        bits.iter().fold(self.state.status_bits(), |word, (bit, set)| word | if *set { *bit } else { 0 })
    }

    /// The set-point rests and the error has been inside the position window for the window time.
    pub fn target_reached(&self) -> bool {
        self.torque && !self.was_moving && self.settling.inside_ticks() >= self.config.window_ticks.max(1)
    }

    fn bus_is_good(&self) -> bool {
        (self.config.bus_min_v..=self.config.bus_max_v).contains(&self.bus_v)
    }

    /// One servo tick: position → command → reference → error → monitors → state → force → current set-point.
    ///
    /// Whatever is wrong, the bridge is off in the output of the tick that sees it.
    #[inline]
    pub fn tick(&mut self, inputs: &Inputs, command: Option<&Command>) -> Output {
        let update = match &self.config.sin_cos {
            None => self.tracker.update(inputs.frame, self.config.origin),
            Some(k) => self.tracker.update_sin_cos(&mut self.interpolator, k, Sample::from_bits(inputs.frame)),
        };
        self.bus_v = f32::from(inputs.bus_code) * self.config.bus_v_per_code;
        self.count(inputs);

        let mut reset = false;
        let mut outcome = None;
        if let Some(command) = command {
            reset = self.is_reset(command);
            self.monitor.hear();
            outcome = Some(self.obey(command));
            self.steady &= self.request == Request::EnableOperation;
        }

        if self.torque {
            self.reference = self.profile.advance();
            if update != Update::Measured {
                // Hold the error: the force then stays what it was, at rest and in motion.
                self.tracker.assume(self.reference.position.plus(-i64::from(self.error_ct)));
            }
        }
        let position = self.tracker.position();
        let step_ct = self.follow_electrical_angle(position);
        let error_ct = self.reference.position.minus(position);
        let had_torque = self.torque;
        if self.has_to_act(inputs, update, position, step_ct, error_ct) {
            outcome = self.act(inputs, update, error_ct, reset, outcome);
        }

        let mut record = TickRecord {
            sequence: self.counters.ticks,
            position,
            iq_a: inputs.iq_a,
            bus_v: self.bus_v,
            state: self.state,
            fault: self.fault,
            tick_cycles: inputs.last_tick_cycles.min(u32::from(u16::MAX)) as u16,
            flags: if update == Update::Measured { 0 } else { flags::FRAME_BAD }
                | if self.tracker.warning() { flags::ENCODER_WARNING } else { 0 }
                // Voltage limited: the same order of bits, so that they are moved as one.
                | (inputs.signals >> 16) as u16 & flags::VOLTAGE_LIMITED,
            ..TickRecord::default()
        };
        if !self.torque {
            return Output { demand: Demand::OFF, record, outcome };
        }
        self.error_ct = error_ct;
        if !had_torque {
            self.close_loops(position);
            self.error_ct = 0;
        }
        record.error_ct = self.error_ct;
        if !self.steady
            && let Some([turns, amps]) = self.vector
        {
            record.iq_set_a = amps;
            record.flags |= flags::BRIDGE_ON | flags::ALIGNING;
            let demand =
                Demand { enabled: true, iq_a: amps, turns, turns_per_period: 0.0, per_bus_v: 1.0 / self.bus_v };
            return Output { demand, record, outcome };
        }
        self.control(&mut record, step_ct);
        if self.exciting {
            // By value: a record that is lent out would be copied in every tick.
            let Excited { force_n, through_n } =
                self.excite(position, step_ct, inputs.iq_a, record.proportional_n, record.force_n);
            record.proportional_n += through_n;
            record.force_n = force_n;
            record.iq_set_a = force_n * self.config.amps_per_newton;
            record.flags |= flags::EXCITED;
        }
        let demand = Demand {
            enabled: true,
            iq_a: record.iq_set_a,
            turns: self.electrical_ct as f32 * self.config.turns_per_ct,
            turns_per_period: step_ct as f32 * self.config.turns_per_ct * (1.0 / PERIODS_PER_TICK as f32),
            per_bus_v: 1.0 / self.bus_v,
        };
        Output { demand, record, outcome }
    }

    /// Whether this tick is anything but one more of Operation enabled with all well. Only then [`Drive::act`] finds out what.
    #[inline]
    fn has_to_act(&mut self, inputs: &Inputs, update: Update, position: Position, step_ct: i32, error_ct: i32) -> bool {
        self.monitor.follow(step_ct);
        if !self.torque {
            return true;
        }
        let k = &self.config.monitor;
        let slow = self.monitor.watch(k, self.counters.ticks, inputs, position, error_ct);
        slow || !self.steady
            || update != Update::Measured
            || self.tracker.same_readings() >= FROZEN_AFTER
            || self.monitor.is_alarmed(k, inputs, error_ct)
    }

    /// Finds the fault, if there is one; then the state after this tick, whether the loops are closed, what is kept of a fault, and the
    /// answer to a reset.
    #[cold]
    #[inline(never)]
    fn act(
        &mut self,
        inputs: &Inputs,
        update: Update,
        error_ct: i32,
        reset: bool,
        outcome: Option<Outcome>,
    ) -> Option<Outcome> {
        if self.config.sin_cos.is_some() && !self.tracker.is_valid() {
            // Where the stage is now, nobody knows.
            self.commutation = Commutation::Unknown;
        }
        let misaligned = self.align(inputs.iq_a);
        let k = &self.config.monitor;
        // The current of an alignment is no force in its direction, and may shake a stage that something elastic holds.
        let aligning = self.aligning.is_some();
        if self.torque || update != Update::Measured || self.monitor.is_bridging() {
            self.monitor.find_jump(if aligning { i32::MAX } else { k.jump_ct }, update, &self.tracker);
        }
        let fault = if self.torque {
            let found = self.monitor.diagnose(k, self.counters.ticks, inputs, update, &self.tracker, error_ct);
            found.filter(|fault| !aligning || *fault != Fault::WrongCommutation).or(misaligned)
        } else {
            self.monitor.check_off(k, inputs)
        };
        if self.fault.is_none() || reset {
            self.fault = fault;
        }
        let ramp = self.config.options.fault_m_per_s2;
        let mut braking = self.torque && self.state == State::FaultReactionActive;
        if let Some(fault) = fault {
            match ramp {
                Some(ramp_m_per_s2)
                    if self.torque && self.aligning.is_none() && fault.reaction() == Reaction::MayBrake =>
                {
                    if !braking {
                        self.brake(ramp_m_per_s2);
                        braking = true;
                    }
                }
                _ => braking = false,
            }
            self.end_alignment();
        }
        let ready = self.tracker.is_valid() && self.bus_is_good();
        if self.climbing {
            self.request = Request::towards_enabled(self.state);
        }
        if self.request == Request::EnableOperation && !self.torque && !ready {
            // Asked for, but not possible now: to be asked for again, or the bridge would go on at some later time.
            self.request = Request::SwitchOn;
            self.climbing = false;
            self.aligning = None;
        }
        let released = match self.state {
            // No ramp: the option has been taken back in the middle of it.
            State::FaultReactionActive => !braking || ramp.is_none() || self.is_at_rest(),
            State::OperationEnabled => self.config.options.disable_m_per_s2.is_none() || self.is_at_rest(),
            State::QuickStopActive => self.config.options.quick_stop_m_per_s2.is_none() || self.is_at_rest(),
            _ => true,
        };
        let stays_stopped = self.config.options.stays_stopped;
        let request = self.request;
        let inputs = state::Inputs { request, fault: fault.is_some(), reset, ready, released, stays_stopped };
        self.state = state::next(self.state, inputs);
        self.climbing &= self.state != State::OperationEnabled;
        self.torque = self.state.has_torque() || (self.state == State::FaultReactionActive && braking);
        let operating = self.state == State::OperationEnabled
            && self.request == Request::EnableOperation
            && self.aligning.is_none();
        if !operating {
            self.abort_excitation();
        }
        self.steady = operating && !self.monitor.is_bridging();
        if self.state == State::SwitchOnDisabled && !self.climbing {
            // A request that led here is spent: only a new one leads on.
            self.request = Request::DisableVoltage;
        }
        match fault {
            Some(fault) if reset => Some(Err(Refusal::FaultPersists(fault))),
            _ => outcome,
        }
    }

    /// The set-point has been at rest for so long that the stage is as well.
    fn is_at_rest(&self) -> bool {
        self.profile.is_done() && self.settling.settling().ticks >= REST_TICKS
    }

    /// Set-point at the measured position, no force, no memory: nothing jumps.
    fn close_loops(&mut self, position: Position) {
        self.profile = Profile::at_rest(position);
        self.reference = self.profile.advance();
        self.was_moving = false;
        self.settling.restart(true);
        self.monitor.restart(position);
        self.begin_alignment(position);
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
            let before_n = self.static_n + terms.rate_n * self.absorbed_share;
            self.cascade.integral_n -= f64::from(wanted_n - before_n);
            wanted_n = before_n;
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
            self.settling.update(record.error_ct, &k.tolerances_ct, k.window_ct);
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
        if inputs.last_tick_cycles > self.config.monitor.tick_limit_cycles {
            c.overruns = c.overruns.saturating_add(1);
        }
    }
}
