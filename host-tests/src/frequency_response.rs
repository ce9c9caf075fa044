//! Loop transmission by stepped sine, measured at the summing node of the current set-point.
//!
//! A sine joins the drive's set-point; what the drive answers and the sum of both are correlated with it, one frequency at a time.
//! Their ratio, with the opposite sign, is the loop transmission, whatever the loop does to the sine. It is a describing function:
//! where friction takes part it depends on the amplitude (5.1, 8.2).

use std::f64::consts::TAU;

use servo_core::SERVO_HZ;
use servo_core::refusal::Refusal;
use servo_core::state::State;

use crate::FastBench;

/// A complex number.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Complex {
    /// Real part.
    pub re: f64,
    /// Imaginary part.
    pub im: f64,
}

impl Complex {
    /// Absolute value.
    pub fn abs(self) -> f64 {
        libm::hypot(self.re, self.im)
    }

    /// Angle, degrees, −180 to 180.
    pub fn degrees(self) -> f64 {
        libm::atan2(self.im, self.re).to_degrees()
    }
}

impl std::ops::Div for Complex {
    type Output = Complex;

    fn div(self, by: Complex) -> Complex {
        let size = by.re * by.re + by.im * by.im;
        Complex { re: (self.re * by.re + self.im * by.im) / size, im: (self.im * by.re - self.re * by.im) / size }
    }
}

impl std::ops::Neg for Complex {
    type Output = Complex;

    fn neg(self) -> Complex {
        Complex { re: -self.re, im: -self.im }
    }
}

/// Correlation of samples with one frequency: `Σ x[n] e^(−j 2π cycles n / N)` over all `N` of them, times 2/N: the amplitude and
/// phase of a sine that fits a whole number of times.
pub fn single_bin(samples: impl ExactSizeIterator<Item = f64>, cycles: u32) -> Complex {
    let count = samples.len() as f64;
    let per_sample = TAU * f64::from(cycles) / count;
    let sum = samples.enumerate().fold(Complex::default(), |sum, (n, x)| {
        let (sin, cos) = libm::sincos(per_sample * n as f64);
        Complex { re: sum.re + x * cos, im: sum.im - x * sin }
    });
    Complex { re: sum.re * 2.0 / count, im: sum.im * 2.0 / count }
}

/// One frequency of a stepped sine.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tone {
    /// Periods measured.
    pub cycles: u32,
    /// Ticks measured: a whole number of periods.
    pub ticks: u32,
    /// Amplitude of the sine, A.
    pub amplitude_a: f64,
}

impl Tone {
    /// The tone nearest to `frequency_hz` (above 0, below half the servo rate) that fits into at least `shortest_s`.
    pub fn near(frequency_hz: f64, amplitude_a: f64, shortest_s: f64) -> Tone {
        let cycles = (frequency_hz * shortest_s).ceil().max(1.0);
        let ticks = (cycles * f64::from(SERVO_HZ) / frequency_hz).round();
        Tone { cycles: cycles as u32, ticks: ticks as u32, amplitude_a }
    }

    /// Its frequency, Hz.
    pub fn frequency_hz(&self) -> f64 {
        f64::from(self.cycles) * f64::from(SERVO_HZ) / f64::from(self.ticks)
    }

    fn at(&self, tick: u32) -> f64 {
        self.amplitude_a * libm::sin(TAU * f64::from(self.cycles) * f64::from(tick) / f64::from(self.ticks))
    }
}

/// What a tone gave.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Response {
    /// Frequency, Hz.
    pub frequency_hz: f64,
    /// Loop transmission.
    pub loop_transmission: Complex,
    /// Amplitude of the position, m.
    pub position_m: f64,
}

/// Plays a tone on an enabled bench, after `settle_ticks` ticks of the same tone.
///
/// # Errors
/// `WrongState` if the drive leaves Operation enabled: the loop is unstable, or the tone too strong for its limits.
pub fn play(bench: &mut FastBench, tone: &Tone, settle_ticks: u32) -> Result<Response, Refusal> {
    let count = tone.ticks as usize;
    let (mut answer_a, mut sum_a, mut position_m) =
        (Vec::with_capacity(count), Vec::with_capacity(count), Vec::with_capacity(count));
    // The measured part begins at a whole period.
    let lead = settle_ticks.next_multiple_of(tone.ticks);
    for tick in (lead - settle_ticks.min(lead))..(lead + tone.ticks) {
        let added_a = tone.at(tick % tone.ticks);
        let output = bench.tick_disturbed(None, added_a);
        if output.record.state != State::OperationEnabled {
            return Err(Refusal::WrongState(output.record.state));
        }
        if tick >= lead {
            let drive_a = f64::from(output.record.iq_set_a);
            answer_a.push(drive_a);
            sum_a.push(drive_a + added_a);
            position_m.push(bench.carriage.position_m());
        }
    }
    let bin = |samples: Vec<f64>| single_bin(samples.into_iter(), tone.cycles);
    Ok(Response {
        frequency_hz: tone.frequency_hz(),
        loop_transmission: -(bin(answer_a) / bin(sum_a)),
        position_m: bin(position_m).abs(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tuning::{self, Tuning};
    use servo_sim::Stage;

    #[test]
    fn a_sine_is_found_with_amplitude_and_phase_and_its_neighbours_are_not() {
        let wave = |cycles: f64| (0..800).map(move |n| 3.0 * (TAU * cycles * f64::from(n) / 800.0 + 0.4).sin());
        let found = single_bin(wave(7.0).collect::<Vec<_>>().into_iter(), 7);
        assert!((found.abs() - 3.0).abs() < 1e-12);
        // A sine is a cosine 90° later.
        assert!((found.degrees() - (0.4f64.to_degrees() - 90.0)).abs() < 1e-9);
        for other in [1.0, 6.0, 8.0, 20.0] {
            assert!(single_bin(wave(other).collect::<Vec<_>>().into_iter(), 7).abs() < 1e-12);
        }
    }

    #[test]
    fn a_tone_is_near_what_is_asked_and_fits_in_whole_periods() {
        for hz in [1.0, 7.3, 100.0, 333.0, 1500.0] {
            let tone = Tone::near(hz, 1.0, 0.25);
            assert!((tone.frequency_hz() / hz - 1.0).abs() < 2e-3, "{hz} Hz");
            assert!(f64::from(tone.ticks) / f64::from(SERVO_HZ) >= 0.2499);
        }
    }

    /// On a mass without friction the loop must be what the gains were computed for: `|L| = 1` and the phase margin at crossover.
    #[test]
    fn without_friction_the_measured_loop_is_the_tuned_one() {
        let mut stage = Stage::default();
        (stage.friction.coulomb_n, stage.encoder.noise_m_rms) = (2e-3, 0.0);
        for tuned in [tuning::STANDARD, tuning::HIGH_PERFORMANCE] {
            let Tuning { crossover_hz, phase_margin_deg, .. } = tuned;
            let settings = tuning::settings(&stage, &tuned).unwrap();
            let mut bench = FastBench::new(&stage, &settings, 1).unwrap();
            bench.enable().unwrap();
            let tone = Tone::near(crossover_hz, 0.5, 0.5);
            let response = play(&mut bench, &tone, 2000).unwrap().loop_transmission;
            let margin_deg = 180.0 + response.degrees();
            println!("{crossover_hz} Hz: {} {margin_deg}", response.abs());
            assert!((response.abs() - 1.0).abs() < 0.1, "{crossover_hz} Hz: {}", response.abs());
            assert!((margin_deg - phase_margin_deg).abs() < 6.0, "{crossover_hz} Hz: {margin_deg}°");
        }
    }
}
