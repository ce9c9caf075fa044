//! Filters without phase, and the noise of a signal.

use std::f64::consts::{FRAC_1_SQRT_2, PI};

/// A low-pass filter of second order (Butterworth), run forwards and backwards: no phase, `1/(1 + (f/corner)⁴)`.
///
/// # Source
/// 4.1: acausal filtering is what makes the second difference of a position usable.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LowPass {
    corner_hz: f64,
    sample_s: f64,
    b: [f64; 3],
    a: [f64; 2],
}

impl LowPass {
    /// Half of the amplitude passes at `corner_hz`; limited to 1e-6..=0.45 of the sampling rate.
    pub fn new(corner_hz: f64, sample_s: f64) -> LowPass {
        let relative = (corner_hz * sample_s).clamp(1e-6, 0.45);
        let warped = libm::tan(PI * relative);
        let norm = 1.0 / (1.0 + 2.0 * FRAC_1_SQRT_2 * warped + warped * warped);
        let gain = warped * warped * norm;
        LowPass {
            corner_hz: relative / sample_s,
            sample_s,
            b: [gain, 2.0 * gain, gain],
            a: [2.0 * (warped * warped - 1.0) * norm, (1.0 - 2.0 * FRAC_1_SQRT_2 * warped + warped * warped) * norm],
        }
    }

    /// Where half of the amplitude passes, Hz.
    pub fn corner_hz(&self) -> f64 {
        self.corner_hz
    }

    /// Samples after which one sample is forgotten.
    fn reach(&self) -> usize {
        (4.0 / (self.corner_hz * self.sample_s)) as usize + 3
    }

    /// The filtered signal. Beyond both ends the signal is continued by its mirror image through its last value.
    pub fn apply(&self, signal: &[f64]) -> Vec<f64> {
        let Some(last) = signal.len().checked_sub(1) else { return Vec::new() };
        let pad = self.reach().min(last);
        let before = (1..=pad).rev().map(|i| 2.0 * signal[0] - signal[i]);
        let after = (1..=pad).map(|i| 2.0 * signal[last] - signal[last - i]);
        let mut padded: Vec<f64> = before.chain(signal.iter().copied()).chain(after).collect();
        self.pass(padded.iter_mut());
        self.pass(padded.iter_mut().rev());
        padded.drain(..pad);
        padded.truncate(signal.len());
        padded
    }

    /// One direction, in the steady state of the first value.
    fn pass<'a>(&self, signal: impl Iterator<Item = &'a mut f64>) {
        let ([b0, b1, b2], [a1, a2]) = (self.b, self.a);
        let mut state: Option<[f64; 2]> = None;
        for value in signal {
            let x = *value;
            let [s1, s2] = state.unwrap_or([x * (1.0 - b0), x * (b2 - a2)]);
            let y = b0 * x + s1;
            state = Some([b1 * x - a1 * y + s2, b2 * x - a2 * y]);
            *value = y;
        }
    }
}

/// Second derivative by central differences, 1/s² of the signal's unit; the ends repeat their neighbours.
pub fn second_derivative(signal: &[f64], sample_s: f64) -> Vec<f64> {
    let per_s2 = 1.0 / (sample_s * sample_s);
    central(signal, |before, here, after| (before - 2.0 * here + after) * per_s2)
}

/// First derivative by central differences, 1/s of the signal's unit; the ends repeat their neighbours.
pub fn derivative(signal: &[f64], sample_s: f64) -> Vec<f64> {
    let per_s = 0.5 / sample_s;
    central(signal, |before, _, after| (after - before) * per_s)
}

fn central(signal: &[f64], of: impl Fn(f64, f64, f64) -> f64) -> Vec<f64> {
    let mut inner: Vec<f64> = signal.windows(3).map(|w| of(w[0], w[1], w[2])).collect();
    match (inner.first().copied(), inner.last().copied()) {
        (Some(first), Some(last)) => {
            inner.insert(0, first);
            inner.push(last);
            inner
        }
        _ => vec![0.0; signal.len()],
    }
}

/// White noise of a signal that is otherwise smooth, rms, from its third differences: the median does not see the few
/// places where the signal bends.
pub fn noise_rms(signal: &[f64]) -> f64 {
    // Var of the third difference of white noise: 1 + 9 + 9 + 1.
    median(signal.windows(4).map(|w| (w[3] - 3.0 * w[2] + 3.0 * w[1] - w[0]).abs()).collect())
        / (NORMAL_MEDIAN * libm::sqrt(20.0))
}

/// Median absolute value of the standard normal distribution.
const NORMAL_MEDIAN: f64 = 0.674_489_750_196_082;

/// The median; 0 of nothing.
pub(crate) fn median(mut values: Vec<f64>) -> f64 {
    if values.is_empty() {
        return 0.0;
    }
    let middle = values.len() / 2;
    *values.select_nth_unstable_by(middle, f64::total_cmp).1
}

/// A signal without as much of its noise as can be taken away.
#[derive(Clone, Debug, PartialEq)]
pub struct Denoised {
    /// What is left.
    pub signal: Vec<f64>,
    /// White noise before, rms.
    pub noise_before: f64,
    /// Noise that is left, rms.
    pub noise_rms: f64,
}

/// As much smoothing as the noise allows: an octave above the lowest corner, in steps of a factor √2, at which what the filter takes
/// away is not more than white noise of [`noise_rms`] would lose. What is taken from the signal falls with the fourth power of the
/// corner, what is left of the noise rises with its root.
///
/// A signal without noise comes back as it is.
pub fn denoised(signal: &[f64], sample_s: f64) -> Denoised {
    let noise_before = noise_rms(signal);
    let filtered = |corner: f64| LowPass::new(corner / sample_s, sample_s).apply(signal);
    let only_noise = |corner: f64| {
        let taken = signal.iter().zip(&filtered(corner)).map(|(a, b)| (a - b) * (a - b)).sum::<f64>();
        taken <= TAKEN_MAX * noise_before * noise_before * signal.len() as f64
    };
    let mut corner = HIGHEST_CORNER;
    while corner * signal.len() as f64 > 4.0 && only_noise(corner) {
        corner *= FRAC_1_SQRT_2;
    }
    corner *= OCTAVES_BACK;
    if corner > HIGHEST_CORNER {
        return Denoised { signal: signal.to_vec(), noise_before, noise_rms: noise_before };
    }
    let share = (2.0 * NOISE_BANDWIDTH * corner).min(1.0);
    Denoised { signal: filtered(corner), noise_before, noise_rms: noise_before * libm::sqrt(share) }
}

/// The highest corner that is tried, as a share of the sampling rate.
const HIGHEST_CORNER: f64 = 0.25;
/// From the first corner that takes too much, back to one that takes less than a hundredth of it: three half octaves.
const OCTAVES_BACK: f64 = 2.0 * std::f64::consts::SQRT_2;

/// `∫ du / (1 + u⁴)²` from 0 to infinity: bandwidth that white noise sees, in corners.
const NOISE_BANDWIDTH: f64 = 0.833;

/// Square of what smoothing may take away, in squares of the noise: all of it, and two per cent for the error of the estimate.
const TAKEN_MAX: f64 = 1.02;

#[cfg(test)]
mod tests {
    use super::*;
    use servo_sim::random::{Noise, Purpose};

    const SAMPLE_S: f64 = 125e-6;

    fn sine(hz: f64, samples: usize) -> Vec<f64> {
        (0..samples).map(|i| libm::sin(2.0 * PI * hz * SAMPLE_S * i as f64)).collect()
    }

    fn amplitude(signal: &[f64], hz: f64) -> (f64, f64) {
        let (mut re, mut im) = (0.0, 0.0);
        for (i, x) in signal.iter().enumerate() {
            let (sin, cos) = libm::sincos(2.0 * PI * hz * SAMPLE_S * i as f64);
            (re, im) = (re + x * sin, im + x * cos);
        }
        let scale = 2.0 / signal.len() as f64;
        (re * scale, im * scale)
    }

    #[test]
    fn amplitude_is_that_of_the_fourth_order_and_phase_is_none() {
        let filter = LowPass::new(200.0, SAMPLE_S);
        for hz in [10.0, 50.0, 100.0, 200.0, 400.0, 800.0] {
            let passed = filter.apply(&sine(hz, 16_000));
            let (in_phase, quadrature) = amplitude(&passed[4_000..12_000], hz);
            let warp = libm::tan(PI * hz * SAMPLE_S) / libm::tan(PI * 200.0 * SAMPLE_S);
            assert!((in_phase - 1.0 / (1.0 + warp.powi(4))).abs() < 1e-6, "{hz} Hz: {in_phase}");
            assert!(quadrature.abs() < 1e-6, "{hz} Hz: {quadrature}");
        }
    }

    #[test]
    fn straight_lines_pass_unchanged_to_their_ends() {
        let line: Vec<f64> = (0..5_000).map(|i| 3.0 - 0.01 * f64::from(i)).collect();
        for corner_hz in [20.0, 300.0, 3_000.0] {
            for (passed, exact) in LowPass::new(corner_hz, SAMPLE_S).apply(&line).iter().zip(&line) {
                assert!((passed - exact).abs() < 1e-5, "{corner_hz} Hz: {passed} {exact}");
            }
        }
    }

    #[test]
    fn derivatives_of_a_parabola_are_exact() {
        let parabola: Vec<f64> = (0..50).map(|i| 2.0 * (f64::from(i) * SAMPLE_S).powi(2)).collect();
        let (first, second) = (derivative(&parabola, SAMPLE_S), second_derivative(&parabola, SAMPLE_S));
        assert_eq!((first.len(), second.len()), (50, 50));
        assert!(second.iter().all(|a| (a - 4.0).abs() < 1e-6));
        assert!((first[20] - 4.0 * 20.0 * SAMPLE_S).abs() < 1e-9);
    }

    #[test]
    fn the_noise_of_a_sine_is_found_and_mostly_taken_away() {
        let mut noise = Noise::new(1, Purpose::Encoder, 0);
        let clean: Vec<f64> = sine(16.0, 8_000).iter().map(|x| x * 1e-6).collect();
        let noisy: Vec<f64> = clean.iter().map(|x| x + 0.44e-9 * noise.normal()).collect();
        let estimate = noise_rms(&noisy);
        assert!((estimate / 0.44e-9 - 1.0).abs() < 0.05, "{estimate}");
        let smooth = denoised(&noisy, SAMPLE_S);
        let left = smooth.signal.iter().zip(&clean).map(|(a, b)| (a - b).powi(2)).sum::<f64>();
        let left = libm::sqrt(left / 8_000.0);
        assert!(left < 0.44e-9 / 3.0, "{left}");
        assert!((smooth.noise_rms / left - 1.0).abs() < 0.3, "{} {left}", smooth.noise_rms);
    }

    #[test]
    fn without_noise_nothing_is_taken_away() {
        let clean = sine(16.0, 8_000);
        let smooth = denoised(&clean, SAMPLE_S);
        assert!(smooth.signal.iter().zip(&clean).all(|(a, b)| (a - b).abs() < 1e-5));
    }
}
