//! Sine and cosine of 1 Vpp: interpolation of the signal period, corrected, and fused with a coarse counter.
//!
//! ```text
//! cos code = mid + cos offset + A·cos φ
//! sin code = mid + sin offset + A·gain·sin(φ + phase)      φ = 2π · position / signal period
//! ```
//! Offsets, gain and phase that are not taken away (Heydemann) make the position wrong by a few nanometres that repeat with every signal
//! period. [`fit`] finds them from a move; [`Interpolator`] follows what drifts and says how much is left. The arctangent alone
//! repeats with every period and would be off by one at more than half a period per tick, 16 mm/s with 4 µm; the counter of the
//! comparators' edges, four a period, says which period it is.

use core::f64::consts::TAU;

use crate::math::atan2_turns;
use crate::position::Position;

pub mod fit;

pub use fit::{Fit, FitError};

/// Counts of a signal period. With [`crate::parameters`]' count of 61 pm: 4 µm.
pub const PERIOD_CT: i32 = 1 << 16;
/// Counts between two edges of the coarse counter.
const EDGE_CT: i64 = PERIOD_CT as i64 / 4;
/// Largest difference between the movements that counter and arctangent tell, counts. An edge at the one and at the other end of a tick
/// makes a quarter of a period; more than three eighths take a lost or invented edge, and half would be the next period.
const COUNTER_CT: i32 = PERIOD_CT * 3 / 8;
/// Code of a converter without signal.
const MID_CODE: f32 = 32_768.0;

/// What is sampled in one servo period, at one instant.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Sample {
    /// Code of the sine channel.
    pub sin: u16,
    /// Code of the cosine channel.
    pub cos: u16,
    /// Edges of both comparators, up and down; wraps.
    pub edges: u16,
}

impl Sample {
    /// From the 64 bits in which [`crate::axis::ServoSample`] carries every kind of encoder: sine in the highest 16, cosine in the next,
    /// edges in the lowest.
    #[inline]
    pub const fn from_bits(bits: u64) -> Self {
        Sample { sin: (bits >> 48) as u16, cos: (bits >> 32) as u16, edges: bits as u16 }
    }

    /// The inverse of [`Sample::from_bits`].
    #[inline]
    pub const fn to_bits(self) -> u64 {
        (self.sin as u64) << 48 | (self.cos as u64) << 32 | self.edges as u64
    }
}

/// Why a sample was not used.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum SampleError {
    /// The amplitude is below its window: signal lost, dirt on the scale, a broken wire.
    TooSmall,
    /// The amplitude is above its window: a converter at its end, a short circuit.
    TooLarge,
    /// Counter and arctangent do not tell the same movement.
    Counter,
}

/// The signals as they are, in a person's units.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Signals {
    /// Amplitude A of the cosine as a share of half the converter's range.
    pub amplitude: f64,
    /// Offset of the cosine as a share of A.
    pub cos_offset: f64,
    /// Offset of the sine as a share of A.
    pub sin_offset: f64,
    /// Amplitude of the sine as a share of A.
    pub gain: f64,
    /// What the sine is ahead of its 90°, rad.
    pub phase_rad: f64,
}

/// What makes codes a point on the unit circle: `x = (cos − c)·k`, `y = (sin − s)·m + n·x`.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Correction {
    cos_code: f32,
    sin_code: f32,
    cos_per_code: f32,
    sin_per_code: f32,
    cross: f32,
}

impl Correction {
    /// The inverse of what [`Signals`] says.
    pub fn new(signals: &Signals) -> Self {
        let amplitude_code = f64::from(MID_CODE) * signals.amplitude;
        Correction {
            cos_code: (f64::from(MID_CODE) + amplitude_code * signals.cos_offset) as f32,
            sin_code: (f64::from(MID_CODE) + amplitude_code * signals.sin_offset) as f32,
            cos_per_code: (1.0 / amplitude_code) as f32,
            sin_per_code: (1.0 / (amplitude_code * signals.gain * libm::cos(signals.phase_rad))) as f32,
            cross: -libm::tan(signals.phase_rad) as f32,
        }
    }

    /// Cosine and sine of a sample, corrected.
    #[inline]
    pub fn apply(&self, sample: Sample) -> [f32; 2] {
        let x = (f32::from(sample.cos) - self.cos_code) * self.cos_per_code;
        [x, (f32::from(sample.sin) - self.sin_code) * self.sin_per_code + self.cross * x]
    }

    /// Takes a share of what is left away.
    fn improve(&mut self, left: &Residual, share: f32) {
        let [dx, dy, stretch, shear, size] =
            [left.cos_offset, left.sin_offset, left.stretch, left.shear, left.size].map(|part| share * part);
        self.cos_code += dx / self.cos_per_code;
        self.sin_code += (dy - self.cross * dx) / self.sin_per_code;
        self.cos_per_code *= 1.0 - stretch - size;
        self.sin_per_code *= 1.0 + stretch - size;
        self.cross = self.cross * (1.0 + 2.0 * stretch) - shear;
    }
}

/// Coefficients of the interpolation.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Coefficients {
    /// Where the correction begins.
    pub correction: Correction,
    /// Square of the smallest amplitude, of the nominal one.
    pub least2: f32,
    /// Square of the largest amplitude, of the nominal one.
    pub most2: f32,
}

/// What is left on the corrected circle, to first order: `x = (1 + size + stretch)·cos φ + cos_offset`,
/// `y = (1 + size − stretch)·sin φ + shear·cos φ + sin_offset`.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
struct Residual {
    cos_offset: f32,
    sin_offset: f32,
    stretch: f32,
    shear: f32,
    size: f32,
}

/// Directions into which a turn is divided.
const OCTANTS: usize = 8;
/// Samples of each octant that make an estimate.
const SAMPLES: u16 = 32;
/// Movement from one sample that is looked at to the next, counts: a whole period gives 64. At rest nothing is learnt.
const APART_CT: u32 = PERIOD_CT as u32 / 64;
/// Share of an estimate by which the correction follows: half a second of motion.
const SHARE: f32 = 1.0 / 16.0;
/// Cosine and sine of the middles of the octants.
const MIDDLES: [[f32; 2]; OCTANTS] = {
    const C: f32 = 0.923_879_5; // cos 22.5°
    const S: f32 = 0.382_683_43;
    [[C, S], [S, C], [-S, C], [-C, S], [-C, -S], [-S, -C], [S, -C], [C, -S]]
};
/// What the mean over an octant leaves of a first and of a second harmonic: sin(π/8)/(π/8) and sin(π/4)/(π/4).
const LEFT_OF: [f32; 2] = [0.974_495_4, 0.900_316_3];

/// Learns from the radius, octant by octant, how far the corrected signals are from a circle.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
struct Circle {
    /// Sums of the squared radius less 1.
    sum: [f32; OCTANTS],
    samples: [u16; OCTANTS],
    full: u8,
}

impl Circle {
    /// Takes in a sample; what is left, whenever enough of every octant have been seen.
    #[inline]
    fn take(&mut self, phase_ct: u16, excess: f32) -> Option<Residual> {
        let octant = usize::from(phase_ct >> 13);
        if self.samples[octant] == SAMPLES {
            return None;
        }
        self.samples[octant] += 1;
        self.sum[octant] += excess;
        self.full += u8::from(self.samples[octant] == SAMPLES);
        (usize::from(self.full) == OCTANTS).then(|| core::mem::take(self).residual())
    }

    /// `radius² − 1 = 2·(size + cos_offset·cos φ + sin_offset·sin φ + stretch·cos 2φ + shear/2·sin 2φ)`.
    #[inline(never)]
    fn residual(&self) -> Residual {
        let mut left = Residual::default();
        for (sum, [c, s]) in self.sum.iter().zip(MIDDLES) {
            let mean = sum / f32::from(SAMPLES) / OCTANTS as f32;
            left.size += 0.5 * mean;
            left.cos_offset += mean * c / LEFT_OF[0];
            left.sin_offset += mean * s / LEFT_OF[0];
            left.stretch += mean * (c * c - s * s) / LEFT_OF[1];
            left.shear += mean * 4.0 * c * s / LEFT_OF[1];
        }
        left
    }
}

/// From samples to positions: the correction in use, what it is worth, and what has been collected for a better one.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Interpolator {
    /// `None` until the first sample: begin with the coefficients'.
    correction: Option<Correction>,
    /// Edges at the last good sample.
    edges: u16,
    /// Position that was last looked at.
    looked_at: Position,
    circle: Circle,
    /// Estimated sub-divisional error, periods; `None` before the first estimate.
    error_periods: Option<f32>,
    fit: Option<Fit>,
}

impl Interpolator {
    /// The position of a sample; `before` is that of the last good one, `None` if there is none to go on from. Positions then begin
    /// within half a signal period of 0.
    ///
    /// # Errors
    /// See [`SampleError`]; nothing has changed then.
    #[inline(never)]
    pub fn update(
        &mut self,
        k: &Coefficients,
        sample: Sample,
        before: Option<Position>,
    ) -> Result<Position, SampleError> {
        let correction = self.correction.get_or_insert(k.correction);
        let [x, y] = correction.apply(sample);
        let radius2 = x * x + y * y;
        if radius2 < k.least2 {
            return Err(SampleError::TooSmall);
        }
        if radius2 > k.most2 {
            return Err(SampleError::TooLarge);
        }
        let turns = atan2_turns(y, x);
        let phase_ct = (turns * PERIOD_CT as f32 + if turns < 0.0 { -0.5 } else { 0.5 }) as i32 as i16;
        let position = match before {
            None => Position(i64::from(phase_ct)),
            Some(before) => {
                let edges = sample.edges.wrapping_sub(self.edges) as i16;
                let told = before.plus(i64::from(edges) * EDGE_CT);
                // The nearest position with this phase.
                let off_ct = phase_ct.wrapping_sub(told.0 as i16);
                if i32::from(off_ct).abs() > COUNTER_CT {
                    return Err(SampleError::Counter);
                }
                told.plus(i64::from(off_ct))
            }
        };
        self.edges = sample.edges;
        if position.minus(self.looked_at).unsigned_abs() >= APART_CT {
            self.looked_at = position;
            if let Some(left) = self.circle.take(phase_ct as u16, radius2 - 1.0) {
                correction.improve(&left, SHARE);
                self.error_periods = Some(left.error_periods());
            }
            if let Some(fit) = &mut self.fit {
                fit.take(sample);
            }
        }
        Ok(position)
    }

    /// Estimated sub-divisional error, peak, as a share of the signal period: what the corrected signals lack to be a circle, seen over
    /// the last few hundred samples in motion. `None` before that many. Higher harmonics than offsets, gain and phase make are not in it.
    pub fn error_periods(&self) -> Option<f32> {
        self.error_periods
    }

    /// Corrects in this way from the next sample on; what has been learnt of the one before is forgotten.
    pub fn correct(&mut self, correction: Correction) {
        let Interpolator { edges, looked_at, .. } = *self;
        *self = Interpolator { correction: Some(correction), edges, looked_at, ..Interpolator::default() };
    }

    /// Starts to collect for a new correction.
    pub fn collect(&mut self) {
        self.fit = Some(Fit::default());
    }

    /// What has been collected since [`Interpolator::collect`].
    pub fn fit(&self) -> Option<&Fit> {
        self.fit.as_ref()
    }
}

impl Residual {
    /// What is seen along the radius is there along the circumference as well, a quarter of its own period further on.
    fn error_periods(&self) -> f32 {
        let first = libm::sqrtf(self.cos_offset * self.cos_offset + self.sin_offset * self.sin_offset);
        let second = libm::sqrtf(self.stretch * self.stretch + 0.25 * self.shear * self.shear);
        (first + second) / TAU as f32
    }
}
