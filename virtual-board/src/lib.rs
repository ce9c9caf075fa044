//! The virtual board: the firmware's ELF on an emulated STM32H743, wired to the simulated stage, in lock-step.
//!
//! ```text
//!   firmware.elf ──► emulated STM32H743 (rigless) ──► TIM1 registers ──► bridge ──► motor, stage (servo-sim)
//!                      ▲      ▲        ▲                                              │
//!            ADC1..3 ──┘      │        └── USART3 ◄──► tests, host tool               │
//!         SPI1: BiSS-C frame, or ADC1, ADC2 and TIM4: sine, cosine, edges ◄───────────┘
//! ```
//!
//! [`VirtualBoard::boot`] gives a board that stands still; [`VirtualBoard::run_for`] lets virtual time pass. Two runs with the
//! same calls are the same run to the bit. [`VirtualBoard::snapshot`] keeps a state to start many tests from.
//!
//! What is *not* modelled: wait states, caches and bus contention (every instruction takes the same time, so this is no
//! worst-case-execution-time tool), analogue settling within a conversion.

mod board;
pub mod coupling;
mod elf;
mod encoder;
mod error;
pub mod flash;
mod link;
mod log;
pub mod port;
pub mod pwm;
mod runner;
mod sensor_fault;
mod serial;
pub mod serve;
pub mod session;
mod told;
mod virtual_board;
mod watchdog;

pub use board::Analog;
pub use coupling::{Counts, Latency, TruthSample};
pub use elf::{ELF_VARIABLE, Elf};
pub use encoder::{EncoderFault, Lasting};
pub use error::Error;
pub use link::Link;
pub use log::LogLine;
pub use sensor_fault::{AdcFault, CounterFault};
pub use session::Session;
pub use told::{Told, ToldKind};
pub use virtual_board::{
    Config, NOMINAL_INSTRUCTIONS_PER_SECOND, PARAMETER_ADDRESSES, ParameterSectors, Snapshot, VirtualBoard,
};
