//! Excitation and measurement: what is added to force or velocity while the loops are closed, and what it is compared with.
//!
//! Generators give one value a tick and compute with a rotating phasor: no trigonometry in the tick. The unit is the caller's: N
//! at the force summing node, m/s at the velocity summing node. All of it is plain state without hardware.
//!
//! | | | thesis |
//! |---|---|---|
//! | [`DecayingSine`] | identification profile | 5.4 |
//! | [`Tone`], [`Correlator`] | one frequency of a stepped sine, and what answers at it | 5.1 |
//! | [`Pulse`] | step and back | 5.3 |
//! | [`Bounds`] | what ends an excitation | |
//! | [`Excitation`] | one of them in the drive, and what it finds | |

mod correlator;
mod decaying_sine;
mod excitation;
mod phasor;
mod tone;
mod watch;

pub use correlator::Correlator;
pub use decaying_sine::{DecayingSine, MAX_PERIODS};
pub use excitation::{Added, Excitation, Node, Order, Progress, Reading, Request, Shape};
pub use phasor::{Complex, Phasor};
pub use tone::{Tone, TonePart};
pub use watch::{Bounds, Exceeded, Motion};

use crate::SERVO_HZ;
use crate::refusal::{Field, Refusal};

/// Lowest frequency of an excitation, Hz.
pub const MIN_HZ: f32 = 0.1;
/// Highest frequency of an excitation, Hz: a tenth below the half of the servo rate.
pub const MAX_HZ: f32 = 0.45 * SERVO_HZ as f32;

/// A constant value for some ticks, then nothing.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Pulse {
    /// The value, in the caller's unit.
    pub amplitude: f32,
    /// Ticks that are left.
    pub ticks: u32,
}

impl Pulse {
    /// The value in this tick; nothing when it is over.
    #[inline]
    pub fn advance(&mut self) -> Option<f32> {
        self.ticks = self.ticks.checked_sub(1)?;
        Some(self.amplitude)
    }
}

fn check_frequency(frequency_hz: f32) -> Result<(), Refusal> {
    Refusal::check(Field::Frequency, f64::from(frequency_hz), f64::from(MIN_HZ), f64::from(MAX_HZ)).map(|_| ())
}
