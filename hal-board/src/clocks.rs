//! Clock tree, caches, cycle counter.
//!
//! | clock | Hz | for |
//! |---|---|---|
//! | core | 400 M | PLL1 P: HSI 64 MHz / 4 × 50 / 2 |
//! | AHB, AXI | 200 M | |
//! | APB1..4 | 100 M | timers run at twice that |
//! | TIM1, TIM2 | 200 M | [`TIMER_HZ`] |
//! | SPI1 kernel | 80 M | PLL1 Q, /8 in the SPI |
//! | ADC kernel | 64 M | PER clock = HSI, /2 twice: 16 MHz at the converters |

use embassy_stm32::Config;
use embassy_stm32::interrupt::Priority;
use embassy_stm32::rcc::{
    AHBPrescaler, APBPrescaler, HSIPrescaler, Pll, PllDiv, PllMul, PllPreDiv, PllSource, Sysclk, VoltageScale, mux,
};

/// Core clock, Hz.
pub const CORE_HZ: u32 = 400_000_000;
/// Counting clock of the PWM timer, Hz.
pub const TIMER_HZ: u32 = 200_000_000;
/// CPU cycles per count of the PWM timer.
pub const CYCLES_PER_COUNT: u32 = CORE_HZ / TIMER_HZ;

/// The clock tree tabled above; interrupts of the DMA controllers, unused, below the control loop all the same.
pub fn config() -> Config {
    let mut config = Config::default();
    config.rcc.hsi = Some(HSIPrescaler::DIV1);
    config.rcc.csi = true;
    config.rcc.pll1 = Some(Pll {
        source: PllSource::HSI,
        prediv: PllPreDiv::DIV4,
        mul: PllMul::MUL50,
        fracn: None,
        divp: Some(PllDiv::DIV2),
        divq: Some(PllDiv::DIV10),
        divr: None,
    });
    config.rcc.sys = Sysclk::PLL1_P;
    config.rcc.ahb_pre = AHBPrescaler::DIV2;
    config.rcc.apb1_pre = APBPrescaler::DIV2;
    config.rcc.apb2_pre = APBPrescaler::DIV2;
    config.rcc.apb3_pre = APBPrescaler::DIV2;
    config.rcc.apb4_pre = APBPrescaler::DIV2;
    config.rcc.voltage_scale = VoltageScale::Scale1;
    // The reset value, PLL2 P, is off here and would stall the converters.
    config.rcc.mux.adcsel = mux::Adcsel::PER;
    config.dma_interrupt_priority = Priority::P8;
    config.bdma_interrupt_priority = Priority::P8;
    config.mdma_interrupt_priority = Priority::P8;
    config
}

/// Instruction and data cache on (tasks run from flash; no DMA is used, so nothing needs cache maintenance), cycle
/// counter running.
pub fn enable_caches_and_cycle_counter() {
    // SAFETY: called once from `init`, before anything else uses a core peripheral.
    let mut core = unsafe { cortex_m::Peripherals::steal() };
    core.SCB.enable_icache();
    core.SCB.enable_dcache(&mut core.CPUID);
    core.DCB.enable_trace();
    cortex_m::peripheral::DWT::unlock();
    core.DWT.enable_cycle_counter();
}

/// Free-running count of core cycles, modulo 2^32.
#[inline(always)]
pub fn cycles() -> u32 {
    cortex_m::peripheral::DWT::cycle_count()
}
