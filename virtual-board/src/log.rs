//! The firmware's log: defmt frames out of the RTT buffer, decoded with the ELF's table.

use std::fmt;

use rigless::emulator::{Error as EmulatorError, Host};
use rigless::soc::Width;

use crate::elf::Elf;

/// "SEGG", the first word of an initialised RTT control block.
const RTT_MAGIC: u64 = 0x4747_4553;
/// Offset of the first up channel: its name, buffer, size, write and read index are five words.
const UP_CHANNEL: u64 = 24;
const BUFFER: u64 = UP_CHANNEL + 4;
const SIZE: u64 = UP_CHANNEL + 8;
const WRITE_INDEX: u64 = UP_CHANNEL + 12;
const READ_INDEX: u64 = UP_CHANNEL + 16;
/// Larger rings are taken for a block that the start-up code has not written yet.
const LARGEST_RING: u64 = 1 << 20;
/// defmt's frames are reversed-zero COBS: a zero ends each.
const FRAME_END: u8 = 0;

/// One line of the firmware's log.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct LogLine {
    /// When the host read it, in virtual time: within a millisecond after it was written.
    pub time_ns: u64,
    /// The firmware's own time stamp, empty where it prints none.
    pub stamp: String,
    /// `info`, `warn`, …; empty for a plain print.
    pub level: &'static str,
    /// The text.
    pub message: String,
}

impl fmt::Display for LogLine {
    /// The firmware's time stamp, or the host's in milliseconds where it has none, level and text.
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.stamp.is_empty() {
            write!(formatter, "{:10.3} ms", self.time_ns as f64 * 1e-6)?;
        } else {
            formatter.write_str(&self.stamp)?;
        }
        write!(formatter, " {:5} {}", self.level, self.message)
    }
}

/// Reads the firmware's RTT buffer and keeps what is not yet a whole frame.
#[derive(Clone, Debug)]
pub(crate) struct LogReader {
    elf: Elf,
    unfinished: Vec<u8>,
    lines: Vec<LogLine>,
}

impl LogReader {
    pub(crate) fn new(elf: Elf) -> Self {
        Self { elf, unfinished: Vec::new(), lines: Vec::new() }
    }

    /// The lines decoded since the last call.
    pub(crate) fn take_lines(&mut self) -> Vec<LogLine> {
        std::mem::take(&mut self.lines)
    }

    /// Empties the ring as a probe does and decodes what is complete.
    pub(crate) fn drain(&mut self, host: &mut dyn Host, time_ns: u64) -> Result<(), EmulatorError> {
        let block = self.elf.rtt_address();
        if host.read(block, Width::W32)? != RTT_MAGIC {
            return Ok(());
        }
        let write = host.read(block + WRITE_INDEX, Width::W32)?;
        let mut read = host.read(block + READ_INDEX, Width::W32)?;
        if read == write {
            return Ok(());
        }
        let buffer = host.read(block + BUFFER, Width::W32)?;
        let size = host.read(block + SIZE, Width::W32)?;
        if size == 0 || size > LARGEST_RING || write >= size || read >= size {
            return Ok(());
        }
        while read != write {
            let byte = host.read(buffer + read, Width::W8)? as u8;
            self.unfinished.push(byte);
            if byte == FRAME_END {
                self.decode(time_ns);
            }
            read = (read + 1) % size;
        }
        host.write(block + READ_INDEX, Width::W32, read)
    }

    fn decode(&mut self, time_ns: u64) {
        // An end without a frame: the transport marks the start of the stream with one.
        if self.unfinished == [FRAME_END] {
            self.unfinished.clear();
            return;
        }
        let mut decoder = self.elf.log_table().new_stream_decoder();
        decoder.received(&self.unfinished);
        let line = match decoder.decode() {
            Ok(frame) => LogLine {
                time_ns,
                stamp: frame.display_timestamp().map(|stamp| stamp.to_string()).unwrap_or_default(),
                level: frame.level().map_or("", |level| level.as_str()),
                message: frame.display_message().to_string(),
            },
            Err(_) => LogLine {
                time_ns,
                stamp: String::new(),
                level: "error",
                message: format!("(undecodable log frame of {} bytes)", self.unfinished.len()),
            },
        };
        self.lines.push(line);
        self.unfinished.clear();
    }
}
