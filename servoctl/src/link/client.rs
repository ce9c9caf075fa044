//! Requests and their replies over a line that loses bytes.

use std::collections::VecDeque;
use std::time::{Duration, Instant};

use servo_protocol::endpoint::{self, Kind};
use servo_protocol::frame::{self, Collector, MAX_FRAME};
use servo_protocol::message::{Reply, Request};
use servo_protocol::stream::Block;

use super::{Error, Port};

/// How long to wait for a reply, and how often to ask.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Patience {
    /// For one reply, before the request is sent again.
    pub reply: Duration,
    /// How often a request is sent before it is given up, at least once.
    pub attempts: u32,
    /// A line on which nothing at all comes for so long is dead, however patient one is with a reply.
    pub silence: Duration,
}

/// A pulled cable is to be reported within a second.
const SILENCE: Duration = Duration::from_millis(750);

impl Patience {
    /// A drive at a serial port answers within milliseconds, and a dead line is silent: only where something comes is there more to wait for.
    pub const SERIAL: Patience = Patience { reply: Duration::from_millis(125), attempts: 40, silence: SILENCE };
    /// A virtual drive is slower than the clock on the wall, and its computer may have other things to do; it sends an empty frame when it
    /// has had nothing to say for a tenth of a second.
    pub const TCP: Patience = Patience { reply: Duration::from_millis(250), attempts: 80, silence: SILENCE };
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
    /// When the line last brought anything, or a request was begun.
    heard: Instant,
    /// Number of the last stream's request, and its blocks that came while something else was waited for.
    stream: Option<u32>,
    blocks: VecDeque<Block>,
}

impl Client {
    /// A client that numbers its requests from `first_id`, which nobody may have used at this drive lately: see [`random_id`].
    pub fn new(port: Box<dyn Port>, patience: Patience, first_id: u32) -> Self {
        Client {
            heard: port.now(),
            port,
            patience,
            collector: Collector::default(),
            next_id: first_id,
            losses: Losses::default(),
            stream: None,
            blocks: VecDeque::new(),
        }
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
        let Patience { reply, attempts, silence } = self.patience;
        // A restarted drive has forgotten what it was asked: it would start again. One attempt then, as long as all.
        let (attempts, reply) = if *request == Request::Restart { (1, reply * attempts) } else { (attempts, reply) };
        let id = self.next_id;
        self.next_id = id.wrapping_add(1);
        if matches!(request, Request::Stream(_)) {
            self.stream = Some(id);
            self.blocks.clear();
        }
        let mut buffer = [0; MAX_FRAME];
        let length = frame::encode(id, request, &mut buffer).map_err(|_| Error::TooLong)?;
        self.heard = self.port.now();
        let mut sent = 0;
        while sent < attempts && self.port.now() < self.heard + silence {
            self.losses.repeated += u64::from(sent > 0);
            sent += 1;
            // The zero ends whatever noise the drive may hold.
            self.port.send(&[0]).and_then(|()| self.port.send(&buffer[..length])).map_err(Error::Broken)?;
            if let Some(reply) = self.wait_for(id, reply)? {
                return Ok(reply);
            }
        }
        let endpoint = endpoint::of(request);
        let unknown = endpoint.kind == Kind::Command;
        Err(Error::NoReply { request: endpoint.request, attempts: sent, unknown })
    }

    /// The next block of the stream, if one comes in the time of a reply.
    ///
    /// # Errors
    /// [`Error::Broken`].
    pub fn next_block(&mut self) -> Result<Option<Block>, Error> {
        let until = self.port.now() + self.patience.reply;
        while self.blocks.is_empty() && self.port.now() < until {
            self.listen(None, until)?;
        }
        Ok(self.blocks.pop_front())
    }

    /// Blocks of the stream that came while something else was waited for.
    pub fn blocks(&mut self) -> impl Iterator<Item = Block> {
        self.blocks.drain(..)
    }

    /// Lets time pass; blocks of the stream that come are kept.
    ///
    /// # Errors
    /// [`Error::Broken`].
    pub fn pass(&mut self, time: Duration) -> Result<(), Error> {
        let until = self.port.now() + time;
        while self.port.now() < until {
            self.listen(None, until)?;
        }
        Ok(())
    }

    fn wait_for(&mut self, id: u32, patience: Duration) -> Result<Option<Reply>, Error> {
        let end = self.port.now() + patience;
        loop {
            let found = self.listen(Some(id), end.min(self.heard + self.patience.silence))?;
            if found.is_some() || self.port.now() >= end.min(self.heard + self.patience.silence) {
                return Ok(found);
            }
        }
    }

    /// Takes what the line holds: blocks of the stream are kept, replies to earlier requests are dropped.
    fn listen(&mut self, id: Option<u32>, until: Instant) -> Result<Option<Reply>, Error> {
        let mut bytes = [0; 4096];
        let waits_until = until.max(self.port.now());
        let received = self.port.receive(&mut bytes, until).map_err(Error::Broken)?;
        self.heard = match received {
            // What this computer has slept through is no silence of the line.
            0 => self.heard + self.port.now().saturating_duration_since(waits_until),
            _ => self.port.now(),
        };
        let mut found = None;
        for byte in &bytes[..received] {
            match self.collector.push::<Reply>(*byte) {
                Some(Ok((of, Reply::Block(block)))) if Some(of) == self.stream => self.blocks.push_back(block),
                Some(Ok((_, Reply::Block(_)))) => {}
                Some(Ok((answered, reply))) if Some(answered) == id => found = Some(reply),
                Some(Err(_)) => self.losses.unreadable += 1,
                _ => {}
            }
        }
        Ok(found)
    }
}

/// A number to begin with: different in every process.
pub fn random_id() -> u32 {
    use std::hash::{BuildHasher, RandomState};
    RandomState::new().hash_one(std::process::id()) as u32
}
