//! The converters: a quantity as the fraction of full scale at a pin, with the noise of one conversion.

use crate::random::Noise;

/// Codes of a full scale, 2^16.
pub const CODES: f64 = 65_536.0;

/// The pin of a bipolar channel: 0.5 at 0 A, 1.0 at `+full_scale_a`, clipped to `0.0..=1.0`.
pub fn bipolar(current_a: f64, full_scale_a: f64, noise_lsb_rms: f64, noise: &mut Noise) -> f64 {
    noisy(0.5 + 0.5 * current_a / full_scale_a, noise_lsb_rms, noise)
}

/// The pin of a channel that reads `zero` at 0.0 and `full_scale` at 1.0, clipped to `0.0..=1.0`.
pub fn linear(value: f64, zero: f64, full_scale: f64, noise_lsb_rms: f64, noise: &mut Noise) -> f64 {
    noisy((value - zero) / (full_scale - zero), noise_lsb_rms, noise)
}

/// The 16-bit code nearest to a fraction of full scale: 32768 at 0.5, 65535 from 65534.5/65536 on.
pub fn code(fraction: f64) -> u16 {
    (fraction * CODES + 0.5) as u16 // a cast saturates, and takes NaN for 0
}

fn noisy(fraction: f64, noise_lsb_rms: f64, noise: &mut Noise) -> f64 {
    (fraction + noise_lsb_rms / CODES * noise.normal()).clamp(0.0, 1.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::Purpose;

    #[test]
    fn a_code_is_the_nearest_step_and_saturates() {
        for (fraction, expected) in [
            (-0.1, 0),
            (0.0, 0),
            (0.49 / CODES, 0),
            (0.51 / CODES, 1),
            (0.5, 32_768),
            (0.75, 49_152),
            (1.0, 65_535),
            (1.1, 65_535),
            (f64::NAN, 0),
        ] {
            assert_eq!(code(fraction), expected, "{fraction}");
        }
    }

    #[test]
    fn currents_and_temperatures_land_where_the_data_sheet_says_and_clip() {
        let mut noise = Noise::new(0, Purpose::PhaseAdc, 0);
        for (current_a, expected) in [(0.0, 0.5), (10.0, 1.0), (-10.0, 0.0), (2.5, 0.625), (30.0, 1.0), (-30.0, 0.0)] {
            assert_eq!(bipolar(current_a, 10.0, 0.0, &mut noise), expected, "{current_a} A");
        }
        // 10 mV/K with 0.5 V at 0 °C on a 3.3 V converter: 0.75 V at 25 °C.
        assert!((linear(25.0, -50.0, 280.0, 0.0, &mut noise) - 0.75 / 3.3).abs() < 1e-15);
    }

    #[test]
    fn the_noise_has_the_stated_rms_in_codes() {
        let mut noise = Noise::new(3, Purpose::PhaseAdc, 0);
        let n = 100_000;
        let square: f64 =
            (0..n).map(|_| (bipolar(0.0, 10.0, 1.0, &mut noise) - 0.5) * CODES).map(|lsb| lsb * lsb).sum();
        let rms_lsb = libm::sqrt(square / f64::from(n));
        assert!((rms_lsb - 1.0).abs() < 5.0 / libm::sqrt(2.0 * f64::from(n)), "{rms_lsb}");
    }
}
