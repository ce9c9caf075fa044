//! Full-rate capture: chosen words of the ticks' records around a trigger, into a ring that the caller keeps.

use crate::record::{Selection, TickRecord, flags};
use crate::refusal::{Field, Refusal};

/// Most words of a record that one capture takes.
pub const MOST_WORDS: usize = 8;

/// What a capture waits for.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Trigger {
    /// Nothing: begins at once.
    Now,
    /// A profile begins.
    MoveStart,
    /// A profile ends.
    #[default]
    MoveEnd,
    /// A fault is seen.
    Fault,
    /// The error's size reaches this many counts.
    Error(u32),
    /// An excitation begins.
    Excitation,
}

/// What to capture.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Order {
    /// Words of the record, 1 to [`MOST_WORDS`].
    pub words: Selection,
    /// Number of samples, at least 1.
    pub samples: u32,
    /// How many of them are from before the trigger, less than `samples`.
    pub before: u32,
    /// One sample every so many ticks, `1..=80`. The trigger is looked for among samples.
    pub every_ticks: u32,
    /// When.
    pub trigger: Trigger,
}

impl Order {
    /// The order, if `capacity_words` hold it.
    ///
    /// # Errors
    /// Names the number that is out of range.
    pub fn check(self, capacity_words: u32) -> Result<Self, Refusal> {
        let words = self.words.count() as u32;
        Refusal::check(Field::Signals, f64::from(words), 1.0, MOST_WORDS as f64)?;
        Refusal::check(Field::Samples, f64::from(self.samples), 1.0, f64::from(capacity_words / words))?;
        Refusal::check(Field::SamplesBefore, f64::from(self.before), 0.0, f64::from(self.samples - 1))?;
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
    /// Waiting for the trigger.
    Armed,
    /// Triggered: so many samples are there.
    Running(u32),
    /// All samples taken.
    Complete(Complete),
}

/// A complete capture.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Complete {
    /// What was ordered.
    pub order: Order,
    /// Index in the ring of the oldest sample, samples.
    pub oldest: u32,
    /// How many samples are older than the trigger; fewer than ordered if it came early.
    pub before: u32,
    /// Tick of the trigger.
    pub tick: u32,
}

/// A sample and where it belongs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Sample {
    /// Index of the first word in the buffer.
    pub at: u32,
    /// Its words.
    pub words: [u32; MOST_WORDS],
    /// How many of them count.
    pub count: u32,
}

/// Decides which ticks go into the ring; the ring itself belongs to the caller.
#[derive(Clone, Copy, Debug, Default)]
pub struct Capture {
    order: Option<Order>,
    progress: Progress,
    /// Index in the ring of the next sample.
    next: u32,
    /// Samples in the ring from before the trigger; at most those wanted.
    held: u32,
    trigger_tick: u32,
    was_moving: bool,
    was_excited: bool,
    had_fault: bool,
    wait_ticks: u32,
}

impl Capture {
    /// Starts anew.
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
        let (moving, fault) = (record.flags & flags::MOVING != 0, record.fault.is_some());
        let excited = record.flags & flags::EXCITED != 0;
        let triggered = match order.trigger {
            Trigger::Now => true,
            Trigger::MoveStart => moving && !self.was_moving,
            Trigger::MoveEnd => !moving && self.was_moving,
            Trigger::Fault => fault && !self.had_fault,
            Trigger::Error(least_ct) => record.error_ct.unsigned_abs() >= least_ct,
            Trigger::Excitation => excited && !self.was_excited,
        };
        (self.was_moving, self.was_excited, self.had_fault) = (moving, excited, fault);
        if self.progress == Progress::Armed && triggered {
            self.progress = Progress::Running(self.held);
            self.trigger_tick = record.sequence;
            // The trigger is a sample, whatever the pace of those before it.
            self.wait_ticks = 0;
        }
        if self.wait_ticks > 0 {
            self.wait_ticks -= 1;
            return None;
        }
        self.wait_ticks = order.every_ticks - 1;
        let index = self.next;
        self.next = if index + 1 == order.samples { 0 } else { index + 1 };
        match self.progress {
            Progress::Armed if order.before > 0 => self.held = (self.held + 1).min(order.before),
            Progress::Running(taken) if taken + 1 < order.samples => self.progress = Progress::Running(taken + 1),
            Progress::Running(_) => {
                let (oldest, before, tick) = (self.next, self.held, self.trigger_tick);
                self.progress = Progress::Complete(Complete { order, oldest, before, tick });
            }
            _ => {
                // Nothing is stored, and the trigger is looked for in every tick.
                (self.next, self.wait_ticks) = (index, 0);
                return None;
            }
        }
        let mut words = [0; MOST_WORDS];
        for (word, value) in words.iter_mut().zip(order.words.of(record)) {
            *word = value;
        }
        let count = order.words.count() as u32;
        Some(Sample { at: index * count, words, count })
    }
}

#[cfg(test)]
mod tests {
    extern crate std;
    use super::*;
    use crate::fault::Fault;
    use proptest::prelude::*;
    use std::vec;
    use std::vec::Vec;

    const ORDER: Order =
        Order { words: Selection(1 << 3), samples: 3, before: 0, every_ticks: 1, trigger: Trigger::MoveEnd };

    /// A move in these ticks, an error that counts ticks, an excitation from tick 20 and a fault from tick 50 on.
    fn record(sequence: u32, moves: core::ops::Range<u32>) -> TickRecord {
        let excited = if sequence >= 20 { flags::EXCITED } else { 0 };
        TickRecord {
            sequence,
            error_ct: sequence as i32,
            flags: excited | if moves.contains(&sequence) { flags::MOVING } else { 0 },
            fault: (sequence >= 50).then_some(Fault::OverCurrent),
            ..TickRecord::default()
        }
    }

    /// Runs 200 ticks and reads the ring out in order: what the host does.
    fn captured(order: Order, moves: core::ops::Range<u32>) -> (Vec<u32>, Progress) {
        let (mut capture, mut ring) = (Capture::default(), vec![u32::MAX; order.samples as usize]);
        capture.arm(order);
        for tick in 0..200 {
            if let Some(sample) = capture.step(&record(tick, moves.clone())) {
                ring[sample.at as usize] = sample.words[0];
            }
        }
        if let Progress::Complete(complete) = capture.progress() {
            ring.rotate_left(complete.oldest as usize);
        }
        (ring, capture.progress())
    }

    #[test]
    fn it_takes_every_nth_tick_from_the_trigger_on() {
        let order = Order { every_ticks: 4, ..ORDER };
        let (samples, progress) = captured(order, 1..10);
        assert_eq!(samples, [10, 14, 18]);
        assert_eq!(progress, Progress::Complete(Complete { order, oldest: 0, before: 0, tick: 10 }));
    }

    #[test]
    fn every_trigger_has_its_tick() {
        for (trigger, tick) in [
            (Trigger::Now, 0),
            (Trigger::MoveStart, 5),
            (Trigger::MoveEnd, 10),
            (Trigger::Fault, 50),
            (Trigger::Error(30), 30),
            (Trigger::Excitation, 20),
        ] {
            assert_eq!(captured(Order { trigger, ..ORDER }, 5..10).0, [tick, tick + 1, tick + 2], "{trigger:?}");
        }
    }

    #[test]
    fn what_was_before_the_trigger_is_kept() {
        let order = Order { samples: 5, before: 2, trigger: Trigger::Error(100), ..ORDER };
        assert_eq!(captured(order, 0..0).0, [98, 99, 100, 101, 102]);
    }

    #[test]
    fn a_trigger_that_comes_early_leaves_more_for_after_it() {
        let order = Order { samples: 5, before: 4, trigger: Trigger::Error(1), ..ORDER };
        let (samples, progress) = captured(order, 0..0);
        assert_eq!(samples, [0, 1, 2, 3, 4]);
        assert_eq!(progress, Progress::Complete(Complete { order, oldest: 0, before: 1, tick: 1 }));
    }

    #[test]
    fn without_a_trigger_it_waits() {
        assert_eq!(captured(ORDER, 0..0).1, Progress::Armed);
    }

    #[test]
    fn orders_that_do_not_fit_are_refused() {
        assert!(Order { samples: 300, before: 299, ..ORDER }.check(300).is_ok());
        for order in [
            Order { samples: 301, ..ORDER },
            Order { samples: 151, words: Selection(0b11), ..ORDER },
            Order { samples: 0, ..ORDER },
            Order { before: 3, ..ORDER },
            Order { every_ticks: 0, ..ORDER },
            Order { words: Selection(0), ..ORDER },
            Order { words: Selection(0x1ff), ..ORDER },
        ] {
            assert!(order.check(300).is_err(), "{order:?}");
        }
    }

    proptest! {
        #[test]
        fn samples_follow_one_another_and_the_trigger_is_where_it_is_said(
            samples in 1u32..40, before in 0u32..40, every_ticks in 1u32..3, at in 0u32..80,
        ) {
            let order = Order { samples, before: before.min(samples - 1), every_ticks, trigger: Trigger::Error(at), ..ORDER };
            let (ring, progress) = captured(order, 0..0);
            let Progress::Complete(complete) = progress else { panic!("{progress:?}") };
            prop_assert_eq!(complete.tick, at);
            prop_assert_eq!(ring[complete.before as usize], at);
            // Among themselves they keep their pace on either side of the trigger.
            let (older, newer) = ring.split_at(complete.before as usize);
            for pair in older.windows(2).chain(newer.windows(2)) {
                prop_assert_eq!(pair[1] - pair[0], every_ticks);
            }
        }
    }
}
