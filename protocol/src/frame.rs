//! Frames: COBS( postcard(id, message) ++ CRC-16 ) and a zero.

use crc::{CRC_16_IBM_SDLC, Crc};
use serde::{Serialize, de::DeserializeOwned};

/// Longest message with its id, before checksum and stuffing, bytes.
pub const MAX_PAYLOAD: usize = 512;
/// Longest frame on the line, with its final zero, bytes.
pub const MAX_FRAME: usize = cobs::max_encoding_length(MAX_PAYLOAD + 2) + 1;

const CRC16: Crc<u16> = Crc::<u16>::new(&CRC_16_IBM_SDLC);

/// Why bytes were not a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FrameError {
    /// Not stuffed as COBS stuffs.
    Stuffing,
    /// The checksum does not fit.
    Checksum,
    /// Checksum right, content unknown: the other side speaks another version.
    Content,
    /// Longer than [`MAX_FRAME`].
    TooLong,
}

/// A message too long for a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TooLong;

/// Writes the frame of `message` into `frame` and returns its length, final zero included.
///
/// # Errors
/// [`TooLong`] if the message takes more than [`MAX_PAYLOAD`] bytes.
pub fn encode<T: Serialize>(id: u16, message: &T, frame: &mut [u8; MAX_FRAME]) -> Result<usize, TooLong> {
    let mut plain = [0u8; MAX_PAYLOAD + 2];
    let used = postcard::to_slice(&(id, message), &mut plain[..MAX_PAYLOAD]).map_err(|_| TooLong)?.len();
    let checksum = CRC16.checksum(&plain[..used]).to_le_bytes();
    plain[used..used + 2].copy_from_slice(&checksum);
    let stuffed = cobs::encode(&plain[..used + 2], frame);
    frame[stuffed] = 0;
    Ok(stuffed + 1)
}

/// Reads a frame (without its final zero); `bytes` is scratch afterwards.
///
/// # Errors
/// See [`FrameError`]. Never panics, whatever the bytes.
pub fn decode<T: DeserializeOwned>(bytes: &mut [u8]) -> Result<(u16, T), FrameError> {
    let length = cobs::decode_in_place(bytes).map_err(|_| FrameError::Stuffing)?;
    let (payload, checksum) = bytes[..length].split_last_chunk::<2>().ok_or(FrameError::Checksum)?;
    if CRC16.checksum(payload) != u16::from_le_bytes(*checksum) {
        return Err(FrameError::Checksum);
    }
    match postcard::take_from_bytes(payload) {
        Ok((frame, [])) => Ok(frame),
        _ => Err(FrameError::Content),
    }
}

/// Collects line bytes until a frame is complete.
#[derive(Clone, Debug)]
pub struct Collector {
    buffer: [u8; MAX_FRAME],
    length: usize,
    overflowed: bool,
}

impl Default for Collector {
    fn default() -> Self {
        Collector { buffer: [0; MAX_FRAME], length: 0, overflowed: false }
    }
}

impl Collector {
    /// Takes one byte from the line; on the zero that ends a frame, what it held. Empty frames (two zeros in a row) are none:
    /// a sender may put a zero in front to end whatever noise the line held.
    pub fn push<T: DeserializeOwned>(&mut self, byte: u8) -> Option<Result<(u16, T), FrameError>> {
        if byte != 0 {
            match self.buffer.get_mut(self.length) {
                Some(place) => {
                    *place = byte;
                    self.length += 1;
                }
                None => self.overflowed = true,
            }
            return None;
        }
        let (length, overflowed) = (self.length, self.overflowed);
        (self.length, self.overflowed) = (0, false);
        match (length, overflowed) {
            (_, true) => Some(Err(FrameError::TooLong)),
            (0, _) => None,
            _ => Some(decode(&mut self.buffer[..length])),
        }
    }
}

#[cfg(test)]
mod tests {
    extern crate std;
    use super::*;
    use crate::message::{Reply, Request};
    use proptest::prelude::*;
    use std::vec::Vec;

    fn frame_of(id: u16, request: &Request) -> Vec<u8> {
        let mut frame = [0; MAX_FRAME];
        let length = encode(id, request, &mut frame).unwrap();
        frame[..length].to_vec()
    }

    fn collect(bytes: &[u8]) -> Vec<Result<(u16, Request), FrameError>> {
        let mut collector = Collector::default();
        bytes.iter().filter_map(|b| collector.push(*b)).collect()
    }

    #[test]
    fn the_identity_request_has_these_bytes_for_ever() {
        // postcard: id 0 (0), first variant (0); CRC-16/IBM-SDLC of 00 00 is 0x0f47; stuffed.
        assert_eq!(frame_of(0, &Request::Identity), [1, 1, 3, 0x47, 0x0f, 0]);
    }

    #[test]
    fn frames_survive_noise_in_front_and_between() {
        let mut line = std::vec![7, 7, 7, 0, 0];
        line.extend(frame_of(1, &Request::Enable));
        line.extend([0x55, 0]);
        line.extend(frame_of(2, &Request::Disable));
        let got = collect(&line);
        assert_eq!(
            got.iter().filter_map(|f| f.clone().ok()).collect::<Vec<_>>(),
            [(1, Request::Enable), (2, Request::Disable)]
        );
        assert_eq!(got.iter().filter(|f| f.is_err()).count(), 2);
    }

    #[test]
    fn an_endless_frame_is_too_long_and_the_next_one_is_read() {
        let mut line = std::vec![9u8; 10 * MAX_FRAME];
        line.push(0);
        line.extend(frame_of(3, &Request::Status));
        assert_eq!(collect(&line), [Err(FrameError::TooLong), Ok((3, Request::Status))]);
    }

    #[test]
    fn the_longest_replies_fit() {
        let words = heapless::Vec::from_slice(&[u32::MAX; crate::message::BLOCK_WORDS]).unwrap();
        let mut frame = [0; MAX_FRAME];
        assert!(encode(u16::MAX, &Reply::Capture { first: u32::MAX, words }, &mut frame).is_ok());
        let values = heapless::Vec::from_slice(&[(u16::MAX, f64::MAX); crate::message::PARAMETERS_PER_REPLY]).unwrap();
        assert!(encode(u16::MAX, &Reply::Parameters(values), &mut frame).is_ok());
    }

    proptest! {
        #[test]
        fn a_damaged_frame_is_never_taken_for_another(flip in 0usize..64, bit in 0u8..8) {
            let mut frame = frame_of(77, &Request::SetParameters(
                heapless::Vec::from_slice(&[(0x0502, 4e6), (0x0503, 0.6)]).unwrap()));
            let at = flip % (frame.len() - 1);
            frame[at] ^= 1 << bit;
            for got in collect(&frame) {
                prop_assert!(got.is_err(), "{got:?}");
            }
        }

        #[test]
        fn any_bytes_are_read_without_panic(bytes in proptest::collection::vec(any::<u8>(), 0..2000)) {
            collect(&bytes);
        }
    }
}
