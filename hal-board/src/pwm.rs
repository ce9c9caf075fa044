//! TIM1: centre-aligned complementary PWM, dead time, break.
//!
//! The counter runs 0 → [`PWM_TOP`] → 0 in 25 µs. PWM mode 2 makes a phase's *low* side conduct around the underflow:
//! there the update interrupt starts the current conversions, and low-side shunts see the phase current. Compares are
//! preloaded: what is written becomes active at the next underflow.

use embassy_stm32::pac::timer::regs::{BdtrAdv, SrAdv};
use embassy_stm32::pac::timer::vals::{Bkp, Cms, FilterValue, Lock, OcmGp, Ossi, Ossr};
use embassy_stm32::pac::{SYSCFG, TIM1};
use embassy_stm32::{peripherals, rcc};

use servo_core::PWM_TOP;

use crate::clocks::{CYCLES_PER_COUNT, TIMER_HZ};

/// Time between one side of a phase switching off and the other switching on, ns.
const DEAD_TIME_NS: u32 = 500;
/// The same in counts; the register is linear up to 127.
const DEAD_TIME_CT: u32 = TIMER_HZ / 1_000_000 * DEAD_TIME_NS / 1000;
const _: () = assert!(DEAD_TIME_CT <= 127);

/// Break and dead-time register without the main output enable, written once before anything else can switch:
/// dead time, break input active low with eight samples of filter at 50 MHz (160 ns), outputs driven to the off level
/// whenever they are not switching, no automatic re-enable, and everything but the output enable locked until reset.
const BRIDGE_OFF: BdtrAdv = {
    let mut r = BdtrAdv(0);
    r.0 = DEAD_TIME_CT
        | (Lock::LEVEL3.to_bits() as u32) << 8
        | (Ossi::IDLE_LEVEL.to_bits() as u32) << 10
        | (Ossr::IDLE_LEVEL.to_bits() as u32) << 11
        | 1 << 12
        | (Bkp::ACTIVE_LOW.to_bits() as u32) << 13
        | (FilterValue::FDTS_DIV4_N8.to_bits() as u32) << 16;
    r
};
/// The same with the outputs enabled.
const BRIDGE_ON: BdtrAdv = BdtrAdv(BRIDGE_OFF.0 | 1 << 15);

/// Sets the timer up, stopped, bridge off.
pub fn configure() {
    rcc::enable_and_reset::<peripherals::TIM1>();
    break_on_lockup();
    TIM1.cr1().write(|w| w.set_cms(Cms::CENTER_ALIGNED1));
    TIM1.psc().write_value(0);
    TIM1.arr().write(|w| w.set_arr(PWM_TOP));
    // One update per period. Taken over by the update event below while the counter stands at zero, which makes it the
    // underflow and not the peak.
    TIM1.rcr().write(|w| w.set_rep(1));
    for pair in 0..2 {
        TIM1.ccmr_output(pair).write(|w| {
            for channel in 0..2 {
                w.set_ocm(channel, OcmGp::PWM_MODE2);
                w.set_ocpe(channel, true);
            }
        });
    }
    TIM1.ccer().write(|w| {
        for phase in 0..3 {
            w.set_cce(phase, true);
            w.set_ccne(phase, true);
        }
    });
    write_compares([PWM_TOP / 2; 3]);
    TIM1.egr().write(|w| w.set_ug(true));
    TIM1.bdtr().write_value(BRIDGE_OFF);
    acknowledge_update();
}

/// Makes a locked-up core (a fault inside the fault handler) trip the break. The bit can only be set; the register is
/// missing from the vendor's register description and so from the register crate.
fn break_on_lockup() {
    const CFGR_OFFSET_WORDS: usize = 0x18 / 4;
    const CM7_LOCKUP: u32 = 1 << 6;
    // SAFETY: SYSCFG_CFGR, RM0433 12.3.6; the clock of SYSCFG is on since `embassy_stm32::init`.
    unsafe { SYSCFG.as_ptr().cast::<u32>().add(CFGR_OFFSET_WORDS).write_volatile(CM7_LOCKUP) };
}

/// Starts counting and checks on the first update that it comes at the underflow; true if it does.
pub fn start() -> bool {
    TIM1.cr1().modify(|w| w.set_cen(true));
    while !TIM1.sr().read().uif() {}
    let at_underflow = TIM1.cnt().read().cnt() < PWM_TOP / 2;
    acknowledge_update();
    take_break();
    TIM1.dier().write(|w| w.set_uie(true));
    at_underflow
}

/// Clears the update flag and no other: a written one leaves a flag alone.
#[inline(always)]
pub fn acknowledge_update() {
    TIM1.sr().write_value(SrAdv(!1));
}

/// CPU cycles since the underflow, valid for the first half of the period.
#[inline(always)]
pub fn cycles_since_update() -> u32 {
    u32::from(TIM1.cnt().read().cnt()) * CYCLES_PER_COUNT
}

/// Whether the break input was active since the last call. As long as it still is, the next call says so again.
#[inline(always)]
pub fn take_break() -> bool {
    const BREAK_FLAGS: u32 = 1 << 7 | 1 << 13; // pin, system (a locked-up core)
    let tripped = TIM1.sr().read().0 & BREAK_FLAGS != 0;
    if tripped {
        TIM1.sr().write_value(SrAdv(!BREAK_FLAGS));
    }
    tripped
}

/// High-side on-times for the next period, in counts; more than [`PWM_TOP`] counts as [`PWM_TOP`].
#[inline(always)]
pub fn write_compares(on_time_ct: [u16; 3]) {
    for (phase, on_time_ct) in on_time_ct.into_iter().enumerate() {
        TIM1.ccr(phase).write(|w| w.set_ccr(PWM_TOP.saturating_sub(on_time_ct)));
    }
}

/// Enables the outputs, unless the break input is active: the hardware then keeps them off.
#[inline(always)]
pub fn bridge_on() {
    TIM1.bdtr().write_value(BRIDGE_ON);
}

/// All six switches off, at once. Also called by the panic and fault handlers.
#[inline(always)]
pub fn bridge_off() {
    TIM1.bdtr().write_value(BRIDGE_OFF);
}
