//! Bits from the encoder's line.

use servo_core::encoder::biss::{FrameError, Reading, decode};
use servo_sim::encoder::frame;

/// Reads eight bytes at a time as the 64 bits of a frame.
///
/// # Panics
/// Where the position that was read is not the one that an encoder would have sent with these bits, or bits without a frame are not missing.
pub fn check(bytes: &[u8]) {
    for line in bytes.as_chunks().0.iter().map(|chunk| u64::from_be_bytes(*chunk)) {
        match decode(line) {
            Ok(Reading { counts, error, warning }) => {
                // The head may differ; from the start bit on the encoder's frame must be in these bits, CDS (the first) aside.
                let sent = frame(counts, error, warning, 1);
                let start = sent.leading_ones() + 1;
                let payload = sent << start << 2 >> 24;
                let heads = (3..=23).map(|head| line << head << 1 >> 24);
                assert!(heads.into_iter().any(|read| read == payload), "{line:#018x} is read as {counts}");
            }
            Err(FrameError::Crc) => assert!(line != 0 && line != u64::MAX),
            Err(FrameError::Missing) => {}
        }
    }
}

/// Healthy and marked frames, early and late.
pub fn seeds() -> Vec<Vec<u8>> {
    let sent =
        [(0, false, false, 1), (u32::MAX, false, true, 4), (0x8000_0000, true, false, 20), (12_345, false, false, 2)];
    sent.iter()
        .map(|(counts, error, warning, acknowledge)| {
            frame(*counts, *error, *warning, *acknowledge).to_be_bytes().to_vec()
        })
        .collect()
}
