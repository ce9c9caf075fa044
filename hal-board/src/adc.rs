//! The three converters: ADC1 and ADC2 for the phase currents and for an encoder's sine and cosine, ADC3 for bus voltage and
//! temperature. 16 bits, started by software.
//!
//! ADC1 and ADC2 are started back to back, for the phases at the middle of the low-side on-time, and sample for 0.53 µs; the
//! end of the second one interrupts 1.06 µs after the start. Nothing polls. In a servo period sine and cosine, if they are asked
//! for, are converted behind the phases in the same way. ADC3 is started once per servo period and read at the next one.

use embassy_stm32::pac::adc::Adc;
use embassy_stm32::pac::adc::regs::Cr;
use embassy_stm32::pac::adc::vals::{Boost, Ovrmod, Pcsel, Res, SampleTime};
use embassy_stm32::pac::adccommon::vals::Presc;
use embassy_stm32::pac::{ADC1, ADC2, ADC3, ADC3_COMMON, ADC12_COMMON};
use embassy_stm32::{peripherals, rcc};

use servo_core::current::PhaseCodes;
use servo_core::encoder::sincos;

use crate::clocks::CORE_HZ;

/// Phase A on ADC1: PC0.
const PHASE_A_CHANNEL: u8 = 10;
/// Phase B on ADC2: PA3.
const PHASE_B_CHANNEL: u8 = 15;
/// Sine on ADC1: PB1.
const SINE_CHANNEL: u8 = 5;
/// Cosine on ADC2: PA4.
const COSINE_CHANNEL: u8 = 18;
/// Bus voltage on ADC3: PF10.
const BUS_CHANNEL: u8 = 6;
/// Temperature on ADC3: PF4.
const TEMPERATURE_CHANNEL: u8 = 9;

/// Start command on top of what must stay set: regulator on, clock range 12.5 to 25 MHz, enabled. Written whole, so that
/// the interrupt needs no read.
const START: Cr = Cr(1 << 28 | (Boost::LT25.to_bits() as u32) << 8 | 1 << 2 | 1);

/// Powers up, calibrates (offset and linearity, all three at a time: 10 ms) and enables the converters.
pub fn configure() {
    rcc::enable_and_reset::<peripherals::ADC1>();
    rcc::enable_and_reset::<peripherals::ADC2>();
    rcc::enable_and_reset::<peripherals::ADC3>();
    ADC12_COMMON.ccr().write(|w| w.set_presc(Presc::DIV2));
    ADC3_COMMON.ccr().write(|w| w.set_presc(Presc::DIV2));
    let converters = [
        (ADC1, PHASE_A_CHANNEL, SampleTime::CYCLES8_5),
        (ADC2, PHASE_B_CHANNEL, SampleTime::CYCLES8_5),
        (ADC3, BUS_CHANNEL, SampleTime::CYCLES64_5),
    ];
    for (adc, ..) in converters {
        adc.cr().write(|w| w.set_advregen(true));
    }
    wait_us(10);
    for (adc, ..) in converters {
        while !adc.isr().read().ldordy() {}
        adc.cr().write(|w| {
            w.set_advregen(true);
            w.set_boost(Boost::LT25);
            w.set_adcallin(true);
            w.set_adcal(true);
        });
    }
    for (adc, ..) in converters {
        while adc.cr().read().adcal() {
            wait_us(100);
        }
    }
    for (adc, channel, sample_time) in converters {
        adc.cr().write(|w| {
            w.set_advregen(true);
            w.set_boost(Boost::LT25);
            w.set_aden(true);
        });
        while !adc.isr().read().adrdy() {}
        adc.cfgr().write(|w| {
            w.set_res(Res::BITS16);
            w.set_ovrmod(Ovrmod::OVERWRITE);
            w.set_jqdis(true);
        });
        select(adc, channel);
        preselect(adc, channel, sample_time);
    }
    preselect(ADC1, SINE_CHANNEL, SampleTime::CYCLES8_5);
    preselect(ADC2, COSINE_CHANNEL, SampleTime::CYCLES8_5);
    preselect(ADC3, TEMPERATURE_CHANNEL, SampleTime::CYCLES64_5);
    ADC2.ier().write(|w| w.set_eocie(true));
}

fn preselect(adc: Adc, channel: u8, sample_time: SampleTime) {
    let channel = usize::from(channel);
    adc.pcsel().modify(|w| w.set_pcsel(channel, Pcsel::PRESELECTED));
    adc.smpr(channel / 10).modify(|w| w.set_smp(channel % 10, sample_time));
}

/// Makes `channel` the only one of the sequence.
#[inline(always)]
fn select(adc: Adc, channel: u8) {
    adc.sqr1().write(|w| w.set_sq(0, channel));
}

/// Starts both phase-current conversions. While others still run it does nothing.
#[inline(always)]
pub fn start_phases() {
    start();
}

#[inline(always)]
fn start() {
    ADC1.cr().write_value(START);
    ADC2.cr().write_value(START);
}

/// The converted phase currents; reading clears the end-of-conversion flags.
#[inline(always)]
pub fn read_phases() -> PhaseCodes {
    PhaseCodes { a: ADC1.dr().read().rdata(), b: ADC2.dr().read().rdata() }
}

/// Starts the conversions of sine and cosine, once those of the phases have ended.
#[inline(always)]
pub fn start_signals() {
    select(ADC1, SINE_CHANNEL);
    select(ADC2, COSINE_CHANNEL);
    start();
}

/// The converted sine and cosine, with the `edges` that belong to them; the phases come next.
#[inline(always)]
pub fn read_signals(edges: u16) -> sincos::Sample {
    let sample = sincos::Sample { sin: ADC1.dr().read().rdata(), cos: ADC2.dr().read().rdata(), edges };
    select(ADC1, PHASE_A_CHANNEL);
    select(ADC2, PHASE_B_CHANNEL);
    sample
}

/// Bus voltage and temperature, taken in turns by one converter.
pub struct SlowInputs {
    turn: u32,
    bus_code: u16,
    temperature_code: u16,
}

impl SlowInputs {
    /// Servo periods per temperature sample; all others go to the bus voltage.
    const TEMPERATURE_EVERY: u32 = 16;

    /// Before the first conversion both codes read zero.
    pub const fn new() -> Self {
        SlowInputs { turn: 0, bus_code: 0, temperature_code: 0 }
    }

    /// Takes the result of the conversion started one servo period ago and starts the next. Returns the newest
    /// (bus voltage, temperature) codes.
    #[inline(always)]
    pub fn exchange(&mut self) -> (u16, u16) {
        let code = ADC3.dr().read().rdata();
        match self.turn {
            0 => {}
            1 => {
                self.temperature_code = code;
                select(ADC3, BUS_CHANNEL);
            }
            _ => self.bus_code = code,
        }
        self.turn += 1;
        if self.turn > Self::TEMPERATURE_EVERY {
            self.turn = 1;
        }
        if self.turn == 1 {
            select(ADC3, TEMPERATURE_CHANNEL);
        }
        ADC3.cr().write_value(START);
        (self.bus_code, self.temperature_code)
    }
}

fn wait_us(us: u32) {
    cortex_m::asm::delay(CORE_HZ / 1_000_000 * us);
}
