//! One axis: servo tick and current loop in the order in which the hardware needs them.
//!
//! Firmware, host harness and QEMU image call these two functions and nothing else per period.

use crate::PERIODS_PER_TICK;
use crate::capture::{self, Capture};
use crate::config::Config;
use crate::current::{Bridge, CurrentLoop, Demand, PhaseCodes};
use crate::drive::{Command, Drive, Inputs, Outcome};
use crate::record::TickRecord;

/// Raw values of a servo period.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ServoSample {
    /// Phase currents of this period.
    pub phases: PhaseCodes,
    /// What the encoder told. BiSS-C: the 64 bits clocked in, first bit in bit 63; `u64::MAX` if there was no frame. Sine and cosine:
    /// [`crate::encoder::sincos::Sample::to_bits`].
    pub frame: u64,
    /// ADC code of the bus voltage.
    pub bus_code: u16,
    /// ADC code of the bridge temperature.
    pub temperature_code: u16,
    /// What the board tells beside: bits of [`crate::monitor::signals`], without those of the current loop.
    pub signals: u32,
    /// CPU cycles from PWM update to new compare values in the previous servo period.
    pub last_tick_cycles: u32,
}

impl Inputs {
    /// What the drive is told of a servo period.
    #[inline]
    pub fn new(sample: &ServoSample, current: &CurrentLoop) -> Inputs {
        Inputs {
            frame: sample.frame,
            iq_a: current.iq_a(),
            bus_code: sample.bus_code,
            temperature_code: sample.temperature_code,
            signals: sample.signals | current.signals(),
            last_tick_cycles: sample.last_tick_cycles,
        }
    }
}

/// Results of a servo period.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ServoOutput {
    /// For the bridge, from the next update on.
    pub bridge: Bridge,
    /// For the record queue.
    pub record: TickRecord,
    /// What the drive was told, for the black box.
    pub inputs: Inputs,
    /// The answer, if there was a command.
    pub outcome: Option<Outcome>,
    /// For the capture buffer.
    pub sample: Option<capture::Sample>,
}

/// Drive and current loop of one axis.
#[derive(Clone, Debug)]
pub struct Axis {
    drive: Drive,
    current: CurrentLoop,
    demand: Demand,
    capture: Capture,
    periods: u32,
}

impl Axis {
    /// An axis with the bridge off.
    pub fn new(config: Config) -> Self {
        Axis {
            drive: Drive::new(config),
            current: CurrentLoop::default(),
            demand: Demand::OFF,
            capture: Capture::default(),
            periods: 0,
        }
    }

    /// The drive, to look at.
    pub fn drive(&self) -> &Drive {
        &self.drive
    }

    /// Where the capture stands.
    pub fn capture(&self) -> &Capture {
        &self.capture
    }

    /// Orders a capture (see [`capture::Order::check`] for what fits).
    pub fn arm_capture(&mut self, order: capture::Order) {
        self.capture.arm(order);
    }

    /// A PWM period without servo tick: the current loop alone.
    #[inline]
    pub fn on_period(&mut self, phases: PhaseCodes) -> Bridge {
        self.periods = if self.periods < PERIODS_PER_TICK { self.periods + 1 } else { self.periods };
        let k = &self.drive.config().current;
        if self.periods == 1 {
            self.current.watch(k, self.demand.enabled, phases);
        }
        self.current.step(k, &self.demand, phases, self.periods)
    }

    /// A servo period: the tick first, then the current loop with the new set-point, so that the voltage that follows from this
    /// period's position is on the motor one PWM period after it was sampled.
    #[inline]
    pub fn on_servo(&mut self, sample: &ServoSample, command: Option<&Command>) -> ServoOutput {
        if command.is_some_and(|command| self.drive.is_reset(command)) {
            self.current.clear_trip();
        }
        let inputs = Inputs::new(sample, &self.current);
        let output = self.drive.tick(&inputs, command);
        self.demand = output.demand;
        self.periods = 0;
        let bridge = self.current.step(&self.drive.config().current, &self.demand, sample.phases, 0);
        let sample = self.capture.step(&output.record);
        ServoOutput { bridge, record: output.record, inputs, outcome: output.outcome, sample }
    }
}
