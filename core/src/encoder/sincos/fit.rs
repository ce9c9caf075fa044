//! Offsets, gain and phase from a move: least squares of an ellipse (Heydemann).

use super::{MID_CODE, OCTANTS, Sample, Signals};

/// Samples that each octant of the ellipse needs.
pub const SAMPLES_PER_OCTANT: u16 = 32;
/// More samples add nothing.
const MOST_SAMPLES: u32 = 16_384;
/// Largest mean square of `radius² − 1`: the radius spreads by 5 %.
const MISFIT: f64 = 0.01;
/// Powers of cosine and sine, up to the fourth order: what the normal equations are made of.
const MOMENTS: [(usize, usize); 14] =
    [(1, 0), (0, 1), (2, 0), (1, 1), (0, 2), (3, 0), (2, 1), (1, 2), (0, 3), (4, 0), (3, 1), (2, 2), (1, 3), (0, 4)];
/// Terms of the conic `Σ w·cos^i·sin^j = 1`.
const TERMS: [(usize, usize); 5] = [(2, 0), (1, 1), (0, 2), (1, 0), (0, 1)];

/// Why there is no correction.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum FitError {
    /// The move has not shown enough of the ellipse: of `octant` (0 to 7) only so many `samples`.
    TooFewSamples {
        /// Octant of the ellipse that has been seen least.
        octant: u8,
        /// Samples in it.
        samples: u16,
    },
    /// The signals are no ellipse, or one that is no encoder's: phase beyond 30°, amplitudes twice as large as each other, or points
    /// that are 5 % off.
    NoEllipse,
}

impl core::fmt::Display for FitError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            FitError::TooFewSamples { octant, samples } => write!(
                f,
                "octant {octant} of the signal period has {samples} samples, {SAMPLES_PER_OCTANT} are needed: move further"
            ),
            FitError::NoEllipse => f.write_str("sine and cosine are no ellipse: check both channels and their wiring"),
        }
    }
}

impl core::error::Error for FitError {}

/// Sums over the samples of a move.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Fit {
    samples: u32,
    octants: [u16; OCTANTS],
    sums: [f64; MOMENTS.len()],
}

impl Fit {
    /// Takes in a sample; the first 16384 count.
    #[inline]
    pub fn take(&mut self, sample: Sample) {
        if self.samples == MOST_SAMPLES {
            return;
        }
        let normal = |code: u16| f64::from(code) / f64::from(MID_CODE) - 1.0;
        let (c, s) = (normal(sample.cos), normal(sample.sin));
        self.samples += 1;
        let octant = usize::from(s < 0.0) << 2 | usize::from(c < 0.0) << 1 | usize::from(s.abs() > c.abs());
        self.octants[octant] = self.octants[octant].saturating_add(1);
        let (c2, cs, s2) = (c * c, c * s, s * s);
        let powers = [c, s, c2, cs, s2, c2 * c, c2 * s, c * s2, s2 * s, c2 * c2, c2 * cs, c2 * s2, cs * s2, s2 * s2];
        self.sums.iter_mut().zip(powers).for_each(|(sum, power)| *sum += power);
    }

    /// Samples so far.
    pub fn samples(&self) -> u32 {
        self.samples
    }

    /// The signals whose ellipse is nearest to the samples. Not for the tick: some thousand instructions.
    ///
    /// # Errors
    /// Too little of the ellipse has been seen, or it is none; see [`FitError`].
    pub fn solve(&self) -> Result<Signals, FitError> {
        let seen_least = (0..).zip(self.octants).min_by_key(|(_, samples)| *samples);
        if let Some((octant, samples)) = seen_least.filter(|(_, samples)| *samples < SAMPLES_PER_OCTANT) {
            return Err(FitError::TooFewSamples { octant, samples });
        }
        let moment = |power: (usize, usize)| {
            let index = MOMENTS.iter().position(|m| *m == power);
            index.map_or(0.0, |i| self.sums[i] / f64::from(self.samples))
        };
        let mut rows = TERMS.map(|(i, j)| {
            let [a, b, c, d, e] = TERMS.map(|(k, l)| moment((i + k, j + l)));
            [a, b, c, d, e, moment((i, j))]
        });
        let weights = solve(&mut rows).ok_or(FitError::NoEllipse)?;
        // Mean square of what the equation lacks of 1; four times that of the radius.
        let misfit = 1.0 - weights.iter().zip(TERMS).map(|(weight, term)| weight * moment(term)).sum::<f64>();
        let [a, half_b, c, d, e] = [weights[0], 0.5 * weights[1], weights[2], weights[3], weights[4]];
        let determinant = a * c - half_b * half_b;
        // Centre: where the gradient is nothing. `1 + a·u² + b·u·v + c·v²` there scales the quadratic form to 1 on the ellipse.
        let u = 0.5 * (half_b * e - c * d) / determinant;
        let v = 0.5 * (half_b * d - a * e) / determinant;
        let scale = 1.0 / (1.0 + a * u * u + 2.0 * half_b * u * v + c * v * v);
        let [a, half_b, c] = [a, half_b, c].map(|w| w * scale);
        let sin_phase = -half_b / libm::sqrt(a * c);
        let gain = libm::sqrt(a / c);
        // Written so that not a number is none as well.
        if !(a > 0.0 && sin_phase.abs() < 0.5 && (0.5..=2.0).contains(&gain) && misfit < MISFIT) {
            return Err(FitError::NoEllipse);
        }
        let amplitude = 1.0 / libm::sqrt(a * (1.0 - sin_phase * sin_phase));
        Ok(Signals {
            amplitude,
            cos_offset: u / amplitude,
            sin_offset: v / amplitude,
            gain,
            phase_rad: libm::asin(sin_phase),
        })
    }
}

/// Solves five equations, the right side in the last column; `None` if they do not determine the five.
fn solve(rows: &mut [[f64; 6]; 5]) -> Option<[f64; 5]> {
    for pivot in 0..5 {
        let largest = (pivot..5).max_by(|a, b| rows[*a][pivot].abs().total_cmp(&rows[*b][pivot].abs()))?;
        rows.swap(pivot, largest);
        let top = rows[pivot];
        if top[pivot].abs() < 1e-12 {
            return None;
        }
        for (index, row) in rows.iter_mut().enumerate() {
            if index != pivot {
                let factor = row[pivot] / top[pivot];
                row.iter_mut().zip(top).for_each(|(to, from)| *to -= factor * from);
            }
        }
    }
    let mut solution = [0.0; 5];
    for (index, row) in rows.iter().enumerate() {
        solution[index] = row[5] / row[index];
    }
    Some(solution)
}
