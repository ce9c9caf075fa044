//! A motion in parts of one direction.

/// Samples from one turning point to the next, both included.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Leg {
    /// First sample.
    pub from: usize,
    /// Last sample.
    pub to: usize,
    /// Towards positive positions.
    pub forward: bool,
}

/// The legs of a motion: a way back of more than `hysteresis` ends a leg, at its farthest sample.
///
/// Nothing if the position never leaves a band of `hysteresis`.
pub fn legs(position: &[f64], hysteresis: f64) -> Vec<Leg> {
    let mut legs: Vec<Leg> = Vec::new();
    let (mut lowest, mut highest, mut from) = (0, 0, 0);
    let mut forward = None;
    for (i, x) in position.iter().enumerate() {
        if *x > position[highest] {
            highest = i;
        }
        if *x < position[lowest] {
            lowest = i;
        }
        let (up, down) = (*x - position[lowest] > hysteresis, position[highest] - *x > hysteresis);
        match forward {
            None if up || down => forward = Some(up),
            Some(true) if down => {
                legs.push(Leg { from, to: highest, forward: true });
                (from, lowest, forward) = (highest, i, Some(false));
            }
            Some(false) if up => {
                legs.push(Leg { from, to: lowest, forward: false });
                (from, highest, forward) = (lowest, i, Some(true));
            }
            _ => {}
        }
        // On the way, the extreme behind is the turning point that the leg began at.
        match forward {
            Some(true) if i == highest => lowest = i,
            Some(false) if i == lowest => highest = i,
            _ => {}
        }
    }
    if let Some(forward) = forward {
        legs.push(Leg { from, to: position.len() - 1, forward });
    }
    legs
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn legs_meet_at_the_turning_points() {
        let position = [0.0, 1.0, 2.0, 5.0, 4.0, 3.0, -1.0, 0.0, 6.0];
        let expected = [(0, 3, true), (3, 6, false), (6, 8, true)].map(|(from, to, forward)| Leg { from, to, forward });
        assert_eq!(legs(&position, 0.5), expected);
    }

    #[test]
    fn a_way_back_within_the_hysteresis_is_no_reversal() {
        let position = [0.0, 3.0, 2.2, 4.0, 3.5, 9.0];
        assert_eq!(legs(&position, 1.0), [Leg { from: 0, to: 5, forward: true }]);
        assert_eq!(legs(&position, 0.6).len(), 3);
        assert_eq!(legs(&position, 100.0), []);
    }

    proptest! {
        #[test]
        fn legs_cover_the_record_in_turn_and_end_at_extremes(position in prop::collection::vec(-1.0f64..1.0, 2..200)) {
            let legs = legs(&position, 0.7);
            for pair in legs.windows(2) {
                prop_assert_eq!(pair[0].to, pair[1].from);
                prop_assert_ne!(pair[0].forward, pair[1].forward);
            }
            for leg in legs.iter().take(legs.len().saturating_sub(1)) {
                let sign = if leg.forward { 1.0 } else { -1.0 };
                prop_assert!(position[leg.from..=leg.to].iter().all(|x| sign * (position[leg.to] - x) >= 0.0));
            }
            for leg in legs.iter().skip(1) {
                let sign = if leg.forward { 1.0 } else { -1.0 };
                prop_assert!(position[leg.from..=leg.to].iter().all(|x| sign * (x - position[leg.from]) >= 0.0));
            }
            if let (Some(first), Some(last)) = (legs.first(), legs.last()) {
                prop_assert_eq!((first.from, last.to), (0, position.len() - 1));
            }
        }
    }
}
