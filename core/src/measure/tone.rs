//! One frequency of a stepped sine.

use super::check_frequency;
use super::phasor::{Complex, Phasor};
use crate::SERVO_HZ;
use crate::refusal::{Field, Refusal};

/// Ticks of a tone at most: an hour.
const MAX_TICKS: f64 = 3_600.0 * SERVO_HZ as f64;

/// A sine whose measured part is a whole number of ticks and of periods, after a lead in which the loop gets used to it.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Tone {
    amplitude: f64,
    phasor: Phasor,
    cycles: u32,
    measured_ticks: u32,
    /// Ticks that are left.
    ticks: u32,
}

/// A tick of a tone.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TonePart {
    /// What is added, in the caller's unit.
    pub value: f32,
    /// For the correlator; nothing during the lead.
    pub reference: Option<Complex>,
}

impl Tone {
    /// The tone nearest to `frequency_hz` whose measured part is `measure_s` long or longer, after a lead of `lead_s`.
    ///
    /// # Range
    /// `frequency_hz` [`MIN_HZ`](super::MIN_HZ) to [`MAX_HZ`](super::MAX_HZ), both times up to an hour.
    ///
    /// # Errors
    /// The value that is out of range.
    pub fn new(amplitude: f32, frequency_hz: f32, measure_s: f32, lead_s: f32) -> Result<Tone, Refusal> {
        Refusal::check(Field::Amplitude, f64::from(amplitude), f64::from(f32::MIN), f64::from(f32::MAX))?;
        check_frequency(frequency_hz)?;
        Refusal::check(Field::Duration, f64::from(measure_s), 0.0, 3_000.0)?;
        Refusal::check(Field::Duration, f64::from(lead_s), 0.0, 3_000.0)?;
        let (hz, rate_hz) = (f64::from(frequency_hz), f64::from(SERVO_HZ));
        let cycles = libm::ceil(hz * f64::from(measure_s)).max(1.0);
        let measured = libm::round(cycles * rate_hz / hz).min(MAX_TICKS);
        Ok(Tone {
            amplitude: f64::from(amplitude),
            phasor: Phasor::new(cycles / measured, 1.0),
            cycles: cycles as u32,
            measured_ticks: measured as u32,
            ticks: libm::round(f64::from(lead_s) * rate_hz) as u32 + measured as u32,
        })
    }

    /// Its frequency, Hz: as near to what was asked for as whole ticks allow.
    pub fn frequency_hz(&self) -> f64 {
        f64::from(self.cycles) * f64::from(SERVO_HZ) / f64::from(self.measured_ticks)
    }

    /// Ticks of the measured part.
    pub fn measured_ticks(&self) -> u32 {
        self.measured_ticks
    }

    /// Ticks of lead and measured part that are left.
    pub fn ticks(&self) -> u32 {
        self.ticks
    }

    /// This tick; nothing when the tone is over.
    #[inline]
    pub fn advance(&mut self) -> Option<TonePart> {
        let measuring = self.ticks <= self.measured_ticks;
        self.ticks = self.ticks.checked_sub(1)?;
        let pointer = self.phasor.advance();
        Some(TonePart { value: (self.amplitude * pointer.im) as f32, reference: measuring.then_some(pointer) })
    }
}

#[cfg(test)]
mod tests {
    use super::super::Correlator;
    use super::*;

    #[test]
    fn a_tone_is_near_what_is_asked_and_fits_in_whole_periods() {
        for hz in [1.0f32, 7.3, 100.0, 333.0, 1500.0] {
            let tone = Tone::new(1.0, hz, 0.25, 0.1).unwrap();
            assert!((tone.frequency_hz() / f64::from(hz) - 1.0).abs() < 2e-3, "{hz} Hz");
            assert!(f64::from(tone.measured_ticks()) / f64::from(SERVO_HZ) >= 0.2499);
            assert_eq!(tone.ticks(), tone.measured_ticks() + 800);
        }
    }

    #[test]
    fn gain_and_phase_of_what_answers_are_found_whatever_the_lead() {
        for lead_s in [0.0, 0.0373] {
            let mut tone = Tone::new(0.5, 73.0, 0.25, lead_s).unwrap();
            let mut correlator = Correlator::default();
            let mut before = 0.0;
            while let Some(part) = tone.advance() {
                // A gain of 3 with an offset, and the tick before.
                correlator.add(part.reference, [3.0 * part.value + 7.0, before, 0.0]);
                before = part.value;
            }
            let [gain, late, _] = correlator.amplitudes();
            assert_eq!(correlator.samples(), tone.measured_ticks());
            assert!((gain.re - 1.5).abs() < 1e-6 && gain.im.abs() < 1e-6, "{gain:?}");
            let angle = core::f64::consts::TAU * tone.frequency_hz() / f64::from(SERVO_HZ);
            let first = if lead_s == 0.0 { 2e-3 } else { 1e-6 };
            assert!((late.re - 0.5 * libm::cos(angle)).abs() < first, "{late:?}");
            assert!((late.im + 0.5 * libm::sin(angle)).abs() < first, "{late:?}");
        }
    }
}
