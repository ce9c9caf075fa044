//! Interrupt priorities: one table, applied at start and read back from the NVIC before the drive may run.
//!
//! After reset every interrupt has the highest priority, and a library that enables one leaves it there. So the check
//! does not stop at the table: *any* enabled interrupt above [`CEILING`] that is not one of the control loop's is a fault.

use cortex_m::peripheral::NVIC;
use embassy_stm32::interrupt::{Interrupt, InterruptExt, Priority};

/// Highest priority an interrupt other than the control loop's may have. Critical sections mask from one step above.
pub const CEILING: Priority = Priority::P2;

/// The interrupts of the control loop. Equal priority: they never pre-empt each other.
const CONTROL: [Interrupt; 3] = [Interrupt::TIM1_UP, Interrupt::ADC, Interrupt::SPI1];

/// Priority of the control loop: not masked by any critical section.
pub const CONTROL_PRIORITY: Priority = Priority::P0;

/// Everybody else.
const OTHERS: [(Interrupt, Priority); 2] = [
    (Interrupt::TIM2, Priority::P6),   // time driver of the executor
    (Interrupt::USART3, Priority::P7), // serial link
];

/// Prints the priorities of the table as the NVIC has them.
pub struct ReadBack;

impl defmt::Format for ReadBack {
    fn format(&self, f: defmt::Formatter) {
        for line in CONTROL.into_iter().chain(OTHERS.map(|(line, _)| line)) {
            defmt::write!(f, "{} {=u8} ", line, level(line as u8));
        }
    }
}

/// Number of interrupt lines of the part.
const LINES: u8 = 150;

/// An interrupt whose priority, read back from the NVIC, is not what the control loop needs.
#[derive(Clone, Copy, Debug, PartialEq, Eq, defmt::Format)]
pub struct PriorityFault {
    /// Line number in the vector table.
    pub line: u8,
    /// Priority level found, 0 (highest) to 15.
    pub level: u8,
}

pub(crate) fn apply() {
    for line in CONTROL {
        line.set_priority(CONTROL_PRIORITY);
    }
    for (line, priority) in OTHERS {
        line.set_priority(priority);
    }
}

/// Reads enables and priorities back.
///
/// # Errors
/// The first line that is enabled and could delay the control loop, or a line of the control loop with another priority.
pub(crate) fn check() -> Result<(), PriorityFault> {
    for line in 0..LINES {
        let control = CONTROL.iter().any(|own| *own as u8 == line);
        let level = level(line);
        let wrong = if control { level != 0 } else { enabled(line) && level < CEILING as u8 >> 4 };
        if wrong {
            return Err(PriorityFault { line, level });
        }
    }
    Ok(())
}

pub(crate) fn unmask_control() {
    for line in CONTROL {
        line.unpend();
        // SAFETY: the state the handlers use has been written, see `PowerStage::start`.
        unsafe { line.enable() };
    }
}

fn level(line: u8) -> u8 {
    // SAFETY: a read without side effects of a register that exists for every line.
    unsafe { (*NVIC::PTR).ipr[usize::from(line)].read() >> 4 }
}

fn enabled(line: u8) -> bool {
    // SAFETY: as above.
    unsafe { (*NVIC::PTR).iser[usize::from(line / 32)].read() >> (line % 32) & 1 == 1 }
}
