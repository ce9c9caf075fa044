//! The drive's end of the line: frames in, each command once.
//!
//! A host has one request under way at a time and begins with a random number, so the last command and its answer are all that has
//! to be remembered: whatever arrives again is either that command or a query.

use servo_core::refusal::Refusal;

use crate::endpoint::{self, Kind};
use crate::frame::Collector;
use crate::message::{Reply, Request};

/// What a frame asks of the drive.
#[derive(Clone, Debug, PartialEq)]
#[expect(clippy::large_enum_variant, reason = "there is no allocator to box with")]
pub enum Incoming {
    /// Carry it out, tell [`Server::answered`], and send the reply with this number.
    Fresh {
        /// Number of the request.
        id: u32,
        /// What is asked.
        request: Request,
    },
    /// The command that was carried out last, again: only send this reply.
    Repeated {
        /// Number of the request.
        id: u32,
        /// The answer given before.
        reply: Reply,
    },
}

/// Collects frames and remembers the last command.
#[derive(Clone, Debug, Default)]
pub struct Server {
    collector: Collector,
    last: Option<(u32, Result<u32, Refusal>)>,
    unreadable: u32,
}

impl Server {
    /// Takes one byte from the line; on the last byte of a readable frame, what it asks.
    pub fn push(&mut self, byte: u8) -> Option<Incoming> {
        match self.collector.push::<Request>(byte)? {
            Err(_) => {
                self.count_unreadable();
                None
            }
            Ok((id, request)) => Some(match self.last {
                Some((last, answer)) if last == id && endpoint::of(&request).kind == Kind::Command => {
                    let reply = match answer {
                        Ok(tick) => Reply::Done { tick },
                        Err(refusal) => Reply::Refused(refusal),
                    };
                    Incoming::Repeated { id, reply }
                }
                _ => Incoming::Fresh { id, request },
            }),
        }
    }

    /// Remembers the answer to request `id`, before it is sent.
    pub fn answered(&mut self, id: u32, reply: &Reply) {
        match reply {
            Reply::Done { tick } => self.last = Some((id, Ok(*tick))),
            Reply::Refused(refusal) => self.last = Some((id, Err(*refusal))),
            _ => {}
        }
    }

    /// Frames that could not be read, and whatever else the line lost.
    pub fn unreadable(&self) -> u32 {
        self.unreadable
    }

    /// The line has lost something.
    pub fn count_unreadable(&mut self) {
        self.unreadable = self.unreadable.wrapping_add(1);
    }
}

#[cfg(test)]
mod tests {
    extern crate std;
    use super::*;
    use crate::frame::{MAX_FRAME, encode};
    use std::vec::Vec;

    fn feed(server: &mut Server, id: u32, request: &Request) -> Vec<Incoming> {
        let mut frame = [0; MAX_FRAME];
        let length = encode(id, request, &mut frame).unwrap();
        frame[..length].iter().filter_map(|byte| server.push(*byte)).collect()
    }

    #[test]
    fn a_command_that_arrives_again_is_answered_from_memory() {
        for reply in [Reply::Done { tick: 77 }, Reply::Refused(Refusal::Moving)] {
            let mut server = Server::default();
            let fresh = Incoming::Fresh { id: 5, request: Request::Stop };
            assert_eq!(feed(&mut server, 5, &Request::Stop), [fresh]);
            server.answered(5, &reply);
            for _ in 0..3 {
                assert_eq!(feed(&mut server, 5, &Request::Stop), [Incoming::Repeated { id: 5, reply: reply.clone() }]);
            }
        }
    }

    #[test]
    fn the_next_command_is_fresh_and_queries_always_are() {
        let mut server = Server::default();
        feed(&mut server, 5, &Request::Stop);
        server.answered(5, &Reply::Done { tick: 1 });
        for (id, request) in [(5, Request::Status), (6, Request::Status), (6, Request::Stop), (4, Request::Stop)] {
            assert_eq!(feed(&mut server, id, &request), [Incoming::Fresh { id, request }]);
        }
    }

    #[test]
    fn unreadable_frames_are_counted_and_ask_nothing() {
        let mut server = Server::default();
        assert_eq!([9, 9, 9, 0].into_iter().find_map(|byte| server.push(byte)), None);
        assert_eq!(server.unreadable(), 1);
    }
}
