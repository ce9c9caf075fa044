//! SPI1 as a BiSS-C master: MA is the clock (10 MHz), SLO the data input; 64 bits a frame, 6.4 µs.
//!
//! The clock rests high. The encoder shifts on its rising edge and data is taken on the rising edge as well (mode 3), so
//! the bit in hand is the one put out a whole clock period earlier: that much may the line and the transceivers take.
//!
//! The interface stays enabled in an endless transfer: two words in the transmit FIFO are one frame, and the receive
//! FIFO interrupts at two words. A frame costs four register accesses. Nothing is ever sent: MOSI has no pin.

use embassy_stm32::pac::SPI1;
use embassy_stm32::pac::spi::regs::Cr1;
use embassy_stm32::pac::spi::vals::{Comm, Cpha, Cpol, Fthlv, Master, Mbr};
use embassy_stm32::{peripherals, rcc};

/// What [`ServoSample::frame`](servo_core::axis::ServoSample) holds when no frame arrived in time. No encoder sends it: the line never
/// leaves its resting level.
pub const MISSING_FRAME: u64 = u64::MAX;

/// Software slave select high, as a master needs it; disabled.
const OFF: Cr1 = Cr1(1 << 12);
/// The same, enabled.
const ON: Cr1 = Cr1(OFF.0 | 1);
/// The same, clock running whenever the transmit FIFO holds something.
const RUN: Cr1 = Cr1(ON.0 | 1 << 9);

/// Sets up the interface and leaves it ready for [`start_frame`].
pub fn configure() {
    rcc::enable_and_reset::<peripherals::SPI1>();
    SPI1.cr1().write_value(OFF);
    SPI1.cfg1().write(|w| {
        w.set_mbr(Mbr::DIV8);
        w.set_dsize(32 - 1);
        w.set_fthlv(Fthlv::TWO_FRAMES);
        // Not used, but a length under eight bits can corrupt received data (errata 2.22.5).
        w.set_crcsize(32 - 1);
    });
    SPI1.cfg2().write(|w| {
        w.set_master(Master::MASTER);
        w.set_comm(Comm::FULL_DUPLEX);
        w.set_ssm(true);
        w.set_cpol(Cpol::IDLE_HIGH);
        w.set_cpha(Cpha::SECOND_EDGE);
        // Hold the clock at its resting level while disabled: an edge would start a frame in the encoder.
        w.set_afcntr(true);
    });
    SPI1.ier().write(|w| w.set_rxpie(true));
    run();
}

fn run() {
    SPI1.cr1().write_value(ON);
    SPI1.cr1().write_value(RUN);
}

/// Starts a frame. Its end raises the SPI1 interrupt.
#[inline(always)]
pub fn start_frame() {
    SPI1.txdr32().write_value(0);
    SPI1.txdr32().write_value(0);
}

/// The 64 bits of the frame that has just ended, the first one in bit 63.
#[inline(always)]
pub fn read_frame() -> u64 {
    let first = SPI1.rxdr32().read();
    let second = SPI1.rxdr32().read();
    u64::from(first) << 32 | u64::from(second)
}

/// Gives up on a frame and empties both FIFOs.
#[inline(never)]
pub fn abort_frame() {
    SPI1.cr1().write_value(OFF);
    run();
}
