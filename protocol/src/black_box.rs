//! The memory of the black box: a header, the entries of the last ticks, and a journal with copies of the drive and the commands
//! that it took. The firmware writes it, where a warm reset leaves it alone; the host reads it and runs the ticks again.
//!
//! ```text
//! word 0  magic                    word 5     firmware that wrote it
//! word 1  number of the recording  word 6, 7  begin and end of the journal
//! word 2  which one has ended      word 8     entries written
//! word 3  which one is sealed      then       ENTRIES entries
//! word 4  CRC-32 of words 5 on     then       the journal: items of length and kind, number, postcard bytes; the oldest make room
//! ```
//! Each word has one writer: the control interrupt writes the entries and words 1, 2 and 8, and where a recording begins also word 6;
//! tasks write the rest. A recording is *sealed* when a task has computed its checksum; a number in place of a flag, because
//! meanwhile the interrupt may have begun the next one.

use core::cell::Cell;

use crc::{CRC_32_ISO_HDLC, Crc};
use serde::{Serialize, de::DeserializeOwned};
use servo_core::black_box::{ENTRIES, ENTRY_WORDS, Entry, Mismatch, replay};
use servo_core::drive::{Command, Drive};

/// Words of the journal: copies of the drive take some 850 bytes every 128 ticks, a change of parameters 600. A power of two, so that
/// its counters may wrap.
pub const JOURNAL_WORDS: usize = 1 << 11;
/// Words of everything.
pub const WORDS: usize = JOURNAL_AT + JOURNAL_WORDS;
/// Most bytes of an item's content.
const ITEM_BYTES: usize = 1536;

const ENTRIES_AT: usize = 9;
const JOURNAL_AT: usize = ENTRIES_AT + ENTRIES as usize * ENTRY_WORDS;

/// To be changed with the layout.
const MAGIC: u32 = 0x5342_4231;

const RECORDING: usize = 1;
const ENDED: usize = 2;
const SEALED: usize = 3;
const CHECKSUM: usize = 4;
const FIRMWARE: usize = 5;
const BEGIN: usize = 6;
const END: usize = 7;
const WRITTEN: usize = 8;

const CRC32: Crc<u32> = Crc::<u32>::new(&CRC_32_ISO_HDLC);

/// [`WORDS`] words that can be read and written through a shared reference: control interrupt and tasks take turns.
pub trait Memory {
    /// The word at `index`; 0 beyond the end.
    fn load(&self, index: usize) -> u32;
    /// Stores a word; beyond the end nothing happens.
    fn store(&self, index: usize, word: u32);
}

/// What the host has read.
impl Memory for &[Cell<u32>] {
    fn load(&self, index: usize) -> u32 {
        self.get(index).map_or(0, Cell::get)
    }

    fn store(&self, index: usize, word: u32) {
        if let Some(cell) = self.get(index) {
            cell.set(word);
        }
    }
}

/// Something for the journal.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u32)]
enum Kind {
    /// A drive after the tick with the item's number.
    Drive = 1,
    /// A command with the item's number.
    Command = 2,
}

/// The black box on its memory.
#[derive(Clone, Copy, Debug)]
pub struct BlackBox<M>(pub M);

impl<M: Memory> BlackBox<M> {
    /// What an earlier run has left, if it is intact: the number of entries written. A run that ended without sealing is sealed now.
    pub fn find(&self) -> Option<u32> {
        let written = self.written();
        if self.0.load(0) != MAGIC || written == 0 || written >= 2 * ENTRIES {
            return None;
        }
        if self.is_sealed() {
            return self.is_intact().then_some(written);
        }
        // Ended by a reset: its entries must follow one another, and the journal must end where it says.
        let journal_words = self.0.load(END).wrapping_sub(self.0.load(BEGIN));
        let in_order =
            self.entries().zip(self.entries().skip(1)).all(|(a, b)| a.sequence().wrapping_add(1) == b.sequence());
        if !in_order || journal_words > JOURNAL_WORDS as u32 || self.items().any(|item| item.is_none()) {
            return None;
        }
        self.end();
        self.seal();
        Some(written)
    }

    /// Empty, for `firmware` (major, minor, patch).
    pub fn clear(&self, firmware: [u16; 3]) {
        let [major, minor, patch] = firmware.map(u32::from);
        (RECORDING..ENTRIES_AT).for_each(|index| self.0.store(index, 0));
        self.0.store(RECORDING, 1);
        self.0.store(FIRMWARE, major << 20 | minor << 10 | patch);
        self.0.store(0, MAGIC);
    }

    /// Stores an entry. With the first one of a recording, what an earlier one has left is gone.
    #[inline(always)]
    pub fn store(&self, index: u32, entry: &Entry, written: u32) {
        let at = ENTRIES_AT + index as usize * ENTRY_WORDS;
        for (offset, word) in entry.0.into_iter().enumerate() {
            self.0.store(at + offset, word);
        }
        if written == 1 {
            self.0.store(BEGIN, self.0.load(END));
            self.0.store(RECORDING, self.0.load(RECORDING).wrapping_add(1));
        }
        self.0.store(WRITTEN, written);
    }

    /// Writes down the drive as it is after tick `sequence`. Not once the box is sealed.
    ///
    /// # Errors
    /// [`TooLong`]: it does not fit; nothing changed.
    pub fn copy(&self, sequence: u32, drive: &Drive) -> Result<(), TooLong> {
        self.append(Kind::Drive, sequence, drive)
    }

    /// Writes down a command before the tick gets it. Not once the box is sealed.
    ///
    /// # Errors
    /// [`TooLong`]: it does not fit; nothing changed.
    pub fn note(&self, number: u32, command: &Command) -> Result<(), TooLong> {
        self.append(Kind::Command, number, command)
    }

    /// The recording is complete.
    #[inline(always)]
    pub fn end(&self) {
        self.0.store(ENDED, self.0.load(RECORDING));
    }

    /// Whether it is complete, but not sealed.
    pub fn is_to_be_sealed(&self) -> bool {
        self.0.load(ENDED) == self.0.load(RECORDING) && !self.is_sealed()
    }

    /// From now on every bit counts. Takes some ms.
    pub fn seal(&self) {
        let recording = self.0.load(RECORDING);
        self.0.store(CHECKSUM, self.checksum());
        self.0.store(SEALED, recording);
    }

    /// Whether it is complete, with a checksum over everything.
    pub fn is_sealed(&self) -> bool {
        self.0.load(SEALED) == self.0.load(RECORDING)
    }

    /// Whether the checksum is right.
    pub fn is_intact(&self) -> bool {
        self.0.load(0) == MAGIC && self.is_sealed() && self.0.load(CHECKSUM) == self.checksum()
    }

    /// Version of the firmware that wrote it: major, minor, patch. Only the same version can run the ticks again.
    pub fn firmware(&self) -> [u16; 3] {
        let word = self.0.load(FIRMWARE);
        [word >> 20, word >> 10 & 0x3ff, word & 0x3ff].map(|number| number as u16)
    }

    /// The entries, oldest first.
    pub fn entries(&self) -> impl Iterator<Item = Entry> {
        let written = self.written();
        (written.saturating_sub(ENTRIES)..written).map(|number| {
            let at = ENTRIES_AT + (number % ENTRIES) as usize * ENTRY_WORDS;
            Entry(core::array::from_fn(|offset| self.0.load(at + offset)))
        })
    }

    /// Runs the ticks of a sealed recording again, from the oldest copy of the drive on; how many came out the same, to the last bit.
    ///
    /// # Errors
    /// [`ReplayError`].
    pub fn replay(&self) -> Result<u32, ReplayError> {
        if !self.is_intact() {
            return Err(ReplayError::Damaged);
        }
        let oldest = self.entries().next().ok_or(ReplayError::Empty)?.sequence();
        // A copy from before the oldest entry will do if it is from the tick before.
        let first = oldest.wrapping_sub(1);
        let reachable = |item: &Item| item.kind == Kind::Drive as u32 && item.number.wrapping_sub(first) < 2 * ENTRIES;
        let copy = self.items().flatten().find(reachable).ok_or(ReplayError::NoCopy)?;
        let mut drive: Drive = self.content(&copy).ok_or(ReplayError::NoCopy)?;
        let entries = self.entries().filter(|entry| entry.sequence().wrapping_sub(copy.number) as i32 > 0);
        replay(&mut drive, entries, |number| {
            let is_it = |item: &Item| item.kind == Kind::Command as u32 && item.number == number;
            self.content(&self.items().flatten().find(is_it)?)
        })
        .map_err(ReplayError::Mismatch)
    }

    fn written(&self) -> u32 {
        self.0.load(WRITTEN)
    }

    /// Of what follows the checksum.
    fn checksum(&self) -> u32 {
        let mut digest = CRC32.digest();
        (FIRMWARE..WORDS).for_each(|index| digest.update(&self.0.load(index).to_le_bytes()));
        digest.finalize()
    }

    fn journal(&self, at: u32) -> usize {
        JOURNAL_AT + at as usize % JOURNAL_WORDS
    }

    fn append<T: Serialize>(&self, kind: Kind, number: u32, content: &T) -> Result<(), TooLong> {
        if self.is_sealed() {
            return Ok(());
        }
        let mut scratch = [0; ITEM_BYTES];
        let bytes = postcard::to_slice(content, &mut scratch).map_err(|_| TooLong)?;
        let length = bytes.len() as u32;
        let words = item_words(length);
        let end = self.0.load(END);
        let mut begin = self.0.load(BEGIN);
        while end.wrapping_sub(begin) + words > JOURNAL_WORDS as u32 {
            begin = begin.wrapping_add(item_words(self.0.load(self.journal(begin)) >> 8));
            self.0.store(BEGIN, begin);
        }
        self.0.store(self.journal(end), length << 8 | kind as u32);
        self.0.store(self.journal(end.wrapping_add(1)), number);
        for (at, bytes) in (end.wrapping_add(2)..).zip(bytes.chunks(4)) {
            let mut word = [0; 4];
            word[..bytes.len()].copy_from_slice(bytes);
            self.0.store(self.journal(at), u32::from_le_bytes(word));
        }
        // Last, so that a reset in between leaves whole items.
        self.0.store(END, end.wrapping_add(words));
        Ok(())
    }

    /// The items, oldest first; `None`, and no more, where there is none though there should be.
    fn items(&self) -> impl Iterator<Item = Option<Item>> {
        let end = self.0.load(END);
        let mut at = self.0.load(BEGIN);
        core::iter::from_fn(move || {
            let left = end.wrapping_sub(at);
            if left == 0 {
                return None;
            }
            let head = self.0.load(self.journal(at));
            let item = Item {
                kind: head & 0xff,
                length: head >> 8,
                number: self.0.load(self.journal(at.wrapping_add(1))),
                at: at.wrapping_add(2),
            };
            let words = item_words(item.length);
            let is_whole = item.length as usize <= ITEM_BYTES && words <= left;
            at = if is_whole { at.wrapping_add(words) } else { end };
            Some(is_whole.then_some(item))
        })
    }

    fn content<T: DeserializeOwned>(&self, item: &Item) -> Option<T> {
        let mut scratch = [0; ITEM_BYTES];
        for (at, bytes) in (item.at..).zip(scratch.chunks_mut(4).take(item.length.div_ceil(4) as usize)) {
            bytes.copy_from_slice(&self.0.load(self.journal(at)).to_le_bytes());
        }
        postcard::from_bytes(scratch.get(..item.length as usize)?).ok()
    }
}

/// An item of the journal.
struct Item {
    kind: u32,
    /// Bytes.
    length: u32,
    number: u32,
    /// Where its content begins.
    at: u32,
}

/// Words of an item with `length` bytes.
fn item_words(length: u32) -> u32 {
    2 + length.div_ceil(4)
}

/// An item longer than 1,536 bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TooLong;

/// Why the ticks could not be run again, or did not come out the same.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ReplayError {
    /// The checksum is wrong, or the recording goes on.
    Damaged,
    /// There are no ticks.
    Empty,
    /// There is no copy of the drive to begin with, or it cannot be read: another version of the firmware wrote it.
    NoCopy,
    /// A tick came out differently.
    Mismatch(Mismatch),
}

impl core::fmt::Display for ReplayError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            ReplayError::Damaged => f.write_str("the black box is still recording, or what was read of it is damaged"),
            ReplayError::Empty => f.write_str("the black box is empty"),
            ReplayError::NoCopy => f.write_str("the black box has no copy of the drive that this version can read"),
            ReplayError::Mismatch(mismatch) => write!(f, "{mismatch}"),
        }
    }
}

impl core::error::Error for ReplayError {}

#[cfg(test)]
mod tests {
    extern crate std;
    use super::*;
    use proptest::prelude::*;
    use std::vec::Vec;

    fn memory(header: [u32; ENTRIES_AT], filling: u32) -> Vec<Cell<u32>> {
        let words = std::vec![Cell::new(filling); WORDS];
        words.iter().zip(header).for_each(|(cell, word)| cell.set(word));
        // Something that may pass for items.
        words[JOURNAL_AT..]
            .iter()
            .zip(0..)
            .for_each(|(cell, i)| cell.set(if i % 7 == 0 { filling << 8 | 1 } else { i }));
        words
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]

        #[test]
        fn whatever_memory_holds_is_found_to_be_a_recording_or_not_without_panic(
            mut header: [u32; ENTRIES_AT],
            written in 0..4 * ENTRIES,
            journal_words in 0..3 * JOURNAL_WORDS as u32,
            filling in prop_oneof![0..64u32, any::<u32>()],
        ) {
            header[0] = MAGIC;
            (header[WRITTEN], header[END]) = (written, header[BEGIN].wrapping_add(journal_words));
            let words = memory(header, filling);
            let black_box = BlackBox(&words[..]);
            let found = black_box.find();
            prop_assert_eq!(found.is_some(), black_box.is_intact());
            prop_assert!(black_box.replay().is_err());
        }
    }

    #[test]
    fn an_empty_box_is_not_found_and_knows_who_made_it() {
        let words = memory([u32::MAX; ENTRIES_AT], u32::MAX);
        let black_box = BlackBox(&words[..]);
        black_box.clear([1, 23, 456]);
        assert_eq!((black_box.find(), black_box.firmware(), black_box.entries().count()), (None, [1, 23, 456], 0));
    }
}
