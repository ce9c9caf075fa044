//! Requests and their replies over a line that loses bytes.

use std::time::Duration;

use servo_protocol::endpoint::{self, Kind};
use servo_protocol::frame::{self, Collector, MAX_FRAME};
use servo_protocol::message::{Reply, Request};

use super::{Error, Port};

/// How long to wait for a reply, and how often to ask.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Patience {
    /// For one reply.
    pub reply: Duration,
    /// How often a request is sent before it is given up, at least once.
    pub attempts: u32,
}

impl Patience {
    /// A drive at a serial port answers within milliseconds; a pulled cable is reported within a second.
    pub const SERIAL: Patience = Patience { reply: Duration::from_millis(150), attempts: 6 };
    /// A virtual drive is slower than the clock on the wall, and its computer may have other things to do.
    pub const VIRTUAL: Patience = Patience { reply: Duration::from_secs(5), attempts: 4 };
}

/// What the line has lost so far.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Losses {
    /// Requests sent again.
    pub repeated: u64,
    /// Frames from the drive that could not be read.
    pub unreadable: u64,
}

/// The host's end of a line.
pub struct Client {
    port: Box<dyn Port>,
    patience: Patience,
    collector: Collector,
    next_id: u32,
    losses: Losses,
}

impl Client {
    /// A client that numbers its requests from `first_id`, which nobody may have used at this drive lately: see [`random_id`].
    pub fn new(port: Box<dyn Port>, patience: Patience, first_id: u32) -> Self {
        Client { port, patience, collector: Collector::default(), next_id: first_id, losses: Losses::default() }
    }

    /// What the line has lost so far.
    pub fn losses(&self) -> Losses {
        self.losses
    }

    /// Sends a request until its reply is in. The drive carries a command out once, however often it is sent.
    ///
    /// # Errors
    /// [`Error::NoReply`]: given up; a command may have been carried out or not. [`Error::Broken`]: the line is gone.
    pub fn request(&mut self, request: &Request) -> Result<Reply, Error> {
        // A restarted drive has forgotten what it was asked: it would start again.
        let attempts = if *request == Request::Restart { 1 } else { self.patience.attempts };
        let id = self.next_id;
        self.next_id = id.wrapping_add(1);
        let mut buffer = [0; MAX_FRAME];
        let length = frame::encode(id, request, &mut buffer).map_err(|_| Error::TooLong)?;
        for attempt in 0..attempts {
            self.losses.repeated += u64::from(attempt > 0);
            // The zero ends whatever noise the drive may hold.
            self.port.send(&[0]).and_then(|()| self.port.send(&buffer[..length])).map_err(Error::Broken)?;
            if let Some(reply) = self.wait_for(id)? {
                return Ok(reply);
            }
        }
        let endpoint = endpoint::of(request);
        Err(Error::NoReply { request: endpoint.request, attempts, unknown: endpoint.kind == Kind::Command })
    }

    /// Replies to earlier requests are dropped.
    fn wait_for(&mut self, id: u32) -> Result<Option<Reply>, Error> {
        let until = self.port.now() + self.patience.reply;
        let mut bytes = [0; 1024];
        loop {
            let received = self.port.receive(&mut bytes, until).map_err(Error::Broken)?;
            let mut found = None;
            for byte in &bytes[..received] {
                match self.collector.push::<Reply>(*byte) {
                    Some(Ok((answered, reply))) if answered == id => found = Some(reply),
                    Some(Err(_)) => self.losses.unreadable += 1,
                    _ => {}
                }
            }
            if found.is_some() || self.port.now() >= until {
                return Ok(found);
            }
        }
    }
}

/// A number to begin with: different in every process.
pub fn random_id() -> u32 {
    use std::hash::{BuildHasher, RandomState};
    RandomState::new().hash_one(std::process::id()) as u32
}
