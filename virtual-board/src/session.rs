//! A person at the board: settings, enable, moves, all through the serial link.

use std::time::Duration;

use servo_core::capture::{Complete, Order, Progress, Trigger};
use servo_core::config::Compensator;
use servo_core::parameters::{Parameter, Settings, TABLE};
use servo_core::profile::Limits;
use servo_core::record::Selection;
use servo_core::refusal::Refusal;
use servo_core::settling::Settling;
use servo_core::state::State;
use servo_protocol::message::{
    PARAMETERS_PER_REPLY, PARAMETERS_PER_REQUEST, ParameterStore, Reply, Request, SaveProgress, Status,
};

use crate::{Error, Link, VirtualBoard};

/// Twice the age that a status can have, ticks.
const OLDEST_STATUS: u32 = 160;
/// How often a state is asked for while waiting for it.
const POLL: Duration = Duration::from_millis(2);
/// The same for the end of a save, which takes a second.
const POLL_SAVE: Duration = Duration::from_millis(20);
/// How long the drive may take to reach Operation enabled, or a move of these experiments to end.
const PATIENCE: Duration = Duration::from_secs(5);

/// A board and the link to it.
#[derive(Debug)]
pub struct Session {
    /// The board.
    pub board: VirtualBoard,
    link: Link,
    /// The tick that carried out the last order.
    last_order: u32,
}

/// One captured sample.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CapturedSample {
    /// Set-point − position, counts.
    pub error_ct: i32,
    /// Force, N.
    pub force_n: f32,
}

impl Session {
    /// Talks to `board`.
    #[must_use]
    pub fn new(board: VirtualBoard) -> Self {
        Session { board, link: Link::new(), last_order: 0 }
    }

    /// Sends a request and returns the reply, whatever it is.
    ///
    /// # Errors
    /// [`Error::NoReply`], [`Error::Ended`].
    pub fn ask(&mut self, request: &Request) -> Result<Reply, Error> {
        self.link.request(&mut self.board, request)
    }

    /// Sends a command and expects it to be carried out.
    ///
    /// # Errors
    /// [`Error::Refused`] with the drive's reason, and those of [`Session::ask`].
    pub fn order(&mut self, request: &Request) -> Result<(), Error> {
        match self.ask(request)? {
            Reply::Done { tick } => {
                self.last_order = tick;
                Ok(())
            }
            other => Err(unexpected(request, &other)),
        }
    }

    /// What the drive is doing, after the last order.
    ///
    /// # Errors
    /// Those of [`Session::ask`].
    pub fn status(&mut self) -> Result<Status, Error> {
        loop {
            match self.ask(&Request::Status)? {
                // Much older than the last order: the drive has been restarted since.
                Reply::Status(status) if status.tick + OLDEST_STATUS < self.last_order => {
                    self.last_order = 0;
                    return Ok(status);
                }
                Reply::Status(status) if status.tick < self.last_order => self.board.run_for(POLL)?,
                Reply::Status(status) => return Ok(status),
                other => return Err(unexpected(&Request::Status, &other)),
            }
        }
    }

    /// How the last move settled.
    ///
    /// # Errors
    /// Those of [`Session::ask`].
    pub fn settling(&mut self) -> Result<Settling, Error> {
        match self.ask(&Request::Settling)? {
            Reply::Settling(settling) => Ok(settling),
            other => Err(unexpected(&Request::Settling, &other)),
        }
    }

    /// Sets all parameters that differ from a new drive's.
    ///
    /// # Errors
    /// A refused value, and those of [`Session::ask`].
    pub fn configure(&mut self, settings: &Settings) -> Result<(), Error> {
        let changed: Vec<(u16, f64)> =
            TABLE.iter().filter(|p| p.get(settings) != p.default).map(|p| (p.id, p.get(settings))).collect();
        for some in changed.chunks(PARAMETERS_PER_REQUEST) {
            let values = some.iter().copied().collect();
            self.order(&Request::SetParameters(values))?;
        }
        Ok(())
    }

    /// Makes a new drive ready to be enabled, as a person would: sets all parameters that differ from a new drive's, saves them,
    /// and resets the fault.
    ///
    /// # Errors
    /// A refused value, a save that failed, and those of [`Session::ask`].
    pub fn commission(&mut self, settings: &Settings) -> Result<(), Error> {
        self.configure(settings)?;
        self.save_parameters()?;
        self.order(&Request::ResetFault)
    }

    /// Saves the parameters in use and waits until they are stored.
    ///
    /// # Errors
    /// [`Error::NotReached`] if the flash fails or takes longer than 5 s, a refusal, and those of [`Session::ask`].
    pub fn save_parameters(&mut self) -> Result<(), Error> {
        self.order(&Request::SaveParameters)?;
        let give_up_ns = self.board.time_ns() + PATIENCE.as_nanos() as u64;
        loop {
            self.board.run_for(POLL_SAVE)?;
            let store = self.parameter_store()?;
            match store.save {
                SaveProgress::Done => return Ok(()),
                SaveProgress::Running { .. } if self.board.time_ns() < give_up_ns => {}
                _ => {
                    let (what, status) = ("the end of the save".to_owned(), format!("{store:?}"));
                    return Err(Error::NotReached { what, status });
                }
            }
        }
    }

    /// What is stored.
    ///
    /// # Errors
    /// Those of [`Session::ask`].
    pub fn parameter_store(&mut self) -> Result<ParameterStore, Error> {
        match self.ask(&Request::ParameterStore)? {
            Reply::ParameterStore(store) => Ok(store),
            other => Err(unexpected(&Request::ParameterStore, &other)),
        }
    }

    /// All parameters in use.
    ///
    /// # Errors
    /// Those of [`Session::ask`], and a value that this table does not allow.
    pub fn parameters(&mut self) -> Result<Settings, Error> {
        let (mut settings, mut first) = (Settings::default(), 0);
        loop {
            let request = Request::ReadParameters { first };
            let values = match self.ask(&request)? {
                Reply::Parameters(values) => values,
                other => return Err(unexpected(&request, &other)),
            };
            for (id, value) in &values {
                let row = Parameter::by_id(*id).ok_or(Refusal::UnknownParameter(*id));
                row.and_then(|row| row.set(&mut settings, *value))
                    .map_err(|refusal| unexpected(&request, &Reply::Refused(refusal)))?;
                first = *id + 1;
            }
            if values.len() < PARAMETERS_PER_REPLY {
                return Ok(settings);
            }
        }
    }

    /// Enables the drive and waits for Operation enabled.
    ///
    /// # Errors
    /// A refusal, a fault on the way, and those of [`Session::ask`].
    pub fn enable(&mut self, compensator: Compensator) -> Result<(), Error> {
        self.order(&Request::Enable)?;
        self.wait_for("Operation enabled", |status| status.state == State::OperationEnabled)?;
        self.order(&Request::Compensator(compensator))
    }

    /// Moves to `target_ct` and returns when the profile has ended.
    ///
    /// # Errors
    /// A refusal, a fault on the way, and those of [`Session::ask`].
    pub fn move_to(&mut self, target_ct: i64, limits: Limits) -> Result<(), Error> {
        self.order(&Request::Move { target_ct, limits })?;
        self.wait_for("the end of the move", |status| !status.moving)?;
        Ok(())
    }

    /// Lets virtual time pass until `reached`.
    fn wait_for(&mut self, what: &str, reached: impl Fn(&Status) -> bool) -> Result<Status, Error> {
        let give_up_ns = self.board.time_ns() + PATIENCE.as_nanos() as u64;
        loop {
            self.board.run_for(POLL)?;
            let status = self.status()?;
            if status.fault.is_some() || self.board.time_ns() > give_up_ns {
                return Err(Error::NotReached { what: what.to_owned(), status: format!("{status:?}") });
            }
            if reached(&status) {
                return Ok(status);
            }
        }
    }

    /// Orders a capture of error, position and force from the end of the next profile on, every so many ticks.
    ///
    /// # Errors
    /// A refusal, and those of [`Session::ask`].
    pub fn arm_capture(&mut self, samples: u32, every_ticks: u32) -> Result<(), Error> {
        let words = Selection::ERROR_POSITION_FORCE;
        self.order(&Request::Capture(Order { words, samples, before: 0, every_ticks, trigger: Trigger::MoveEnd }))
    }

    /// Reads the capture out.
    ///
    /// # Errors
    /// [`Error::NotReached`] if it is not complete, and those of [`Session::ask`].
    pub fn read_capture(&mut self) -> Result<Vec<CapturedSample>, Error> {
        let status = self.status()?;
        let Progress::Complete(Complete { order, oldest, .. }) = status.capture else {
            return Err(Error::NotReached { what: "the end of the capture".to_owned(), status: format!("{status:?}") });
        };
        let count = order.words.count();
        let total = order.samples as usize * count;
        let mut words: Vec<u32> = Vec::with_capacity(total);
        while words.len() < total {
            let request = Request::ReadCapture { first: words.len() as u32 };
            match self.ask(&request)? {
                Reply::Capture { words: block, .. } if !block.is_empty() => words.extend(block),
                other => return Err(unexpected(&request, &other)),
            }
        }
        words.rotate_left(oldest as usize * count);
        // As `Selection::ERROR_POSITION_FORCE` orders them.
        let sample = |w: &[u32]| CapturedSample { error_ct: w[1] as i32, force_n: f32::from_bits(w[2]) };
        Ok(words.chunks_exact(count).map(sample).collect())
    }
}

fn unexpected(request: &Request, reply: &Reply) -> Error {
    match reply {
        Reply::Refused(refusal) => Error::Refused { request: format!("{request:?}"), reason: refusal.to_string() },
        other => Error::Refused { request: format!("{request:?}"), reason: format!("answered by {other:?}") },
    }
}
