//! Two flash sectors with anything in them.

use crc::{CRC_32_ISO_HDLC, Crc};
use servo_core::image::{self, BLANK, WORD_BYTES, Word};
use servo_core::parameters::Settings;
use servo_core::store::{Opened, Step, Store};

/// Words that a sector of the input may have.
const WORDS: usize = 64;
/// A word of these bytes cannot be read.
const UNREADABLE: u8 = 0xec;

type Sector = Vec<Word>;

/// Takes the first byte as options, the second as the length of sector A in words, the rest as the words of A and B; opens, settles, saves,
/// and opens again.
///
/// # Panics
/// Where accepted settings are not valid, settling would touch what it must not, or what was saved is not found again.
pub fn check(bytes: &[u8]) {
    let [options, length, rest @ ..] = bytes else { return };
    let words: Vec<Word> = rest.as_chunks::<WORD_BYTES>().0.to_vec();
    let (a, b) = words.split_at(usize::from(*length).min(words.len()));
    let mut flash = [a, b].map(|words| words[..words.len().min(WORDS)].to_vec());
    for (sector, mask) in flash.iter_mut().zip([1, 2]) {
        if options & mask != 0 {
            repair(sector, options & (mask << 2) != 0);
        }
    }
    let opened = open(&flash);
    let newest = opened.store.newest();
    if let Ok(settings) = opened.settings {
        assert_eq!(settings.validate(), Ok(()));
        assert!(newest.is_some());
    }
    for step in opened.settle.into_iter().flatten() {
        match step {
            Step::Erase(slot) => assert_ne!(newest.map(|newest| newest.slot), Some(slot)),
            Step::Program { slot, index, .. } => {
                assert_eq!(
                    (newest.map(|newest| newest.slot), word(&flash[slot as usize], index)),
                    (Some(slot), Some(BLANK))
                );
            }
        }
        carry_out(&mut flash, step);
    }
    let settled = open(&flash);
    assert_eq!((settled.settings.ok(), settled.store.newest()), (opened.settings.ok(), newest));

    let mut store = settled.store;
    let settings = Settings { niasa_coulomb_n: 0.123, ..settled.settings.unwrap_or_default() };
    let save = store.save(&settings);
    save.clone().for_each(|step| carry_out(&mut flash, step));
    store.saved(&save);
    let saved = open(&flash);
    // After four thousand million saves the numbers are used up.
    if newest.is_none_or(|newest| newest.sequence < u32::MAX) {
        assert_eq!((saved.settings, saved.store, saved.settle), (Ok(settings), store, [None; 4]));
    }
}

fn open(flash: &[Sector; 2]) -> Opened {
    Store::open(|slot, index| word(&flash[slot as usize], index))
}

fn word(sector: &[Word], index: u32) -> Option<Word> {
    let word = sector.get(index as usize).copied().unwrap_or(BLANK);
    (word != [UNREADABLE; WORD_BYTES]).then_some(word)
}

fn carry_out(flash: &mut [Sector; 2], step: Step) {
    match step {
        Step::Erase(slot) => flash[slot as usize].clear(),
        Step::Program { slot, index, word } => {
            let (sector, index) = (&mut flash[slot as usize], index as usize);
            sector.resize(sector.len().max(index + 1), BLANK);
            sector[index] = word;
        }
    }
}

/// Makes an image of what is there: magic and checksums, and a pair of seals behind it.
fn repair(sector: &mut Sector, sealed: bool) {
    let crc = Crc::<u32>::new(&CRC_32_ISO_HDLC);
    let checked = |mut word: Word| {
        let checksum = crc.checksum(&word[..28]).to_le_bytes();
        word[28..].copy_from_slice(&checksum);
        word
    };
    let Some(mut header) = sector.first().copied() else { return };
    header[..4].copy_from_slice(b"SVPI");
    let entries = usize::from(u16::from_le_bytes([header[6], header[7]]) % (3 * WORDS as u16));
    header[6..8].copy_from_slice(&(entries as u16).to_le_bytes());
    let words = 1 + entries.div_ceil(3);
    sector.resize(words, [0; WORD_BYTES]);
    header[12..16].copy_from_slice(&crc.checksum(&sector[1..].concat()).to_le_bytes());
    sector[0] = checked(header);
    if sealed {
        let mut seal = [0; WORD_BYTES];
        seal[..4].copy_from_slice(b"SEAL");
        seal[4..8].copy_from_slice(&sector[0][8..12]);
        seal[8..12].copy_from_slice(&sector[0][28..]);
        sector.extend([checked(seal); 2]);
    }
}

/// Images of both schemas in either sector, complete, unsealed, and with words that cannot be read.
pub fn seeds() -> Vec<Vec<u8>> {
    let (words, seal) = image::encode(&Settings::default(), 5);
    let now = [&words[..], &[seal; 2]].concat();
    let before = include_bytes!("../../core/tests/images/schema-1.bin");
    let input = |options: u8, a: &[u8], b: &[u8]| [&[options, (a.len() / WORD_BYTES) as u8][..], a, b].concat();
    let bytes = |words: &[Word]| words.concat();
    vec![
        input(0, before, &bytes(&now)),
        input(0, &bytes(&now), before),
        input(0, &bytes(&now[..now.len() - 1]), before),
        input(0, &bytes(&now), &bytes(&words)),
        input(0, &[&bytes(&words)[..], &[UNREADABLE; WORD_BYTES]].concat(), before),
        input(0x0f, &bytes(&words), before),
        input(0x0f, &bytes(&words[..3]), &[]),
        input(0x0f, &[], before),
    ]
}
