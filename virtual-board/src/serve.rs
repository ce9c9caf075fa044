//! A virtual board behind a TCP port: the bytes of USART3, as an adapter would carry them.

use std::fs::File;
use std::io::{ErrorKind, Read, Write};
use std::net::{TcpListener, TcpStream};
use std::path::PathBuf;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, Weak};
use std::thread::{sleep, spawn};
use std::time::{Duration, Instant};

use anyhow::{Context, Result};

use crate::VirtualBoard;

/// Virtual time between two looks at the socket.
const SLICE: Duration = Duration::from_micros(500);
/// Wall time between two looks for a client while there is none.
const LOOK: Duration = Duration::from_millis(20);
/// After so long without a byte for the client it gets an empty frame: the board may be slow, but it is there.
const SIGN_OF_LIFE: Duration = Duration::from_millis(100);
/// A client that takes nothing for so long has gone.
const DEAF: Duration = Duration::from_secs(10);

/// How to serve.
#[derive(Clone, Debug)]
pub struct Service {
    /// Where the log goes; line by line.
    pub log: Option<PathBuf>,
    /// The service ends when this file does.
    pub while_exists: Option<PathBuf>,
    /// The service ends after so long without a client.
    pub idle: Duration,
    /// Time passes without a client, too.
    pub runs_on: bool,
}

/// Serves one client after the other; a second one at the same time is turned away. While nobody is connected time stands still,
/// unless the service says otherwise; it never runs faster than the clock on the wall.
///
/// # Errors
/// The board gave up, or the log cannot be written.
pub fn serve(board: &mut VirtualBoard, listener: &TcpListener, service: &Service) -> Result<()> {
    listener.set_nonblocking(true).context("the listening socket")?;
    let mut log = match &service.log {
        Some(path) => Some(File::create(path).with_context(|| format!("writing {}", path.display()))?),
        None => None,
    };
    let line = Arc::new(Mutex::new(Line { client: None, sent: Instant::now() }));
    give_signs_of_life(Arc::downgrade(&line));
    let mut frames = Frames::default();
    let mut pace = Pace::from(board);
    let mut last_seen = Instant::now();
    let mut last_look = Instant::now();
    loop {
        let is_served = lock(&line).client.is_some();
        if !is_served || last_look.elapsed() > LOOK {
            last_look = Instant::now();
            if service.while_exists.as_ref().is_some_and(|file| !file.exists()) {
                return Ok(());
            }
            if let Some(new) = arrived(listener)? {
                // The one before may have gone since it was last looked at: its end comes behind what it sent.
                exchange(board, &mut frames, &line)?;
                exchange(board, &mut frames, &line)?;
                // Another one is dropped, which closes its connection.
                let mut line = lock(&line);
                if line.client.is_none() {
                    line.client = Some(new);
                    pace = Pace::from(board);
                }
            }
        }
        exchange(board, &mut frames, &line)?;
        let is_served = lock(&line).client.is_some();
        if is_served {
            last_seen = Instant::now();
        } else if last_seen.elapsed() > service.idle {
            return Ok(());
        }
        if is_served || service.runs_on {
            board.run_for(SLICE)?;
            pace.wait(board);
        } else {
            sleep(LOOK);
        }
        for line in board.log()? {
            if let Some(log) = &mut log {
                writeln!(log, "{line}").context("writing the log")?;
            }
        }
    }
}

fn arrived(listener: &TcpListener) -> Result<Option<TcpStream>> {
    match listener.accept() {
        Ok((stream, _)) => {
            stream.set_nonblocking(true)?;
            stream.set_nodelay(true)?;
            Ok(Some(stream))
        }
        Err(error) if error.kind() == ErrorKind::WouldBlock => Ok(None),
        Err(error) => Err(error).context("waiting for a client"),
    }
}

/// Who is at the other end of the board's serial line. Between two frames, always: what a client is sent are whole ones.
struct Line {
    client: Option<TcpStream>,
    /// When the client was last sent something.
    sent: Instant,
}

impl Line {
    /// What a client that has gone is sent is lost, as on a serial line.
    fn give(&mut self, bytes: &[u8]) {
        if bytes.is_empty() {
            return;
        }
        if !self.client.as_mut().is_some_and(|stream| give(stream, bytes)) {
            self.client = None;
        }
        self.sent = Instant::now();
    }

    /// Takes what the client sends; nothing if there is none, or no more.
    fn take(&mut self, bytes: &mut [u8]) -> usize {
        let Some(stream) = &mut self.client else { return 0 };
        match stream.read(bytes) {
            Ok(length) if length > 0 => length,
            Err(error) if is_later(&error) => 0,
            _ => {
                self.client = None;
                0
            }
        }
    }
}

fn lock(line: &Mutex<Line>) -> MutexGuard<'_, Line> {
    // Whoever panicked left a connection, which is whole or broken.
    line.lock().unwrap_or_else(PoisonError::into_inner)
}

/// An empty frame whenever the client has heard nothing for a while: in a thread of its own, because a piece of the emulation may take long.
/// Ends with the line.
fn give_signs_of_life(line: Weak<Mutex<Line>>) {
    spawn(move || {
        while let Some(line) = line.upgrade() {
            let mut line = lock(&line);
            if line.sent.elapsed() > SIGN_OF_LIFE {
                line.give(&[0]);
            }
            drop(line);
            sleep(SIGN_OF_LIFE / 4);
        }
    });
}

/// What the board has sent of a frame that has not ended.
#[derive(Default)]
struct Frames(Vec<u8>);

impl Frames {
    /// Takes `bytes`, and gives the frames that end in them.
    fn whole(&mut self, bytes: &[u8]) -> Vec<u8> {
        self.0.extend_from_slice(bytes);
        let end = self.0.iter().rposition(|byte| *byte == 0).map_or(0, |last| last + 1);
        let rest = self.0.split_off(end);
        std::mem::replace(&mut self.0, rest)
    }
}

/// Moves what there is in both directions.
fn exchange(board: &mut VirtualBoard, frames: &mut Frames, line: &Mutex<Line>) -> Result<()> {
    let sent = frames.whole(&board.received()?);
    let mut arrived = [0; 4096];
    let length = {
        let mut line = lock(line);
        let length = line.take(&mut arrived);
        line.give(&sent);
        length
    };
    if length > 0 {
        board.send(&arrived[..length])?;
    }
    Ok(())
}

/// Sends all of `bytes`, or returns `false`: the client has gone.
fn give(stream: &mut TcpStream, mut bytes: &[u8]) -> bool {
    let begun = Instant::now();
    while !bytes.is_empty() {
        match stream.write(bytes) {
            Ok(length) => bytes = &bytes[length..],
            // It does not read: nothing is lost, and no time passes meanwhile.
            Err(error) if is_later(&error) && begun.elapsed() < DEAF => sleep(LOOK),
            Err(_) => return false,
        }
    }
    true
}

fn is_later(error: &std::io::Error) -> bool {
    matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::Interrupted)
}

/// Virtual time against the clock on the wall.
struct Pace {
    started: Instant,
    from_ns: u64,
}

impl Pace {
    fn from(board: &VirtualBoard) -> Self {
        Pace { started: Instant::now(), from_ns: board.time_ns() }
    }

    /// Waits while the board is ahead.
    fn wait(&mut self, board: &VirtualBoard) {
        let virtual_time = Duration::from_nanos(board.time_ns() - self.from_ns);
        match virtual_time.checked_sub(self.started.elapsed()) {
            Some(ahead) => sleep(ahead),
            // What was lost is not made up for.
            None => *self = Pace::from(board),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_client_is_sent_whole_frames() {
        let mut frames = Frames::default();
        let sent: Vec<Vec<u8>> =
            [&[1, 2][..], &[], &[3, 0, 4], &[5, 0, 0, 6], &[0]].map(|bytes| frames.whole(bytes)).into();
        assert_eq!(sent, [vec![], vec![], vec![1, 2, 3, 0], vec![4, 5, 0, 0], vec![6, 0]]);
    }
}
