//! Sine and cosine of 1 Vpp as converters and comparators see them.

use std::f64::consts::TAU;

use crate::adc;
use crate::random::Noise;
use crate::stage::encoder::SinCos;

/// Counts of a signal period.
pub const PERIOD_CT: f64 = 65_536.0;

/// What is to be read in a servo period.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Reading {
    /// Sine and cosine at the converters, as fractions of their range, 0.5 without signal.
    pub pins: [f64; 2],
    /// Edges counted since position 0, four a period.
    pub edges: i64,
}

impl Reading {
    /// Code of the sine in bits 63 to 48, of the cosine in bits 47 to 32, the counter in bits 15 to 0.
    pub fn bits(&self) -> u64 {
        let [sin, cos] = self.pins.map(|pin| u64::from(adc::code(pin)));
        sin << 48 | cos << 32 | u64::from(self.edges as u16)
    }
}

/// Sine and cosine at a position in signal periods, with the noise of one conversion each.
pub fn pins(signals: &SinCos, periods: f64, noise_lsb_rms: f64, noise: &mut Noise) -> [f64; 2] {
    shares(signals, periods).map(|share| adc::bipolar(signals.amplitude * share, 1.0, noise_lsb_rms, noise))
}

/// The counter after a movement to `periods`: it stays where it is as long as the hysteresis lets it.
///
/// Edges are where the signals pass the middle of the range, so that offsets and phase move them.
pub fn count(signals: &SinCos, edges: i64, periods: f64) -> i64 {
    let below = quarter(signals, periods - signals.hysteresis);
    let above = quarter(signals, periods + signals.hysteresis);
    edges.clamp(below, above.max(below))
}

/// The signals as shares of the amplitude: sine and cosine.
fn shares(signals: &SinCos, periods: f64) -> [f64; 2] {
    // Without whole periods first: exact however far the stage is.
    let angle = TAU * (periods - libm::floor(periods));
    let sin = signals.sin_offset + signals.gain * libm::sin(angle + signals.phase_rad);
    [sin, signals.cos_offset + libm::cos(angle)]
}

/// Quarter of a period, by the signs of both signals.
fn quarter(signals: &SinCos, periods: f64) -> i64 {
    let [sin, cos] = shares(signals, periods);
    let quadrant = match (sin >= 0.0, cos >= 0.0) {
        (true, true) => 0,
        (true, false) => 1,
        (false, false) => 2,
        (false, true) => 3,
    };
    // Where an edge is not exactly at the beginning of the period, the quadrant of the neighbour reaches over it.
    let whole = libm::floor(periods - 0.25 * f64::from(quadrant) + 0.5 - 0.125);
    4 * whole as i64 + i64::from(quadrant)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::random::Purpose;

    const GOOD: SinCos = SinCos {
        amplitude: 0.75,
        cos_offset: 0.0,
        sin_offset: 0.0,
        gain: 1.0,
        phase_rad: 0.0,
        hysteresis: 0.0,
        counter_late_s: 0.0,
    };

    #[test]
    fn the_signals_are_where_the_definition_says() {
        let mut noise = Noise::new(0, Purpose::SinCosAdc, 0);
        let wrong = SinCos { cos_offset: 0.1, sin_offset: -0.2, gain: 1.5, phase_rad: TAU / 12.0, ..GOOD };
        for (signals, periods, sin, cos) in [
            (GOOD, 0.0, 0.0, 1.0_f64),
            (GOOD, 1_000_000.25, 1.0, 0.0),
            (GOOD, -0.25, -1.0, 0.0),
            (GOOD, 0.5, 0.0, -1.0),
            (wrong, 0.0, -0.2 + 1.5 * 0.5, 1.1),
        ] {
            let pins = pins(&signals, periods, 0.0, &mut noise);
            for (pin, share) in pins.into_iter().zip([sin, cos]) {
                assert!((pin - f64::min(0.5 + 0.375 * share, 1.0)).abs() < 1e-9, "{periods}: {pin} {share}");
            }
        }
        let reading = Reading { pins: [0.75, 0.25], edges: -1 };
        assert_eq!(reading.bits(), 0xc000_4000_0000_ffff);
    }

    #[test]
    fn offsets_move_the_edges() {
        // The cosine passes its middle later by the offset's arc sine on the one side and sooner on the other.
        let shifted = SinCos { cos_offset: 0.1, ..GOOD };
        let arc = libm::asin(0.1) / TAU;
        for whole in [-5.0, 0.0, 7.0] {
            for (edge, quadrant) in [(0.25 + arc, 1), (0.5, 2), (0.75 - arc, 3), (1.0, 4)] {
                let at = |periods| quarter(&shifted, whole + periods) - 4 * whole as i64;
                assert_eq!((at(edge - 1e-6), at(edge + 1e-6)), (quadrant - 1, quadrant), "{edge}");
            }
        }
    }

    proptest! {
        /// With offsets of a tenth and a phase of 6° a count is never more than a twelfth of a period off.
        #[test]
        fn the_counter_follows_the_position(
            periods in -1e6..1e6f64, cos_offset in -0.1..0.1f64, sin_offset in -0.1..0.1f64, phase_rad in -0.1..0.1f64
        ) {
            let signals = SinCos { cos_offset, sin_offset, phase_rad, ..GOOD };
            let middle = (quarter(&signals, periods) as f64 + 0.5) / 4.0;
            prop_assert!((middle - periods).abs() < 0.125 + 1.0 / 12.0, "{middle}");
        }

        /// A comparator with hysteresis does not chatter: within it, the counter stays.
        #[test]
        fn the_counter_does_not_move_within_its_hysteresis(periods in -1e3..1e3f64, shift in -1.0..1.0f64, edges: i32) {
            let signals = SinCos { hysteresis: 0.01, ..GOOD };
            let counted = count(&signals, i64::from(edges), periods);
            // Nearer to the position where it was counted than the hysteresis, an edge there cannot be passed back.
            prop_assert_eq!(count(&signals, counted, periods), counted);
            let near = count(&signals, counted, periods + 0.009 * shift);
            let back = count(&signals, near, periods);
            prop_assert!((near - counted).abs() <= 1 && back == near);
        }
    }
}
