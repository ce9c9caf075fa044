//! The stage in lock-step with the emulated processor.
//!
//! The plant is advanced lazily, at the instants at which the firmware and the stage exchange anything:
//!
//! | Event | What crosses |
//! |---|---|
//! | `ADSTART` of ADC1 or ADC2 | both phase currents, sampled here; or sine and cosine, and the edges since the last time |
//! | `ADSTART` of ADC3 | bus voltage and temperature |
//! | a word for SPI1 after a rest | its clock starts and an encoder with frames latches its position |
//! | TIM1 update event | the preloaded compares become the bridge's duty |
//! | a write to TIM1's enables, or its break | bridge on or off, at once |
//!
//! Between two events the bridge's average output is constant, so nothing is lost by not stepping in between.

use rigless::emulator::{Access, AccessKind, Stop, StopReason};
use rigless::time::VirtualNanos;
use servo_sim::encoder::sincos::Reading;
use servo_sim::stage::encoder::Kind;
use servo_sim::{BridgeState, Plant, adc};

use crate::board::{Analog, Nucleo};
use crate::encoder::IDLE_LINE;
use crate::sensor_fault::{AdcFault, CounterFault};
use crate::watchdog::Watchdog;

const TIM1: u64 = 0x4001_0000;
const TIM1_SR: u64 = TIM1 + 0x10;
const TIM1_CCR1: u64 = TIM1 + 0x34;
const TIM1_CCR3: u64 = TIM1 + 0x3C;
const TIM1_END: u64 = TIM1 + 0x400;
const SPI1_TXDR: u64 = 0x4001_3020;
const ADC1_CR: u64 = 0x4002_2008;
const ADC2_CR: u64 = 0x4002_2108;
const ADC3_CR: u64 = 0x5802_6008;
const ADC_ADSTART: u64 = 1 << 2;
const IWDG_KR: u64 = 0x5800_4800;

/// ADC1 and ADC2 are started by two instructions; starts closer than this belong to one pair and share one sample.
const SAME_SAMPLE_NS: u64 = 1_000;

/// The truth at one servo tick, at the instant the encoder latches.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TruthSample {
    /// Virtual time since reset.
    pub time_ns: u64,
    /// Position, 0 = mid-travel.
    pub position_m: f64,
    /// Velocity.
    pub velocity_m_per_s: f64,
    /// Friction force on the carriage.
    pub friction_n: f64,
    /// Motor force on the carriage.
    pub force_n: f64,
    /// The three phase currents.
    pub currents_a: [f64; 3],
    /// Fraction of the PWM period for which each high side is commanded on.
    pub duty: [f64; 3],
    /// Whether the bridge is driven.
    pub enabled: bool,
}

/// Times from a PWM update event to the compare values written in answer, in virtual nanoseconds.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Latency {
    /// Periods measured.
    pub count: u64,
    /// Longest.
    pub max_ns: u64,
    /// Sum, for the mean.
    pub total_ns: u64,
}

impl Latency {
    fn record(&mut self, ns: u64) {
        self.count += 1;
        self.max_ns = self.max_ns.max(ns);
        self.total_ns += ns;
    }

    /// Mean in nanoseconds, 0 before the first measurement.
    #[must_use]
    pub fn mean_ns(&self) -> f64 {
        if self.count == 0 { 0.0 } else { self.total_ns as f64 / self.count as f64 }
    }
}

/// What the coupling has counted since reset.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counts {
    /// Peripheral accesses the core made.
    pub accesses: u64,
    /// Stops of the emulator for its models.
    pub stops: u64,
    /// Advances of the plant.
    pub plant_steps: u64,
    /// PWM periods that began.
    pub updates: u64,
    /// Times the watchdog was fed.
    pub feeds: u64,
    /// Update to compares, in periods that also ran the servo tick.
    pub servo_tick: Latency,
    /// Update to compares, in the other periods.
    pub current_loop: Latency,
}

/// The plant, what the bridge does to it, and what has been observed.
#[derive(Clone, Debug)]
pub struct Coupling {
    plant: Plant,
    bridge: BridgeState,
    now_ns: u64,
    update_flag: bool,
    update_ns: u64,
    /// The update event that began the servo tick under way.
    servo_since_ns: Option<u64>,
    watchdog: Watchdog,
    phases_ns: Option<u64>,
    signals_ns: Option<u64>,
    codes: [u16; Analog::ALL.len()],
    faults: [Option<AdcFault>; Analog::ALL.len()],
    /// The quarter period that the comparators show; `None` before the first.
    quarter: Option<i64>,
    /// Edges seen that there were not.
    invented: i64,
    counter_stopped: bool,
    trace: Option<Vec<TruthSample>>,
    counts: Counts,
}

impl Coupling {
    /// `plant` at time 0 with the bridge off.
    #[must_use]
    pub fn new(plant: Plant) -> Self {
        Self {
            plant,
            bridge: BridgeState { duty: [0.0; 3], enabled: false, dead_time_s: 0.0 },
            now_ns: 0,
            update_flag: false,
            update_ns: 0,
            servo_since_ns: None,
            watchdog: Watchdog::default(),
            phases_ns: None,
            signals_ns: None,
            codes: [0; Analog::ALL.len()],
            faults: [None; Analog::ALL.len()],
            quarter: None,
            invented: 0,
            counter_stopped: false,
            trace: None,
            counts: Counts::default(),
        }
    }

    /// The plant as it will be at `now_ns`, if nothing happens until then. Looking changes nothing: the run keeps its own steps.
    #[must_use]
    pub fn plant_at(&self, now_ns: u64) -> Plant {
        let mut plant = self.plant.clone();
        plant.advance(now_ns.saturating_sub(self.now_ns), &self.bridge);
        plant
    }

    /// The plant, advanced to `now_ns`, to change it.
    pub fn plant_mut(&mut self, now_ns: u64) -> &mut Plant {
        self.advance_to(now_ns);
        &mut self.plant
    }

    /// What the bridge does now.
    #[must_use]
    pub fn bridge(&self) -> &BridgeState {
        &self.bridge
    }

    /// What has been counted.
    #[must_use]
    pub fn counts(&self) -> &Counts {
        &self.counts
    }

    /// Sets or, with `None`, clears the fault of `signal`, from its next conversion on.
    pub fn set_adc_fault(&mut self, signal: Analog, fault: Option<AdcFault>) {
        self.faults[signal.index()] = fault;
    }

    /// Breaks the comparators of sine and cosine from the next sample on or, with `None`, lets them count again.
    pub fn set_counter_fault(&mut self, fault: Option<CounterFault>) {
        self.counter_stopped = fault == Some(CounterFault::Stopped);
        if let Some(CounterFault::Invented { edges }) = fault {
            self.invented += edges;
        }
    }

    /// Starts (or restarts, empty) recording one [`TruthSample`] per servo tick.
    pub fn start_trace(&mut self) {
        self.trace = Some(Vec::new());
    }

    /// Ends the recording and returns it; empty where none was started.
    pub fn take_trace(&mut self) -> Vec<TruthSample> {
        self.trace.take().unwrap_or_default()
    }

    /// An access of the core, after its peripheral has served it.
    pub fn on_access(&mut self, board: &mut Nucleo, access: &Access, value: u64) {
        self.counts.accesses += 1;
        if access.kind != AccessKind::Write {
            return;
        }
        let now_ns = access.virtual_time.0;
        match access.address {
            ADC1_CR | ADC2_CR if value & ADC_ADSTART != 0 => {
                if board.converts(Analog::Sine) {
                    self.sample_signals(board, access.virtual_time);
                } else {
                    self.sample_phases(board, now_ns);
                }
            }
            ADC3_CR if value & ADC_ADSTART != 0 => self.sample_slow_signals(board, now_ns),
            SPI1_TXDR if board.encoder().at_rest(now_ns) => self.latch_encoder(board, now_ns),
            IWDG_KR => self.counts.feeds += u64::from(self.watchdog.on_key(value, board.watchdog_reload(), now_ns)),
            TIM1_CCR3 => {
                self.measure_latency(now_ns);
                self.note_update(board, now_ns);
            }
            TIM1_SR | TIM1_CCR1..TIM1_CCR3 => self.note_update(board, now_ns),
            TIM1..TIM1_END => {
                self.note_update(board, now_ns);
                self.switch_bridge(board, now_ns);
            }
            _ => {}
        }
    }

    /// A stop of the emulator: an event of some peripheral, perhaps TIM1's update, or a reset that the firmware asked for.
    pub fn on_stop(&mut self, board: &mut Nucleo, stop: Stop) {
        self.counts.stops += 1;
        if stop.reason == StopReason::Reset {
            self.after_reset(board, stop.at);
        }
        self.note_update(board, stop.at.0);
        // A break turns the outputs off with no instruction and no interrupt.
        if self.bridge.enabled && !board.main_output() {
            self.switch_bridge(board, stop.at.0);
        }
    }

    /// Lets the watchdog reset the microcontroller if its counter has run out. Events of TIM1 stop the emulator often enough.
    pub fn watch(&mut self, board: &mut Nucleo, at: VirtualNanos) {
        if self.watchdog.has_expired(at.0) {
            self.watchdog.reset();
            board.reset_by_watchdog(at);
        }
    }

    /// The microcontroller has been reset: its outputs are off, the world around it is as it was.
    pub fn after_reset(&mut self, board: &mut Nucleo, at: VirtualNanos) {
        board.after_reset(at);
        self.watchdog.reset();
        self.quarter = None;
        self.update_flag = false;
        self.servo_since_ns = None;
        self.switch_bridge(board, at.0);
    }

    /// Advances the plant to `now_ns`; a time in the past does nothing.
    fn advance_to(&mut self, now_ns: u64) {
        let dt_ns = now_ns.saturating_sub(self.now_ns);
        if dt_ns > 0 {
            self.counts.plant_steps += 1;
            self.plant.advance(dt_ns, &self.bridge);
            self.now_ns = now_ns;
        }
    }

    /// Re-reads everything about the bridge but the duty, whose compares only an update event loads. Called where the main output
    /// enable may have changed: a write to TIM1, a break, a reset.
    pub fn switch_bridge(&mut self, board: &mut Nucleo, now_ns: u64) {
        self.advance_to(now_ns);
        let timer_hz = board.timer_hz();
        let duty = self.bridge.duty;
        self.bridge = BridgeState { duty, ..board.pwm().bridge(timer_hz) };
    }

    /// Sees an update event by its flag rising. Where the firmware is late and the flag still stands from the update before,
    /// nothing is missed: the interrupt that clears the flag is also what writes new compares.
    fn note_update(&mut self, board: &mut Nucleo, now_ns: u64) {
        let flag = board.update_flag();
        if flag && !self.update_flag {
            self.counts.updates += 1;
            self.update_ns = now_ns;
            self.advance_to(now_ns);
            let pwm = board.pwm();
            self.bridge.duty = pwm.duty();
            self.bridge.enabled = pwm.outputs_on();
        }
        self.update_flag = flag;
    }

    fn measure_latency(&mut self, now_ns: u64) {
        match self.servo_since_ns.take() {
            Some(since_ns) => self.counts.servo_tick.record(now_ns - since_ns),
            None if self.counts.updates > 0 => self.counts.current_loop.record(now_ns - self.update_ns),
            None => {}
        }
    }

    fn sample_phases(&mut self, board: &mut Nucleo, now_ns: u64) {
        if self.phases_ns.is_some_and(|at_ns| now_ns < at_ns + SAME_SAMPLE_NS) {
            return;
        }
        self.phases_ns = Some(now_ns);
        self.advance_to(now_ns);
        let [a, b] = self.plant.phase_codes();
        self.present(board, Analog::PhaseA, a);
        self.present(board, Analog::PhaseB, b);
    }

    /// Sine and cosine; the comparators have gone on to where the stage is now. Without such an encoder nothing drives the inputs.
    fn sample_signals(&mut self, board: &mut Nucleo, at: VirtualNanos) {
        if self.signals_ns.is_some_and(|at_ns| at.0 < at_ns + SAME_SAMPLE_NS) {
            return;
        }
        self.signals_ns = Some(at.0);
        self.advance_to(at.0);
        let reading = self.plant.encoder_signals().unwrap_or(Reading { pins: [0.0; 2], edges: 0 });
        let [sin, cos] = reading.pins.map(adc::code);
        self.present(board, Analog::Sine, sin);
        self.present(board, Analog::Cosine, cos);
        if !self.counter_stopped || self.quarter.is_none() {
            let quarter = reading.edges + self.invented;
            board.turn_quadrature(self.quarter.unwrap_or(quarter), quarter, at);
            self.quarter = Some(quarter);
        }
        self.note_position(at.0);
    }

    fn sample_slow_signals(&mut self, board: &mut Nucleo, now_ns: u64) {
        self.advance_to(now_ns);
        let bus = adc::code(self.plant.bus_adc());
        let temperature = adc::code(self.plant.temperature_adc());
        self.present(board, Analog::Bus, bus);
        self.present(board, Analog::Temperature, temperature);
    }

    fn present(&mut self, board: &mut Nucleo, signal: Analog, code: u16) {
        let held = &mut self.codes[signal.index()];
        *held = match self.faults[signal.index()] {
            None => code,
            Some(fault) => fault.apply(code, *held),
        };
        board.set_analog(signal, *held);
    }

    fn latch_encoder(&mut self, board: &mut Nucleo, now_ns: u64) {
        self.advance_to(now_ns);
        let frame = match self.plant.stage().encoder.kind {
            Kind::BissC { .. } => self.plant.encoder_frame(),
            Kind::SinCos(_) => IDLE_LINE,
        };
        board.encoder().latch(frame, now_ns);
        self.note_position(now_ns);
    }

    /// The position of a servo tick has been taken.
    fn note_position(&mut self, now_ns: u64) {
        if self.counts.updates > 0 {
            self.servo_since_ns = Some(self.update_ns);
        }
        if let Some(trace) = &mut self.trace {
            trace.push(TruthSample {
                time_ns: now_ns,
                position_m: self.plant.position_m(),
                velocity_m_per_s: self.plant.velocity_m_per_s(),
                friction_n: self.plant.friction_n(),
                force_n: self.plant.force_n(),
                currents_a: self.plant.currents_a(),
                duty: self.bridge.duty,
                enabled: self.bridge.enabled,
            });
        }
    }
}
