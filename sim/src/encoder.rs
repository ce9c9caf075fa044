//! The encoder's side of the line: from position to the bits of a BiSS-C frame, or to [`sincos`].

pub mod sincos;

/// Count at mid-travel.
pub const MID_TRAVEL_CT: u32 = 0x8000_0000;
/// The most acknowledge bits with which a frame of 64 line bits is complete.
pub const MAX_ACKNOWLEDGE_BITS: u32 = 64 - IDLE_BITS - 42;

const IDLE_BITS: u32 = 2;

/// The count nearest to a position, `MID_TRAVEL_CT` at 0 m; saturates at both ends of the 32 bits.
#[inline]
pub fn counts(position_m: f64, count_m: f64) -> u32 {
    // The cast rounds towards 0, which is down, and 0 is the end below.
    (position_m / count_m + f64::from(MID_TRAVEL_CT) + 0.5) as u32
}

/// A frame as it comes in on the line, first bit in bit 63.
///
/// Two idle ones, `acknowledge_bits` zeros (limited to `1..=MAX_ACKNOWLEDGE_BITS`) while the encoder computes, the start
/// bit (1), the CDS bit (0), the position MSB first, nError and nWarning (active low), the inverted CRC, and zeros for the
/// encoder's time-out.
#[inline]
pub fn frame(position_ct: u32, error: bool, warning: bool, acknowledge_bits: u32) -> u64 {
    let data = u64::from(position_ct) << 2 | u64::from(!error) << 1 | u64::from(!warning);
    let payload = 0b10 << 40 | data << 6 | u64::from(!crc6(data) & 0x3f); // 42 bits: start, CDS, data, CRC
    let idle = !0 << (64 - IDLE_BITS);
    idle | payload << (MAX_ACKNOWLEDGE_BITS - acknowledge_bits.clamp(1, MAX_ACKNOWLEDGE_BITS))
}

/// Remainder of the 34 data bits times x⁶ modulo x⁶ + x + 1, start value 0, byte by byte.
fn crc6(data: u64) -> u8 {
    let bytes = data.to_be_bytes();
    // The remainder is kept in the upper six bits.
    bytes[3..].iter().fold(0, |remainder, byte| REMAINDERS[usize::from(remainder ^ byte)]) >> 2
}

/// Remainder of each byte times x⁶, shifted to the upper six bits.
const REMAINDERS: [u8; 256] = {
    let mut table = [0; 256];
    let mut byte = 0;
    while byte < 256 {
        let mut remainder = byte as u8;
        let mut bit = 0;
        while bit < 8 {
            let carry = remainder & 0x80 != 0;
            remainder = (remainder << 1) ^ if carry { 0b0000_1100 } else { 0 };
            bit += 1;
        }
        table[byte] = remainder;
        byte += 1;
    }
    table
};

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    /// A shift register fed bit by bit, as in an encoder: `line` first bit first.
    fn shift_register(line: impl Iterator<Item = bool>) -> u8 {
        line.fold(0, |register, bit| {
            let feedback = (register >> 5 & 1 == 1) != bit;
            (register << 1 & 0x3f) ^ if feedback { 0b000011 } else { 0 }
        })
    }

    #[test]
    fn the_frame_of_count_zero_is_the_one_worked_out_by_hand() {
        // Data 0…011 = x + 1. (x + 1) x⁶ = (x + 1)(x + 1) = x² + 1 modulo x⁶ + x + 1: 000101, sent as 111010.
        let bits = "11 000000000000 1 0 00000000000000000000000000000000 1 1 111010 00000000";
        assert_eq!(frame(0, false, false, 12), parse(bits));
    }

    #[test]
    fn the_frame_at_mid_travel_is_the_one_worked_out_by_hand() {
        // Data x³³ + x + 1, times x⁶: x³⁹ + x² + 1. With x⁶ = x + 1: x³⁶ = (x + 1)⁶ = x⁶ + x⁴ + x² + 1 = x⁴ + x² + x,
        // x³⁹ = x⁷ + x⁵ + x⁴ = x⁵ + x⁴ + x² + x. The remainder is x⁵ + x⁴ + x + 1: 110011, sent as 001100.
        let bits = "11 0 1 0 10000000000000000000000000000000 1 1 001100 0000000000000000000";
        assert_eq!(frame(MID_TRAVEL_CT, false, false, 1), parse(bits));
    }

    fn parse(bits: &str) -> u64 {
        let bits: String = bits.split_whitespace().collect();
        assert_eq!(bits.len(), 64);
        u64::from_str_radix(&bits, 2).unwrap()
    }

    proptest! {
        #[test]
        fn every_field_is_in_its_place(position_ct: u32, error: bool, warning: bool, acknowledge_bits in 1u32..=MAX_ACKNOWLEDGE_BITS) {
            let line = frame(position_ct, error, warning, acknowledge_bits);
            let mut bits = (0..64).rev().map(|i| line >> i & 1 == 1);
            let mut take = |n: u32| (0..n).fold(0u64, |value, _| value << 1 | u64::from(bits.next().unwrap()));
            prop_assert_eq!(take(2), 0b11, "idle");
            prop_assert_eq!(take(acknowledge_bits), 0, "acknowledge");
            prop_assert_eq!(take(2), 0b10, "start, CDS");
            prop_assert_eq!(take(32), u64::from(position_ct));
            prop_assert_eq!(take(1), u64::from(!error));
            prop_assert_eq!(take(1), u64::from(!warning));
            let data = (0..34).map(|i| line << (4 + acknowledge_bits + i) >> 63 == 1);
            prop_assert_eq!(take(6), u64::from(shift_register(data) ^ 0x3f), "CRC");
            prop_assert_eq!(take(20 - acknowledge_bits), 0, "time-out");
        }

        #[test]
        fn a_position_is_rounded_to_the_nearest_count(position_ct: u32, offset in -0.49..0.49) {
            let count_m = 61.03515625e-12;
            let position_m = (f64::from(position_ct) - f64::from(MID_TRAVEL_CT) + offset) * count_m;
            prop_assert_eq!(counts(position_m, count_m), position_ct);
        }
    }

    #[test]
    fn counts_saturate_beyond_their_range() {
        assert_eq!(counts(1.0, 61.03515625e-12), u32::MAX);
        assert_eq!(counts(-1.0, 61.03515625e-12), 0);
    }

    #[test]
    fn acknowledge_bits_are_limited_to_what_fits() {
        assert_eq!(frame(1, false, false, 0), frame(1, false, false, 1));
        assert_eq!(frame(1, false, false, 99), frame(1, false, false, MAX_ACKNOWLEDGE_BITS));
    }
}
