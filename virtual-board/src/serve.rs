//! A virtual board behind a TCP port: the bytes of USART3, as an adapter would carry them.

use std::fs::File;
use std::io::{ErrorKind, Read, Write};
use std::net::{TcpListener, TcpStream};
use std::path::PathBuf;
use std::thread::sleep;
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
    let mut line = Line { client: None, in_frame: false, sent: Instant::now() };
    let mut pace = Pace::from(board);
    let mut last_seen = Instant::now();
    let mut last_look = Instant::now();
    loop {
        if line.client.is_none() || last_look.elapsed() > LOOK {
            last_look = Instant::now();
            if service.while_exists.as_ref().is_some_and(|file| !file.exists()) {
                return Ok(());
            }
            if let Some(new) = arrived(listener)? {
                // The one before may have gone since it was last looked at: its end comes behind what it sent.
                line.exchange(board)?;
                line.exchange(board)?;
                // Another one is dropped, which closes its connection.
                if line.client.is_none() {
                    line.client = Some(new);
                    pace = Pace::from(board);
                }
            }
        }
        line.exchange(board)?;
        if line.client.is_some() {
            last_seen = Instant::now();
        } else if last_seen.elapsed() > service.idle {
            return Ok(());
        }
        if line.client.is_some() || service.runs_on {
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

/// The board's serial line, and who is at its other end.
struct Line {
    client: Option<TcpStream>,
    /// The board has begun a frame and not ended it.
    in_frame: bool,
    /// When the client was last sent something.
    sent: Instant,
}

impl Line {
    /// Moves what there is in both directions; what the board sends while nobody listens is lost, as on a serial line. A client that has
    /// gone is forgotten.
    fn exchange(&mut self, board: &mut VirtualBoard) -> Result<()> {
        let mut bytes = board.received()?;
        if let Some(last) = bytes.last() {
            self.in_frame = *last != 0;
        } else if !self.in_frame && self.sent.elapsed() > SIGN_OF_LIFE {
            bytes.push(0);
        }
        let Some(stream) = &mut self.client else { return Ok(()) };
        let mut arrived = [0; 4096];
        let there = match stream.read(&mut arrived) {
            Ok(length) => {
                board.send(&arrived[..length])?;
                length > 0
            }
            Err(error) => is_later(&error),
        };
        if !there || !give(stream, &bytes) {
            self.client = None;
        } else if !bytes.is_empty() {
            self.sent = Instant::now();
        }
        Ok(())
    }
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
