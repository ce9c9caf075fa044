//! The black box: what the drive was told and what it did in the ticks around the first fault, so that they can be run again.
//!
//! Of each tick there is an [`Entry`]: everything that [`Drive::tick`] was given, and its record. With the drive as it was before
//! the first of them, [`replay`] computes the same records once more, to the last bit. Where entries, drives and commands are kept
//! and how they survive a reset is the application's business; this module decides *which* ticks are kept.

use crate::drive::{Command, Drive, Inputs};
use crate::record::{self, TickRecord, flags};

/// Ticks kept from before a fault, at least.
pub const BEFORE_TICKS: u32 = 512;
/// Ticks kept after it.
pub const AFTER_TICKS: u32 = 64;
/// A copy of the drive is due every so many ticks.
pub const COPY_EVERY_TICKS: u32 = 128;
/// Entries that there is room for: what is kept, one distance between two copies, and 8 ms for a task to store one.
pub const ENTRIES: u32 = BEFORE_TICKS + AFTER_TICKS + COPY_EVERY_TICKS + 64;
/// 32-bit words of an entry.
pub const ENTRY_WORDS: usize = record::WORDS + 5;

/// One tick: its record, then encoder frame (low word first), codes of bus (low half) and temperature, signals, and the number of
/// the command it took, 0 if none.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Entry(pub [u32; ENTRY_WORDS]);

impl Entry {
    /// What went into a tick and what came out.
    #[inline]
    pub fn new(inputs: &Inputs, command_number: u32, record: &TickRecord) -> Entry {
        let [r0, r1, r2, r3, r4, r5, r6, r7, r8, r9, r10, r11, r12, r13, r14, r15] = record.words();
        let codes = u32::from(inputs.bus_code) | u32::from(inputs.temperature_code) << 16;
        let (low, high) = (inputs.frame as u32, (inputs.frame >> 32) as u32);
        Entry([
            r0,
            r1,
            r2,
            r3,
            r4,
            r5,
            r6,
            r7,
            r8,
            r9,
            r10,
            r11,
            r12,
            r13,
            r14,
            r15,
            low,
            high,
            codes,
            inputs.signals,
            command_number,
        ])
    }

    /// Number of the tick.
    pub fn sequence(&self) -> u32 {
        self.0[0]
    }

    /// Words of the record, see [`TickRecord::words`].
    pub fn record(&self) -> &[u32] {
        &self.0[..record::WORDS]
    }

    /// What the drive was told. The last tick's duration is that of the record, which ends at 65,535 cycles: as far above any
    /// limit as what it stands for.
    pub fn inputs(&self) -> Inputs {
        let [.., low, high, codes, signals, _] = self.0;
        Inputs {
            frame: u64::from(low) | u64::from(high) << 32,
            iq_a: f32::from_bits(self.0[12]),
            bus_code: codes as u16,
            temperature_code: (codes >> 16) as u16,
            signals,
            last_tick_cycles: self.0[14] >> 16,
        }
    }

    /// Number of the command that the tick took.
    pub fn command_number(&self) -> Option<u32> {
        let [.., number] = self.0;
        (number != 0).then_some(number)
    }

    /// The number of the record's fault, 0 if none.
    pub fn fault_number(&self) -> u16 {
        self.0[15] as u16
    }
}

/// What the black box is doing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Phase {
    /// Every tick replaces the oldest one.
    Recording,
    /// A fault was seen; so many ticks more.
    Ending(u32),
    /// Full, and kept until the bridge is next turned on.
    Kept,
}

/// Decides which ticks are kept.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Recorder {
    phase: Phase,
    written: u32,
    /// Ticks until a copy of the drive is due.
    copy_in: u32,
}

impl Recorder {
    /// Records from the next tick on.
    pub const fn recording() -> Self {
        Recorder { phase: Phase::Recording, written: 0, copy_in: 0 }
    }

    /// Keeps what `written` entries of an earlier run have left, until the bridge is turned on.
    pub const fn keeping(written: u32) -> Self {
        Recorder { phase: Phase::Kept, written, copy_in: 0 }
    }

    /// What it is doing.
    pub fn phase(&self) -> Phase {
        self.phase
    }

    /// Entries since recording began, less the rounds that have been overwritten: below `2 * ENTRIES`. Number `n` is at index
    /// `n % ENTRIES`, and the newest [`ENTRIES`] of them are there.
    pub fn written(&self) -> u32 {
        self.written
    }

    /// Looks at a tick's record; the index at which the tick is to be stored, if it is.
    #[inline]
    pub fn step(&mut self, record: &TickRecord) -> Option<u32> {
        match self.phase {
            Phase::Recording => {
                if record.fault.is_some() {
                    self.phase = Phase::Ending(AFTER_TICKS);
                }
            }
            Phase::Ending(0) => {
                self.phase = Phase::Kept;
                return None;
            }
            Phase::Ending(left) => self.phase = Phase::Ending(left - 1),
            Phase::Kept if record.flags & flags::BRIDGE_ON != 0 => *self = Self::recording(),
            Phase::Kept => return None,
        }
        if self.written == 2 * ENTRIES - 1 {
            self.written = ENTRIES - 1;
        }
        let index = if self.written < ENTRIES { self.written } else { self.written - ENTRIES };
        self.written += 1;
        self.copy_in = self.copy_in.saturating_sub(1);
        Some(index)
    }

    /// Whether the drive is to be copied now, after the tick; asks once per due copy.
    #[inline]
    pub fn copy_is_due(&mut self) -> bool {
        let due = self.copy_in == 0 && self.written != 0 && self.phase != Phase::Kept;
        if due {
            self.copy_in = COPY_EVERY_TICKS;
        }
        due
    }
}

/// A tick that came out differently.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Mismatch {
    /// This word of the record of this tick (see [`TickRecord::words`]) is another one.
    Word {
        /// Tick.
        sequence: u32,
        /// Index of the first word that differs.
        word: usize,
    },
    /// The command with this number was not kept.
    NoCommand {
        /// Tick that took it.
        sequence: u32,
        /// Its number.
        number: u32,
    },
}

impl core::fmt::Display for Mismatch {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Mismatch::Word { sequence, word } => write!(f, "tick {sequence}: word {word} of the record differs"),
            Mismatch::NoCommand { sequence, number } => {
                write!(f, "tick {sequence}: its command (number {number}) was not kept")
            }
        }
    }
}

impl core::error::Error for Mismatch {}

/// Runs `entries` again on `drive`, which is as it was before the first of them; `command` gives the commands by number. Returns how
/// many ticks came out the same.
///
/// # Errors
/// The first tick that did not.
pub fn replay(
    drive: &mut Drive,
    entries: impl IntoIterator<Item = Entry>,
    mut command: impl FnMut(u32) -> Option<Command>,
) -> Result<u32, Mismatch> {
    let mut ticks = 0;
    for entry in entries {
        let sequence = entry.sequence();
        let command = match entry.command_number() {
            Some(number) => Some(command(number).ok_or(Mismatch::NoCommand { sequence, number })?),
            None => None,
        };
        let output = drive.tick(&entry.inputs(), command.as_ref());
        let words = output.record.words();
        if let Some(word) = words.iter().zip(entry.record()).position(|(now, then)| now != then) {
            return Err(Mismatch::Word { sequence, word });
        }
        ticks += 1;
    }
    Ok(ticks)
}

#[cfg(test)]
mod tests {
    extern crate std;
    use super::*;
    use crate::fault::Fault;
    use std::vec::Vec;

    fn record(fault: bool, on: bool) -> TickRecord {
        TickRecord {
            fault: fault.then_some(Fault::BusOverVoltage),
            flags: if on { flags::BRIDGE_ON } else { 0 },
            ..TickRecord::default()
        }
    }

    #[test]
    fn it_keeps_the_tick_of_the_fault_and_64_after_it_and_then_nothing_until_the_bridge_is_on() {
        let mut recorder = Recorder::recording();
        for _ in 0..5_000 {
            assert!(recorder.step(&record(false, true)).is_some());
        }
        let kept = (0..1_000).filter(|_| recorder.step(&record(true, false)).is_some()).count();
        assert_eq!((kept as u32, recorder.phase()), (1 + AFTER_TICKS, Phase::Kept));
        // Acknowledged, and off: still kept.
        assert_eq!(recorder.step(&record(false, false)), None);
        assert_eq!(recorder.written() % ENTRIES, (5_000 + 1 + AFTER_TICKS) % ENTRIES);
        assert_eq!((recorder.step(&record(false, true)), recorder.written()), (Some(0), 1));
    }

    #[test]
    fn entries_go_round_and_copies_are_due_after_the_first_one_and_then_regularly() {
        let mut recorder = Recorder::recording();
        assert!(!recorder.copy_is_due());
        let mut due = Vec::new();
        for tick in 0..3 * ENTRIES {
            assert_eq!(recorder.step(&record(false, false)), Some(tick % ENTRIES));
            if recorder.copy_is_due() {
                due.push(tick);
            }
            assert!(!recorder.copy_is_due(), "asked twice in a tick");
        }
        assert!(due.iter().enumerate().all(|(i, tick)| *tick == i as u32 * COPY_EVERY_TICKS), "{due:?}");
    }

    #[test]
    fn what_an_earlier_run_left_is_kept() {
        let mut recorder = Recorder::keeping(700);
        assert_eq!(recorder.step(&record(true, false)), None);
        assert!(!recorder.copy_is_due());
        assert_eq!((recorder.phase(), recorder.written()), (Phase::Kept, 700));
    }

    #[test]
    fn an_entry_gives_back_its_inputs() {
        let inputs = Inputs {
            frame: 0x0123_4567_89ab_cdef,
            iq_a: -1.25,
            bus_code: 0xfedc,
            temperature_code: 0xba98,
            signals: 0x89ab_cdef,
            last_tick_cycles: 4_321,
        };
        let record = TickRecord { sequence: 7, iq_a: inputs.iq_a, tick_cycles: 4_321, ..record(true, true) };
        let entry = Entry::new(&inputs, 3, &record);
        assert_eq!((entry.inputs(), entry.sequence(), entry.command_number()), (inputs, 7, Some(3)));
        assert_eq!(entry.record(), record.words());
        assert_eq!(entry.fault_number(), Fault::BusOverVoltage.number());
        assert_eq!(Entry::new(&inputs, 0, &record).command_number(), None);
    }
}
