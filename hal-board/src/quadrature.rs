//! TIM4 as the counter of an encoder's quarter periods: comparators of cosine and sine on its first two inputs, every edge counts.
//!
//! It counts up while the cosine is ahead of the sine by less than half a period, which is where the angle grows. A comparator that
//! bounces counts up and down by one; the inputs are not filtered beyond that, because the comparators have a hysteresis.

use embassy_stm32::pac::TIM4;
use embassy_stm32::pac::timer::vals::{CcmrInputCcs, Sms};
use embassy_stm32::{peripherals, rcc};

/// Starts counting.
pub fn configure() {
    rcc::enable_and_reset::<peripherals::TIM4>();
    TIM4.ccmr_input(0).write(|w| {
        for input in 0..2 {
            w.set_ccs(input, CcmrInputCcs::TI4);
        }
    });
    TIM4.smcr().write(|w| w.set_sms(Sms::ENCODER_MODE_3));
    TIM4.arr().write(|w| w.set_arr(u16::MAX));
    TIM4.cr1().write(|w| w.set_cen(true));
}

/// Edges counted so far, up less down; wraps.
#[inline(always)]
pub fn edges() -> u16 {
    TIM4.cnt().read().cnt()
}
