//! The identification profile.

use super::check_frequency;
use super::phasor::Phasor;
use crate::SERVO_HZ;
use crate::refusal::{Field, Refusal};

/// Most periods of a profile.
pub const MAX_PERIODS: u32 = 10_000;

/// A sine that begins at 0 and decays exponentially, for a whole number of periods.
///
/// It is like the settling of an axis, but slower and as large as one wants: friction shows its loops, inertia next to nothing.
///
/// # Source
/// Section 5.4; 8, 16 and 32 Hz in section 6.1.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct DecayingSine {
    amplitude: f64,
    phasor: Phasor,
    ticks: u32,
}

impl DecayingSine {
    /// `amplitude` is that at the beginning, in the caller's unit; after `periods` periods it has decayed to `end_share` of it.
    ///
    /// # Range
    /// `frequency_hz` [`MIN_HZ`](super::MIN_HZ) to [`MAX_HZ`](super::MAX_HZ), `periods` 1 to [`MAX_PERIODS`], `end_share` 1e-6
    /// (almost nothing left) to 1 (no decay).
    ///
    /// # Errors
    /// The value that is out of range.
    pub fn new(amplitude: f32, frequency_hz: f32, periods: u32, end_share: f32) -> Result<DecayingSine, Refusal> {
        Refusal::check(Field::Amplitude, f64::from(amplitude), f64::from(f32::MIN), f64::from(f32::MAX))?;
        check_frequency(frequency_hz)?;
        Refusal::check(Field::Periods, f64::from(periods), 1.0, f64::from(MAX_PERIODS))?;
        Refusal::check(Field::EndShare, f64::from(end_share), 1e-6, 1.0)?;
        let turns_per_tick = f64::from(frequency_hz) / f64::from(SERVO_HZ);
        let ticks = libm::round(f64::from(periods) / turns_per_tick);
        let shrink_per_tick = libm::pow(f64::from(end_share), 1.0 / ticks);
        Ok(DecayingSine {
            amplitude: f64::from(amplitude),
            phasor: Phasor::new(turns_per_tick, shrink_per_tick),
            ticks: ticks as u32,
        })
    }

    /// Ticks that are left.
    pub fn ticks(&self) -> u32 {
        self.ticks
    }

    /// The value in this tick; nothing when it is over.
    #[inline]
    pub fn advance(&mut self) -> Option<f32> {
        self.ticks = self.ticks.checked_sub(1)?;
        Some((self.amplitude * self.phasor.advance().im) as f32)
    }
}

#[cfg(test)]
mod tests {
    extern crate std;
    use super::*;
    use std::vec::Vec;

    #[test]
    fn it_is_a_sine_under_an_exponential_and_ends() {
        let mut profile = DecayingSine::new(2.0, 16.0, 8, 0.25).unwrap();
        assert_eq!(profile.ticks(), 4_000);
        let values: Vec<f32> = core::iter::from_fn(|| profile.advance()).collect();
        assert_eq!((values.len(), values[0]), (4_000, 0.0));
        for (k, value) in values.iter().enumerate() {
            let t = k as f64 / 8_000.0;
            let exact = 2.0 * libm::pow(0.25, t / 0.5) * libm::sin(core::f64::consts::TAU * 16.0 * t);
            assert!((f64::from(*value) - exact).abs() < 1e-6, "{k}: {value} {exact}");
        }
        assert_eq!(profile.advance(), None);
    }

    #[test]
    fn what_is_out_of_range_is_named() {
        let named = |result: Result<DecayingSine, Refusal>| match result {
            Err(Refusal::OutOfRange { field, .. }) => field,
            other => panic!("{other:?}"),
        };
        assert_eq!(named(DecayingSine::new(f32::NAN, 8.0, 8, 0.5)), Field::Amplitude);
        assert_eq!(named(DecayingSine::new(1.0, 0.0, 8, 0.5)), Field::Frequency);
        assert_eq!(named(DecayingSine::new(1.0, 4_000.0, 8, 0.5)), Field::Frequency);
        assert_eq!(named(DecayingSine::new(1.0, 8.0, 0, 0.5)), Field::Periods);
        assert_eq!(named(DecayingSine::new(1.0, 8.0, 8, 0.0)), Field::EndShare);
        assert_eq!(named(DecayingSine::new(1.0, 8.0, 8, 1.5)), Field::EndShare);
    }
}
