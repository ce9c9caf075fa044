//! A parameter image: what one flash sector holds.
//!
//! ```text
//! word 0       header   magic, schema, entries, sequence, CRC-32 of the body; CRC-32 of the header itself in the last 4 bytes
//! word 1 …     body     3 entries a word: id (u16), value (f64) in the unit of the table; ids ascending, unused entries 0
//! then         seals    in pairs; words that repeat sequence and checksum of the header. An image without a seal is none
//! ```
//! A word is the unit that the flash of the STM32H743 programs at once and protects with ECC: 32 bytes. All numbers are little-endian.
//! Why there are seals, and two at a time: see [`crate::store`].

use crc::{CRC_32_ISO_HDLC, Crc, NoTable};

use crate::parameters::{COUNT, Parameter, Settings, TABLE};
use crate::refusal::Refusal;

/// Bytes of a flash word.
pub const WORD_BYTES: usize = 32;
/// What is programmed at once.
pub type Word = [u8; WORD_BYTES];
/// An erased word.
pub const BLANK: Word = [0xff; WORD_BYTES];

/// Version of the table that images are written with. To be raised with every release whose table differs from the one before.
pub const SCHEMA: u16 = 2;
/// Oldest version that is still read.
pub const OLDEST_SCHEMA: u16 = SCHEMA - 1;

/// First version with `commutation_identity`.
const COMMUTATION_IDENTITY_SINCE: u16 = 2;

/// Words of an image of the present table, header included, seals not.
pub const WORDS: usize = 1 + COUNT.div_ceil(ENTRIES_PER_WORD);
/// More entries than any table has; a header that claims more is none.
const MAX_ENTRIES: u16 = 999;

const MAGIC: [u8; 4] = *b"SVPI";
const SEAL_MAGIC: [u8; 4] = *b"SEAL";
const ENTRY_BYTES: usize = 10;
const ENTRIES_PER_WORD: usize = WORD_BYTES / ENTRY_BYTES;
/// Where header and seal keep the CRC-32 of what is in front of it.
const CHECKED_BYTES: usize = WORD_BYTES - 4;

const CRC32: Crc<u32, NoTable> = Crc::<u32, NoTable>::new(&CRC_32_ISO_HDLC);

/// Why a sector gives no parameters.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Invalid {
    /// The first word is erased.
    Blank,
    /// The first word is no header, or cannot be read.
    NoHeader,
    /// The body cannot be read or does not fit its checksum.
    Body,
    /// Intact, but the save that wrote it was not finished.
    Unsealed,
    /// Intact; the other sector's image is newer.
    Superseded,
    /// Written with this version of the table, which this firmware does not read.
    Schema(u16),
    /// The parameter with this id is missing.
    Missing(u16),
    /// A value that the drive refuses.
    Refused(Refusal),
}

impl core::fmt::Display for Invalid {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match *self {
            Invalid::Blank => f.write_str("nothing was ever saved"),
            Invalid::NoHeader => f.write_str("no parameter image"),
            Invalid::Body => f.write_str("the image is damaged"),
            Invalid::Unsealed => f.write_str("saving was not finished"),
            Invalid::Superseded => f.write_str("an older image"),
            Invalid::Schema(schema) => {
                write!(f, "written with schema {schema}, but this firmware reads {OLDEST_SCHEMA} and {SCHEMA}")
            }
            Invalid::Missing(id) => write!(f, "{} is missing", Parameter::by_id(id).map_or("a parameter", |p| p.name)),
            Invalid::Refused(refusal) => write!(f, "{refusal}"),
        }
    }
}

/// What the header of an intact image says.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Header {
    /// Version of the table.
    pub schema: u16,
    /// Parameters in the body.
    pub entries: u16,
    /// Number of the save, from 1; the higher one is the newer image.
    pub sequence: u32,
    body_crc: u32,
    /// Of the header word: what the seals repeat.
    crc: u32,
}

impl Header {
    /// Words of the image, header included; the seals begin behind them.
    pub fn words(&self) -> u32 {
        1 + u32::from(self.entries).div_ceil(ENTRIES_PER_WORD as u32)
    }

    /// The seal of this image: the same word every time.
    pub fn seal(&self) -> Word {
        let [q0, q1, q2, q3] = self.sequence.to_le_bytes();
        let [c0, c1, c2, c3] = self.crc.to_le_bytes();
        let mut word = [0; WORD_BYTES];
        word[..12].copy_from_slice(&[
            SEAL_MAGIC[0],
            SEAL_MAGIC[1],
            SEAL_MAGIC[2],
            SEAL_MAGIC[3],
            q0,
            q1,
            q2,
            q3,
            c0,
            c1,
            c2,
            c3,
        ]);
        checked(word)
    }

    fn read(word: &Word) -> Option<Header> {
        let crc = checksum(word)?;
        let [m0, m1, m2, m3, s0, s1, n0, n1, q0, q1, q2, q3, c0, c1, c2, c3, ..] = *word;
        let header = Header {
            schema: u16::from_le_bytes([s0, s1]),
            entries: u16::from_le_bytes([n0, n1]),
            sequence: u32::from_le_bytes([q0, q1, q2, q3]),
            body_crc: u32::from_le_bytes([c0, c1, c2, c3]),
            crc,
        };
        ([m0, m1, m2, m3] == MAGIC && header.entries <= MAX_ENTRIES).then_some(header)
    }
}

/// Puts the checksum of the rest into a word's last bytes.
fn checked(mut word: Word) -> Word {
    let crc = CRC32.checksum(&word[..CHECKED_BYTES]);
    word[CHECKED_BYTES..].copy_from_slice(&crc.to_le_bytes());
    word
}

/// The checksum in a word's last bytes, if it is right.
fn checksum(word: &Word) -> Option<u32> {
    let (rest, crc) = word.split_last_chunk::<4>()?;
    let crc = u32::from_le_bytes(*crc);
    (CRC32.checksum(rest) == crc).then_some(crc)
}

/// The image of `settings`, to be programmed in this order, and its seal.
pub fn encode(settings: &Settings, sequence: u32) -> ([Word; WORDS], Word) {
    let mut words = [[0; WORD_BYTES]; WORDS];
    for (word, rows) in words[1..].iter_mut().zip(TABLE.chunks(ENTRIES_PER_WORD)) {
        for (entry, row) in word.chunks_exact_mut(ENTRY_BYTES).zip(rows) {
            entry[..2].copy_from_slice(&row.id.to_le_bytes());
            entry[2..].copy_from_slice(&row.get(settings).to_le_bytes());
        }
    }
    let mut digest = CRC32.digest();
    words[1..].iter().for_each(|word| digest.update(word));
    let body_crc = digest.finalize();

    let mut head = [0; WORD_BYTES];
    head[..4].copy_from_slice(&MAGIC);
    head[4..6].copy_from_slice(&SCHEMA.to_le_bytes());
    head[6..8].copy_from_slice(&(COUNT as u16).to_le_bytes());
    head[8..12].copy_from_slice(&sequence.to_le_bytes());
    head[12..16].copy_from_slice(&body_crc.to_le_bytes());
    words[0] = checked(head);
    let crc = u32::from_le_bytes([words[0][28], words[0][29], words[0][30], words[0][31]]);
    let header = Header { schema: SCHEMA, entries: COUNT as u16, sequence, body_crc, crc };
    (words, header.seal())
}

/// The header of the image that `read` gives word by word (`None`: the word cannot be read), if header and body are intact.
///
/// # Errors
/// [`Invalid::Blank`], [`Invalid::NoHeader`] or [`Invalid::Body`].
pub fn intact(mut read: impl FnMut(u32) -> Option<Word>) -> Result<Header, Invalid> {
    let first = read(0).ok_or(Invalid::NoHeader)?;
    if first == BLANK {
        return Err(Invalid::Blank);
    }
    let header = Header::read(&first).ok_or(Invalid::NoHeader)?;
    let mut digest = CRC32.digest();
    for index in 1..header.words() {
        digest.update(&read(index).ok_or(Invalid::Body)?);
    }
    if digest.finalize() == header.body_crc { Ok(header) } else { Err(Invalid::Body) }
}

/// The settings of an [`intact`] image.
///
/// An image of the present schema must hold every parameter. In one of the schema before, a parameter that is new since then takes
/// its default, or another value, so that the drive behaves as it did; one that is gone is ignored.
///
/// # Errors
/// [`Invalid::Schema`], [`Invalid::Missing`], or [`Invalid::Refused`] with the value and its range.
pub fn settings(header: &Header, mut read: impl FnMut(u32) -> Option<Word>) -> Result<Settings, Invalid> {
    if !(OLDEST_SCHEMA..=SCHEMA).contains(&header.schema) {
        return Err(Invalid::Schema(header.schema));
    }
    let mut settings = Settings::default();
    if header.schema < COMMUTATION_IDENTITY_SINCE {
        // The drive that wrote it commutated by its offset, whatever the encoder.
        settings.commutation_identity = settings.encoder_identity;
    }
    let mut found = [false; COUNT];
    for index in 1..header.words() {
        let word = read(index).ok_or(Invalid::Body)?;
        for entry in word.chunks_exact(ENTRY_BYTES) {
            let [i0, i1, value @ ..] = entry else { continue };
            let id = u16::from_le_bytes([*i0, *i1]);
            let value = value.first_chunk().map_or(f64::NAN, |bytes| f64::from_le_bytes(*bytes));
            let Some(row) = TABLE.iter().position(|row| row.id == id) else { continue };
            TABLE[row].set(&mut settings, value).map_err(Invalid::Refused)?;
            found[row] = true;
        }
    }
    if header.schema == SCHEMA
        && let Some(missing) = found.iter().position(|found| !found)
    {
        return Err(Invalid::Missing(TABLE[missing].id));
    }
    settings.validate().map_err(Invalid::Refused)?;
    Ok(settings)
}

#[cfg(test)]
mod tests {
    extern crate std;
    use super::*;
    use proptest::prelude::*;
    use std::vec::Vec;

    /// Any values in their ranges; those that are out of order with one another are left at their defaults.
    fn any_settings() -> impl Strategy<Value = Settings> {
        proptest::collection::vec(0.0..=1.0f64, COUNT).prop_map(|shares| {
            let mut settings = Settings::default();
            for (row, share) in TABLE.iter().zip(shares) {
                let before = settings;
                let value = (row.min + share * (row.max - row.min)).clamp(row.min, row.max);
                if row.set(&mut settings, value).and_then(|()| settings.validate()).is_err() {
                    settings = before;
                }
            }
            settings
        })
    }

    fn load(words: &[Word]) -> Result<Settings, Invalid> {
        let read = |index: u32| words.get(index as usize).copied();
        settings(&intact(read)?, read)
    }

    fn sample() -> Vec<Word> {
        encode(&Settings { niasa_coulomb_n: 0.61, ..Settings::default() }, 7).0.to_vec()
    }

    #[test]
    fn an_erased_or_foreign_sector_is_no_image() {
        assert_eq!(load(&[BLANK; 8]), Err(Invalid::Blank));
        assert_eq!(load(&[[0; WORD_BYTES]; 8]), Err(Invalid::NoHeader));
        assert_eq!(load(&[]), Err(Invalid::NoHeader));
    }

    #[test]
    fn a_word_that_cannot_be_read_makes_no_image() {
        let words = sample();
        for broken in 0..words.len() as u32 {
            let read = |index: u32| if index == broken { None } else { words.get(index as usize).copied() };
            assert_eq!(intact(read), Err(if broken == 0 { Invalid::NoHeader } else { Invalid::Body }), "word {broken}");
        }
    }

    #[test]
    fn an_image_of_another_schema_is_refused_with_both_numbers() {
        let mut words = sample();
        words[0][4] = SCHEMA as u8 + 1;
        words[0] = checked(words[0]);
        let refused = load(&words).unwrap_err();
        assert_eq!(refused, Invalid::Schema(SCHEMA + 1));
        use std::string::ToString;
        assert_eq!(refused.to_string(), "written with schema 3, but this firmware reads 1 and 2");
    }

    /// A body as a future or faulty writer might leave it: right checksums, `change` in the first entry.
    fn with_first_entry(id: u16, value: f64) -> Vec<Word> {
        let mut words = sample();
        words[1][..2].copy_from_slice(&id.to_le_bytes());
        words[1][2..10].copy_from_slice(&value.to_le_bytes());
        let body: Vec<u8> = words[1..].concat();
        words[0][12..16].copy_from_slice(&CRC32.checksum(&body).to_le_bytes());
        words[0] = checked(words[0]);
        words
    }

    #[test]
    fn a_missing_parameter_is_named() {
        assert_eq!(load(&with_first_entry(0xfff0, 0.0)), Err(Invalid::Missing(0x0101)));
    }

    #[test]
    fn a_value_out_of_range_is_named() {
        for value in [-1.0, f64::NAN, f64::INFINITY] {
            let refused = load(&with_first_entry(0x0101, value)).unwrap_err();
            assert!(matches!(refused, Invalid::Refused(Refusal::OutOfRange { .. })), "{refused}");
        }
    }

    proptest! {
        #[test]
        fn what_was_encoded_is_decoded(settings in any_settings(), sequence: u32) {
            let (words, seal) = encode(&settings, sequence);
            let header = intact(|index| words.get(index as usize).copied()).unwrap();
            prop_assert_eq!((header.sequence, header.words() as usize), (sequence, WORDS));
            prop_assert_eq!(header.seal(), seal);
            prop_assert_eq!(load(&words), Ok(settings));
        }

        #[test]
        fn a_wrong_bit_anywhere_makes_no_image(word in 0..WORDS, bit in 0..8 * WORD_BYTES) {
            let mut words = sample();
            words[word][bit / 8] ^= 1 << (bit % 8);
            prop_assert_eq!(load(&words), Err(if word == 0 { Invalid::NoHeader } else { Invalid::Body }));
        }

        #[test]
        fn any_bytes_are_read_without_panic(words in proptest::collection::vec(any::<Word>(), 0..8)) {
            prop_assert!(load(&words).is_err());
        }
    }
}
