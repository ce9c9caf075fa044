//! A board as the far end of a line of `servoctl`'s client, on the board's own clock: two runs are the same run.

use std::collections::VecDeque;
use std::io;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use servoctl::link::Port;

use crate::{Error, VirtualBoard};

/// How often the line is looked at, virtual time.
const LOOK: Duration = Duration::from_micros(250);

/// A board that others may look at as well, while no request is under way.
pub type Shared = Arc<Mutex<VirtualBoard>>;

/// The line. Time passes while somebody waits for bytes.
pub struct BoardPort {
    board: Shared,
    began: Instant,
    arrived: VecDeque<u8>,
}

impl BoardPort {
    /// The line to `board`.
    #[must_use]
    pub fn new(board: Shared) -> Self {
        BoardPort { board, began: Instant::now(), arrived: VecDeque::new() }
    }

    fn with<R>(&self, act: impl FnOnce(&mut VirtualBoard) -> Result<R, Error>) -> io::Result<R> {
        act(&mut self.board.lock().unwrap_or_else(PoisonError::into_inner)).map_err(io::Error::other)
    }
}

impl Port for BoardPort {
    fn send(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.with(|board| board.send(bytes))
    }

    fn receive(&mut self, bytes: &mut [u8], until: Instant) -> io::Result<usize> {
        while self.arrived.is_empty() && self.now() < until {
            let new = self.with(|board| {
                board.run_for(LOOK)?;
                board.received()
            })?;
            self.arrived.extend(new);
        }
        let length = self.arrived.len().min(bytes.len());
        for (place, byte) in bytes.iter_mut().zip(self.arrived.drain(..length)) {
            *place = byte;
        }
        Ok(length)
    }

    fn now(&self) -> Instant {
        let board = self.board.lock().unwrap_or_else(PoisonError::into_inner);
        self.began + Duration::from_nanos(board.time_ns())
    }
}
