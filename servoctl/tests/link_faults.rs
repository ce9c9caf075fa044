//! The client against the protocol's own server over a line that loses, flips and delays: each command once, or reported.

use std::io::{self, ErrorKind};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use proptest::prelude::*;
use rand_pcg::Pcg64;
use rand_pcg::rand_core::{Rng, SeedableRng};
use servo_core::refusal::Refusal;
use servo_protocol::frame::{MAX_FRAME, encode};
use servo_protocol::message::{Identity, PROTOCOL, Reply, Request};
use servo_protocol::server::{Incoming, Server};
use servoctl::link::{Client, Drive, Error, Patience, Port};

/// What the drive has carried out: the values that commands set, in their order.
type Done = Arc<Mutex<Vec<f64>>>;

/// What a line does to bytes.
#[derive(Clone, Copy)]
struct Damage {
    /// Probability that a byte has one bit flipped, in a thousand.
    flipped: u64,
    /// Probability that a byte is lost, in a thousand.
    dropped: u64,
}

const CLEAN: Damage = Damage { flipped: 0, dropped: 0 };
const ONE_PERCENT_FLIPPED: Damage = Damage { flipped: 10, dropped: 0 };
const ONE_PERCENT_DROPPED: Damage = Damage { flipped: 0, dropped: 10 };

/// A line with a drive at its end, on a clock of its own.
struct Line {
    server: Server,
    identity: Identity,
    done: Done,
    damage: Damage,
    random: Pcg64,
    to_host: Vec<u8>,
    now: Instant,
    /// The cable is pulled at this instant, and the system says so or stays silent.
    pulled: Option<(Instant, bool)>,
}

impl Line {
    fn new(damage: Damage, seed: u64) -> (Line, Done) {
        let done = Done::default();
        let identity =
            Identity { protocol: PROTOCOL, firmware: [0, 1, 0], program: 1, board: Default::default(), serial: [0; 3] };
        let random = Pcg64::seed_from_u64(seed);
        let line = Line {
            server: Server::default(),
            identity,
            done: done.clone(),
            damage,
            random,
            to_host: Vec::new(),
            now: Instant::now(),
            pulled: None,
        };
        (line, done)
    }

    fn damaged(&mut self, bytes: &[u8]) -> Vec<u8> {
        let mut left = Vec::new();
        for byte in bytes {
            let (fate, bit) = (self.random.next_u64() % 1000, self.random.next_u64() % 8);
            if fate < self.damage.flipped {
                left.push(byte ^ 1 << bit);
            } else if fate >= self.damage.flipped + self.damage.dropped {
                left.push(*byte);
            }
        }
        left
    }

    fn carry_out(&self, request: &Request) -> Reply {
        match request {
            Request::Identity => Reply::Identity(self.identity.clone()),
            Request::SetParameters(values) => {
                let (_, value) = values[0];
                if value < 0.0 {
                    return Reply::Refused(Refusal::Moving);
                }
                let mut done = self.done.lock().unwrap();
                done.push(value);
                Reply::Done { tick: done.len() as u32 }
            }
            other => panic!("{other:?} is not in this script"),
        }
    }

    fn is_pulled(&self) -> Option<bool> {
        self.pulled.filter(|(at, _)| self.now >= *at).map(|(_, told)| told)
    }
}

impl Port for Line {
    fn send(&mut self, bytes: &[u8]) -> io::Result<()> {
        match self.is_pulled() {
            Some(true) => return Err(ErrorKind::BrokenPipe.into()),
            Some(false) => return Ok(()),
            None => {}
        }
        for byte in self.damaged(bytes) {
            let (id, reply) = match self.server.push(byte) {
                None => continue,
                Some(Incoming::Repeated { id, reply }) => (id, reply),
                Some(Incoming::Fresh { id, request }) => {
                    let reply = self.carry_out(&request);
                    self.server.answered(id, &reply);
                    (id, reply)
                }
            };
            let mut frame = [0; MAX_FRAME];
            let length = encode(id, &reply, &mut frame).unwrap();
            let damaged = self.damaged(&frame[..length]);
            self.to_host.extend(damaged);
        }
        Ok(())
    }

    fn receive(&mut self, bytes: &mut [u8], until: Instant) -> io::Result<usize> {
        if self.is_pulled() == Some(true) {
            return Err(ErrorKind::BrokenPipe.into());
        }
        if self.to_host.is_empty() {
            self.now = until;
            return Ok(0);
        }
        let length = self.to_host.len().min(bytes.len());
        bytes[..length].copy_from_slice(&self.to_host[..length]);
        self.to_host.drain(..length);
        Ok(length)
    }

    fn now(&self) -> Instant {
        self.now
    }
}

fn set(value: f64) -> Request {
    Request::SetParameters([(0x0504, value)].into_iter().collect())
}

/// Sends commands 0, 1, 2, … and returns those that were reported done and those whose fate is reported unknown.
fn run_script(damage: Damage, seed: u64, commands: u32) -> (Vec<f64>, Vec<f64>, Vec<f64>) {
    let (line, done) = Line::new(damage, seed);
    let mut client = Client::new(Box::new(line), Patience::SERIAL, 0xffff_fff0);
    let (mut reported, mut unknown) = (Vec::new(), Vec::new());
    for value in (0..commands).map(f64::from) {
        match client.request(&set(value)) {
            Ok(Reply::Done { .. }) => reported.push(value),
            Err(Error::NoReply { unknown: true, .. }) => unknown.push(value),
            other => panic!("command {value}: {other:?}"),
        }
    }
    let done = done.lock().unwrap().clone();
    (done, reported, unknown)
}

#[test]
fn ten_thousand_commands_over_a_bad_line_are_each_carried_out_once_or_reported_as_failed() {
    for damage in [CLEAN, ONE_PERCENT_FLIPPED, ONE_PERCENT_DROPPED] {
        let (done, reported, unknown) = run_script(damage, 7, 10_000);
        assert_eq!(reported.len() + unknown.len(), 10_000);
        // In their order and none twice.
        assert!(done.windows(2).all(|pair| pair[0] < pair[1]));
        assert!(reported.iter().all(|value| done.binary_search_by(|d| d.total_cmp(value)).is_ok()));
        let extra = done.iter().filter(|value| !reported.contains(value));
        assert!(extra.into_iter().all(|value| unknown.contains(value)));
        // The line is bad enough to test something, and good enough for six attempts.
        println!("flipped {} ‰, dropped {} ‰: {} unknown", damage.flipped, damage.dropped, unknown.len());
        assert!(unknown.len() < 100, "{} of 10,000 given up", unknown.len());
    }
}

#[test]
fn a_bad_line_is_counted() {
    let (line, _) = Line::new(ONE_PERCENT_FLIPPED, 3);
    let mut client = Client::new(Box::new(line), Patience::SERIAL, 1);
    (0..500).for_each(|value| drop(client.request(&set(f64::from(value)))));
    let losses = client.losses();
    assert!(losses.repeated > 50 && losses.unreadable > 20, "{losses:?}");
}

#[test]
fn a_refused_command_is_refused_once_however_often_it_arrives() {
    let (line, done) = Line::new(ONE_PERCENT_DROPPED, 5);
    let mut client = Client::new(Box::new(line), Patience::SERIAL, 1);
    for _ in 0..1000 {
        let reply = client.request(&set(-1.0));
        assert!(matches!(reply, Ok(Reply::Refused(Refusal::Moving)) | Err(Error::NoReply { .. })), "{reply:?}");
    }
    assert!(done.lock().unwrap().is_empty());
}

#[test]
fn a_pulled_cable_is_reported_within_a_second() {
    for told in [true, false] {
        let (mut line, _) = Line::new(CLEAN, 1);
        let start = line.now;
        line.pulled = Some((start, told));
        let port = Arc::new(Mutex::new(line));
        let mut client = Client::new(Box::new(Shared(port.clone())), Patience::SERIAL, 1);
        let error = client.request(&set(1.0)).unwrap_err();
        assert_eq!(matches!(error, Error::Broken(_)), told, "{error}");
        assert!(port.lock().unwrap().now - start < Duration::from_secs(1));
        let words = error.to_string();
        assert!(
            words.contains(if told { "the link broke" } else { "whether it was carried out is not known" }),
            "{words}"
        );
    }
}

/// A line that the test looks at as well.
struct Shared(Arc<Mutex<Line>>);

impl Port for Shared {
    fn send(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.0.lock().unwrap().send(bytes)
    }

    fn receive(&mut self, bytes: &mut [u8], until: Instant) -> io::Result<usize> {
        self.0.lock().unwrap().receive(bytes, until)
    }

    fn now(&self) -> Instant {
        self.0.lock().unwrap().now()
    }
}

#[test]
fn a_firmware_of_another_protocol_is_refused_with_both_numbers_and_what_to_do() {
    for theirs in [PROTOCOL - 1, PROTOCOL + 1] {
        let (mut line, _) = Line::new(CLEAN, 1);
        line.identity.protocol = theirs;
        let Err(error) = Drive::connect(Client::new(Box::new(line), Patience::SERIAL, 1)) else {
            panic!("protocol {theirs} was taken for {PROTOCOL}")
        };
        let words = error.to_string();
        for part in [&format!("protocol {theirs}"), &format!("protocol {PROTOCOL}"), "cargo xtask flash"] {
            assert!(words.contains(part), "{words}");
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(32))]
    #[test]
    fn no_command_is_ever_carried_out_twice(seed: u64, flipped in 0u64..60, dropped in 0u64..60) {
        let (done, reported, unknown) = run_script(Damage { flipped, dropped }, seed, 200);
        prop_assert!(done.windows(2).all(|pair| pair[0] < pair[1]), "{done:?}");
        prop_assert!(reported.iter().all(|value| done.contains(value)));
        prop_assert!(done.iter().all(|value| reported.contains(value) || unknown.contains(value)));
    }
}
