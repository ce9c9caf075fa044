//! Where a measured position turned back: the memory that [`super::dahl`] and [`super::maxwell_slip`] have in common.

use crate::position::Position;

/// The branch between two velocity reversals that the axis is on.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Branch {
    /// Where the last reversal was.
    anchor: Position,
    /// The furthest position since.
    extreme: Position,
    /// Direction of motion: +1 or −1.
    direction: f32,
}

impl Branch {
    /// A branch that begins at `position`, forwards.
    pub fn starting_at(position: Position) -> Self {
        Branch { anchor: position, extreme: position, direction: 1.0 }
    }

    /// Direction of motion: +1 or −1.
    #[inline]
    pub fn direction(&self) -> f32 {
        self.direction
    }

    /// Distance from the last reversal to the extreme since, counts, at least 0 and saturated to `i32`.
    #[inline]
    pub fn travel_ct(&self) -> i32 {
        if self.direction > 0.0 { self.extreme.minus(self.anchor) } else { self.anchor.minus(self.extreme) }
    }

    /// Takes the measured position. What counts is the extreme, so that encoder noise moves nothing back; coming back from it by
    /// more than `hysteresis_ct` *is* the reversal, and the extreme is where it was. Gives the travel of the branch that ended, if one did.
    #[inline]
    pub fn follow(&mut self, position: Position, hysteresis_ct: i32) -> Option<i32> {
        let forward = self.direction > 0.0;
        let ahead_ct = if forward { position.minus(self.extreme) } else { self.extreme.minus(position) };
        if ahead_ct > 0 {
            self.extreme = position;
        } else if ahead_ct < -hysteresis_ct {
            let travelled_ct = self.travel_ct();
            *self = Branch { anchor: self.extreme, extreme: position, direction: -self.direction };
            return Some(travelled_ct);
        }
        None
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_coming_back_by_more_than_the_hysteresis_ends_a_branch() {
        let mut branch = Branch::starting_at(Position(0));
        for (position, ended, travel_ct, direction) in [
            (100, None, 100, 1.0),
            (84, None, 100, 1.0), // exactly the hysteresis
            (120, None, 120, 1.0),
            (103, Some(120), 17, -1.0), // from 120, not from 84
            (-30, None, 150, -1.0),
            (-14, None, 150, -1.0),
            (-13, Some(150), 17, 1.0),
        ] {
            assert_eq!(branch.follow(Position(position), 16), ended, "at {position}");
            assert_eq!((branch.travel_ct(), branch.direction()), (travel_ct, direction), "at {position}");
        }
    }
}
