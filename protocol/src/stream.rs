//! Streaming: chosen words of every n-th tick's record, in numbered blocks, so that every loss is seen and counted.

use heapless::Vec;
use serde::{Deserialize, Serialize};
use servo_core::record::{Selection, TickRecord};

/// Bytes of samples in one block.
pub const BLOCK_BYTES: usize = 448;

/// Some samples in a row, none missing between the first and the last.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Block {
    /// Number of the block since the stream began: gaps are blocks that were lost behind this numbering.
    pub number: u32,
    /// Tick of the first sample.
    pub first_tick: u32,
    /// Words of the samples, least significant byte first.
    pub bytes: Vec<u8, BLOCK_BYTES>,
}

impl Block {
    /// Its samples, if `words` are what was ordered.
    pub fn samples(&self, words: Selection) -> impl Iterator<Item = impl Iterator<Item = u32>> {
        let word = |bytes: &[u8]| bytes.iter().rev().fold(0, |word, byte| word << 8 | u32::from(*byte));
        self.bytes.chunks_exact(4 * words.count().max(1)).map(move |sample| sample.chunks_exact(4).map(word))
    }
}

/// What is to be streamed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Order {
    /// Words of the record; none ends the stream.
    pub words: Selection,
    /// One sample every so many ticks, `1..=8000`.
    pub every_ticks: u16,
}

/// The drive's end: records in, blocks out.
#[derive(Clone, Debug)]
pub struct Packer {
    order: Order,
    block: Block,
    next_tick: u32,
}

impl Packer {
    /// Begins a stream.
    pub fn new(order: Order) -> Self {
        Packer { order, block: Block::default(), next_tick: 0 }
    }

    /// Takes a record; the block that it completes, or that ends before it because records are missing in between.
    pub fn push(&mut self, record: &TickRecord) -> Option<Block> {
        if self.order.words.is_empty() || !record.sequence.is_multiple_of(u32::from(self.order.every_ticks.max(1))) {
            return None;
        }
        let sample_bytes = 4 * self.order.words.count();
        let interrupted = !self.block.bytes.is_empty() && record.sequence != self.next_tick;
        let before = interrupted.then(|| self.finish());
        if self.block.bytes.is_empty() {
            self.block.first_tick = record.sequence;
        }
        for word in self.order.words.of(record) {
            // As many fit as are put: a block is given away before the next sample would not.
            let _ = self.block.bytes.extend_from_slice(&word.to_le_bytes());
        }
        self.next_tick = record.sequence.wrapping_add(u32::from(self.order.every_ticks.max(1)));
        // Never both: a block that has just begun holds one sample and has room for a second.
        before.or_else(|| (self.block.bytes.len() + sample_bytes > BLOCK_BYTES).then(|| self.finish()))
    }

    fn finish(&mut self) -> Block {
        let next = Block { number: self.block.number.wrapping_add(1), ..Block::default() };
        core::mem::replace(&mut self.block, next)
    }
}

/// The host's end: what arrived and what did not.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Tally {
    /// Samples that arrived.
    pub samples: u64,
    /// Samples that did not, between the first and the last that did.
    pub lost_samples: u64,
    /// Blocks that did not.
    pub lost_blocks: u64,
    expected: Option<(u32, u32)>,
}

impl Tally {
    /// Counts a block of the stream that `order` began.
    pub fn count(&mut self, order: &Order, block: &Block) {
        let (every, words) = (u32::from(order.every_ticks.max(1)), order.words.count().max(1));
        let samples = (block.bytes.len() / (4 * words)) as u32;
        if let Some((number, tick)) = self.expected {
            self.lost_blocks += u64::from(block.number.wrapping_sub(number));
            self.lost_samples += u64::from(block.first_tick.wrapping_sub(tick) / every);
        }
        self.samples += u64::from(samples);
        self.expected = Some((block.number.wrapping_add(1), block.first_tick.wrapping_add(samples * every)));
    }
}

#[cfg(test)]
mod tests {
    extern crate std;
    use super::*;
    use proptest::prelude::*;
    use std::vec::Vec as StdVec;

    fn record(sequence: u32) -> TickRecord {
        TickRecord { sequence, error_ct: sequence as i32 * 3, force_n: sequence as f32, ..TickRecord::default() }
    }

    const ORDER: Order = Order { words: Selection(0b1_0000_1001), every_ticks: 1 };

    fn blocks(order: Order, ticks: impl Iterator<Item = u32>) -> StdVec<Block> {
        let mut packer = Packer::new(order);
        ticks.filter_map(|tick| packer.push(&record(tick))).collect()
    }

    #[test]
    fn samples_are_the_chosen_words_in_the_record_s_order() {
        let blocks = blocks(ORDER, 0..100);
        let words: StdVec<u32> = blocks[1].samples(ORDER.words).flatten().collect();
        assert_eq!((blocks[1].number, blocks[1].first_tick), (1, 37));
        assert_eq!(words[..6], [37, 111, 37f32.to_bits(), 38, 114, 38f32.to_bits()]);
        assert_eq!(words.len(), 3 * 37, "as many samples as fit");
    }

    #[test]
    fn every_nth_tick_is_taken_on_multiples() {
        let order = Order { words: Selection(1), every_ticks: 80 };
        let blocks = blocks(order, 5..80 * 200);
        assert_eq!(blocks[0].first_tick, 80);
        let mut tally = Tally::default();
        blocks.iter().for_each(|block| tally.count(&order, block));
        assert_eq!((tally.lost_samples, tally.lost_blocks), (0, 0));
    }

    proptest! {
        #[test]
        fn every_lost_record_and_block_is_counted(
            missing in proptest::collection::btree_set(100u32..3900, 0..200),
            dropped in proptest::collection::btree_set(1usize..30, 0..10),
        ) {
            let sent = blocks(ORDER, (0..4000).filter(|tick| !missing.contains(tick)));
            let mut tally = Tally::default();
            let arrived: StdVec<_> = sent
                .iter()
                .enumerate()
                .filter(|(number, _)| *number == sent.len() - 1 || !dropped.contains(number))
                .map(|(_, block)| block)
                .collect();
            arrived.iter().for_each(|block| tally.count(&ORDER, block));
            let last = arrived.last().unwrap();
            let ticks = u64::from(last.first_tick) + (last.bytes.len() / 12) as u64;
            prop_assert_eq!(tally.samples + tally.lost_samples, ticks);
            prop_assert_eq!(tally.lost_blocks as usize, sent.len() - arrived.len());
        }
    }
}
