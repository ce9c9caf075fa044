//! Two sectors, one image each: a save cut short at any instant leaves the old image or the new one.
//!
//! A save erases the sector that does *not* hold the image in use, programs the new image, and then two seals, one after the other.
//! Only a sealed image counts, and of two the one with the higher sequence number.
//!
//! # What a power cut leaves behind
//! A word whose programming was cut short may read as erased, as programmed, as anything, or not at all, and differently after every
//! power-up; so may every word of a sector whose erasure was. Two things follow. An image is *confirmed* when both seals of a pair can be read:
//! the second was begun after the first was complete, so that one of them will be there for ever. And what is not confirmed has to be
//! made final before anyone relies on it: [`Store::open`] tells what to do ([`Settle`]): seal the image in use once more, erase an image that was
//! not sealed. Only then is the other sector ever erased.

use crate::image::{self, BLANK, Header, Invalid, WORDS, Word};
use crate::parameters::Settings;

/// Pairs of seals that a sector has room for: one for the save, one for every power cut that left the one before it undecided.
const SEAL_PAIRS: u32 = 64;

/// One of the two sectors.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Slot {
    /// The lower one.
    A,
    /// The upper one.
    B,
}

impl Slot {
    /// Both.
    pub const ALL: [Slot; 2] = [Slot::A, Slot::B];

    /// The other one.
    pub fn other(self) -> Slot {
        match self {
            Slot::A => Slot::B,
            Slot::B => Slot::A,
        }
    }
}

/// What the flash is to do next. Each step must be complete before the next one begins, and a step that fails ends the job.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Step {
    /// Erase a sector.
    Erase(Slot),
    /// Program a word, and read it back.
    Program {
        /// Sector.
        slot: Slot,
        /// Number of the word in the sector.
        index: u32,
        /// Its content.
        word: Word,
    },
}

/// Where the image in use is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Current {
    /// Sector.
    pub slot: Slot,
    /// Number of the save that wrote it.
    pub sequence: u32,
    /// Version of the table that it was written with.
    pub schema: u16,
}

/// Steps that make final what an earlier power cut left undecided: none, unless there was one. To be carried out before the settings
/// are used.
pub type Settle = [Option<Step>; 4];

/// Which sector holds the image in use.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Store {
    newest: Option<Current>,
}

/// The contents of the store.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Opened {
    /// Bookkeeping for the saves to come.
    pub store: Store,
    /// The stored settings, or why sector A and sector B give none.
    pub settings: Result<Settings, [Invalid; 2]>,
    /// What to do first.
    pub settle: Settle,
}

impl Store {
    /// Reads both sectors with `read` (`None`: the word cannot be read) and chooses.
    ///
    /// The newest sealed image decides alone: if this firmware cannot use it, no older one stands in for it unnoticed.
    pub fn open(mut read: impl FnMut(Slot, u32) -> Option<Word>) -> Opened {
        let found = Slot::ALL.map(|slot| Found::look(slot, |index| read(slot, index)));
        let [a, b] = &found;
        let newest = match (a.sealed(), b.sealed()) {
            (Some(a_header), Some(b_header)) => Some(if b_header.sequence > a_header.sequence { b } else { a }),
            (Some(_), None) => Some(a),
            (None, Some(_)) => Some(b),
            (None, None) => None,
        };
        let mut reasons = found.each_ref().map(Found::reason);
        let mut settle = [None; 4];
        let mut store = Store::default();
        let mut settings = None;
        if let Some((newest, header)) = newest.and_then(|found| Some((found, found.sealed()?))) {
            let slot = newest.slot;
            store.newest = Some(Current { slot, sequence: header.sequence, schema: header.schema });
            match image::settings(&header, |index| read(slot, index)) {
                Ok(found) => settings = Some(found),
                Err(invalid) => reasons[slot as usize] = invalid,
            }
            if let (false, Some(index)) = (newest.confirmed, newest.free) {
                let word = header.seal();
                settle[0] = Some(Step::Program { slot, index, word });
                settle[1] = Some(Step::Program { slot, index: index + 1, word });
            }
        }
        for (step, found) in settle[2..].iter_mut().zip(&found) {
            *step = (found.image.is_ok() && !found.is_sealed).then_some(Step::Erase(found.slot));
        }
        Opened { store, settings: settings.ok_or(reasons), settle }
    }

    /// The newest sealed image, whether this firmware can use it or not.
    pub fn newest(&self) -> Option<Current> {
        self.newest
    }

    /// The steps that store `settings`.
    pub fn save(&self, settings: &Settings) -> Save {
        let slot = self.newest.map_or(Slot::A, |newest| newest.slot.other());
        let sequence = self.newest.map_or(1, |newest| newest.sequence.saturating_add(1));
        let (words, seal) = image::encode(settings, sequence);
        Save { target: Current { slot, sequence, schema: image::SCHEMA }, words, seal, done: 0 }
    }

    /// Every step of `save` has been carried out: its image is the one in use.
    pub fn saved(&mut self, save: &Save) {
        self.newest = Some(save.target);
    }
}

/// A save in progress: an iterator over its steps.
#[derive(Clone, Debug)]
pub struct Save {
    target: Current,
    words: [Word; WORDS],
    seal: Word,
    done: u16,
}

impl Save {
    /// Number of steps of every save.
    pub const STEPS: u16 = 1 + WORDS as u16 + 2;

    /// What the image will be when the last step is done. If a step fails, this sector is to be erased: the image in use is in the other one.
    pub fn target(&self) -> Current {
        self.target
    }

    /// Steps handed out so far, of [`Save::STEPS`].
    pub fn done(&self) -> u16 {
        self.done
    }
}

impl Iterator for Save {
    type Item = Step;

    fn next(&mut self) -> Option<Step> {
        let slot = self.target.slot;
        let step = match self.done.checked_sub(1) {
            _ if self.done == Self::STEPS => return None,
            None => Step::Erase(slot),
            Some(index) => {
                let word = self.words.get(usize::from(index)).copied().unwrap_or(self.seal);
                Step::Program { slot, index: index.into(), word }
            }
        };
        self.done += 1;
        Some(step)
    }
}

/// What there is in a sector.
struct Found {
    slot: Slot,
    image: Result<Header, Invalid>,
    is_sealed: bool,
    /// Some pair of seals is complete.
    confirmed: bool,
    /// First word of the pair behind the last one that is not erased.
    free: Option<u32>,
}

impl Found {
    fn look(slot: Slot, mut read: impl FnMut(u32) -> Option<Word>) -> Found {
        let mut found = Found { slot, image: image::intact(&mut read), is_sealed: false, confirmed: false, free: None };
        let Ok(header) = found.image else { return found };
        let seal = Some(header.seal());
        found.free = Some(header.words());
        // All of them: a torn seal may read as erased today.
        for pair_number in 0..SEAL_PAIRS {
            let index = header.words() + 2 * pair_number;
            let pair = [read(index), read(index + 1)];
            if pair != [Some(BLANK); 2] {
                found.free = Some(index + 2).filter(|_| pair_number + 1 < SEAL_PAIRS);
            }
            found.is_sealed |= pair.contains(&seal);
            found.confirmed |= pair == [seal; 2];
        }
        found
    }

    fn sealed(&self) -> Option<Header> {
        self.image.ok().filter(|_| self.is_sealed)
    }

    /// Why this sector is not the one that counts.
    fn reason(&self) -> Invalid {
        match self.image {
            Err(invalid) => invalid,
            Ok(_) if !self.is_sealed => Invalid::Unsealed,
            Ok(_) => Invalid::Superseded,
        }
    }
}
