//! Byte streams to a drive: a serial port or a TCP connection.

use std::io::{self, ErrorKind, Read, Write};
use std::net::TcpStream;
use std::time::{Duration, Instant};

use serialport::SerialPort;

use super::Error;

/// Bits per second of the serial link, as the firmware sets it.
pub const BAUD: u32 = 3_000_000;
/// The beginning of an address that is not a device's name.
const TCP: &str = "tcp://";
/// How long a TCP connection may take to come about.
const CONNECT: Duration = Duration::from_secs(3);
/// A socket cannot wait for less.
const SHORTEST_WAIT: Duration = Duration::from_millis(1);

/// Bytes to and from a drive, and the clock that time-outs are counted on.
pub trait Port: Send {
    /// Sends all of `bytes`.
    ///
    /// # Errors
    /// The line is gone.
    fn send(&mut self, bytes: &[u8]) -> io::Result<()>;

    /// Waits until there are bytes or it is `until`, and returns how many there were (0: it is `until`, or nearly).
    ///
    /// # Errors
    /// The line is gone.
    fn receive(&mut self, bytes: &mut [u8], until: Instant) -> io::Result<usize>;

    /// The time.
    fn now(&self) -> Instant {
        Instant::now()
    }
}

/// Opens `tcp://HOST:PORT` or the serial device with this name.
///
/// # Errors
/// [`Error::Open`] with what can be done about it.
pub fn open(address: &str) -> Result<Box<dyn Port>, Error> {
    match address.strip_prefix(TCP) {
        Some(host) => Ok(Box::new(Tcp(connect(host).map_err(|error| refused(address, &error))?))),
        None => open_serial(address),
    }
}

fn refused(address: &str, error: &io::Error) -> Error {
    let help = match error.kind() {
        ErrorKind::ConnectionRefused => {
            "nobody listens there: start `servoctl virtual --listen …` or look at the address"
        }
        ErrorKind::InvalidInput => "an address looks like tcp://127.0.0.1:5025",
        _ => "look at the address and the network",
    };
    Error::Open { address: address.to_owned(), reason: error.to_string(), help: help.to_owned() }
}

fn connect(host: &str) -> io::Result<TcpStream> {
    let addresses: Vec<_> = std::net::ToSocketAddrs::to_socket_addrs(host)?.collect();
    let mut failure = io::Error::from(ErrorKind::InvalidInput);
    for address in addresses {
        match TcpStream::connect_timeout(&address, CONNECT) {
            Ok(stream) => {
                stream.set_nodelay(true)?;
                return Ok(stream);
            }
            Err(error) => failure = error,
        }
    }
    Err(failure)
}

fn open_serial(device: &str) -> Result<Box<dyn Port>, Error> {
    // Opened for this process alone: a second one is refused by the system.
    let port = serialport::new(device, BAUD).timeout(SHORTEST_WAIT).open().map_err(|error| {
        let reason = error.to_string();
        let help = match error.kind() {
            serialport::ErrorKind::NoDevice if std::path::Path::new(device).exists() => {
                "another program has it open (another servoctl, a terminal, a modem manager): end that one first"
            }
            serialport::ErrorKind::NoDevice => "is the board plugged in? `servoctl ports` lists what there is",
            serialport::ErrorKind::Io(ErrorKind::PermissionDenied) => {
                "your user may not use it: join its group (`sudo usermod -aG dialout $USER`) and log in again"
            }
            _ => "`servoctl ports` lists what there is",
        };
        Error::Open { address: device.to_owned(), reason, help: help.to_owned() }
    })?;
    Ok(Box::new(Serial(port)))
}

struct Tcp(TcpStream);

impl Port for Tcp {
    fn send(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.0.write_all(bytes).map_err(closed)
    }

    fn receive(&mut self, bytes: &mut [u8], until: Instant) -> io::Result<usize> {
        let wait = until.saturating_duration_since(Instant::now()).max(SHORTEST_WAIT);
        self.0.set_read_timeout(Some(wait))?;
        match self.0.read(bytes) {
            Ok(0) => Err(closed(ErrorKind::UnexpectedEof.into())),
            other => quiet(other.map_err(closed)),
        }
    }
}

/// How a connection ends that the other side does not want, or no longer, depends on who was faster.
fn closed(error: io::Error) -> io::Error {
    match error.kind() {
        ErrorKind::UnexpectedEof
        | ErrorKind::ConnectionReset
        | ErrorKind::ConnectionAborted
        | ErrorKind::BrokenPipe => io::Error::new(
            error.kind(),
            "the other side closed the connection: it has ended, or serves another client (one at a time)",
        ),
        _ => error,
    }
}

struct Serial(Box<dyn SerialPort>);

impl Port for Serial {
    fn send(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.0.write_all(bytes)
    }

    fn receive(&mut self, bytes: &mut [u8], until: Instant) -> io::Result<usize> {
        let wait = until.saturating_duration_since(Instant::now()).max(SHORTEST_WAIT);
        self.0.set_timeout(wait).map_err(io::Error::from)?;
        match self.0.read(bytes) {
            // A device that was unplugged reads as an end of file for ever.
            Ok(0) => Err(io::Error::new(ErrorKind::UnexpectedEof, "the device is gone: was the cable pulled?")),
            other => quiet(other),
        }
    }
}

/// Nothing came in time: no error.
fn quiet(result: io::Result<usize>) -> io::Result<usize> {
    match result {
        Err(error) if matches!(error.kind(), ErrorKind::TimedOut | ErrorKind::WouldBlock | ErrorKind::Interrupted) => {
            Ok(0)
        }
        other => other,
    }
}
