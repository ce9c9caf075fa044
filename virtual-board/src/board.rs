//! The NUCLEO-H743ZI2 with the power stage on its headers: which pin of the microcontroller sees what.
//!
//! Only wiring lives here. What the pins carry comes from the plant, through [`crate::coupling`].

use std::num::{NonZeroU32, NonZeroU64};

use rigless::cpu::armv7m::windows;
use rigless::device::Level;
use rigless::machine::{Board, Target, armv7m};
use rigless::mcu::{Mcu, Operate};
use rigless::snapshot::store;
use rigless::soc;
use rigless::soc::stm32h743::Stm32h743;
use rigless::soc::stm32h743::generated::adc3::Register as Adc;
use rigless::soc::stm32h743::generated::gpioa::Register as Gpio;
use rigless::soc::stm32h743::generated::iwdg::Register as Iwdg;
use rigless::soc::stm32h743::generated::tim1::Register as Tim1;
use rigless::soc::stm32h743::peripherals::adc;
use rigless::soc::stm32h743::peripherals::rcc::TimerBus;
use rigless::soc::stm32h743::peripherals::tim::{self, ADVANCED_TIMERS, BreakInput, BreakSource, TIMERS, Tim};
use rigless::time::VirtualNanos;

use crate::encoder::BissEncoder;
use crate::pwm::PwmRegisters;
use crate::serial::SerialLine;
use crate::watchdog::Reload;

/// Core clock that the firmware sets, DS12110 rev 11 table 2 at voltage scale 1.
const CORE_HZ: NonZeroU64 = NonZeroU64::new(400_000_000).expect("not zero");
const SUPPLY_MV: u32 = 3300;
const SPI_ENCODER: usize = 0;
const USART_LINK: usize = 2;
/// TIM1 is the first advanced timer.
const TIMER_BRIDGE: usize = 0;
/// TIM4 is the third general-purpose timer.
const TIMER_QUADRATURE: usize = 2;
/// What the function registers of port D must say for PD12 and PD13 to be inputs of TIM4.
const QUADRATURE_MODE: u64 = 0b1010 << 24;
const QUADRATURE_FUNCTION: u64 = 0x22 << 16;

/// The converters measure in codes, not volts: with `VREF+` set to 65535 units, an input of n units converts to code n at 16
/// bits. The emulator takes whole millivolts, which would leave 11.7 of the 16 bits; only the ratio matters to it.
const REFERENCE_UNITS: u32 = 65_535;

/// An analogue signal of the power stage.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Analog {
    /// Current of phase A, ADC1.
    PhaseA,
    /// Current of phase B, ADC2.
    PhaseB,
    /// Bus voltage behind its divider, ADC3.
    Bus,
    /// Temperature of the power stage, ADC3.
    Temperature,
    /// Sine of the encoder, ADC1.
    Sine,
    /// Cosine of the encoder, ADC2.
    Cosine,
}

impl Analog {
    /// All, in the order of [`Analog::index`].
    pub const ALL: [Self; 6] = [Self::PhaseA, Self::PhaseB, Self::Bus, Self::Temperature, Self::Sine, Self::Cosine];

    /// Position in [`Analog::ALL`].
    #[must_use]
    pub const fn index(self) -> usize {
        self as usize
    }

    /// Converter (0 for ADC1) and channel, as the pin table in `hal-board` has them.
    const fn pin(self) -> (usize, u8) {
        match self {
            Self::PhaseA => (0, 10),
            Self::PhaseB => (1, 15),
            Self::Bus => (2, 6),
            Self::Temperature => (2, 9),
            Self::Sine => (0, 5),
            Self::Cosine => (1, 18),
        }
    }
}

/// The board: a whole microcontroller and how its core is made.
#[derive(Debug)]
pub struct Nucleo {
    mcu: Stm32h743,
    bridge_fault: bool,
    instructions_per_second: NonZeroU64,
}
store!(Nucleo { values: [bridge_fault], parts: [mcu], built: [instructions_per_second] });

impl Nucleo {
    /// A board out of reset whose core retires `instructions_per_second`.
    ///
    /// # Errors
    /// Where the emulator cannot assemble the part, which would be its own mistake.
    pub fn new(instructions_per_second: NonZeroU64) -> Result<Self, soc::Error> {
        let mut mcu = Stm32h743::new()?;
        // The firmware runs from the internal oscillator: no crystal is fitted.
        mcu.rcc.attach_crystals(0, 0);
        mcu.set_supply(SUPPLY_MV);
        mcu.set_analog_supply(SUPPLY_MV);
        mcu.spi[SPI_ENCODER].attach(BissEncoder::default());
        mcu.usart[USART_LINK].attach(SerialLine::default());
        for converter in &mut mcu.adc {
            converter.set_reference(REFERENCE_UNITS);
        }
        Ok(Self { mcu, bridge_fault: false, instructions_per_second })
    }

    /// Puts the 16-bit `code` on the pin of `signal`.
    pub fn set_analog(&mut self, signal: Analog, code: u16) {
        let (converter, channel) = signal.pin();
        if let Some(channel) = adc::Channel::new(channel) {
            self.mcu.adc[converter].set_input(channel, u32::from(code));
        }
    }

    /// Whether ADC1 is about to convert `signal`, rather than another one.
    pub fn converts(&self, signal: Analog) -> bool {
        let selected = self.mcu.bus().registers("ADC1").map_or(0, |registers| registers.get(Adc::Sqr1) >> 6 & 0x1f);
        signal.pin() == (0, selected as u8)
    }

    /// Turns the comparators of cosine and sine on PD12 and PD13 from one quarter of a period to another, edge by edge. Nothing
    /// happens while the pins belong to something else than TIM4.
    pub fn turn_quadrature(&mut self, from: i64, to: i64, at: VirtualNanos) {
        let wired = self.mcu.bus().registers("GPIOD").is_some_and(|port| {
            let (mode, function) = (port.get(Gpio::Moder), port.get(Gpio::Afrh));
            mode & 0b1111 << 24 == QUADRATURE_MODE && function & 0xff << 16 == QUADRATURE_FUNCTION
        });
        let Ok(slot) = self.mcu.bus().slot("TIM4") else { return };
        if !wired {
            return;
        }
        let spare = Tim::new(TIMERS[TIMER_QUADRATURE]);
        let mut timer = std::mem::replace(&mut self.mcu.tim[TIMER_QUADRATURE], spare);
        let mut quarter = from;
        loop {
            // Quarters 0 to 3: cosine high, low, low, high; sine high, high, low, low.
            let levels = [matches!(quarter.rem_euclid(4), 0 | 3), matches!(quarter.rem_euclid(4), 0 | 1)];
            for (channel, high) in [1, 2].map(tim::Channel::new).into_iter().flatten().zip(levels) {
                let (registers, mut context) = self.mcu.bus_mut().drive(at, slot);
                timer.drive_input(channel, Level::from(high), registers, &mut context);
            }
            if quarter == to {
                break;
            }
            quarter += (to - quarter).signum();
        }
        self.mcu.tim[TIMER_QUADRATURE] = timer;
    }

    /// The encoder on SPI1.
    ///
    /// # Panics
    /// Never: the encoder was attached in [`Nucleo::new`] and nothing replaces it.
    pub fn encoder(&mut self) -> &mut BissEncoder {
        self.mcu.spi[SPI_ENCODER].chip_mut(0).expect("attached in Nucleo::new")
    }

    /// The far end of USART3.
    ///
    /// # Panics
    /// Never: the line was attached in [`Nucleo::new`] and nothing replaces it.
    pub fn serial(&mut self) -> &mut SerialLine {
        self.mcu.usart[USART_LINK].chip_mut().expect("attached in Nucleo::new")
    }

    /// How many words in a million reach the firmware with a noise and with a framing error on USART3.
    pub fn set_serial_errors(&mut self, noise_per_million: u32, framing_per_million: u32, seed: u64) {
        let errors = self.mcu.usart[USART_LINK].errors_mut();
        errors.seed = seed;
        (errors.noise.name, errors.noise.per_million) = ("noise", noise_per_million);
        (errors.framing.name, errors.framing.per_million) = ("framing", framing_per_million);
    }

    /// Whether TIM1's update flag stands.
    pub fn update_flag(&mut self) -> bool {
        let (_, registers) = self.mcu.advanced_timer(TIMER_BRIDGE);
        registers.get(Tim1::Sr) & 1 != 0
    }

    /// Whether TIM1's main output enable stands; a break clears it.
    pub fn main_output(&mut self) -> bool {
        let (_, registers) = self.mcu.advanced_timer(TIMER_BRIDGE);
        registers.get(Tim1::Bdtr) & 1 << 15 != 0
    }

    /// TIM1's registers as they stand; at an update event the compare values read are the ones that become active.
    pub fn pwm(&mut self) -> PwmRegisters {
        let (_, registers) = self.mcu.advanced_timer(TIMER_BRIDGE);
        let get = |register| registers.get(register) as u32;
        PwmRegisters {
            cr1: get(Tim1::Cr1),
            ccmr1: get(Tim1::Ccmr1Output),
            ccmr2: get(Tim1::Ccmr2Output),
            ccer: get(Tim1::Ccer),
            arr: get(Tim1::Arr),
            ccr: [get(Tim1::Ccr1), get(Tim1::Ccr2), get(Tim1::Ccr3)],
            bdtr: get(Tim1::Bdtr),
        }
    }

    /// What the independent watchdog is set to.
    pub fn watchdog_reload(&self) -> Reload {
        let get = |register| self.mcu.bus().registers("IWDG").map_or(0, |registers| registers.get(register));
        Reload { prescaler: get(Iwdg::Pr), value: get(Iwdg::Rlr) }
    }

    /// The independent watchdog resets the microcontroller, when the run goes on from the stop at `at`.
    pub fn reset_by_watchdog(&mut self, at: VirtualNanos) {
        let Ok(slot) = self.mcu.bus().slot("IWDG") else { return };
        let (_, mut context) = self.mcu.bus_mut().drive(at, slot);
        context.request_reset();
    }

    /// Clock of TIM1 in hertz.
    pub fn timer_hz(&mut self) -> u64 {
        let (rcc, registers) = self.mcu.clocks();
        rcc.timer_clock(registers, TimerBus::Apb2)
    }

    /// Sets or clears the power stage's fault output, active low on TIM1's break pin, from `at` on.
    pub fn set_bridge_fault(&mut self, fault: bool, at: VirtualNanos) {
        self.bridge_fault = fault;
        self.drive_break_pin(at);
    }

    /// Puts back what a reset of the microcontroller forgets of its surroundings.
    pub fn after_reset(&mut self, at: VirtualNanos) {
        self.drive_break_pin(at);
    }

    fn drive_break_pin(&mut self, at: VirtualNanos) {
        let level = if self.bridge_fault { Level::Low } else { Level::High };
        let Ok(slot) = self.mcu.bus().slot("TIM1") else { return };
        // A model may not borrow the bus that owns its registers: take it out for the call.
        let spare = Tim::new(ADVANCED_TIMERS[TIMER_BRIDGE]);
        let mut timer = std::mem::replace(&mut self.mcu.advanced[TIMER_BRIDGE], spare);
        let (registers, mut context) = self.mcu.bus_mut().drive(at, slot);
        timer.drive_break(BreakInput::First, BreakSource::Pin, level, registers, &mut context);
        self.mcu.advanced[TIMER_BRIDGE] = timer;
    }

    fn core(&self) -> armv7m::Config {
        let lines = u32::from(Operate::cpu(&self.mcu).interrupt_lines);
        let core = armv7m::Core {
            variant: armv7m::Variant::M7,
            clock_hz: CORE_HZ,
            interrupt_lines: NonZeroU32::new(lines).unwrap_or(NonZeroU32::MIN),
            priority_bits: 4,
            refclk_divider: NonZeroU32::new(8).unwrap_or(NonZeroU32::MIN),
            instructions_per_second: self.instructions_per_second,
            boot: "flash",
        };
        let mut config = armv7m::Config::new(core, &windows(Mcu::bus(&self.mcu)));
        config.fpu = armv7m::Fpu::FpV5Dp;
        config.mpu_regions = armv7m::MpuRegions::Sixteen;
        // Cortex-M7 r1p1 (ES0392 rev 15 section 2.1), 16 KiB caches each (PM0253 rev 6 tables 77 and 81).
        config.cpuid = 0x411F_C271;
        config.caches =
            Some(armv7m::Caches { clidr: 0x0900_0003, ctr: 0x8303_C003, ccsidr: &[0xF00F_E019, 0xF01F_E009] });
        config.branch_prediction = armv7m::BranchPrediction::Always;
        config.implementation_registers = access_control_registers();
        config.vector_table = Some(0x0800_0000);
        config
    }
}

/// ITCMCR (64 KiB), DTCMCR (128 KiB), AHBPCR, CACR, AHBSCR and ABFSR with their writable bits, PM0253 rev 6 tables 104 to 109.
fn access_control_registers() -> Vec<armv7m::ImplementationRegister> {
    let register = |offset, reset, writable| armv7m::ImplementationRegister { offset, reset, writable };
    vec![
        register(0xF90, 7 << 3, 0b111),
        register(0xF94, 8 << 3, 0b111),
        register(0xF98, 0, 0b1),
        register(0xF9C, 0, 0b111),
        register(0xFA0, 1 << 11, 0x7FF),
        register(0xFA8, 0, 0),
    ]
}

impl Board for Nucleo {
    fn name(&self) -> &'static str {
        "nucleo-h743zi2"
    }

    fn target_names(&self) -> Vec<&'static str> {
        vec!["stm32h743"]
    }

    fn mcu(&mut self, target: usize) -> Option<&mut dyn Mcu> {
        (target == 0).then_some(&mut self.mcu)
    }

    fn targets(&mut self) -> Vec<Target<'_>> {
        let core = self.core().spec();
        vec![Target::new("stm32h743", &mut self.mcu, core)]
    }
}
