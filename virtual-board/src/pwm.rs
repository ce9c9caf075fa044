//! What the bridge does, read from TIM1's registers as the pins would show it.
//!
//! The emulator reports no duty cycle for centre-aligned PWM, and the plant wants the average per PWM period anyway, so the
//! registers are decoded here: RM0433 rev 9 sections 38.4.1 (`CR1`), 38.4.8 (`CCMRx`), 38.4.11 (`CCER`), 38.4.20 (`BDTR`).

use servo_sim::BridgeState;

/// The registers of an advanced timer that decide what its six outputs do, raw.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PwmRegisters {
    /// Control register 1: counting direction (`CMS`), clock division (`CKD`), counter enable.
    pub cr1: u32,
    /// Output modes of channels 1 and 2.
    pub ccmr1: u32,
    /// Output modes of channel 3 (and 4).
    pub ccmr2: u32,
    /// Output enables and polarities.
    pub ccer: u32,
    /// Auto-reload: half a period in counts when centre-aligned.
    pub arr: u32,
    /// The three compare values.
    pub ccr: [u32; 3],
    /// Main output enable, dead time.
    pub bdtr: u32,
}

const CR1_CEN: u32 = 1 << 0;
const CR1_CMS_SHIFT: u32 = 5;
const CR1_CKD_SHIFT: u32 = 8;
const BDTR_MOE: u32 = 1 << 15;
/// `CC1E | CC1NE | CC2E | CC2NE | CC3E | CC3NE`.
const CCER_SIX_OUTPUTS: u32 = 0x0555;
const MODE_FORCE_ACTIVE: u32 = 0b0101;
const MODE_PWM_1: u32 = 0b0110;
const MODE_PWM_2: u32 = 0b0111;

impl PwmRegisters {
    /// Fraction of the PWM period, 0 to 1, for which each high-side output is commanded on, dead time not subtracted.
    ///
    /// PWM modes 1 and 2 in centre- or edge-aligned counting and both output polarities are decoded; "force active" is 1 and
    /// every other output mode counts as 0. A compare value above the period saturates, as the comparator does.
    #[must_use]
    pub fn duty(&self) -> [f64; 3] {
        let centre_aligned = (self.cr1 >> CR1_CMS_SHIFT) & 0b11 != 0;
        let period_counts = if centre_aligned { self.arr } else { self.arr + 1 }.max(1);
        std::array::from_fn(|channel| {
            let below = f64::from(self.ccr[channel].min(period_counts)) / f64::from(period_counts);
            let reference = match self.output_mode(channel) {
                MODE_PWM_1 => below,
                MODE_PWM_2 => 1.0 - below,
                MODE_FORCE_ACTIVE => 1.0,
                _ => 0.0,
            };
            let active_low = (self.ccer >> (4 * channel + 1)) & 1 != 0;
            if active_low { 1.0 - reference } else { reference }
        })
    }

    /// Whether all six gates are driven: counter running, every output enabled and `MOE` set. A bridge with fewer than six
    /// outputs enabled counts as off.
    #[must_use]
    pub fn outputs_on(&self) -> bool {
        self.cr1 & CR1_CEN != 0 && self.ccer & CCER_SIX_OUTPUTS == CCER_SIX_OUTPUTS && self.bdtr & BDTR_MOE != 0
    }

    /// Dead time in seconds at a timer clock of `timer_hz`: `DTG` in units of the clock divided by `CKD`. A stopped clock (0)
    /// gives 0 s.
    #[must_use]
    pub fn dead_time_s(&self, timer_hz: u64) -> f64 {
        if timer_hz == 0 {
            return 0.0;
        }
        let ticks = dead_time_ticks((self.bdtr & 0xFF) as u8) << ((self.cr1 >> CR1_CKD_SHIFT) & 0b11);
        f64::from(ticks) / timer_hz as f64
    }

    /// The average output of the bridge over one PWM period.
    #[must_use]
    pub fn bridge(&self, timer_hz: u64) -> BridgeState {
        BridgeState { duty: self.duty(), enabled: self.outputs_on(), dead_time_s: self.dead_time_s(timer_hz) }
    }

    fn output_mode(&self, channel: usize) -> u32 {
        let (register, shift) = match channel {
            0 => (self.ccmr1, 4),
            1 => (self.ccmr1, 12),
            _ => (self.ccmr2, 4),
        };
        // The mode's fourth bit lies 12 bits above its third.
        ((register >> shift) & 0b111) | (((register >> (shift + 12)) & 1) << 3)
    }
}

/// Dead time in periods of `t_DTS` that `BDTR.DTG` encodes: 0 to 1008, RM0433 rev 9 section 38.4.20.
#[must_use]
pub fn dead_time_ticks(dtg: u8) -> u32 {
    let dtg = u32::from(dtg);
    match dtg >> 5 {
        0..=3 => dtg,
        4 | 5 => (64 + (dtg & 0x3F)) * 2,
        6 => (32 + (dtg & 0x1F)) * 8,
        _ => (32 + (dtg & 0x1F)) * 16,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const CENTRE_ALIGNED: u32 = 0b01 << CR1_CMS_SHIFT | CR1_CEN;

    fn registers(mode: u32, ccr: [u32; 3]) -> PwmRegisters {
        PwmRegisters {
            cr1: CENTRE_ALIGNED,
            ccmr1: mode << 4 | mode << 12,
            ccmr2: mode << 4,
            ccer: CCER_SIX_OUTPUTS,
            arr: 2500,
            ccr,
            bdtr: BDTR_MOE,
        }
    }

    #[test]
    fn the_two_pwm_modes_are_complements() {
        let ccr = [0, 625, 2500];
        assert_eq!(registers(MODE_PWM_1, ccr).duty(), [0.0, 0.25, 1.0]);
        assert_eq!(registers(MODE_PWM_2, ccr).duty(), [1.0, 0.75, 0.0]);
    }

    #[test]
    fn a_compare_above_the_period_saturates() {
        assert_eq!(registers(MODE_PWM_1, [2501, 65_535, 2500]).duty(), [1.0; 3]);
    }

    #[test]
    fn an_edge_aligned_period_is_one_count_longer() {
        let mut edge = registers(MODE_PWM_1, [0, 1250, 2500]);
        edge.cr1 = CR1_CEN;
        edge.arr = 2499;
        assert_eq!(edge.duty(), [0.0, 0.5, 1.0]);
    }

    #[test]
    fn an_active_low_output_is_inverted() {
        let mut inverted = registers(MODE_PWM_1, [625; 3]);
        inverted.ccer |= 1 << 5;
        assert_eq!(inverted.duty(), [0.25, 0.75, 0.25]);
    }

    #[test]
    fn modes_that_are_not_pwm_are_off_or_forced_on() {
        assert_eq!(registers(0b0000, [1250; 3]).duty(), [0.0; 3]);
        assert_eq!(registers(0b0100, [1250; 3]).duty(), [0.0; 3]);
        assert_eq!(registers(MODE_FORCE_ACTIVE, [1250; 3]).duty(), [1.0; 3]);
        // Combined PWM mode 2 shares its low three bits with no plain PWM mode.
        let mut combined = registers(MODE_PWM_1, [1250; 3]);
        combined.ccmr1 |= 1 << 16;
        assert_eq!(combined.duty()[0], 0.0);
    }

    #[test]
    fn the_bridge_is_on_only_with_counter_outputs_and_moe() {
        let on = registers(MODE_PWM_2, [1250; 3]);
        assert!(on.outputs_on());
        assert!(!PwmRegisters { bdtr: 0, ..on }.outputs_on());
        assert!(!PwmRegisters { ccer: 0x0155, ..on }.outputs_on());
        assert!(!PwmRegisters { cr1: 0, ..on }.outputs_on());
    }

    /// The ranges of RM0433 rev 9 section 38.4.20 with their edges: (DTG, ticks).
    #[test]
    fn dead_time_codes_follow_the_manual() {
        let table = [
            (0, 0),
            (100, 100),
            (0x7F, 127),
            (0x80, 128),
            (0xBF, 254),
            (0xC0, 256),
            (0xDF, 504),
            (0xE0, 512),
            (0xFF, 1008),
        ];
        for (dtg, ticks) in table {
            assert_eq!(dead_time_ticks(dtg), ticks, "DTG {dtg:#04x}");
        }
    }

    #[test]
    fn dead_time_scales_with_the_clock_division() {
        let mut pwm = registers(MODE_PWM_2, [0; 3]);
        pwm.bdtr |= 100;
        assert_eq!(pwm.dead_time_s(200_000_000), 0.5e-6);
        pwm.cr1 |= 0b10 << CR1_CKD_SHIFT;
        assert_eq!(pwm.dead_time_s(200_000_000), 2.0e-6);
        assert_eq!(pwm.dead_time_s(0), 0.0);
    }
}
