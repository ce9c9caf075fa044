//! The drive, as its commands see it: one method for each thing that a person wants of it.

use std::cell::Cell;
use std::time::Duration;

use servo_core::SERVO_HZ;
use servo_core::capture::{Complete, Order, Progress};
use servo_core::measure::Reading;
use servo_core::parameters::{Parameter, Settings, TABLE};
use servo_core::record::COLUMNS;
use servo_core::settling::Settling;
use servo_core::state::State;
use servo_protocol::black_box;
use servo_protocol::endpoint;
use servo_protocol::message::{
    Identity, PARAMETERS_PER_REPLY, PARAMETERS_PER_REQUEST, PROTOCOL, ParameterStore, Reply, Request, SaveProgress,
    Status,
};
use servo_protocol::stream::{self, Block};

use super::{Client, Error};

/// A status this much older than the last command comes from a drive that was restarted since, ticks.
const RESTARTED: u32 = SERVO_HZ / 10;
/// Longer than any alignment, ticks.
const ALIGN: u32 = 20 * SERVO_HZ;

/// So often a drive that has been restarted is asked who it is before it is given up.
const RESTART_ATTEMPTS: u32 = 8;
/// So often a drive that has been restarted is asked whether its control loop runs, and with such pauses.
const STARTING_LOOKS: u32 = 100;
const STARTING_LOOK: Duration = Duration::from_millis(20);

/// A drive that speaks our protocol.
pub struct Drive {
    client: Client,
    identity: Identity,
    last_tick: u32,
}

/// A capture, read out.
#[derive(Clone, Debug, PartialEq)]
pub struct Capture {
    /// What was recorded, and where in it the trigger is.
    pub complete: Complete,
    /// Samples of as many words as were ordered, the oldest first.
    words: Vec<u32>,
}

impl Capture {
    /// From the ring as it lies in the drive.
    pub fn new(complete: Complete, mut words: Vec<u32>) -> Capture {
        words.rotate_left(complete.oldest as usize * complete.order.words.count());
        Capture { complete, words }
    }

    /// Time of each sample from the trigger on, s.
    pub fn times_s(&self) -> Vec<f64> {
        let Complete { order, before, .. } = self.complete;
        let step_s = f64::from(order.every_ticks) / f64::from(SERVO_HZ);
        (0..order.samples).map(|index| (f64::from(index) - f64::from(before)) * step_s).collect()
    }

    /// The column with this name in [`COLUMNS`], if it was recorded.
    pub fn column(&self, name: &str) -> Option<Vec<f64>> {
        let selection = self.complete.order.words;
        let place = selection.numbers().position(|number| COLUMNS[number].0 == name)?;
        let kind = COLUMNS[selection.numbers().nth(place)?].1;
        Some(self.words.chunks_exact(selection.count()).map(|sample| kind.value(sample[place])).collect())
    }
}

impl Drive {
    /// Asks who is there.
    ///
    /// # Errors
    /// [`Error::Protocol`] for a firmware of another protocol; those of [`Client::request`].
    pub fn connect(client: Client) -> Result<Self, Error> {
        let nobody =
            Identity { protocol: PROTOCOL, firmware: [0; 3], program: 0, board: Default::default(), serial: [0; 3] };
        let mut drive = Drive { client, identity: nobody, last_tick: 0 };
        drive.identify()?;
        Ok(drive)
    }

    fn identify(&mut self) -> Result<(), Error> {
        self.identity = self.query(&Request::Identity, |reply| match reply {
            Reply::Identity(identity) => Some(identity),
            _ => None,
        })?;
        let theirs = self.identity.protocol;
        if theirs == PROTOCOL { Ok(()) } else { Err(Error::Protocol { theirs }) }
    }

    /// Who is there.
    pub fn identity(&self) -> &Identity {
        &self.identity
    }

    /// The line.
    pub fn client(&self) -> &Client {
        &self.client
    }

    /// Sends a command and expects it to be carried out; returns the tick that did.
    ///
    /// # Errors
    /// [`Error::Refused`] with reason and state; those of [`Client::request`].
    pub fn order(&mut self, request: &Request) -> Result<u32, Error> {
        match self.client.request(request)? {
            Reply::Done { tick } => {
                self.last_tick = tick;
                Ok(tick)
            }
            Reply::Refused(refusal) => {
                let state = self.status().ok().map(|status| status.state);
                Err(Error::Refused { request: endpoint::of(request).request, refusal, state })
            }
            other => Err(Error::Unexpected { request: endpoint::of(request).request, reply: endpoint::name(&other) }),
        }
    }

    /// What the drive is doing: at least as new as the last command.
    ///
    /// # Errors
    /// [`Error::Interrupted`] if the drive was restarted since the last command; those of [`Client::request`].
    pub fn status(&mut self) -> Result<Status, Error> {
        loop {
            let status = self.query(&Request::Status, |reply| match reply {
                Reply::Status(status) => Some(status),
                _ => None,
            })?;
            let older = self.last_tick.wrapping_sub(status.tick) as i32;
            if older > RESTARTED as i32 {
                self.last_tick = status.tick;
                return Err(Error::Interrupted {
                    what: "the drive was restarted",
                    why: format!("its tick count fell by {older}"),
                    help: "`servoctl status` shows where it stands now",
                });
            }
            if older <= 0 {
                return Ok(status);
            }
        }
    }

    /// Sends a query and takes what is wanted out of its reply.
    fn query<T>(&mut self, request: &Request, take: impl FnOnce(Reply) -> Option<T>) -> Result<T, Error> {
        let reply = self.client.request(request)?;
        if let Reply::Refused(refusal) = reply {
            let state = match self.client.request(&Request::Status) {
                Ok(Reply::Status(status)) => Some(status.state),
                _ => None,
            };
            return Err(Error::Refused { request: endpoint::of(request).request, refusal, state });
        }
        let name = endpoint::name(&reply);
        take(reply).ok_or(Error::Unexpected { request: endpoint::of(request).request, reply: name })
    }

    /// Waits until `reached`, at most `ticks` of the drive's own time; `look` sees every status and ends the wait by returning `false`.
    ///
    /// # Errors
    /// A fault on the way, or the time is over; those of [`Drive::status`].
    pub fn wait_until(
        &mut self,
        what: &'static str,
        ticks: u32,
        mut look: impl FnMut(&Status) -> bool,
        reached: impl Fn(&Status) -> bool,
    ) -> Result<Status, Error> {
        let first = self.status()?;
        let mut status = first;
        loop {
            if let Some(fault) = status.fault {
                return Err(Error::Interrupted {
                    what,
                    why: format!("fault {}: {}", fault.number(), fault.explanation()),
                    help: "`servoctl faults` tells more",
                });
            }
            if reached(&status) || !look(&status) {
                return Ok(status);
            }
            if status.tick.wrapping_sub(first.tick) > ticks {
                return Err(Error::Interrupted {
                    what,
                    why: format!("not within {} s; the drive is in state {}", ticks / SERVO_HZ, status.state),
                    help: "`servoctl status` shows where it stands",
                });
            }
            status = self.status()?;
        }
    }

    /// Closes the loops and waits until they are.
    ///
    /// # Errors
    /// A refusal, a fault on the way.
    pub fn enable(&mut self) -> Result<Status, Error> {
        self.order(&Request::Enable)?;
        self.wait_until("enabling", 2 * SERVO_HZ, |_| true, |status| status.state == State::OperationEnabled)
    }

    /// Looks for the motor's electrical zero; the bridge is off when it has ended, and at once when `go_on` returns `false`.
    /// Whether it was found: the drive's parameters then have it.
    ///
    /// # Errors
    /// A refusal, the fault of an alignment that failed.
    pub fn align(&mut self, go_on: impl Fn() -> bool) -> Result<bool, Error> {
        self.order(&Request::Align)?;
        for torque in [true, false] {
            self.wait_until("aligning", ALIGN, |_| go_on(), |status| status.state.has_torque() == torque)?;
        }
        if go_on() {
            return Ok(true);
        }
        self.order(&Request::Disable)?;
        Ok(false)
    }

    /// How the last move settled.
    ///
    /// # Errors
    /// Those of [`Client::request`].
    pub fn settling(&mut self) -> Result<Settling, Error> {
        self.query(&Request::Settling, |reply| match reply {
            Reply::Settling(settling) => Some(settling),
            _ => None,
        })
    }

    /// What the excitation under way, or the last one, has found: at least as new as the last command.
    ///
    /// # Errors
    /// Those of [`Client::request`].
    pub fn excitation(&mut self) -> Result<Reading, Error> {
        loop {
            let (tick, reading) = self.query(&Request::Excitation, |reply| match reply {
                Reply::Excitation { tick, reading } => Some((tick, reading)),
                _ => None,
            })?;
            if self.last_tick.wrapping_sub(tick) as i32 <= 0 {
                return Ok(reading);
            }
        }
    }

    /// Lets so many ticks of the drive's own time pass.
    ///
    /// # Errors
    /// Those of [`Drive::status`].
    pub fn wait(&mut self, ticks: u32) -> Result<(), Error> {
        let first = self.status()?.tick;
        let mut gone = 0;
        while gone < ticks {
            // A virtual drive's time is slower than the clock on the wall: it is asked how much has passed.
            self.client.pass(Duration::from_secs_f64(f64::from(ticks - gone) / f64::from(SERVO_HZ)))?;
            gone = self.status()?.tick.wrapping_sub(first);
        }
        Ok(())
    }

    /// All parameters in use.
    ///
    /// # Errors
    /// Those of [`Client::request`]; a parameter that this program does not know.
    pub fn parameters(&mut self) -> Result<Settings, Error> {
        let (mut settings, mut first) = (Settings::default(), 0);
        loop {
            let values = self.query(&Request::ReadParameters { first }, |reply| match reply {
                Reply::Parameters(values) => Some(values),
                _ => None,
            })?;
            for (id, value) in &values {
                let set = Parameter::by_id(*id).map(|row| row.set(&mut settings, *value));
                if !matches!(set, Some(Ok(()))) {
                    return Err(Error::Unexpected {
                        request: "ReadParameters",
                        reply: "a parameter that this program does not know",
                    });
                }
                first = *id + 1;
            }
            if values.len() < PARAMETERS_PER_REPLY {
                return Ok(settings);
            }
        }
    }

    /// Sets parameters by rows of the table: as many at once as fit a request.
    ///
    /// # Errors
    /// A refusal; what was in earlier requests is set then.
    pub fn set_parameters(&mut self, values: &[(u16, f64)]) -> Result<(), Error> {
        for some in values.chunks(PARAMETERS_PER_REQUEST) {
            self.order(&Request::SetParameters(some.iter().copied().collect()))?;
        }
        Ok(())
    }

    /// Sets what differs from `wanted`, and returns the ids.
    ///
    /// # Errors
    /// Those of [`Drive::parameters`] and [`Drive::set_parameters`].
    pub fn make_parameters(&mut self, wanted: &Settings) -> Result<Vec<u16>, Error> {
        let used = self.parameters()?;
        let differ = TABLE.iter().filter(|row| row.get(&used) != row.get(wanted));
        let values: Vec<_> = differ.map(|row| (row.id, row.get(wanted))).collect();
        self.set_parameters(&values)?;
        Ok(values.into_iter().map(|(id, _)| id).collect())
    }

    /// What is stored.
    ///
    /// # Errors
    /// Those of [`Client::request`].
    pub fn parameter_store(&mut self) -> Result<ParameterStore, Error> {
        self.query(&Request::ParameterStore, |reply| match reply {
            Reply::ParameterStore(store) => Some(store),
            _ => None,
        })
    }

    /// Stores the parameters in use and waits until they are.
    ///
    /// # Errors
    /// A refusal; a flash that fails or takes longer than ten seconds.
    pub fn save_parameters(&mut self) -> Result<ParameterStore, Error> {
        let begun = self.order(&Request::SaveParameters)?;
        loop {
            let store = self.parameter_store()?;
            let waited = self.status()?.tick.wrapping_sub(begun);
            match store.save {
                SaveProgress::Done => return Ok(store),
                SaveProgress::Running { .. } if waited < 10 * SERVO_HZ => {}
                other => {
                    return Err(Error::Interrupted {
                        what: "saving",
                        why: format!("{other:?} after {:.1} s", f64::from(waited) / f64::from(SERVO_HZ)),
                        help: "what was stored before is still there; try again",
                    });
                }
            }
        }
    }

    /// Starts the firmware anew and waits until it answers and its control loop runs; one that never does is the caller's to see.
    ///
    /// # Errors
    /// A refusal; those of [`Client::request`].
    pub fn restart(&mut self) -> Result<Status, Error> {
        self.order(&Request::Restart)?;
        self.last_tick = 0;
        // Settling a save that was cut short takes seconds, and nobody answers meanwhile.
        let silent = |answer: &Result<(), Error>| matches!(answer, Err(Error::NoReply { .. }));
        (1..RESTART_ATTEMPTS)
            .fold(self.identify(), |answer, _| if silent(&answer) { self.identify() } else { answer })?;
        for _ in 0..STARTING_LOOKS {
            if self.status()?.state != State::NotReadyToSwitchOn {
                break;
            }
            self.client.pass(STARTING_LOOK)?;
        }
        self.status()
    }

    /// Reads a complete capture out; `progress` sees words to read and the length of the last block.
    ///
    /// # Errors
    /// [`Error::Interrupted`] if there is none; those of [`Client::request`].
    pub fn read_capture(&mut self, mut progress: impl FnMut(usize, usize)) -> Result<Capture, Error> {
        let Progress::Complete(complete) = self.status()?.capture else {
            return Err(Error::Interrupted {
                what: "reading the capture",
                why: "there is no complete one".to_owned(),
                help: "`servoctl capture` orders one and reads it",
            });
        };
        let total = complete.order.samples as usize * complete.order.words.count();
        let mut words: Vec<u32> = Vec::with_capacity(total);
        while words.len() < total {
            let block = self.read_words(words.len())?;
            progress(total, block.len());
            words.extend(block);
        }
        Ok(Capture::new(complete, words))
    }

    /// Words of a complete capture as they lie in the drive, from this one on: at least one, and as many as fit a reply.
    ///
    /// # Errors
    /// [`Error::Unexpected`] if there are none; those of [`Client::request`].
    pub fn read_words(&mut self, from: usize) -> Result<Vec<u32>, Error> {
        self.query(&Request::ReadCapture { first: from as u32 }, |reply| match reply {
            Reply::Capture { first, words } if first == from as u32 && !words.is_empty() => Some(words.to_vec()),
            _ => None,
        })
    }

    /// Reads the black box's memory; whether it holds a recording, [`black_box::BlackBox::is_intact`] says.
    ///
    /// # Errors
    /// Those of [`Client::request`].
    pub fn read_black_box(&mut self) -> Result<Vec<Cell<u32>>, Error> {
        let mut memory = Vec::with_capacity(black_box::WORDS);
        while memory.len() < black_box::WORDS {
            let from = memory.len() as u32;
            let block = self.query(&Request::ReadBlackBox { first: from }, |reply| match reply {
                Reply::BlackBox { first, words } if first == from && !words.is_empty() => Some(words),
                _ => None,
            })?;
            memory.extend(block.into_iter().map(Cell::new));
        }
        Ok(memory)
    }

    /// Orders a capture.
    ///
    /// # Errors
    /// A refusal.
    pub fn arm_capture(&mut self, order: Order) -> Result<(), Error> {
        self.order(&Request::Capture(order)).map(|_| ())
    }

    /// Begins a stream in place of the one under way; its blocks come by [`Drive::next_block`].
    ///
    /// # Errors
    /// A refusal.
    pub fn stream(&mut self, order: stream::Order) -> Result<(), Error> {
        self.order(&Request::Stream(order)).map(|_| ())
    }

    /// The next block of the stream, if one comes in time.
    ///
    /// # Errors
    /// The line is gone.
    pub fn next_block(&mut self) -> Result<Option<Block>, Error> {
        self.client.next_block()
    }

    /// Blocks of the stream that came with the answers to other requests.
    pub fn blocks(&mut self) -> impl Iterator<Item = Block> {
        self.client.blocks()
    }
}
