//! Absolute position as an integer.

/// A position on the axis in encoder counts, relative to the configured origin.
///
/// Addition and subtraction never round: a 100 mm stage with 61 pm counts needs 31 bits, an `f32` has 24. `i64` holds
/// ±562 million metres of such counts, so arithmetic on positions of real stages cannot overflow; it wraps rather than panics.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Position(pub i64);

impl Position {
    /// The difference `self − other` in counts, saturated to `i32` (±131 mm at 61 pm): what loops turn into `f32`.
    #[inline]
    pub const fn minus(self, other: Position) -> i32 {
        saturate(self.0.wrapping_sub(other.0))
    }

    /// The position `counts` further on.
    #[inline]
    pub const fn plus(self, counts: i64) -> Position {
        Position(self.0.wrapping_add(counts))
    }
}

/// `value`, or the nearest `i32`.
#[inline]
pub const fn saturate(value: i64) -> i32 {
    let low = value as i32;
    // One comparison where all is well: this is in every difference of positions.
    if low as i64 == value {
        low
    } else if value < 0 {
        i32::MIN
    } else {
        i32::MAX
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_count_at_the_far_end_of_the_stage_is_still_a_count() {
        let end = Position(1_638_400_000);
        assert_eq!(end.plus(1).minus(end), 1);
        assert_eq!(end.minus(end.plus(1)), -1);
    }

    #[test]
    fn differences_saturate_instead_of_wrapping() {
        assert_eq!(Position(i64::from(i32::MAX) + 1).minus(Position(0)), i32::MAX);
        assert_eq!(Position(i64::from(i32::MIN) - 1).minus(Position(0)), i32::MIN);
        assert_eq!(Position(i64::MIN).minus(Position(0)), i32::MIN);
    }
}
