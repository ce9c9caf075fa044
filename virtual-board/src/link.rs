//! Requests to the firmware over USART3, as the host tool makes them, in virtual time.

use std::collections::VecDeque;
use std::time::Duration;

use servo_protocol::frame::{self, Collector, MAX_FRAME};
use servo_protocol::message::{Reply, Request};

use crate::{Error, VirtualBoard};

/// How long a reply may take, virtual time: many times a tick and a frame on the line.
const PATIENCE: Duration = Duration::from_millis(200);
/// How often the line is looked at.
const LOOK: Duration = Duration::from_micros(500);

/// The host's end of the serial link.
#[derive(Debug, Default)]
pub struct Link {
    /// `None` before the first request.
    next_id: Option<u32>,
    collector: Collector,
    arrived: VecDeque<u8>,
    garbled: u32,
}

impl Link {
    /// A link that has said nothing yet.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// Sends `request` and lets virtual time pass until its reply is in. Replies to earlier requests are dropped, unreadable
    /// frames counted.
    ///
    /// # Errors
    /// [`Error::NoReply`] after 200 ms of virtual time, [`Error::TooLong`] for a request that does not fit a frame,
    /// [`Error::Ended`].
    pub fn request(&mut self, board: &mut VirtualBoard, request: &Request) -> Result<Reply, Error> {
        // A link begins with a number that none before it has used: microseconds, where a request takes some hundred. The upper bit
        // makes all of them equally long on the line.
        let id = self.next_id.unwrap_or((board.time_ns() / 1000) as u32 | 1 << 31);
        self.next_id = Some(id.wrapping_add(1));
        let mut bytes = [0; MAX_FRAME];
        let length = frame::encode(id, request, &mut bytes).map_err(|_| Error::TooLong)?;
        board.send(&bytes[..length])?;
        let give_up_ns = board.time_ns() + PATIENCE.as_nanos() as u64;
        loop {
            while let Some(byte) = self.arrived.pop_front() {
                match self.collector.push::<Reply>(byte) {
                    Some(Ok((replied, reply))) if replied == id => return Ok(reply),
                    Some(Err(_)) => self.garbled += 1,
                    _ => {}
                }
            }
            if board.time_ns() >= give_up_ns {
                return Err(Error::NoReply { request: format!("{request:?}") });
            }
            board.run_for(LOOK)?;
            self.arrived.extend(board.received()?);
        }
    }

    /// Frames from the firmware that could not be read.
    #[must_use]
    pub fn garbled(&self) -> u32 {
        self.garbled
    }
}
