//! The far end of USART3, the line that the ST-LINK's virtual COM port carries on the real board.

use std::collections::VecDeque;

use rigless::chip::{Timeline, uart};
use rigless::snapshot::store;
use rigless::time::VirtualNanos;
use serde::{Deserialize, Serialize};

/// Bytes on their way to the firmware and bytes it has sent. The emulated USART times every byte by its own baud rate, so a
/// queue is all there is: the next byte starts when the one before it has ended.
#[derive(Debug, Default, Serialize, Deserialize)]
pub struct SerialLine {
    to_firmware: VecDeque<u8>,
    from_firmware: Vec<u8>,
}
store!(SerialLine);

impl SerialLine {
    /// Queues `bytes` behind whatever is still waiting.
    pub fn send(&mut self, bytes: &[u8]) {
        self.to_firmware.extend(bytes);
    }

    /// Takes everything the firmware has sent since the last call.
    pub fn take_received(&mut self) -> Vec<u8> {
        std::mem::take(&mut self.from_firmware)
    }

    /// Bytes not yet started on the line.
    #[must_use]
    pub fn waiting(&self) -> usize {
        self.to_firmware.len()
    }
}

impl uart::Peer for SerialLine {
    fn receive(&mut self, word: u16, _context: &mut Timeline<'_, '_>) {
        self.from_firmware.push((word & 0xFF) as u8);
    }

    fn transmit(&mut self, _now: VirtualNanos) -> Option<u16> {
        self.to_firmware.pop_front().map(u16::from)
    }
}
