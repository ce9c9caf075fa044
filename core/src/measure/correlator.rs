//! A single bin of Fourier's transform, for three signals at once.

use super::phasor::Complex;

/// Sums up `x · e^(−jφ)` while a tone is measured.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Correlator {
    sums: [Complex; 3],
    samples: u32,
}

impl Correlator {
    /// Takes a tick in; without a reference (the lead) nothing happens.
    #[inline]
    pub fn add(&mut self, reference: Option<Complex>, signals: [f32; 3]) {
        let Some(pointer) = reference else { return };
        self.samples += 1;
        for (sum, signal) in self.sums.iter_mut().zip(signals) {
            let x = f64::from(signal);
            sum.re += x * pointer.im;
            sum.im += x * pointer.re;
        }
    }

    /// Amplitudes of the signals: real what is in phase with the tone, imaginary what leads it by 90°. Over a whole number of periods
    /// an offset and other multiples of the measurement's frequency do not show.
    pub fn amplitudes(&self) -> [Complex; 3] {
        let scale = 2.0 / f64::from(self.samples.max(1));
        self.sums.map(|sum| Complex { re: sum.re * scale, im: sum.im * scale })
    }

    /// Ticks taken in.
    pub fn samples(&self) -> u32 {
        self.samples
    }
}
