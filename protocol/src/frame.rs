//! Frames: COBS( postcard(id, message) ++ CRC-32 ) and a zero. The form never changes: a host can always read which protocol a drive
//! speaks.

use crc::{CRC_32_ISO_HDLC, Crc};
use serde::{Serialize, de::DeserializeOwned};

/// Longest message with its id, before checksum and stuffing, bytes.
pub const MAX_PAYLOAD: usize = 512;
/// Longest frame on the line, with its final zero, bytes.
pub const MAX_FRAME: usize = cobs::max_encoding_length(MAX_PAYLOAD + CHECKSUM) + 1;

/// Length of the checksum, bytes. With two, one in 65,536 damaged frames would pass, and a bad line damages that many in an hour.
const CHECKSUM: usize = 4;
const CRC32: Crc<u32> = Crc::<u32>::new(&CRC_32_ISO_HDLC);

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
pub fn encode<T: Serialize>(id: u32, message: &T, frame: &mut [u8; MAX_FRAME]) -> Result<usize, TooLong> {
    let mut plain = [0u8; MAX_PAYLOAD + CHECKSUM];
    let used = postcard::to_slice(&(id, message), &mut plain[..MAX_PAYLOAD]).map_err(|_| TooLong)?.len();
    let checksum = CRC32.checksum(&plain[..used]).to_le_bytes();
    plain[used..used + CHECKSUM].copy_from_slice(&checksum);
    let stuffed = cobs::encode(&plain[..used + CHECKSUM], frame);
    frame[stuffed] = 0;
    Ok(stuffed + 1)
}

/// Reads a frame (without its final zero); `bytes` is scratch afterwards.
///
/// # Errors
/// See [`FrameError`]. Never panics, whatever the bytes.
pub fn decode<T: DeserializeOwned>(bytes: &mut [u8]) -> Result<(u32, T), FrameError> {
    let length = cobs::decode_in_place(bytes).map_err(|_| FrameError::Stuffing)?;
    let (payload, checksum) = bytes[..length].split_last_chunk::<CHECKSUM>().ok_or(FrameError::Checksum)?;
    if CRC32.checksum(payload) != u32::from_le_bytes(*checksum) {
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
    pub fn push<T: DeserializeOwned>(&mut self, byte: u8) -> Option<Result<(u32, T), FrameError>> {
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
    use crate::message::{Identity, Reply, Request};
    use proptest::prelude::*;
    use std::vec::Vec;

    fn frame_of(id: u32, request: &Request) -> Vec<u8> {
        let mut frame = [0; MAX_FRAME];
        let length = encode(id, request, &mut frame).unwrap();
        frame[..length].to_vec()
    }

    fn collect(bytes: &[u8]) -> Vec<Result<(u32, Request), FrameError>> {
        let mut collector = Collector::default();
        bytes.iter().filter_map(|b| collector.push(*b)).collect()
    }

    #[test]
    fn the_identity_request_has_these_bytes_for_ever() {
        // postcard: id 0 (0), first variant (0); CRC-32/ISO-HDLC of 00 00 is 0x41d912ff; stuffed.
        assert_eq!(frame_of(0, &Request::Identity), [1, 1, 5, 0xff, 0x12, 0xd9, 0x41, 0]);
    }

    #[test]
    fn the_identity_reply_has_this_form_for_ever() {
        let identity = Identity {
            protocol: 3,
            firmware: [1, 2, 300],
            program: 5,
            board: "B".try_into().unwrap(),
            serial: [6, 7, 8],
        };
        let mut frame = [0; MAX_FRAME];
        let length = encode(1, &Reply::Identity(identity), &mut frame).unwrap();
        let stuffed = &mut frame[..length - 1];
        let plain = cobs::decode_in_place(stuffed).unwrap();
        // id 1, first variant, protocol, firmware (300 takes two bytes), program, length and letters of the board, serial.
        assert_eq!(stuffed[..plain - CHECKSUM], [1, 0, 3, 1, 2, 0xac, 2, 5, 1, b'B', 6, 7, 8]);
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
        assert!(encode(u32::MAX, &Reply::Capture { first: u32::MAX, words }, &mut frame).is_ok());
        let bytes = heapless::Vec::from_slice(&[0xff; crate::stream::BLOCK_BYTES]).unwrap();
        let block = crate::stream::Block { number: u32::MAX, first_tick: u32::MAX, bytes };
        assert!(encode(u32::MAX, &Reply::Block(block), &mut frame).is_ok());
        let values = heapless::Vec::from_slice(&[(u16::MAX, f64::MAX); crate::message::PARAMETERS_PER_REPLY]).unwrap();
        assert!(encode(u32::MAX, &Reply::Parameters(values), &mut frame).is_ok());
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
