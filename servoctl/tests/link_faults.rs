//! The client against the protocol's own server over a line that loses, flips and delays: each command once, or reported. The same against the
//! firmware's ELF: `virtual-board/tests/link_faults.rs`.

use std::collections::BTreeMap;
use std::io::{self, ErrorKind};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use proptest::prelude::*;
use rand_pcg::Pcg64;
use rand_pcg::rand_core::{Rng, SeedableRng};
use servo_core::capture::{self, Trigger};
use servo_core::cascade::ParallelGains;
use servo_core::compensator::Compensator;
use servo_core::measure::{self, Node, Shape};
use servo_core::profile::Limits;
use servo_core::record::Selection;
use servo_core::refusal::Refusal;
use servo_core::state::ControlWord;
use servo_protocol::endpoint::{self, ENDPOINTS, Kind};
use servo_protocol::frame::{MAX_FRAME, encode};
use servo_protocol::message::{Identity, PROTOCOL, Reply, Request};
use servo_protocol::server::{Incoming, Server};
use servo_protocol::stream;
use servoctl::link::{Client, Drive, Error, Patience, Port};

/// What the drive has carried out, in its order: numbers of the requests, and what they were.
type Done = Arc<Mutex<Vec<(u32, Request)>>>;

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

    fn carry_out(&self, id: u32, request: &Request) -> Reply {
        match request {
            Request::Identity => Reply::Identity(self.identity.clone()),
            Request::GetParameter(id) => Reply::Parameter { id: *id, value: f64::from(*id) },
            Request::Move { target_ct, .. } if *target_ct < 0 => Reply::Refused(Refusal::Moving),
            command => {
                assert_eq!(endpoint::of(command).kind, Kind::Command, "{command:?} is not in this script");
                let mut done = self.done.lock().unwrap();
                done.push((id, command.clone()));
                Reply::Done { tick: done.len() as u32 }
            }
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
                    let reply = self.carry_out(id, &request);
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

/// Number of the first request: few before it begins anew.
const FIRST_ID: u32 = 0xffff_fff0;

/// A command of every kind that is sent again when it is lost; `Restart` is not.
fn any_command(random: &mut Pcg64) -> Request {
    let mut number = |below: u64| random.next_u64() % below;
    let limits = Limits { velocity_m_per_s: 0.1, acceleration_m_per_s2: 1.0, jerk_m_per_s3: None };
    match number(20) {
        0 => Request::Enable,
        1 => Request::Disable,
        2 => Request::ResetFault,
        3 => Request::Move { target_ct: number(1 << 40) as i64, limits },
        // Refused.
        4 => Request::Move { target_ct: -1 - number(1 << 40) as i64, limits },
        5 => Request::Stop,
        6 => Request::Compensator(Compensator::ALL[number(3) as usize]),
        7 => {
            let [kp_n_per_m, ki_n_per_m_s, kd_n_s_per_m] = [(); 3].map(|()| number(1000) as f64);
            Request::Gains(ParallelGains { kp_n_per_m, ki_n_per_m_s, kd_n_s_per_m })
        }
        8 => Request::SetParameters((0..1 + number(3)).map(|id| (id as u16, id as f64)).collect()),
        9 => {
            let (words, samples) = (Selection(number(256) as u32), number(10_000) as u32);
            Request::Capture(capture::Order { words, samples, before: 0, every_ticks: 1, trigger: Trigger::Now })
        }
        10 => Request::SaveParameters,
        11 => Request::LoadParameters,
        12 => Request::ResetParameters,
        13 => Request::Stream(stream::Order { words: Selection(number(256) as u32), every_ticks: 1 }),
        14 => {
            let shape = Shape::Pulse { amplitude: number(100) as f32, length_s: 0.1 };
            Request::Excite(measure::Request {
                shape,
                node: Node::Force,
                travel_m: 1e-3,
                speed_m_per_s: 0.1,
                current_a: 1.0,
            })
        }
        15 => Request::Align,
        16 => Request::CollectSignals,
        17 => Request::CorrectSignals,
        18 => Request::Control(ControlWord(number(0x200) as u16)),
        _ => Request::GetParameter(number(1000) as u16),
    }
}

/// What became of a script: requests by their places in it.
struct Outcome {
    script: Vec<Request>,
    /// What the drive has carried out, in its order.
    done: Vec<usize>,
    /// What the host was told.
    reported: Vec<usize>,
    refused: Vec<usize>,
    unknown: Vec<usize>,
    answered: usize,
}

fn run_script(damage: Damage, seed: u64, requests: usize) -> Outcome {
    let (line, done) = Line::new(damage, seed);
    let mut client = Client::new(Box::new(line), Patience::SERIAL, FIRST_ID);
    let mut random = Pcg64::seed_from_u64(seed ^ 0x5c41_9700);
    let script: Vec<Request> = (0..requests).map(|_| any_command(&mut random)).collect();
    let (mut reported, mut refused, mut unknown, mut answered) = (Vec::new(), Vec::new(), Vec::new(), 0);
    for (at, request) in script.iter().enumerate() {
        match (request, client.request(request)) {
            (Request::GetParameter(id), Ok(Reply::Parameter { id: of, value })) => {
                assert!(*id == of && value == f64::from(of), "the answer to another request");
                answered += 1;
            }
            (Request::GetParameter(_), Err(Error::NoReply { unknown: false, .. })) => answered += 1,
            (_, Ok(Reply::Done { .. })) => reported.push(at),
            (_, Ok(Reply::Refused(Refusal::Moving))) => refused.push(at),
            (_, Err(Error::NoReply { unknown: true, .. })) => unknown.push(at),
            other => panic!("request {at}: {other:?}"),
        }
    }
    let done = done.lock().unwrap();
    let done = done.iter().map(|(id, request)| {
        let at = id.wrapping_sub(FIRST_ID) as usize;
        assert_eq!(script.get(at), Some(request), "carried out, but never asked for");
        at
    });
    let done = done.collect();
    Outcome { script, done, reported, refused, unknown, answered }
}

impl Outcome {
    /// Every command once, in its order, or reported.
    fn check(&self) {
        let Outcome { script, done, reported, refused, unknown, answered } = self;
        assert_eq!(reported.len() + refused.len() + unknown.len() + answered, script.len());
        assert!(done.windows(2).all(|pair| pair[0] < pair[1]), "none twice, none late");
        assert!(reported.iter().all(|at| done.binary_search(at).is_ok()), "none said to be done that is not");
        assert!(refused.iter().all(|at| done.binary_search(at).is_err()), "none said to be refused that is done");
        let unsaid = done.iter().filter(|at| reported.binary_search(at).is_err());
        assert!(unsaid.into_iter().all(|at| unknown.binary_search(at).is_ok()), "none done and not reported");
    }

    /// How many of the places in `some` hold each kind of command.
    fn kinds(&self, some: &[usize]) -> BTreeMap<&'static str, usize> {
        some.iter().fold(BTreeMap::new(), |mut kinds, at| {
            *kinds.entry(endpoint::of(&self.script[*at]).request).or_default() += 1;
            kinds
        })
    }
}

#[test]
fn ten_thousand_commands_of_every_kind_over_a_bad_line_are_each_carried_out_once_or_reported_as_failed() {
    for damage in [CLEAN, ONE_PERCENT_FLIPPED, ONE_PERCENT_DROPPED] {
        let outcome = run_script(damage, 7, 10_700);
        outcome.check();
        assert!(outcome.script.len() - outcome.answered >= 10_000, "the rest are queries");
        let (done, reported) = (outcome.kinds(&outcome.done), outcome.kinds(&outcome.reported));
        for row in ENDPOINTS.iter().filter(|row| row.kind == Kind::Command && row.request != "Restart") {
            let (done, reported) = (done[row.request], reported[row.request]);
            assert!(reported > 400 && done >= reported && done < reported + 30, "{}: {reported} {done}", row.request);
        }
        // The line is bad enough to test something, and good enough for the attempts that there are.
        let unknown = outcome.unknown.len();
        println!("flipped {} ‰, dropped {} ‰: {unknown} unknown", damage.flipped, damage.dropped);
        assert!(unknown < 150, "{unknown} of 10,000 given up");
    }
}

#[test]
fn a_bad_line_is_counted() {
    let (line, _) = Line::new(ONE_PERCENT_FLIPPED, 3);
    let mut client = Client::new(Box::new(line), Patience::SERIAL, 1);
    (0..500).for_each(|_| drop(client.request(&Request::Stop)));
    let losses = client.losses();
    assert!(losses.repeated > 50 && losses.unreadable > 20, "{losses:?}");
}

#[test]
fn a_restart_is_never_sent_again() {
    // Half of the frames are lost.
    let (line, done) = Line::new(Damage { flipped: 0, dropped: 50 }, 11);
    let mut client = Client::new(Box::new(line), Patience::SERIAL, 1);
    let replies: Vec<_> = (0..100).map(|_| client.request(&Request::Restart)).collect();
    let lost = replies.iter().filter(|reply| matches!(reply, Err(Error::NoReply { attempts: 1, unknown: true, .. })));
    assert!((20..90).contains(&lost.count()), "{replies:?}");
    assert_eq!(client.losses().repeated, 0);
    assert!(done.lock().unwrap().len() < 90);
}

#[test]
fn a_pulled_cable_is_reported_within_a_second() {
    for told in [true, false] {
        let (mut line, _) = Line::new(CLEAN, 1);
        let start = line.now;
        line.pulled = Some((start, told));
        let port = Arc::new(Mutex::new(line));
        let mut client = Client::new(Box::new(Shared(port.clone())), Patience::SERIAL, 1);
        let error = client.request(&Request::Enable).unwrap_err();
        assert_eq!(matches!(error, Error::Broken(_)), told, "{error}");
        assert!(port.lock().unwrap().now - start < Duration::from_secs(1));
        let words = error.to_string();
        assert!(
            words.contains(if told { "the link broke" } else { "whether it was carried out is not known" }),
            "{words}"
        );
    }
}

/// A computer that has other things to do, or was asleep: the silence is its own, and the request is sent again.
#[test]
fn what_the_computer_has_slept_through_is_no_silence_of_the_line() {
    for pulled in [false, true] {
        let (mut line, _) = Line::new(CLEAN, 1);
        line.pulled = pulled.then_some((line.now, false));
        let mut client =
            Client::new(Box::new(Drowsy { line, sleeps: Some(Duration::from_secs(30)) }), Patience::TCP, 1);
        let reply = client.request(&Request::Enable);
        match pulled {
            false => assert!(matches!(reply, Ok(Reply::Done { .. }))),
            true => assert!(matches!(reply, Err(Error::NoReply { attempts: 3, .. })), "{reply:?}"),
        }
    }
}

/// A line to a computer that sleeps while the first reply comes, and loses it.
struct Drowsy {
    line: Line,
    sleeps: Option<Duration>,
}

impl Port for Drowsy {
    fn send(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.line.send(bytes)
    }

    fn receive(&mut self, bytes: &mut [u8], until: Instant) -> io::Result<usize> {
        let Some(time) = self.sleeps.take() else { return self.line.receive(bytes, until) };
        self.line.to_host.clear();
        self.line.now = until + time;
        Ok(0)
    }

    fn now(&self) -> Instant {
        self.line.now
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
        run_script(Damage { flipped, dropped }, seed, 200).check();
    }
}
