//! What the drive does with a command.

use super::{Command, Commutation, Drive, Outcome};
use crate::alignment::Alignment;
use crate::compensator::{Compensator, Memory};
use crate::config::Config;
use crate::encoder::sincos::Interpolator;
use crate::encoder::tracker::Tracker;
use crate::position::Position;
use crate::profile::{Limits, Profile};
use crate::refusal::{Field, Refusal};
use crate::state::{ControlWord, Request, State};

impl Drive {
    /// Whether a command acknowledges the fault: the command for it, or the rising edge of the controlword's bit 7, and both in
    /// state Fault only. A fault of the same tick, or one that still brakes, is never acknowledged unseen.
    pub fn is_reset(&self, command: &Command) -> bool {
        if self.state != State::Fault {
            return false;
        }
        match command {
            Command::ResetFault => true,
            Command::Control(word) => word.fault_reset() && !self.control_word.fault_reset(),
            _ => false,
        }
    }

    #[inline(never)]
    pub(super) fn obey(&mut self, command: &Command) -> Outcome {
        match *command {
            Command::Enable => self.enable(),
            Command::Align => self.start_alignment(),
            Command::Disable => {
                self.end_alignment();
                Ok(())
            }
            Command::ResetFault if self.state == State::FaultReactionActive => Err(Refusal::WrongState(self.state)),
            Command::ResetFault | Command::KeepAlive => Ok(()),
            Command::Control(word) => self.control_by(word),
            Command::Move { target, limits } => self.start_move(target, limits),
            Command::Stop if self.aligning.is_some() => {
                self.end_alignment();
                Ok(())
            }
            Command::Stop => {
                self.brake(self.config.acceleration_max_m_per_s2);
                Ok(())
            }
            Command::BeginSave => {
                if self.request != Request::DisableVoltage || self.torque {
                    return Err(Refusal::WrongState(self.state));
                }
                self.saving = true;
                Ok(())
            }
            Command::EndSave => {
                self.saving = false;
                Ok(())
            }
            Command::Compensator(compensator) => {
                self.choose(compensator);
                Ok(())
            }
            Command::Excite(ref order) => self.begin_excitation(order),
            Command::CollectSignals => {
                if self.config.sin_cos.is_none() {
                    return Err(Refusal::NoSignals);
                }
                self.interpolator.collect();
                Ok(())
            }
            Command::CorrectSignals(correction) => {
                let k = self.config.sin_cos.as_mut().ok_or(Refusal::NoSignals)?;
                k.correction = correction;
                self.interpolator.correct(correction);
                Ok(())
            }
            Command::Configure { ref config, needs_bridge_off } => self.configure(config, needs_bridge_off),
        }
    }

    fn enable(&mut self) -> Outcome {
        self.may_enable()?;
        self.is_aligned()?;
        self.climbing = self.state != State::OperationEnabled;
        self.request = Request::towards_enabled(self.state);
        Ok(())
    }

    fn start_alignment(&mut self) -> Outcome {
        if self.torque || self.climbing {
            return Err(Refusal::WrongState(self.state));
        }
        self.may_enable()?;
        self.aligning = Some(Alignment::start(self.tracker.position()));
        self.climbing = true;
        self.request = Request::towards_enabled(self.state);
        Ok(())
    }

    /// Whether there is an electrical zero to commutate by.
    fn is_aligned(&self) -> Outcome {
        match self.commutation {
            _ if self.aligning.is_some() => Err(Refusal::Aligning),
            Commutation::Stored | Commutation::Found(_) => Ok(()),
            Commutation::Unknown => Err(Refusal::NotAligned(None)),
            Commutation::Failed(reason) => Err(Refusal::NotAligned(Some(reason))),
        }
    }

    /// Whether the loops may be closed now.
    fn may_enable(&self) -> Outcome {
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
        Ok(())
    }

    /// Takes a controlword: requests, options and ramps as the standard has them.
    fn control_by(&mut self, word: ControlWord) -> Outcome {
        let before = core::mem::replace(&mut self.control_word, word);
        if matches!(self.state, State::Fault | State::FaultReactionActive) {
            return Ok(());
        }
        let request = word.request();
        if request == Request::EnableOperation && !self.state.has_torque() {
            self.may_enable()?;
            self.is_aligned()?;
        }
        self.climbing = false;
        if self.aligning.is_some() {
            // A master that walks through the states by itself has something else in mind.
            self.end_alignment();
            return Ok(());
        }
        let options = self.config.options;
        if self.state == State::OperationEnabled {
            match request {
                Request::QuickStop => match options.quick_stop_m_per_s2 {
                    Some(ramp_m_per_s2) => self.brake(ramp_m_per_s2),
                    None => {
                        self.drop_request();
                        return Ok(());
                    }
                },
                Request::Shutdown | Request::SwitchOn => {
                    if let Some(ramp_m_per_s2) = options.disable_m_per_s2.filter(|_| self.request != request) {
                        self.brake(ramp_m_per_s2);
                    }
                }
                Request::EnableOperation if word.halt() && !before.halt() => self.brake(options.halt_m_per_s2),
                _ => {}
            }
        }
        self.request = request;
        Ok(())
    }

    /// Asks for the bridge to be off.
    pub(super) fn drop_request(&mut self) {
        self.request = Request::DisableVoltage;
        self.climbing = false;
    }

    /// Ends an excitation, and replaces the motion under way by one that brakes it to rest.
    pub(super) fn brake(&mut self, deceleration_m_per_s2: f32) {
        self.abort_excitation();
        if self.torque && !self.profile.is_done() {
            let from = self.reference;
            self.profile =
                Profile::stopping(from.position, from.velocity_m_per_s, deceleration_m_per_s2, self.config.count_m);
        }
    }

    /// Whether the stage may be made to move now.
    pub(super) fn may_move(&self) -> Outcome {
        if self.state != State::OperationEnabled || self.request != Request::EnableOperation {
            return Err(Refusal::WrongState(self.state));
        }
        if self.aligning.is_some() {
            return Err(Refusal::Aligning);
        }
        if self.control_word.halt() {
            return Err(Refusal::Halted);
        }
        Ok(())
    }

    fn start_move(&mut self, target: Position, limits: Limits) -> Outcome {
        self.may_move()?;
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
        let before_n_s_per_m = self.derivative_n_s_per_m();
        self.switch(kind);
        self.absorb_from(before_n_s_per_m);
    }

    /// What the derivative part was made with in the last tick.
    fn derivative_n_s_per_m(&self) -> f32 {
        let k = &self.config;
        k.cascade.velocity_n_s_per_m * self.compensator.gain(&k.compensator, k.cascade.proportional_n_per_m)
    }

    fn absorb_from(&mut self, derivative_n_s_per_m: f32) {
        self.absorb = true;
        self.absorbed_share = derivative_n_s_per_m / self.config.cascade.velocity_n_s_per_m;
    }

    fn switch(&mut self, kind: Compensator) {
        self.config.compensator.kind = kind;
        self.merge_integrals();
        (self.compensator, self.cascade.integral_n) =
            Memory::start(kind, self.tracker.position(), self.cascade.integral_n);
    }

    /// Hands the force of the compensator's integrator to the linear one; their sum stays.
    fn merge_integrals(&mut self) {
        self.cascade.integral_n += self.nonlinear_n;
        self.nonlinear_n = 0.0;
    }

    fn configure(&mut self, config: &Config, needs_bridge_off: bool) -> Outcome {
        if needs_bridge_off && self.torque {
            return Err(Refusal::WrongState(self.state));
        }
        if needs_bridge_off {
            // An alignment that failed has found the old zero, or the wiring, wrong: other parameters do not mend that.
            let stays_failed = matches!(self.commutation, Commutation::Failed(_))
                && config.commutation_stored == self.config.commutation_stored
                && config.commutation_zero == self.config.commutation_zero;
            self.config = *config;
            // Origin, count or commutation may differ: begin again from the next good frame.
            self.tracker = Tracker::default();
            if config.sin_cos.is_some() {
                self.interpolator = Interpolator::default();
            }
            self.begin_angle();
            if !stays_failed {
                self.commutation = if config.commutation_stored { Commutation::Stored } else { Commutation::Unknown };
            }
            return Ok(());
        }
        let kind = config.compensator.kind;
        let switch = kind != self.config.compensator.kind;
        let before_n_s_per_m = self.derivative_n_s_per_m();
        self.config.adopt(config);
        if switch {
            self.switch(kind);
        }
        self.absorb_from(before_n_s_per_m);
        Ok(())
    }
}
