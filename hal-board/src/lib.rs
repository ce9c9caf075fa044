//! The board: NUCLEO-H743ZI2, a three-phase bridge and an encoder, BiSS-C or sine and cosine.
//!
//! Everything that touches a register is here, and all of the project's unsafe code. What the drive *does* is in
//! `servo-core`; this crate only moves codes in and compares out:
//!
//! - [`init`] brings up clocks, memories, pins and peripherals with the bridge off, and says how the last run ended.
//! - [`PowerStage::start`] hands the control object to the interrupts and starts the PWM timer, last of all.
//!
//! Pins, wiring and the registers each module owns are tabled in `README.md`.
//!
//! # Contexts
//! Three interrupts run at priority P0 and therefore never pre-empt one another: the timer update, the end of the
//! conversions and the end of the encoder frame ([`control`]). Everything else is at P2 or lower, and
//! critical sections mask P1 and below only (`critical.rs`): no library lock can delay the control loop.
#![no_std]

mod adc;
pub mod black_box;
pub mod capture;
mod clocks;
pub mod control;
mod critical;
mod encoder;
mod flash;
pub mod last_words;
mod link;
mod memory;
mod pins;
pub mod priorities;
mod pwm;
mod quadrature;
mod reset;
pub mod watchdog;

pub use control::{Control, Encoder, PowerStage, StartFault};
pub use flash::{FlashFault, ParameterFlash};
pub use link::{LinkReceiver, LinkSender};
pub use memory::{program, stack_free_bytes};
pub use reset::{ResetCause, restart};

/// Name of the board.
pub const NAME: &str = "NUCLEO-H743ZI2";

use servo_core::monitor::signals;

/// What [`init`] leaves to the application.
pub struct Board {
    /// Serial link: USART3, the virtual COM port of the on-board ST-LINK.
    ///
    /// An error means that the bit rate does not fit the clock, a defect of this crate.
    pub link: Result<(LinkSender, LinkReceiver), embassy_stm32::usart::ConfigError>,
    /// Bridge, current converters and encoder: configured, stopped, outputs off.
    pub power_stage: PowerStage,
    /// The two sectors that keep parameters.
    pub flash: ParameterFlash,
    /// Core clock, Hz.
    pub core_hz: u32,
    /// Serial number of the chip.
    pub serial: [u32; 3],
    /// Why the processor started.
    pub reset_cause: ResetCause,
    /// Message of the panic or fault that ended the previous run, if one did.
    pub last_words: Option<&'static str>,
}

/// Brings the board up with the bridge off. To be called once, first thing in `main`.
pub fn init() -> Board {
    let reset_cause = reset::take_cause();
    let last_words = last_words::take();
    memory::protect();
    let p = embassy_stm32::init(clocks::config());
    let core_hz = embassy_stm32::rcc::clocks(&p.RCC).sys.to_hertz().map_or(0, |hertz| hertz.0);
    clocks::enable_caches_and_cycle_counter();
    priorities::apply();

    // The timer first: its outputs must be defined before the pins are handed to it.
    pwm::configure();
    pins::bridge(
        [p.PE8.into(), p.PE9.into(), p.PE10.into(), p.PE11.into(), p.PE12.into(), p.PE13.into()],
        p.PE15.into(),
    );
    pins::encoder(p.PA5.into(), p.PA6.into());
    pins::quadrature([p.PD12.into(), p.PD13.into()]);
    pins::analog([p.PC0.into(), p.PA3.into(), p.PB1.into(), p.PA4.into(), p.PF10.into(), p.PF4.into()]);
    encoder::configure();
    quadrature::configure();
    adc::configure();

    let link = link::open(p.USART3, p.PD9, p.PD8);
    let serial = [0, 1, 2].map(|word| embassy_stm32::pac::UID.uid(word).read());
    let ended_by = match (last_words, reset_cause) {
        (Some(_), _) => signals::PANICKED,
        (None, ResetCause::Watchdog) => signals::WATCHDOG_RESET,
        (None, _) => 0,
    };
    let (power_stage, flash) = (PowerStage::new(ended_by), ParameterFlash::new());
    Board { link, power_stage, flash, core_hz, serial, reset_cause, last_words }
}
