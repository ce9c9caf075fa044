//! Pin assignment. One function per connector group; the table with the board's connector names is in `README.md`.

use embassy_stm32::Peri;
use embassy_stm32::gpio::{AfType, AnyPin, Flex, OutputType, Pull, Speed};

/// TIM1 on port E.
const AF_TIM1: u8 = 1;
/// SPI1 on port A.
const AF_SPI1: u8 = 5;
/// TIM4 on port D.
const AF_TIM4: u8 = 2;

/// Six gate signals (low and high side of phases A, B, C in this order) and the break input, active low. The pull-down
/// makes an unplugged power stage a tripped one.
pub fn bridge(gates: [Peri<'static, AnyPin>; 6], fault: Peri<'static, AnyPin>) {
    alternate(fault, AF_TIM1, AfType::input(Pull::Down));
    for gate in gates {
        alternate(gate, AF_TIM1, AfType::output(OutputType::PushPull, Speed::Medium));
    }
}

/// BiSS-C through an RS-485 transceiver: MA is the clock, SLO the data input. With no transceiver connected the pull-up
/// reads as a frame of ones, which no encoder sends.
pub fn encoder(ma: Peri<'static, AnyPin>, slo: Peri<'static, AnyPin>) {
    alternate(ma, AF_SPI1, AfType::output(OutputType::PushPull, Speed::High));
    alternate(slo, AF_SPI1, AfType::input(Pull::Up));
}

/// Comparators of an encoder's cosine and sine, in this order. The pull-downs keep the counter still with nothing connected.
pub fn quadrature(comparators: [Peri<'static, AnyPin>; 2]) {
    for comparator in comparators {
        alternate(comparator, AF_TIM4, AfType::input(Pull::Down));
    }
}

/// Analogue inputs.
pub fn analog(inputs: [Peri<'static, AnyPin>; 6]) {
    for input in inputs {
        let mut pin = Flex::new(input);
        pin.set_as_analog();
        core::mem::forget(pin);
    }
}

fn alternate(pin: Peri<'static, AnyPin>, function: u8, kind: AfType) {
    let mut pin = Flex::new(pin);
    pin.set_as_af_unchecked(function, kind);
    // Dropping it would release the pin again.
    core::mem::forget(pin);
}
