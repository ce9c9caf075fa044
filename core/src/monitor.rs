//! What is watched: checks of every tick, and slower ones in windows of four ticks, one kind in each tick of a window.
//!
//! Thresholds are converted to what is compared (codes, counts, cycles) when the configuration is made; a healthy tick costs a
//! comparison each. Only a tick in which something is wrong looks for what it is, in the order in which causes come before effects.

use crate::SERVO_DT_S;
use crate::drive::Inputs;
use crate::encoder::biss::FrameError;
use crate::encoder::tracker::{Cause, FROZEN_AFTER, Update};
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
    /// The stored parameters are not valid.
    pub const PARAMETERS_INVALID: u32 = 1 << 6;
    /// All bits that are faults.
    pub const FAULTS: u32 = 0xffff;
    /// The current loop asks for more voltage than the bus gives: a limit, not a fault.
    pub const VOLTAGE_LIMITED: u32 = 1 << 16;
}

/// Ticks in a window of the slower checks.
pub const WINDOW_TICKS: u8 = 4;
/// Length of a window, s.
pub const WINDOW_S: f32 = SERVO_DT_S * WINDOW_TICKS as f32;
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
    /// Equal readings in a row at rest that are a frozen encoder, and windows of equal current; `u16::MAX`: never.
    pub frozen_ticks: u16,
    /// Largest position error, counts.
    pub following_error_max_ct: i32,
    /// Largest movement in a tick, counts.
    pub overspeed_ct: i32,
    /// Largest change of the movement from tick to tick, counts.
    pub jump_ct: i32,
    /// Longest tick, CPU cycles.
    pub tick_limit_cycles: u32,
    /// Largest growth of the position error in a window, counts.
    pub runaway_ct: u32,
    /// Sum of the currents of two windows from which on acceleration must have their sign, A.
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
    /// Windows without a command; `u32::MAX`: no limit.
    pub silent_windows: u32,
}

/// What the checks look at in a tick.
#[derive(Clone, Copy, Debug)]
pub struct Seen<'a> {
    /// Inputs of the tick.
    pub inputs: &'a Inputs,
    /// What became of the encoder frame.
    pub update: Update,
    /// Equal readings in a row.
    pub same_readings: u16,
    /// The stage was measurably moving before the readings were equal.
    pub was_moving: bool,
    /// Position.
    pub position: Position,
    /// Movement since the last tick, counts.
    pub step_ct: i32,
    /// Set-point − position, counts.
    pub error_ct: i32,
}

/// The memory of the checks.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Monitor {
    last_step_ct: i32,
    tick: u8,
    /// Windows in a row with the same sum of currents, to the last bit.
    same_sums: u16,
    opposed: u8,
    sum_a: f32,
    last_sum_a: f32,
    sum_a2: f32,
    heat_a2: f32,
    /// Low 32 bits of the position where the last window ended.
    window_at: i32,
    window_step_ct: i32,
    window_error_ct: u32,
    silent_windows: u32,
}

impl Monitor {
    /// The loops are closed at `position`, at rest: windows begin anew. The motor stays as warm as it was.
    pub fn restart(&mut self, position: Position) {
        *self = Monitor {
            heat_a2: self.heat_a2,
            last_step_ct: self.last_step_ct,
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

    /// The first thing that is wrong in a tick with the loops closed.
    #[inline]
    pub fn check(&mut self, k: &Coefficients, seen: &Seen) -> Option<Fault> {
        let slow = self.slow(k, seen);
        let change_ct = seen.step_ct.wrapping_sub(self.last_step_ct);
        self.last_step_ct = seen.step_ct;
        let wrong = seen.inputs.signals << 16 != 0
            || seen.inputs.bus_code.wrapping_sub(k.bus_min_code) > k.bus_max_code.wrapping_sub(k.bus_min_code)
            || seen.inputs.last_tick_cycles > k.tick_limit_cycles
            || seen.same_readings >= FROZEN_AFTER
            || beyond(seen.error_ct, k.following_error_max_ct)
            || beyond(seen.step_ct, k.overspeed_ct)
            || beyond(change_ct, k.jump_ct)
            || !matches!(seen.update, Update::Measured);
        if wrong { diagnose(k, seen, change_ct).or(slow) } else { slow }
    }

    /// The first thing that is wrong in a tick with the bridge off.
    #[inline]
    pub fn check_off(&mut self, k: &Coefficients, inputs: &Inputs, step_ct: i32) -> Option<Fault> {
        self.last_step_ct = step_ct;
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

    /// Sums of every tick, and the check whose turn it is.
    #[inline]
    fn slow(&mut self, k: &Coefficients, seen: &Seen) -> Option<Fault> {
        let iq_a = seen.inputs.iq_a;
        self.sum_a += iq_a;
        self.sum_a2 += iq_a * iq_a;
        self.tick = (self.tick + 1) % WINDOW_TICKS;
        let (wrong, fault) = match self.tick {
            0 => {
                let opposed = self.end_window(k, seen.position);
                if self.same_sums >= k.frozen_ticks {
                    (true, Fault::CurrentFrozen)
                } else {
                    (opposed, Fault::WrongCommutation)
                }
            }
            1 => {
                let mean_a2 = core::mem::take(&mut self.sum_a2) * (1.0 / WINDOW_TICKS as f32);
                self.heat_a2 += k.overload_share * (mean_a2 - self.heat_a2);
                if seen.inputs.temperature_code > k.temperature_max_code {
                    (true, Fault::OverTemperature)
                } else {
                    (self.heat_a2 > k.overload_a2, Fault::MotorOverload)
                }
            }
            2 => {
                let error_ct = seen.error_ct.unsigned_abs();
                let grown = error_ct > self.window_error_ct.saturating_add(k.runaway_ct);
                self.window_error_ct = error_ct;
                (grown, Fault::Runaway)
            }
            _ => {
                self.silent_windows = self.silent_windows.saturating_add(1);
                if self.silent_windows > k.silent_windows {
                    (true, Fault::CommandTimeout)
                } else {
                    (seen.position < k.position_min || seen.position > k.position_max, Fault::PositionLimit)
                }
            }
        };
        wrong.then_some(fault)
    }

    /// End of a window: whether the stage has for some time moved and accelerated against a force that is no friction.
    #[inline]
    fn end_window(&mut self, k: &Coefficients, position: Position) -> bool {
        let at = position.0 as i32;
        let step_ct = at.wrapping_sub(self.window_at);
        let change_ct = step_ct.wrapping_sub(self.window_step_ct);
        let sum_a = self.sum_a + self.last_sum_a;
        self.window_at = at;
        self.window_step_ct = step_ct;
        self.same_sums = if self.sum_a == self.last_sum_a { self.same_sums.saturating_add(1) } else { 0 };
        self.last_sum_a = self.sum_a;
        self.sum_a = 0.0;
        let against_ct =
            if sum_a < 0.0 { change_ct.min(step_ct) } else { change_ct.max(step_ct).wrapping_neg() };
        let opposed = sum_a.abs() > k.opposed_a && against_ct > k.opposed_ct;
        self.opposed = if opposed { self.opposed + 1 } else { 0 };
        self.opposed >= OPPOSED_WINDOWS
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

/// Which of the checks of every tick it was; `None` if a limit was only come near to.
#[cold]
#[inline(never)]
fn diagnose(k: &Coefficients, seen: &Seen, change_ct: i32) -> Option<Fault> {
    let inputs = seen.inputs;
    let frozen_after = if seen.was_moving { FROZEN_AFTER } else { k.frozen_ticks };
    if let Some(fault) = signalled(inputs.signals) {
        Some(fault)
    } else if inputs.bus_code > k.bus_max_code {
        Some(Fault::BusOverVoltage)
    } else if inputs.bus_code < k.bus_min_code {
        Some(Fault::BusUnderVoltage)
    } else if let Update::Lost(cause) = seen.update {
        Some(match cause {
            Cause::Frame(FrameError::Missing) => Fault::EncoderLost,
            Cause::Frame(FrameError::Crc) => Fault::EncoderChecksum,
            Cause::ErrorBit => Fault::EncoderErrorBit,
        })
    } else if seen.same_readings >= frozen_after || (seen.same_readings > 0 && beyond(change_ct, k.jump_ct)) {
        // Nothing stops so suddenly, and on the same count.
        Some(Fault::EncoderFrozen)
    } else if beyond(change_ct, k.jump_ct) {
        Some(Fault::EncoderJump)
    } else if beyond(seen.step_ct, k.overspeed_ct) {
        Some(Fault::Overspeed)
    } else if beyond(seen.error_ct, k.following_error_max_ct) {
        Some(Fault::FollowingError)
    } else if inputs.last_tick_cycles > k.tick_limit_cycles {
        Some(Fault::TickOverrun)
    } else {
        None
    }
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
                None
            ]
        );
        assert_eq!(signalled(signals::VOLTAGE_LIMITED), None);
    }
}
