//! A continuous position from absolute 32-bit readings, or from sine and cosine, through bad ones.

use super::biss::{self, FrameError, Reading};
use super::sincos::{self, Interpolator};
use crate::position::Position;

/// Consecutive bad frames after which the encoder counts as lost.
pub const LOST_AFTER: u8 = 3;

/// Equal readings in a row after a movement that count as a frozen encoder; at rest it takes more.
pub const FROZEN_AFTER: u16 = 3;
/// A last movement of so many counts in a tick was motion, not noise: 0.5 mm/s with 61 pm counts. No stage stops from it to the count.
const MOTION_CT: u32 = 1024;

/// What one frame did to the position.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Update {
    /// Measured.
    Measured,
    /// The frame was unusable; the position is the one before, or what [`Tracker::assume`] makes of it.
    Held(Cause),
    /// [`LOST_AFTER`] unusable frames in a row, or none so far: the position must not be used.
    Lost(Cause),
}

/// Why a frame was unusable.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Cause {
    /// See [`FrameError`].
    Frame(FrameError),
    /// The encoder's own error bit.
    ErrorBit,
    /// Any [`sincos::SampleError`].
    Signal,
}

/// Extends the encoder's 32-bit reading, or its signal periods, to `i64` and bridges short losses.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Tracker {
    position: Position,
    /// Position at `raw`, the last good reading.
    measured: Position,
    raw: u32,
    bad: u8,
    alive: bool,
    bad_total: u32,
    warning: bool,
    /// Readings equal to the one before.
    same: u16,
    /// The last movement that was none of those, counts.
    moved_ct: i32,
}

impl Tracker {
    /// The latest position, measured, held or assumed.
    #[inline]
    pub fn position(&self) -> Position {
        self.position
    }

    /// A position has been measured and the encoder is not lost.
    #[inline]
    pub fn is_valid(&self) -> bool {
        self.alive && self.bad < LOST_AFTER
    }

    /// Unusable frames since start, saturating.
    pub fn bad_frames(&self) -> u32 {
        self.bad_total
    }

    /// Readings in a row that were equal to the one before, to the count.
    #[inline]
    pub fn same_readings(&self) -> u16 {
        self.same
    }

    /// Before them, the stage was measurably moving.
    #[inline]
    pub fn was_moving(&self) -> bool {
        self.moved_ct.unsigned_abs() >= MOTION_CT
    }

    /// The movement from the good reading before the last one to the last one, counts, however many frames were lost in between.
    pub fn measured_step_ct(&self) -> i32 {
        if self.same > 0 { 0 } else { self.moved_ct }
    }

    /// The encoder's warning bit of the last good frame.
    pub fn warning(&self) -> bool {
        self.warning
    }

    /// Takes the line bits of one servo period (see [`biss::decode`]).
    ///
    /// The first good reading after start, or after a loss, sets the position to `reading − origin` directly; later ones move
    /// it by the shortest way around the 32-bit circle.
    #[inline]
    pub fn update(&mut self, line: u64, origin: u32) -> Update {
        match biss::decode(line) {
            Ok(Reading { error: false, counts, warning }) => {
                let moved_ct = counts.wrapping_sub(self.raw) as i32;
                self.measured = if self.is_valid() {
                    if moved_ct == 0 {
                        self.same = self.same.saturating_add(1);
                    } else {
                        (self.same, self.moved_ct) = (0, moved_ct);
                    }
                    self.measured.plus(i64::from(moved_ct))
                } else {
                    (self.same, self.moved_ct) = (0, 0);
                    Position(i64::from(counts) - i64::from(origin))
                };
                self.position = self.measured;
                self.raw = counts;
                self.warning = warning;
                self.alive = true;
                self.bad = 0;
                Update::Measured
            }
            Ok(_) => self.hold(Cause::ErrorBit),
            Err(error) => self.hold(Cause::Frame(error)),
        }
    }

    /// Takes what was sampled of an encoder with sine and cosine instead.
    ///
    /// The first good sample after start, or after a loss, puts the position within half a signal period of 0: where the stage is
    /// then, nobody knows.
    #[inline(never)]
    pub fn update_sin_cos(
        &mut self,
        interpolator: &mut Interpolator,
        k: &sincos::Coefficients,
        sample: sincos::Sample,
    ) -> Update {
        let before = self.is_valid().then_some(self.measured);
        match interpolator.update(k, sample, before) {
            Ok(position) => {
                match before.map(|before| position.minus(before)) {
                    Some(0) => self.same = self.same.saturating_add(1),
                    Some(moved_ct) => (self.same, self.moved_ct) = (0, moved_ct),
                    None => (self.same, self.moved_ct) = (0, 0),
                }
                (self.measured, self.position) = (position, position);
                self.alive = true;
                self.bad = 0;
                Update::Measured
            }
            Err(_) => self.hold(Cause::Signal),
        }
    }

    /// Puts `position` in the place of a measurement that failed. The next good frame does not depend on it.
    #[inline]
    pub fn assume(&mut self, position: Position) {
        self.position = position;
    }

    fn hold(&mut self, cause: Cause) -> Update {
        self.bad_total = self.bad_total.saturating_add(1);
        self.bad = self.bad.saturating_add(1);
        if self.is_valid() { Update::Held(cause) } else { Update::Lost(cause) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const ORIGIN: u32 = 0x8000_0000;

    /// A healthy frame, made with the decoder's own checksum found by trial: the encoder's side is tested in `biss`.
    fn frame(counts: u32) -> u64 {
        let bare = 0b1010_u64 << 60 | u64::from(counts) << 28 | 0b11 << 26;
        (0..64).map(|crc| bare | crc << 20).find(|line| biss::decode(*line).is_ok()).unwrap()
    }

    fn fed(counts: impl IntoIterator<Item = u32>) -> Tracker {
        let mut tracker = Tracker::default();
        for c in counts {
            assert_eq!(tracker.update(frame(c), ORIGIN), Update::Measured);
        }
        tracker
    }

    #[test]
    fn mid_travel_is_zero() {
        assert_eq!(fed([ORIGIN + 5]).position(), Position(5));
    }

    #[test]
    fn the_reading_may_wrap_in_either_direction() {
        let up = fed([u32::MAX - 1, 3]);
        assert_eq!(up.position().minus(fed([u32::MAX - 1]).position()), 5);
        let down = fed([3, u32::MAX - 1]);
        assert_eq!(down.position().minus(fed([3]).position()), -5);
    }

    #[test]
    fn nothing_is_valid_before_the_first_good_frame() {
        let mut tracker = Tracker::default();
        assert_eq!(tracker.update(0, ORIGIN), Update::Lost(Cause::Frame(FrameError::Missing)));
        assert!(!tracker.is_valid());
        tracker.update(frame(ORIGIN), ORIGIN);
        assert!(tracker.is_valid());
    }

    #[test]
    fn a_bad_frame_keeps_the_position_or_the_assumed_one_and_the_next_good_one_is_exact() {
        for bad in [0, u64::MAX, frame(ORIGIN + 1234) ^ 1 << 40] {
            let mut tracker = fed([ORIGIN, ORIGIN + 200]);
            assert!(matches!(tracker.update(bad, ORIGIN), Update::Held(_)));
            assert_eq!(tracker.position(), Position(200));
            tracker.assume(Position(300));
            assert_eq!(tracker.position(), Position(300));
            tracker.update(frame(ORIGIN + 410), ORIGIN);
            assert_eq!(tracker.position(), Position(410));
        }
    }

    #[test]
    fn equal_readings_are_counted_and_what_came_before_tells_motion_from_rest() {
        for (step, moving) in [(1, false), (1023, false), (1024, true), (0u32.wrapping_sub(1024), true)] {
            let mut tracker = fed([ORIGIN, ORIGIN.wrapping_add(step)]);
            assert_eq!(tracker.same_readings(), 0);
            for n in 1..5 {
                tracker.update(frame(ORIGIN.wrapping_add(step)), ORIGIN);
                assert_eq!((tracker.same_readings(), tracker.was_moving()), (n, moving), "{step}");
            }
            tracker.update(frame(ORIGIN.wrapping_add(step + 1)), ORIGIN);
            assert_eq!(tracker.same_readings(), 0);
        }
    }

    #[test]
    fn the_third_bad_frame_in_a_row_is_a_loss_and_two_are_not() {
        let mut tracker = fed([ORIGIN]);
        for expected_valid in [true, true, false, false] {
            tracker.update(u64::MAX, ORIGIN);
            assert_eq!(tracker.is_valid(), expected_valid);
        }
        assert_eq!(tracker.bad_frames(), 4);
        tracker.update(frame(ORIGIN + 9_999), ORIGIN);
        assert_eq!((tracker.is_valid(), tracker.position()), (true, Position(9_999)));
    }
}
