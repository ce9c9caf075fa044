//! What is watched: checks of every tick, and slower ones in windows of four ticks, one kind in each tick of a window.
//!
//! Thresholds are converted to what is compared (codes, counts, cycles) when the configuration is made; a healthy tick costs a
//! comparison each. Only a tick in which something is wrong looks for what it is, in the order in which causes come before effects.

use crate::SERVO_DT_S;
use crate::drive::Inputs;
use crate::encoder::biss::FrameError;
use crate::encoder::tracker::{Cause, FROZEN_AFTER, Tracker, Update};
use crate::fault::Fault;
use crate::position::Position;

/// What the board tells beside measured values, as bits.
pub mod signals {
    /// The current loop has tripped.
    pub const OVER_CURRENT: u32 = 1 << 0;
    /// The power stage's fault output has turned the bridge off.
    pub const BRIDGE_FAULT: u32 = 1 << 1;
    /// A task has not checked in.
    pub const TASK_HUNG: u32 = 1 << 2;
    /// The stack has come near its end.
    pub const STACK_LOW: u32 = 1 << 3;
    /// First tick after a panic or a processor fault.
    pub const PANICKED: u32 = 1 << 4;
    /// First tick after a reset by the watchdog.
    pub const WATCHDOG_RESET: u32 = 1 << 5;
    /// No valid parameters are stored: those in use are defaults that nobody has chosen.
    pub const PARAMETERS_INVALID: u32 = 1 << 6;
    /// A converter of a phase current gives the same code for ever.
    pub const CURRENT_FROZEN: u32 = 1 << 7;
    /// All bits that are faults.
    pub const FAULTS: u32 = 0xffff;
    /// The current loop asks for more voltage than the bus gives: a limit, not a fault. The upper half has the order of the record's flags.
    pub const VOLTAGE_LIMITED: u32 = (crate::record::flags::VOLTAGE_LIMITED as u32) << 16;
}

/// Ticks in a window of the slower checks.
pub const WINDOW_TICKS: u32 = 4;
/// Length of a window, s.
pub const WINDOW_S: f32 = SERVO_DT_S * WINDOW_TICKS as f32;
/// A code of the temperature below this, the lowest hundredth of the converter's range, is that of an input without a wire.
const NO_SENSOR_CODE: u16 = 655;
/// Windows of acceleration against the force in a row that are a fault.
const OPPOSED_WINDOWS: u8 = 3;

/// Thresholds.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Coefficients {
    /// Lowest code of the bus voltage with the bridge on.
    pub bus_min_code: u16,
    /// Highest code of the bus voltage.
    pub bus_max_code: u16,
    /// Highest code of the temperature.
    pub temperature_max_code: u16,
    /// Equal readings in a row at rest that are a frozen encoder; `u16::MAX`: never.
    pub frozen_ticks: u16,
    /// Largest position error, counts.
    pub following_error_max_ct: i32,
    /// Largest movement in a window, counts.
    pub overspeed_ct: i32,
    /// Largest change of the movement from tick to tick, counts.
    pub jump_ct: i32,
    /// Longest tick, CPU cycles.
    pub tick_limit_cycles: u32,
    /// Largest growth of the position error in a window, counts.
    pub runaway_ct: u32,
    /// Sum of the currents at both ends of a window from which on the stage must not go against them, A.
    pub opposed_a: f32,
    /// Movement in a window, and its change to the last, against that sign which count, counts.
    pub opposed_ct: i32,
    /// Mean square of the continuous current, A².
    pub overload_a2: f32,
    /// Share by which the thermal model follows in a window.
    pub overload_share: f32,
    /// The stage may not be below this.
    pub position_min: Position,
    /// The stage may not be above this.
    pub position_max: Position,
    /// Windows without a command, a sign of life included; `u32::MAX`: no limit.
    pub silent_windows: u32,
}

/// The memory of the checks.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Monitor {
    step_ct: i32,
    /// Change of the movement from the last tick to this one, counts.
    change_ct: i32,
    /// Around lost frames: the last movement between two measured positions.
    bridge: Option<Bridge>,
    /// The movement changes by more than it can.
    jumped: bool,
    /// Low 32 bits of the position where the last window ended.
    window_at: i32,
    window_step_ct: i32,
    window_error_ct: u32,
    window_a: f32,
    heat_a2: f32,
    silent_windows: u32,
    opposed: u8,
    runs_away: bool,
}

/// A movement between two measured positions, and what is missing after it.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
struct Bridge {
    moved_ct: i32,
    /// Ticks that it took.
    ticks: u8,
    /// Frames lost since.
    lost: u8,
}

impl Monitor {
    /// The loops are closed at `position`, at rest: windows begin anew. The motor stays as warm as it was.
    pub fn restart(&mut self, position: Position) {
        *self = Monitor {
            heat_a2: self.heat_a2,
            step_ct: self.step_ct,
            bridge: self.bridge,
            window_at: position.0 as i32,
            ..Monitor::default()
        };
    }

    /// A command has come.
    pub fn hear(&mut self) {
        self.silent_windows = 0;
    }

    /// Mean square of the current as the thermal model has it, A².
    pub fn heat_a2(&self) -> f32 {
        self.heat_a2
    }

    /// Takes the movement of this tick, counts.
    #[inline]
    pub fn follow(&mut self, step_ct: i32) {
        self.change_ct = step_ct.wrapping_sub(self.step_ct);
        self.step_ct = step_ct;
    }

    /// Looks for a jump in the measured positions, in place of the assumed ones that stand in for lost frames: with those, the error
    /// at the set-point would count as a change of the movement.
    ///
    /// Mean speeds over neighbouring spans of m and n ticks differ by at most (m + n) / 2 times what the speed changes in a tick.
    // Within the function that calls it, it would cost a tick with the bridge off the registers that it needs.
    #[inline(never)]
    pub fn find_jump(&mut self, jump_ct: i32, update: Update, tracker: &Tracker) {
        if update != Update::Measured {
            let before = Bridge { moved_ct: self.step_ct.wrapping_sub(self.change_ct), ticks: 1, lost: 0 };
            let bridge = self.bridge.get_or_insert(before);
            bridge.lost = bridge.lost.saturating_add(1);
            self.jumped = false;
            return;
        }
        let Some(Bridge { moved_ct, ticks, lost }) = self.bridge else {
            self.jumped = beyond(self.change_ct, jump_ct);
            return;
        };
        let now = Bridge { moved_ct: tracker.measured_step_ct(), ticks: lost.saturating_add(1), lost: 0 };
        let (m, n) = (i64::from(ticks), i64::from(now.ticks));
        // Two means that differ by d counts a tick, times 2 m n.
        let twice_ct = 2 * (i64::from(now.moved_ct) * m - i64::from(moved_ct) * n);
        self.jumped = twice_ct.abs() > i64::from(jump_ct) * m * n * (m + n);
        self.bridge = (now.ticks > 1).then_some(now);
    }

    /// A frame was lost, now or shortly before: [`Monitor::find_jump`] has to look at the next tick.
    pub fn is_bridging(&self) -> bool {
        self.bridge.is_some()
    }

    /// Whether one of the checks of every tick finds something, encoder frames apart.
    #[inline]
    pub fn is_alarmed(&self, k: &Coefficients, inputs: &Inputs, error_ct: i32) -> bool {
        inputs.signals << 16 != 0
            || inputs.bus_code.wrapping_sub(k.bus_min_code) > k.bus_max_code.wrapping_sub(k.bus_min_code)
            || inputs.last_tick_cycles > k.tick_limit_cycles
            || beyond(error_ct, k.following_error_max_ct)
            || beyond(self.change_ct, k.jump_ct)
    }

    /// The slower check whose turn it is in tick number `ticks`; whether it finds something.
    #[inline]
    pub fn watch(&mut self, k: &Coefficients, ticks: u32, inputs: &Inputs, position: Position, error_ct: i32) -> bool {
        match ticks % WINDOW_TICKS {
            0 => {
                // Movement and acceleration over the window, against the force at its ends.
                let step_ct = (position.0 as i32).wrapping_sub(self.window_at);
                let change_ct = step_ct.wrapping_sub(self.window_step_ct);
                let sum_a = inputs.iq_a + self.window_a;
                (self.window_at, self.window_step_ct, self.window_a) = (position.0 as i32, step_ct, inputs.iq_a);
                let against_ct =
                    if sum_a < 0.0 { change_ct.min(step_ct) } else { change_ct.max(step_ct).wrapping_neg() };
                let opposed = sum_a.abs() > k.opposed_a && against_ct > k.opposed_ct;
                self.opposed = if opposed { self.opposed + 1 } else { 0 };
                self.opposed >= OPPOSED_WINDOWS
            }
            1 => {
                self.heat_a2 += k.overload_share * (inputs.iq_a * inputs.iq_a - self.heat_a2);
                self.heat_a2 > k.overload_a2
                    || inputs.temperature_code > k.temperature_max_code
                    || inputs.temperature_code < NO_SENSOR_CODE
            }
            2 => {
                let error_ct = error_ct.unsigned_abs();
                self.runs_away = error_ct > self.window_error_ct.saturating_add(k.runaway_ct);
                self.window_error_ct = error_ct;
                self.runs_away || beyond(self.window_step_ct, k.overspeed_ct)
            }
            _ => {
                self.silent_windows = self.silent_windows.saturating_add(1);
                self.silent_windows > k.silent_windows || position < k.position_min || position > k.position_max
            }
        }
    }

    /// What is wrong in a tick with the loops closed, the cause before its effects; `None` if a limit was only come near to.
    pub fn diagnose(
        &self,
        k: &Coefficients,
        ticks: u32,
        inputs: &Inputs,
        update: Update,
        tracker: &Tracker,
        error_ct: i32,
    ) -> Option<Fault> {
        let same = tracker.same_readings();
        let frozen_after = if tracker.was_moving() { FROZEN_AFTER } else { k.frozen_ticks };
        let lost = match update {
            Update::Lost(cause) => Some(cause),
            Update::Measured | Update::Held(_) => None,
        };
        let turn = ticks % WINDOW_TICKS;
        let position = tracker.position();
        let outside = position < k.position_min || position > k.position_max;
        let findings = [
            (inputs.bus_code > k.bus_max_code, Fault::BusOverVoltage),
            (inputs.bus_code < k.bus_min_code, Fault::BusUnderVoltage),
            (lost == Some(Cause::Frame(FrameError::Missing)), Fault::EncoderLost),
            (lost == Some(Cause::Frame(FrameError::Crc)), Fault::EncoderChecksum),
            (lost == Some(Cause::ErrorBit), Fault::EncoderErrorBit),
            (lost == Some(Cause::Signal), Fault::EncoderSignal),
            // Nothing stops so suddenly, and on the same count.
            (same >= frozen_after || (same > 0 && self.jumped), Fault::EncoderFrozen),
            (self.jumped, Fault::EncoderJump),
            (turn == 0 && self.opposed >= OPPOSED_WINDOWS, Fault::WrongCommutation),
            (turn == 2 && beyond(self.window_step_ct, k.overspeed_ct), Fault::Overspeed),
            (turn == 2 && self.runs_away, Fault::Runaway),
            (beyond(error_ct, k.following_error_max_ct), Fault::FollowingError),
            (inputs.temperature_code > k.temperature_max_code, Fault::OverTemperature),
            (turn == 1 && inputs.temperature_code < NO_SENSOR_CODE, Fault::TemperatureSensor),
            (self.heat_a2 > k.overload_a2, Fault::MotorOverload),
            (turn == 3 && outside, Fault::PositionLimit),
            (turn == 3 && self.silent_windows > k.silent_windows, Fault::CommandTimeout),
            (inputs.last_tick_cycles > k.tick_limit_cycles, Fault::TickOverrun),
        ];
        signalled(inputs.signals).or_else(|| findings.iter().find(|(found, _)| *found).map(|(_, fault)| *fault))
    }

    /// What is wrong in a tick with the bridge off.
    pub fn check_off(&mut self, k: &Coefficients, inputs: &Inputs) -> Option<Fault> {
        self.heat_a2 -= k.overload_share * (1.0 / WINDOW_TICKS as f32) * self.heat_a2;
        if inputs.signals & signals::FAULTS != 0 {
            signalled(inputs.signals)
        } else if inputs.bus_code > k.bus_max_code {
            Some(Fault::BusOverVoltage)
        } else if inputs.temperature_code > k.temperature_max_code {
            Some(Fault::OverTemperature)
        } else {
            None
        }
    }
}

/// `|value| > limit`, for limits from 0 on.
#[inline]
fn beyond(value: i32, limit: i32) -> bool {
    value.wrapping_add(limit) as u32 > (limit as u32) << 1
}

/// What a signal means, the cause before its effects.
#[cold]
fn signalled(bits: u32) -> Option<Fault> {
    use signals::*;
    let table = [
        (CURRENT_FROZEN, Fault::CurrentFrozen),
        (OVER_CURRENT, Fault::OverCurrent),
        (BRIDGE_FAULT, Fault::BridgeFault),
        (PANICKED, Fault::Panic),
        (WATCHDOG_RESET, Fault::WatchdogReset),
        (PARAMETERS_INVALID, Fault::ParametersInvalid),
        (STACK_LOW, Fault::StackLow),
        (TASK_HUNG, Fault::TaskHung),
    ];
    table.iter().find(|(bit, _)| bits & bit != 0).map(|(_, fault)| *fault)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn beyond_is_what_it_says(value: i32, limit in 0..=i32::MAX) {
            prop_assert_eq!(beyond(value, limit), value.unsigned_abs() > limit.unsigned_abs());
        }
    }

    #[test]
    fn every_fault_signal_has_its_fault_and_a_limit_is_none() {
        let faults: [Option<Fault>; 8] = core::array::from_fn(|bit| signalled(1 << bit));
        assert_eq!(
            faults,
            [
                Some(Fault::OverCurrent),
                Some(Fault::BridgeFault),
                Some(Fault::TaskHung),
                Some(Fault::StackLow),
                Some(Fault::Panic),
                Some(Fault::WatchdogReset),
                Some(Fault::ParametersInvalid),
                Some(Fault::CurrentFrozen)
            ]
        );
        assert_eq!(signalled(signals::VOLTAGE_LIMITED), None);
    }
}
