//! What commissioning asks of a drive, on whatever line it is.

use std::sync::atomic::{AtomicBool, Ordering};

use servo_core::SERVO_HZ;
use servo_core::capture::{self, Trigger};
use servo_core::config::Compensator;
use servo_core::fault::Fault;
use servo_core::measure::{self, Progress, Reading};
use servo_core::parameters::Settings;
use servo_core::profile::Limits;
use servo_core::record::Selection;
use servo_core::state::State;

use super::{Event, Failure};
use crate::link::{Capture, Patience};

/// What a drive can be told to do.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Order {
    /// Close the loops.
    Enable,
    /// Bridge off.
    Disable,
    /// Brake to rest.
    Stop,
    /// Begin a move to a position (m).
    Move {
        /// Where to, m.
        target_m: f64,
        /// How fast.
        limits: Limits,
    },
    /// Begin an excitation.
    Excite(measure::Request),
    /// Choose the compensator.
    Compensator(Compensator),
}

/// How a drive is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Status {
    /// Power state.
    pub state: State,
    /// First fault.
    pub fault: Option<Fault>,
    /// Position, m.
    pub position_m: f64,
    /// A profile moves the set-point.
    pub moving: bool,
}

/// A sample of a capture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sample {
    /// Set-point − position, m.
    pub error_m: f64,
    /// Position against the first sample, m.
    pub position_m: f64,
    /// Force asked of the motor, N.
    pub force_n: f64,
}

/// A drive on a line.
pub trait Link {
    /// Which drive it is: its chip's serial number.
    fn serial(&self) -> String;
    /// Puts parameters into use.
    ///
    /// # Errors
    /// The drive's refusal, or that of the line.
    fn configure(&mut self, settings: &Settings) -> Result<(), Failure>;
    /// Gives an order; returns when the drive has taken it.
    ///
    /// # Errors
    /// As for [`Link::configure`].
    fn order(&mut self, order: &Order) -> Result<(), Failure>;
    /// How the drive is now.
    ///
    /// # Errors
    /// That of the line.
    fn status(&mut self) -> Result<Status, Failure>;
    /// What the excitation under way, or the last one, has found.
    ///
    /// # Errors
    /// That of the line.
    fn reading(&mut self) -> Result<Reading, Failure>;
    /// Orders a capture.
    ///
    /// # Errors
    /// As for [`Link::configure`].
    fn arm(&mut self, order: capture::Order) -> Result<(), Failure>;
    /// The capture, once it is complete.
    ///
    /// # Errors
    /// That of the line.
    fn captured(&mut self) -> Result<Option<Capture>, Failure>;
    /// Lets time pass, s.
    ///
    /// # Errors
    /// That of the line.
    fn wait(&mut self, seconds: f64) -> Result<(), Failure>;
    /// Looks for the motor's electrical zero, bridge off before and after; the parameters in use afterwards.
    ///
    /// # Errors
    /// As for [`Link::configure`]; the fault of an alignment that failed.
    fn align(&mut self, stop: &AtomicBool) -> Result<Settings, Failure>;
    /// Stores the parameters in use; the bridge is off.
    ///
    /// # Errors
    /// As for [`Link::configure`].
    fn save(&mut self) -> Result<(), Failure>;
}

/// Time between two looks at the drive, s.
const LOOK_S: f64 = 0.02;
/// Longest wait for rest, and for the bridge to turn off, when all is to end, s.
const BRAKE_S: f64 = 1.0;
/// Time in which a stage comes to rest whose friction gives back what the motor's force held, s.
const RELEASE_S: f64 = 0.1;
/// Longest wait for anything, s.
const PATIENCE_S: f64 = 120.0;
/// The drive's command time-out at most, s: twice the silence after which this program gives the line up, so that whatever it still asks
/// for comes in time.
pub const SILENCE_S: f64 = 2.0 * Patience::SERIAL.silence.as_millis() as f64 * 1e-3;

/// A link in use: every wait looks for faults and for the wish to end.
///
/// The drive is asked something every 20 ms or so while its bridge is on: what takes long to compute is computed with the bridge off.
pub struct Session<'a> {
    /// The drive.
    pub link: &'a mut dyn Link,
    /// The wish to end.
    pub stop: &'a AtomicBool,
    /// Parameters in use, with the user's own command time-out.
    pub settings: Settings,
    /// The command time-out in use, s: without a word for so long the drive ends by itself what it does; 0: never.
    pub silence_s: f64,
    /// Is told how far it is.
    pub said: &'a mut dyn FnMut(Event),
}

impl Session<'_> {
    /// Tells that `done` parts of `of` are done.
    pub fn done(&mut self, done: usize, of: usize) {
        (self.said)(Event::Done(done as u32, of as u32));
    }

    /// Puts parameters into use, but with a command time-out of [`SILENCE_S`] at most.
    ///
    /// # Errors
    /// As for [`Link::configure`].
    pub fn configure(&mut self, settings: Settings) -> Result<(), Failure> {
        let own_s = settings.command_timeout_s;
        let silence_s = if own_s > 0.0 { own_s.min(SILENCE_S) } else { SILENCE_S };
        self.link.configure(&Settings { command_timeout_s: silence_s, ..settings })?;
        (self.settings, self.silence_s) = (settings, silence_s);
        Ok(())
    }

    /// Puts the user's own command time-out into use; the bridge is off.
    ///
    /// # Errors
    /// As for [`Link::configure`].
    pub fn leave(&mut self) -> Result<(), Failure> {
        self.link.configure(&self.settings)?;
        self.silence_s = self.settings.command_timeout_s;
        Ok(())
    }

    /// Looks whether to go on.
    ///
    /// # Errors
    /// [`Failure::Stopped`], [`Failure::Fault`].
    pub fn look(&mut self) -> Result<Status, Failure> {
        if self.stop.load(Ordering::Relaxed) {
            return Err(Failure::Stopped);
        }
        let status = self.link.status()?;
        match status.fault {
            Some(fault) => Err(Failure::Fault(fault)),
            None => Ok(status),
        }
    }

    /// Lets time pass, s.
    ///
    /// # Errors
    /// As for [`Session::look`].
    pub fn wait(&mut self, seconds: f64) -> Result<(), Failure> {
        let mut left_s = seconds;
        while left_s > 0.0 {
            self.look()?;
            self.link.wait(left_s.min(LOOK_S))?;
            left_s -= LOOK_S;
        }
        Ok(())
    }

    /// Waits until `done` gives something.
    fn until<T>(
        &mut self,
        what: &'static str,
        mut done: impl FnMut(&mut Self) -> Result<Option<T>, Failure>,
    ) -> Result<T, Failure> {
        for _ in 0..(PATIENCE_S / LOOK_S) as u32 {
            self.look()?;
            if let Some(value) = done(self)? {
                return Ok(value);
            }
            self.link.wait(LOOK_S)?;
        }
        Err(Failure::Late(what))
    }

    /// Closes the loops.
    ///
    /// # Errors
    /// The drive's refusal, a fault.
    pub fn enable(&mut self) -> Result<(), Failure> {
        self.look()?;
        self.link.order(&Order::Enable)?;
        self.until("Operation enabled", |s| Ok((s.link.status()?.state == State::OperationEnabled).then_some(())))?;
        self.wait(0.2)
    }

    /// Moves and waits for the end of the profile.
    ///
    /// # Errors
    /// The drive's refusal, a fault.
    pub fn move_to(&mut self, target_m: f64, limits: Limits) -> Result<(), Failure> {
        self.link.order(&Order::Move { target_m, limits })?;
        self.rest()
    }

    /// Waits for the end of the profile.
    ///
    /// # Errors
    /// A fault.
    pub fn rest(&mut self) -> Result<(), Failure> {
        self.until("the end of a move", |s| Ok((!s.link.status()?.moving).then_some(())))
    }

    /// Brakes whatever moves, even if the user wishes to end: up to a second.
    ///
    /// # Errors
    /// The drive's refusal, that of the line.
    pub fn brake(&mut self) -> Result<(), Failure> {
        if self.link.status()?.state != State::OperationEnabled {
            return Ok(());
        }
        self.link.order(&Order::Stop)?;
        for _ in 0..(BRAKE_S / LOOK_S) as u32 {
            if !self.link.status()?.moving {
                break;
            }
            self.link.wait(LOOK_S)?;
        }
        Ok(())
    }

    /// Turns the bridge off and waits until it is, and what its force held is at rest.
    ///
    /// # Errors
    /// The drive's refusal, that of the line, a fault; [`Failure::Late`].
    pub fn off(&mut self) -> Result<(), Failure> {
        self.link.order(&Order::Disable)?;
        self.bridge_off()?;
        self.wait(RELEASE_S)
    }

    /// Looks until the bridge is off: up to a second.
    ///
    /// # Errors
    /// That of the line; [`Failure::Late`].
    pub fn bridge_off(&mut self) -> Result<(), Failure> {
        for _ in 0..(BRAKE_S / LOOK_S) as u32 {
            // A fault may brake, with torque.
            let state = self.link.status()?.state;
            if !state.has_torque() && state != State::FaultReactionActive {
                return Ok(());
            }
            self.link.wait(LOOK_S)?;
        }
        Err(Failure::Late("the bridge's turning off"))
    }

    /// Plays an excitation that has to come to its end.
    ///
    /// # Errors
    /// The drive's refusal, a fault; [`Failure::Limit`].
    pub fn measure(&mut self, request: &measure::Request) -> Result<Reading, Failure> {
        self.link.order(&Order::Excite(*request))?;
        self.complete()
    }

    /// Waits for the end of the excitation under way, which has to be its own.
    ///
    /// # Errors
    /// A fault; [`Failure::Limit`].
    pub fn complete(&mut self) -> Result<Reading, Failure> {
        let reading = self.until("the end of an excitation", |s| {
            let reading = s.link.reading()?;
            Ok((reading.progress != Progress::Running).then_some(reading))
        })?;
        match reading.progress {
            Progress::Complete => Ok(reading),
            Progress::Exceeded(limit) => Err(Failure::Limit(limit)),
            _ => Err(Failure::Late("the end of an excitation")),
        }
    }

    /// Captures every `every_ticks`-th of the ticks that follow an order, for `length_s`: from the beginning of an excitation, from the
    /// end of a move.
    ///
    /// # Errors
    /// The drive's refusal, a fault.
    pub fn capture(&mut self, order: &Order, length_s: f64, every_ticks: u32) -> Result<Vec<Sample>, Failure> {
        let names = ["error_ct", "position_low_ct", "force_n"];
        let [error_ct, position_ct, force_n] = self.signals(names, order, length_s, every_ticks)?;
        let count_m = self.settings.encoder_count_m;
        let samples = error_ct
            .into_iter()
            .zip(force_n)
            .zip(from_first(&position_ct))
            .map(|((error_ct, force_n), ct)| Sample { error_m: error_ct * count_m, position_m: ct * count_m, force_n });
        Ok(samples.collect())
    }

    /// [`Session::capture`] of other signals, by their names in [`COLUMNS`](servo_core::record::COLUMNS) and in their units.
    ///
    /// # Errors
    /// The drive's refusal, a fault.
    pub fn signals<const N: usize>(
        &mut self,
        names: [&'static str; N],
        order: &Order,
        length_s: f64,
        every_ticks: u32,
    ) -> Result<[Vec<f64>; N], Failure> {
        let words = Selection::named(names).ok_or(Failure::Missing("one of the signals"))?;
        let captured = self.capture_words(words, order, length_s, every_ticks)?;
        let mut columns = [const { Vec::new() }; N];
        for (values, name) in columns.iter_mut().zip(names) {
            *values = column(&captured, name)?;
        }
        Ok(columns)
    }

    fn capture_words(
        &mut self,
        words: Selection,
        order: &Order,
        length_s: f64,
        every_ticks: u32,
    ) -> Result<Capture, Failure> {
        let trigger = match order {
            Order::Excite(_) => Trigger::Excitation,
            _ => Trigger::MoveEnd,
        };
        self.arm(words, length_s, every_ticks, trigger)?;
        self.link.order(order)?;
        self.captured()
    }

    /// Captures one signal in every tick for `length_s` from now on, in the unit of its name in
    /// [`COLUMNS`](servo_core::record::COLUMNS).
    ///
    /// # Errors
    /// The drive's refusal, a fault.
    pub fn signal(&mut self, name: &'static str, length_s: f64) -> Result<Vec<f64>, Failure> {
        let words = Selection::named([name]).ok_or(Failure::Missing(name))?;
        self.arm(words, length_s, 1, Trigger::Now)?;
        column(&self.captured()?, name)
    }

    fn arm(&mut self, words: Selection, length_s: f64, every_ticks: u32, trigger: Trigger) -> Result<(), Failure> {
        let samples = (length_s * f64::from(SERVO_HZ) / f64::from(every_ticks)).round() as u32;
        self.link.arm(capture::Order { words, samples, before: 0, every_ticks, trigger })
    }

    fn captured(&mut self) -> Result<Capture, Failure> {
        self.until("a capture", |s| s.link.captured())
    }
}

fn column(capture: &Capture, name: &'static str) -> Result<Vec<f64>, Failure> {
    capture.column(name).ok_or(Failure::Missing(name))
}

/// Counts against the first of them; the low word of a position may turn over.
pub fn from_first(position_low_ct: &[f64]) -> impl Iterator<Item = f64> {
    let low = |ct: f64| ct as i64 as u32;
    let first = position_low_ct.first().map_or(0, |ct| low(*ct));
    position_low_ct.iter().map(move |ct| f64::from(low(*ct).wrapping_sub(first) as i32))
}
