//! BiSS-C single-cycle frames: 32-bit position, error and warning bits, CRC-6.
//!
//! On the wire, first to last: idle ones, acknowledge zeros (the encoder's processing time), the start bit (1), the CDS
//! bit (ignored), 32 position bits MSB first, nError, nWarning (both active low), and six CRC bits.
//! The CRC covers position, nError and nWarning, polynomial x⁶ + x + 1, and is sent inverted.

use crc::{Algorithm, Crc, Table};

/// CRC-6 of BiSS: polynomial 0x43 without its top bit, start value 0, sent inverted.
const CRC6: Crc<u8, Table<1>> = Crc::<u8, Table<1>>::new(&Algorithm {
    width: 6,
    poly: 0x03,
    init: 0,
    refin: false,
    refout: false,
    xorout: 0x3f,
    check: 0x00,
    residue: 0x00,
});

/// Bits after the start bit: CDS, position, nError, nWarning, CRC.
const PAYLOAD_BITS: u32 = 1 + 32 + 2 + 6;

/// What a valid frame says.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Reading {
    /// Absolute position, encoder counts.
    pub counts: u32,
    /// The encoder says that its position may be wrong.
    pub error: bool,
    /// The encoder asks for service; the position is right.
    pub warning: bool,
}

/// Why a frame was not used.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FrameError {
    /// No acknowledge or start bit where the frame can still be complete: nothing, or a broken wire, on the line.
    Missing,
    /// The checksum does not fit the data.
    Crc,
}

/// Decodes the 64 bits clocked in from the line, first bit in bit 63.
///
/// The frame may start late (line delay, processing time) as long as it is complete: up to 22 bits before the start bit.
///
/// # Errors
/// [`FrameError::Missing`] if acknowledge and start bit are not found in time, [`FrameError::Crc`] if the checksum fails.
#[inline]
pub fn decode(line: u64) -> Result<Reading, FrameError> {
    // Whatever comes before the data must be in the first half, or there is no room for them.
    let first = (line >> 32) as u32;
    let idle = first.leading_ones();
    let acknowledge = first.checked_shl(idle).map_or(0, u32::leading_zeros);
    // Bits in front of and including the start bit.
    let head = idle + acknowledge + 1;
    if idle == 0 || head + PAYLOAD_BITS > u64::BITS {
        return Err(FrameError::Missing);
    }
    let payload = line << head << 1 >> (u64::BITS - PAYLOAD_BITS + 1);
    let covered = payload >> 6;
    let bytes = covered.to_be_bytes();
    if CRC6.checksum(&bytes[3..]) != (payload & 0x3f) as u8 {
        return Err(FrameError::Crc);
    }
    Ok(Reading { counts: (covered >> 2) as u32, error: covered & 2 == 0, warning: covered & 1 == 0 })
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// The encoder's side, bit by bit, sharing nothing with the decoder.
    fn encode(counts: u32, error: bool, warning: bool, idle: u32, acknowledge: u32) -> u64 {
        let data = u64::from(counts) << 2 | u64::from(!error) << 1 | u64::from(!warning);
        let mut register = 0u8;
        for i in (0..34).rev() {
            let feedback = (register >> 5 & 1) ^ (data >> i & 1) as u8;
            register = (register << 1 & 0x3f) ^ if feedback == 1 { 0x03 } else { 0 };
        }
        let frame = 1u64 << 41 | data << 6 | u64::from(!register & 0x3f); // start, CDS = 0, data, CRC
        let head = idle + acknowledge;
        let ones = if idle == 0 { 0 } else { u64::MAX << (64 - idle) };
        ones | frame << (64 - head - 42) | ((1u64 << (64 - head - 42)) - 1)
    }

    #[test]
    fn a_frame_worked_by_hand() {
        // Position 0, healthy: data bits 0…011, CRC register of (x+1)·x⁶ mod (x⁶+x+1) = (x+1)² = x²+1 → 000101, inverted 111010.
        let line = 0b1010_u64 << 60 | 0b11 << 26 | 0b111010 << 20;
        assert_eq!(decode(line), Ok(Reading { counts: 0, error: false, warning: false }));
    }

    #[test]
    fn a_dead_line_is_missing_whatever_its_level() {
        for line in [0, u64::MAX, 1, u64::MAX << 1, u64::MAX << 32, 0x7fff_ffff_ffff_ffff] {
            assert_eq!(decode(line), Err(FrameError::Missing), "{line:#x}");
        }
    }

    #[test]
    fn the_latest_complete_frame_is_read_and_a_later_one_is_missing() {
        assert!(decode(encode(77, false, false, 2, 20)).is_ok());
        let one_late = encode(77, false, false, 2, 20) >> 1 | 1 << 63;
        assert_eq!(decode(one_late), Err(FrameError::Missing));
    }

    proptest! {
        #[test]
        fn decoding_inverts_encoding(counts: u32, error: bool, warning: bool, idle in 1u32..4, acknowledge in 1u32..18) {
            let line = encode(counts, error, warning, idle, acknowledge);
            prop_assert_eq!(decode(line), Ok(Reading { counts, error, warning }));
        }

        #[test]
        fn one_or_two_wrong_bits_never_give_another_position(counts: u32, first in 0u32..41, second in 0u32..41) {
            let line = encode(counts, false, false, 2, 2);
            let start = 64 - 4 - 1; // bit number of the start bit
            let wrong = line ^ 1 << (start - 1 - first) ^ if second == first { 0 } else { 1 << (start - 1 - second) };
            if let Ok(reading) = decode(wrong) {
                // Only the CDS bit is outside the checksum.
                prop_assert_eq!(reading.counts, counts);
                prop_assert!(first == 0 || second == 0);
            }
        }

        #[test]
        fn any_bits_decode_without_panic(line: u64) {
            let _ = decode(line);
        }
    }
}
