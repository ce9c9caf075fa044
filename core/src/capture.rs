//! Full-rate capture of error and force, from the end of a profile or the beginning of an excitation on.

use crate::record::{TickRecord, flags};
use crate::refusal::{Field, Refusal};

/// 32-bit words per captured sample: position error (counts), position (low 32 bits, counts), force (`f32` bits, N).
pub const WORDS_PER_SAMPLE: u32 = 3;

/// What to capture.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Order {
    /// Number of samples, at least 1.
    pub samples: u32,
    /// One sample every so many ticks, `1..=80`.
    pub every_ticks: u32,
}

impl Order {
    /// The order, if `capacity_words` hold it.
    ///
    /// # Errors
    /// Names the number that is out of range.
    pub fn check(self, capacity_words: u32) -> Result<Self, Refusal> {
        Refusal::check(Field::Samples, f64::from(self.samples), 1.0, f64::from(capacity_words / WORDS_PER_SAMPLE))?;
        Refusal::check(Field::Decimation, f64::from(self.every_ticks), 1.0, 80.0)?;
        Ok(self)
    }
}

/// Where a capture stands.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Progress {
    /// Nothing ordered.
    #[default]
    Idle,
    /// Waiting for a profile to end or an excitation to begin.
    Armed,
    /// Samples taken so far.
    Running(u32),
    /// All samples taken: this many.
    Complete(u32),
}

/// A sample and where it belongs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Sample {
    /// Index of the first word in the buffer.
    pub at: u32,
    /// Words in the order of [`WORDS_PER_SAMPLE`].
    pub words: [u32; WORDS_PER_SAMPLE as usize],
}

/// Decides which ticks go into the buffer; the buffer itself belongs to the caller.
#[derive(Clone, Copy, Debug, Default)]
pub struct Capture {
    order: Option<Order>,
    progress: Progress,
    was_moving: bool,
    was_excited: bool,
    wait_ticks: u32,
}

impl Capture {
    /// Starts anew: the first sample is the tick on which the next profile ends or the next excitation begins.
    pub fn arm(&mut self, order: Order) {
        *self = Capture { order: Some(order), progress: Progress::Armed, ..Capture::default() };
    }

    /// Where it stands.
    pub fn progress(&self) -> Progress {
        self.progress
    }

    /// Looks at a tick's record; a sample, if this tick is to be stored.
    #[inline]
    pub fn step(&mut self, record: &TickRecord) -> Option<Sample> {
        let order = self.order?;
        let moving = record.flags & flags::MOVING != 0;
        let excited = record.flags & flags::EXCITED != 0;
        let begins = (self.was_moving && !moving) || (excited && !self.was_excited);
        (self.was_moving, self.was_excited) = (moving, excited);
        let taken = match self.progress {
            Progress::Armed if begins => 0,
            Progress::Running(taken) => taken,
            _ => return None,
        };
        if self.wait_ticks > 0 {
            self.wait_ticks -= 1;
            return None;
        }
        self.wait_ticks = order.every_ticks - 1;
        self.progress =
            if taken + 1 >= order.samples { Progress::Complete(taken + 1) } else { Progress::Running(taken + 1) };
        let words = [record.error_ct as u32, record.position.0 as u32, record.force_n.to_bits()];
        Some(Sample { at: taken * WORDS_PER_SAMPLE, words })
    }
}

#[cfg(test)]
mod tests {
    extern crate std;
    use super::*;
    use std::vec::Vec;

    fn record(sequence: u32, moving: bool) -> TickRecord {
        TickRecord { error_ct: sequence as i32, flags: if moving { flags::MOVING } else { 0 }, ..TickRecord::default() }
    }

    fn captured(order: Order, ticks: u32, moving_until: u32) -> (Vec<(u32, u32)>, Progress) {
        let mut capture = Capture::default();
        capture.arm(order);
        let samples = (0..ticks)
            .filter_map(|i| capture.step(&record(i, (1..moving_until).contains(&i))))
            .map(|s| (s.at, s.words[0]))
            .collect();
        (samples, capture.progress())
    }

    #[test]
    fn it_begins_when_the_profile_ends_and_takes_every_nth_tick() {
        let (samples, progress) = captured(Order { samples: 3, every_ticks: 4 }, 100, 10);
        assert_eq!(samples, [(0, 10), (3, 14), (6, 18)]);
        assert_eq!(progress, Progress::Complete(3));
    }

    #[test]
    fn it_begins_with_an_excitation() {
        let mut capture = Capture::default();
        capture.arm(Order { samples: 2, every_ticks: 1 });
        let excited = |i: u32| TickRecord { flags: if i >= 7 { flags::EXCITED } else { 0 }, ..record(i, false) };
        let taken: Vec<u32> = (0..20).filter_map(|i| capture.step(&excited(i))).map(|sample| sample.words[0]).collect();
        assert_eq!(taken, [7, 8]);
    }

    #[test]
    fn without_a_move_it_waits() {
        assert_eq!(captured(Order { samples: 3, every_ticks: 1 }, 100, 0), (Vec::new(), Progress::Armed));
    }

    #[test]
    fn orders_that_do_not_fit_are_refused() {
        assert!(Order { samples: 100, every_ticks: 1 }.check(300).is_ok());
        for order in [
            Order { samples: 101, every_ticks: 1 },
            Order { samples: 0, every_ticks: 1 },
            Order { samples: 1, every_ticks: 0 },
        ] {
            assert!(order.check(300).is_err(), "{order:?}");
        }
    }
}
