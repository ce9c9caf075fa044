//! What ends an excitation before harm is done.

use crate::position::Position;

/// Limits while an excitation acts.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Bounds {
    /// Largest distance from where it began, counts.
    pub travel_ct: u32,
    /// Largest way in a tick, counts.
    pub speed_ct_per_tick: u32,
    /// Largest current, A.
    pub current_a: f32,
}

/// How the axis moves in a tick.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Motion {
    /// Where the excitation began.
    pub start: Position,
    /// Where the axis is.
    pub position: Position,
    /// Way since the last tick, counts.
    pub step_ct: i32,
    /// Measured current, A.
    pub iq_a: f32,
}

/// A limit that was exceeded.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Exceeded {
    /// Distance from the start.
    Travel,
    /// Speed.
    Speed,
    /// Current; also if it is not a number.
    Current,
}

impl Bounds {
    /// The first limit that `motion` exceeds.
    #[inline]
    pub fn exceeded(&self, motion: &Motion) -> Option<Exceeded> {
        let from_start_ct = motion.position.minus(motion.start);
        if from_start_ct.unsigned_abs() > self.travel_ct {
            Some(Exceeded::Travel)
        } else if motion.step_ct.unsigned_abs() > self.speed_ct_per_tick {
            Some(Exceeded::Speed)
        } else if motion.iq_a.abs() <= self.current_a {
            None
        } else {
            Some(Exceeded::Current)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_limit_ends_it_in_both_directions_and_no_sooner() {
        let bounds = Bounds { travel_ct: 100, speed_ct_per_tick: 10, current_a: 2.0 };
        let at = |ct: i64, step_ct: i32, iq_a: f32| {
            bounds.exceeded(&Motion { start: Position(1_000), position: Position(1_000 + ct), step_ct, iq_a })
        };
        for sign in [1i8, -1] {
            assert_eq!(at(100 * i64::from(sign), 10 * i32::from(sign), 2.0 * f32::from(sign)), None);
            assert_eq!(at(101 * i64::from(sign), 0, 0.0), Some(Exceeded::Travel));
            assert_eq!(at(0, 11 * i32::from(sign), 0.0), Some(Exceeded::Speed));
            assert_eq!(at(0, 0, 2.1 * f32::from(sign)), Some(Exceeded::Current));
        }
        assert_eq!(at(0, i32::MIN, 0.0), Some(Exceeded::Speed));
        assert_eq!(at(0, 0, f32::NAN), Some(Exceeded::Current));
    }
}
