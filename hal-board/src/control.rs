//! The control interrupts and what they call.
//!
//! ```text
//! t0          timer update: start both phase converters, on every fifth period also the encoder frame and ADC3
//! t0 + 1.2 µs conversions end: current loop, compares written (on a servo period: codes kept for the tick)
//! t0 + 6.6 µs encoder frame ends: servo tick, then the current loop with its new set-point, compares written
//! t0 + 25 µs  underflow: compares become active; next update
//! ```
//! With sine and cosine in place of frames, on a servo period:
//! ```text
//! t0 + 1.2 µs phase conversions end: start those of sine and cosine, read the counter of their edges
//! t0 + 2.4 µs conversions end: servo tick, then the current loop, compares written
//! ```
//! Nothing waits for anything. A frame that has not ended by the next update is given up and the tick runs a period
//! late with `u64::MAX` as its frame; conversions that have not ended are reported as full-scale phase codes, which any over-current
//! limit answers by switching off.

use core::cell::UnsafeCell;
use core::mem::MaybeUninit;

use embassy_stm32::interrupt;
use servo_core::axis::ServoSample;
use servo_core::current::{Bridge, PhaseCodes};
use servo_core::monitor::signals;
use servo_core::{PERIODS_PER_TICK, PWM_TOP};

use crate::adc::{self, SlowInputs};
use crate::clocks::cycles;
use crate::encoder::{self, MISSING_FRAME};
use crate::priorities::{self, PriorityFault};
use crate::pwm;
use crate::quadrature;
use crate::watchdog::Watchdog;

/// What a converter reports that did not deliver.
const MISSING_PHASES: PhaseCodes = PhaseCodes { a: u16::MAX, b: u16::MAX };

/// The drive as the interrupts see it. Both functions run at the highest priority and must end well within 25 µs.
pub trait Control: Send {
    /// A PWM period that is not a servo period.
    fn on_period(&mut self, phases: PhaseCodes) -> Bridge;
    /// Every fifth period, when the encoder has been read.
    fn on_servo(&mut self, sample: &ServoSample) -> Bridge;
    /// What the next servo period is to read.
    fn encoder(&self) -> Encoder;
}

/// Kinds of encoder that the board has inputs for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Encoder {
    /// Frames on SPI1.
    BissC,
    /// Sine and cosine on ADC1 and ADC2, edges on TIM4.
    SinCos,
}

/// Why the drive was not started.
#[derive(Clone, Copy, Debug, PartialEq, Eq, defmt::Format)]
pub enum StartFault {
    /// Some other interrupt could delay the control loop, or one of its own has the wrong priority.
    Priority(PriorityFault),
    /// The timer's update does not come at the underflow.
    UpdateNotAtUnderflow,
}

/// Permission to start the control loop; there is one.
pub struct PowerStage {
    /// How the last run ended, for the first servo period: bits of [`signals`].
    ended_by: u32,
}

impl PowerStage {
    pub(crate) fn new(ended_by: u32) -> Self {
        PowerStage { ended_by }
    }

    /// Moves `control` into the interrupts and starts the PWM timer, bridge off until `control` enables it.
    ///
    /// # Errors
    /// [`StartFault`], with the bridge off and the interrupts still masked, if an assumption of the loop does not hold.
    pub fn start(self, control: &'static mut dyn Control) -> Result<(), StartFault> {
        priorities::check().map_err(StartFault::Priority)?;
        // SAFETY: the interrupts that use the cell are masked until the end of this function, and since `self` is
        // consumed it runs once.
        unsafe { *LOOP.0.get() = MaybeUninit::new(Loop::new(control, self.ended_by)) };
        if !pwm::start() {
            return Err(StartFault::UpdateNotAtUnderflow);
        }
        Watchdog::start();
        priorities::unmask_control();
        Ok(())
    }
}

/// State of the control loop, owned by the three P0 interrupts.
struct Loop {
    control: &'static mut dyn Control,
    /// PWM periods since the last servo period, `0..PERIODS_PER_TICK`.
    period: u32,
    converting: bool,
    encoder: Encoder,
    reading: Reading,
    bridge_enabled: bool,
    slow: SlowInputs,
    sample: ServoSample,
    /// Cycle count at the underflow that began the servo period.
    servo_began_cycles: u32,
    watchdog: Watchdog,
    /// For the next servo period, once.
    ended_by: u32,
}

/// How far the reading of the encoder in the current servo period is.
#[derive(PartialEq, Eq)]
enum Reading {
    /// Done, or none in this period.
    None,
    /// A frame is on the wire.
    Frame,
    /// A frame was given up.
    LateFrame,
    /// Sine and cosine are to be converted once the phases have been.
    BehindPhases,
    /// Sine and cosine are being converted.
    Signals {
        /// Edges when that began.
        edges: u16,
    },
}

impl Loop {
    fn new(control: &'static mut dyn Control, ended_by: u32) -> Self {
        Loop {
            encoder: control.encoder(),
            control,
            period: PERIODS_PER_TICK - 1,
            converting: false,
            reading: Reading::None,
            bridge_enabled: false,
            slow: SlowInputs::new(),
            sample: ServoSample {
                phases: MISSING_PHASES,
                frame: MISSING_FRAME,
                bus_code: 0,
                temperature_code: 0,
                signals: 0,
                last_tick_cycles: 0,
            },
            servo_began_cycles: 0,
            watchdog: Watchdog::new(),
            ended_by,
        }
    }

    /// Start of a PWM period.
    #[inline(always)]
    fn on_update(&mut self) {
        pwm::acknowledge_update();
        adc::start_phases();
        if self.converting {
            let bridge = self.control.on_period(MISSING_PHASES);
            self.apply(bridge);
        }
        self.converting = true;
        if self.reading == Reading::Frame {
            encoder::abort_frame();
            self.reading = Reading::LateFrame;
        }
        self.period += 1;
        if self.period == PERIODS_PER_TICK {
            self.period = 0;
            self.reading = match self.encoder {
                Encoder::BissC => {
                    encoder::start_frame();
                    Reading::Frame
                }
                Encoder::SinCos => Reading::BehindPhases,
            };
            self.servo_began_cycles = cycles().wrapping_sub(pwm::cycles_since_update());
            (self.sample.bus_code, self.sample.temperature_code) = self.slow.exchange();
        }
    }

    /// ADC1 and ADC2 have converted: phase currents, or sine and cosine.
    #[inline(always)]
    fn on_converted(&mut self) {
        self.converting = false;
        match self.reading {
            Reading::None => {
                let bridge = self.control.on_period(adc::read_phases());
                self.apply(bridge);
            }
            Reading::Frame => self.sample.phases = adc::read_phases(),
            Reading::LateFrame => {
                self.sample.phases = adc::read_phases();
                self.servo(MISSING_FRAME);
            }
            Reading::BehindPhases => {
                self.sample.phases = adc::read_phases();
                adc::start_signals();
                self.converting = true;
                self.reading = Reading::Signals { edges: quadrature::edges() };
            }
            Reading::Signals { edges } => self.servo(adc::read_signals(edges).to_bits()),
        }
    }

    /// Encoder frame received.
    #[inline(always)]
    fn on_frame(&mut self) {
        let frame = encoder::read_frame();
        // An interrupt still pending from a frame that was given up finds nothing to do.
        if self.reading == Reading::Frame {
            self.servo(frame);
        }
    }

    #[inline(always)]
    fn servo(&mut self, frame: u64) {
        self.reading = Reading::None;
        self.sample.frame = frame;
        let tripped = if pwm::take_break() { signals::BRIDGE_FAULT } else { 0 };
        let told = self.watchdog.tick() | core::mem::take(&mut self.ended_by);
        self.sample.signals = tripped | told;
        let bridge = self.control.on_servo(&self.sample);
        self.apply(bridge);
        self.sample.last_tick_cycles = cycles().wrapping_sub(self.servo_began_cycles);
        self.encoder = self.control.encoder();
    }

    /// Off takes effect at once, everything else at the next underflow. While off, the compares rest at one half.
    #[inline(always)]
    fn apply(&mut self, bridge: Bridge) {
        match (self.bridge_enabled, bridge.enabled) {
            (true, true) => pwm::write_compares(bridge.compare),
            (false, true) => {
                pwm::write_compares(bridge.compare);
                pwm::bridge_on();
            }
            (true, false) => {
                pwm::bridge_off();
                pwm::write_compares([PWM_TOP / 2; 3]);
            }
            (false, false) => {}
        }
        self.bridge_enabled = bridge.enabled;
    }
}

/// Written once by [`PowerStage::start`], then used by the three interrupts below and by nothing else.
struct LoopCell(UnsafeCell<MaybeUninit<Loop>>);

// SAFETY: see `LoopCell::get`.
unsafe impl Sync for LoopCell {}

static LOOP: LoopCell = LoopCell(UnsafeCell::new(MaybeUninit::uninit()));

impl LoopCell {
    /// # Safety
    /// Only from the P0 interrupts. They are unmasked after the cell is written, and interrupts of one priority do not
    /// pre-empt each other ([`priorities::check`] has read the priorities back), so there is one reference at a time.
    #[inline(always)]
    #[allow(clippy::mut_from_ref)]
    unsafe fn get(&self) -> &mut Loop {
        // SAFETY: as above.
        unsafe { (*self.0.get()).assume_init_mut() }
    }
}

#[interrupt]
fn TIM1_UP() {
    // SAFETY: a P0 interrupt.
    unsafe { LOOP.get() }.on_update();
}

#[interrupt]
fn ADC() {
    // SAFETY: a P0 interrupt.
    unsafe { LOOP.get() }.on_converted();
}

#[interrupt]
fn SPI1() {
    // SAFETY: a P0 interrupt.
    unsafe { LOOP.get() }.on_frame();
}
