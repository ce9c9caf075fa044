//! The encoder on SPI1: a BiSS-C slave that answers with the frame latched at the first clock edge after a rest, and the ways its
//! line can go wrong.

use rigless::chip::{Timeline, spi};
use rigless::snapshot::store;
use serde::{Deserialize, Serialize};
use servo_core::encoder::biss;
use servo_sim::encoder;

/// A BiSS slave takes a clock pause of this length for the end of a frame and latches a new position at the next edge; with less
/// rest it goes on with the frame under way.
const TIMEOUT_NS: u64 = 12_500;

/// What an undriven RS-485 pair with its bias resistors reads as: every bit one.
pub(crate) const IDLE_LINE: u64 = u64::MAX;

/// Clock periods in which a frame made anew acknowledges before its start bit.
const ACKNOWLEDGE_BITS: u32 = 2;

/// A fault of the encoder or its line, applied to whole frames of 64 line bits (first bit in bit 63).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum EncoderFault {
    /// The bits set in the mask arrive inverted.
    Corrupted {
        /// Line bits to invert, first bit in bit 63.
        mask: u64,
    },
    /// No encoder: the line idles high.
    Missing,
    /// The line is shorted: every bit zero.
    Shorted,
    /// The encoder repeats the last frame from before the fault, valid CRC included.
    Stuck,
    /// The frame arrives this many bit times late and is cut off at the end.
    Shifted {
        /// Delay in bits; 64 and more leave nothing of the frame.
        bits: u32,
    },
    /// The encoder marks its position as wrong, in a frame that is right.
    Marked,
    /// The encoder reads elsewhere, in a frame that is right.
    Displaced {
        /// How much further on, counts.
        counts: i32,
    },
}

/// For how long a fault lasts.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Lasting {
    /// The next so many encoder frames.
    Frames(u32),
    /// Until cleared.
    Forever,
}

/// The encoder as the SPI sees it.
#[derive(Debug, Serialize, Deserialize)]
pub struct BissEncoder {
    line: u64,
    /// Bits of the current frame already clocked out.
    clocked_bits: u32,
    /// The last clock activity: the first edge of a burst or the end of a word.
    clocked_ns: Option<u64>,
    last_good: u64,
    fault: Option<(EncoderFault, Lasting)>,
    frames: u64,
    faulty_frames: u64,
}
store!(BissEncoder);

impl Default for BissEncoder {
    fn default() -> Self {
        Self {
            line: IDLE_LINE,
            clocked_bits: 0,
            clocked_ns: None,
            last_good: IDLE_LINE,
            fault: None,
            frames: 0,
            faulty_frames: 0,
        }
    }
}

impl BissEncoder {
    /// Whether a clock edge at `now_ns` begins a new frame.
    #[must_use]
    pub fn at_rest(&self, now_ns: u64) -> bool {
        self.clocked_ns.is_none_or(|clocked_ns| now_ns >= clocked_ns + TIMEOUT_NS)
    }

    /// Begins a frame at its first clock edge, which is where the slave latches its position: `frame` is what a healthy encoder
    /// would send.
    pub fn latch(&mut self, frame: u64, now_ns: u64) {
        self.clocked_ns = Some(now_ns);
        self.clocked_bits = 0;
        self.frames += 1;
        self.line = match self.take_fault() {
            None => {
                self.last_good = frame;
                frame
            }
            Some(fault) => {
                self.faulty_frames += 1;
                fault.apply(frame, self.last_good)
            }
        };
    }

    /// Injects `fault` from the next frame on, in place of any other.
    pub fn inject(&mut self, fault: EncoderFault, duration: Lasting) {
        self.fault = Some((fault, duration));
    }

    /// Ends any fault; the next frame is healthy.
    pub fn heal(&mut self) {
        self.fault = None;
    }

    /// Frames begun so far.
    #[must_use]
    pub fn frames(&self) -> u64 {
        self.frames
    }

    /// Frames to which a fault was applied.
    #[must_use]
    pub fn faulty_frames(&self) -> u64 {
        self.faulty_frames
    }

    fn take_fault(&mut self) -> Option<EncoderFault> {
        let (fault, duration) = self.fault?;
        match duration {
            Lasting::Forever => Some(fault),
            Lasting::Frames(0) => {
                self.fault = None;
                None
            }
            Lasting::Frames(left) => {
                self.fault = Some((fault, Lasting::Frames(left - 1)));
                Some(fault)
            }
        }
    }

    fn clock_out(&mut self, bits: u32) -> u32 {
        let taken = (0..bits).fold(0, |word, offset| {
            let position = self.clocked_bits + offset;
            let bit = if position < u64::BITS { self.line >> (u64::BITS - 1 - position) & 1 } else { 1 };
            word << 1 | bit as u32
        });
        self.clocked_bits = self.clocked_bits.saturating_add(bits);
        taken
    }
}

impl EncoderFault {
    fn apply(self, frame: u64, last_good: u64) -> u64 {
        match self {
            Self::Corrupted { mask } => frame ^ mask,
            Self::Missing => IDLE_LINE,
            Self::Shorted => 0,
            Self::Stuck => last_good,
            Self::Shifted { bits } => {
                let late = frame.checked_shr(bits).unwrap_or(0);
                let idle = !IDLE_LINE.checked_shr(bits).unwrap_or(0);
                late | idle
            }
            Self::Marked => sent_anew(frame, 0, true),
            Self::Displaced { counts } => sent_anew(frame, counts, false),
        }
    }
}

/// The frame of an encoder `further_ct` further on, with or without its error bit; what is no frame stays.
fn sent_anew(frame: u64, further_ct: i32, error: bool) -> u64 {
    biss::decode(frame).map_or(frame, |reading| {
        encoder::frame(reading.counts.wrapping_add_signed(further_ct), error, reading.warning, ACKNOWLEDGE_BITS)
    })
}

impl spi::Peer for BissEncoder {
    /// The next `bits` bits of the line, most significant first, at the end of the word. Past the frame the line idles.
    fn transfer(&mut self, _mosi: u32, bits: u8, context: &mut Timeline<'_, '_>) -> u32 {
        self.clocked_ns = Some(context.now().0);
        self.clock_out(u32::from(bits))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const FRAME: u64 = 0xC292_3456_789A_BCDE;

    fn words(encoder: &mut BissEncoder) -> u64 {
        u64::from(encoder.clock_out(32)) << 32 | u64::from(encoder.clock_out(32))
    }

    #[test]
    fn a_frame_is_clocked_out_msb_first_in_words_of_any_size() {
        let mut encoder = BissEncoder::default();
        encoder.latch(FRAME, 0);
        assert_eq!(words(&mut encoder), FRAME);
        encoder.latch(FRAME, 0);
        let bytes: Vec<u8> = (0..8).map(|_| encoder.clock_out(8) as u8).collect();
        assert_eq!(bytes, FRAME.to_be_bytes());
        assert_eq!(encoder.clock_out(8), 0xFF, "past the frame the line idles high");
    }

    #[test]
    fn before_the_first_frame_the_line_idles() {
        assert_eq!(words(&mut BissEncoder::default()), IDLE_LINE);
    }

    #[test]
    fn a_frame_begins_only_after_the_time_out() {
        let mut encoder = BissEncoder::default();
        assert!(encoder.at_rest(0));
        encoder.latch(FRAME, 1_000);
        assert!(!encoder.at_rest(1_010));
        assert!(!encoder.at_rest(1_000 + TIMEOUT_NS - 1));
        assert!(encoder.at_rest(1_000 + TIMEOUT_NS));
    }

    #[test]
    fn each_fault_does_what_it_says() {
        let table = [
            (EncoderFault::Corrupted { mask: 1 << 63 | 1 }, FRAME ^ (1 << 63 | 1)),
            (EncoderFault::Missing, u64::MAX),
            (EncoderFault::Shorted, 0),
            (EncoderFault::Stuck, 0x1111),
            (EncoderFault::Shifted { bits: 0 }, FRAME),
            (EncoderFault::Shifted { bits: 4 }, 0xF << 60 | FRAME >> 4),
            (EncoderFault::Shifted { bits: 64 }, u64::MAX),
        ];
        for (fault, line) in table {
            let mut encoder = BissEncoder::default();
            encoder.latch(0x1111, 0);
            encoder.inject(fault, Lasting::Forever);
            encoder.latch(FRAME, 0);
            assert_eq!(words(&mut encoder), line, "{fault:?}");
        }
    }

    #[test]
    fn an_encoder_that_errs_sends_frames_that_are_right() {
        let healthy = encoder::frame(1_000, false, true, ACKNOWLEDGE_BITS);
        let read = |fault: EncoderFault| biss::decode(fault.apply(healthy, 0)).map(|r| (r.counts, r.error, r.warning));
        assert_eq!(read(EncoderFault::Marked), Ok((1_000, true, true)));
        assert_eq!(read(EncoderFault::Displaced { counts: -1_001 }), Ok((u32::MAX, false, true)));
    }

    #[test]
    fn a_counted_fault_ends_by_itself_and_a_permanent_one_when_healed() {
        let mut encoder = BissEncoder::default();
        encoder.inject(EncoderFault::Shorted, Lasting::Frames(2));
        let seen: Vec<u64> = (0..3)
            .map(|_| {
                encoder.latch(FRAME, 0);
                words(&mut encoder)
            })
            .collect();
        assert_eq!(seen, [0, 0, FRAME]);
        encoder.inject(EncoderFault::Shorted, Lasting::Forever);
        encoder.latch(FRAME, 0);
        encoder.heal();
        encoder.latch(FRAME, 0);
        assert_eq!(words(&mut encoder), FRAME);
        assert_eq!((encoder.frames(), encoder.faulty_frames()), (5, 3));
    }
}
