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
    let mut client: Option<TcpStream> = None;
    let mut pace = Pace::from(board);
    let mut last_seen = Instant::now();
    let mut last_look = Instant::now();
    loop {
        if client.is_none() || last_look.elapsed() > LOOK {
            last_look = Instant::now();
            if service.while_exists.as_ref().is_some_and(|file| !file.exists()) {
                return Ok(());
            }
            if let Some(new) = arrived(listener)? {
                // The one before may have gone since it was last looked at: its end comes behind what it sent.
                for _ in 0..2 {
                    if let Some(stream) = &mut client
                        && exchange(board, stream)?.is_none()
                    {
                        client = None;
                    }
                }
                // Another one is dropped, which closes its connection.
                if client.is_none() {
                    client = Some(new);
                    pace = Pace::from(board);
                }
            }
        }
        if let Some(stream) = &mut client {
            last_seen = Instant::now();
            if exchange(board, stream)?.is_none() {
                client = None;
            }
        } else if last_seen.elapsed() > service.idle {
            return Ok(());
        }
        if client.is_some() || service.runs_on {
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

/// Moves what there is in both directions; `None` if the client is gone.
fn exchange(board: &mut VirtualBoard, stream: &mut TcpStream) -> Result<Option<()>> {
    let mut bytes = [0; 4096];
    match stream.read(&mut bytes) {
        Ok(0) => return Ok(None),
        Ok(length) => board.send(&bytes[..length])?,
        Err(error) if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::Interrupted) => {}
        Err(_) => return Ok(None),
    }
    let mut rest = &board.received()?[..];
    while !rest.is_empty() {
        match stream.write(rest) {
            Ok(length) => rest = &rest[length..],
            // The client does not read: nothing is lost, and no time passes meanwhile.
            Err(error) if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::Interrupted) => sleep(LOOK),
            Err(_) => return Ok(None),
        }
    }
    Ok(Some(()))
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
