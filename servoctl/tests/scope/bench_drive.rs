//! A drive at the far end of a port, in this process: the drive of core on the stage of sim, asked in the protocol's frames and
//! paced by the clock on the wall.

use std::collections::VecDeque;
use std::io;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::{Duration, Instant};

use servo_core::SERVO_HZ;
use servo_core::config::Config;
use servo_core::drive::Command;
use servo_core::parameters::{Access, Parameter, Settings, TABLE};
use servo_core::position::Position;
use servo_core::record::TickRecord;
use servo_core::refusal::Refusal;
use servo_host_tests::{Bench, tuning};
use servo_protocol::frame::{MAX_FRAME, encode};
use servo_protocol::message::{
    BLOCK_WORDS, Identity, PARAMETERS_PER_REPLY, PROTOCOL, ParameterStore, Reply, Request, SaveProgress, Status,
    VIRTUAL_SERIAL,
};
use servo_protocol::server::{Incoming, Server};
use servo_protocol::stream::Packer;
use servo_sim::Stage;
use servoctl::cli::drive::Connected;
use servoctl::link::{Client, Drive, Patience, Port};

/// A computer that is busy elsewhere lets the drive fall behind rather than rush.
const MOST_TICKS_AT_ONCE: u32 = 400;
const CAPACITY_WORDS: u32 = 128 * 1024;
const SAVED: ParameterStore = ParameterStore { image: None, invalid: None, unsaved: false, save: SaveProgress::None };

/// A cable that can be pulled.
pub type Cable = Arc<AtomicBool>;

pub struct BenchDrive {
    bench: Bench,
    settings: Settings,
    stored: Settings,
    server: Server,
    replies: VecDeque<u8>,
    captured: Vec<u32>,
    stream: Option<(u32, Packer)>,
    record: TickRecord,
    until: Instant,
    pulled: Cable,
}

impl BenchDrive {
    /// The thesis' stage and first tuning, at rest, bridge off.
    pub fn new(pulled: Cable) -> Self {
        let stage = Stage::default();
        let settings = tuning::settings(&stage, &tuning::STANDARD).unwrap();
        BenchDrive {
            bench: Bench::new(&stage, &settings, 7).unwrap(),
            settings,
            stored: settings,
            server: Server::default(),
            replies: VecDeque::new(),
            captured: Vec::new(),
            stream: None,
            record: TickRecord::default(),
            until: Instant::now(),
            pulled,
        }
    }

    /// What the scope connects to, as often as it likes: a new drive each time.
    pub fn connect(pulled: &Cable) -> anyhow::Result<Connected> {
        let drive = BenchDrive::new(pulled.clone());
        let drive = Drive::connect(Client::new(Box::new(drive), Patience::TCP, 1))?;
        Ok(drive.into())
    }

    fn tick(&mut self, command: Option<Command>) -> Option<Result<(), Refusal>> {
        let output = self.bench.tick(command);
        self.record = output.record;
        if let Some(sample) = output.sample {
            let (at, count) = (sample.at as usize, sample.count as usize);
            self.captured.resize(self.captured.len().max(at + count), 0);
            self.captured[at..at + count].copy_from_slice(&sample.words[..count]);
        }
        if let Some((id, packer)) = &mut self.stream
            && let Some(block) = packer.push(&output.record)
        {
            let id = *id;
            self.reply(id, &Reply::Block(block));
        }
        output.outcome
    }

    fn reply(&mut self, id: u32, reply: &Reply) {
        let mut frame = [0; MAX_FRAME];
        let length = encode(id, reply, &mut frame).unwrap();
        self.replies.extend(&frame[..length]);
    }

    fn catch_up(&mut self) {
        let now = Instant::now();
        let behind_s = now.saturating_duration_since(self.until).as_secs_f64();
        self.until = now;
        let ticks = (behind_s * f64::from(SERVO_HZ)) as u32;
        for _ in 0..ticks.min(MOST_TICKS_AT_ONCE) {
            self.tick(None);
        }
    }

    fn handle(&mut self, id: u32, request: Request) -> Reply {
        let command = match request {
            Request::Identity => return Reply::Identity(identity()),
            Request::Status => return Reply::Status(self.status()),
            Request::Settling => return Reply::Settling(self.bench.axis.drive().settling()),
            Request::ReadCapture { first } => {
                let words = self.captured.iter().skip(first as usize).take(BLOCK_WORDS).copied().collect();
                return Reply::Capture { first, words };
            }
            Request::ReadParameters { first } => {
                let rows = TABLE.iter().filter(|row| row.id >= first).take(PARAMETERS_PER_REPLY);
                return Reply::Parameters(rows.map(|row| (row.id, row.get(&self.settings))).collect());
            }
            Request::ParameterStore => {
                return Reply::ParameterStore(ParameterStore { unsaved: self.settings != self.stored, ..SAVED });
            }
            Request::Capture(order) => match order.check(CAPACITY_WORDS) {
                Ok(order) => {
                    self.bench.axis.arm_capture(order);
                    return self.done(Ok(()));
                }
                Err(refusal) => return Reply::Refused(refusal),
            },
            Request::Stream(order) => {
                self.stream = Some((id, Packer::new(order)));
                return self.done(Ok(()));
            }
            Request::Enable => Command::Enable,
            Request::Disable => Command::Disable,
            Request::ResetFault => Command::ResetFault,
            Request::Stop => Command::Stop,
            Request::Move { target_ct, limits } => Command::Move { target: Position(target_ct), limits },
            Request::Compensator(chosen) => {
                self.settings.compensator = f64::from(chosen as u8);
                Command::Compensator(chosen)
            }
            Request::SetParameters(values) => {
                let set = self.set(&values);
                return self.done(set);
            }
            other => panic!("the page asked for {other:?}"),
        };
        let outcome = self.tick(Some(command)).expect("a command is answered in its tick");
        self.done(outcome)
    }

    fn done(&self, outcome: Result<(), Refusal>) -> Reply {
        match outcome {
            Ok(()) => Reply::Done { tick: self.record.sequence },
            Err(refusal) => Reply::Refused(refusal),
        }
    }

    fn set(&mut self, values: &[(u16, f64)]) -> Result<(), Refusal> {
        let mut settings = self.settings;
        for (id, value) in values {
            Parameter::by_id(*id).ok_or(Refusal::UnknownParameter(*id))?.set(&mut settings, *value)?;
        }
        let differs = |row: &&Parameter| row.get(&settings) != row.get(&self.settings);
        let needs_bridge_off = TABLE.iter().filter(differs).any(|row| row.access == Access::BridgeOff);
        let config = Config::new(&settings)?;
        self.tick(Some(Command::Configure { config, needs_bridge_off })).expect("a command is answered in its tick")?;
        self.settings = settings;
        Ok(())
    }

    fn status(&self) -> Status {
        let (drive, capture) = (self.bench.axis.drive(), self.bench.axis.capture().progress());
        let status_word = drive.status_word(&self.record);
        Status {
            bad_requests: self.server.unreadable(),
            ..Status::of(&self.record, status_word, drive.counters(), capture)
        }
    }
}

fn identity() -> Identity {
    let board = "bench".try_into().unwrap();
    Identity { protocol: PROTOCOL, firmware: [0, 1, 0], program: 0, board, serial: VIRTUAL_SERIAL }
}

impl Port for BenchDrive {
    fn send(&mut self, bytes: &[u8]) -> io::Result<()> {
        if self.pulled.load(Ordering::Relaxed) {
            return Err(io::Error::new(io::ErrorKind::UnexpectedEof, "the cable was pulled"));
        }
        self.catch_up();
        for byte in bytes {
            let (id, reply) = match self.server.push(*byte) {
                None => continue,
                Some(Incoming::Repeated { id, reply }) => (id, reply),
                Some(Incoming::Fresh { id, request }) => {
                    let reply = self.handle(id, request);
                    self.server.answered(id, &reply);
                    (id, reply)
                }
            };
            self.reply(id, &reply);
        }
        Ok(())
    }

    fn receive(&mut self, bytes: &mut [u8], until: Instant) -> io::Result<usize> {
        if self.replies.is_empty() {
            thread::sleep(until.saturating_duration_since(Instant::now()).min(Duration::from_millis(1)));
        }
        let length = bytes.len().min(self.replies.len());
        for (place, byte) in bytes.iter_mut().zip(self.replies.drain(..length)) {
            *place = byte;
        }
        Ok(length)
    }
}
