//! The thread that owns the drive: carries out orders, looks at the drive fifty times a second, sees moves through.

use std::sync::Arc;
use std::sync::mpsc::{Receiver, RecvTimeoutError};
use std::time::{Duration, Instant};

use servo_core::SERVO_HZ;
use servo_core::capture::{self, Complete, Progress, Trigger};
use servo_core::compensator::Compensator;
use servo_core::parameters::{Parameter, Settings, TABLE};
use servo_core::profile::Limits;
use servo_core::record::Selection;
use servo_core::refusal::Refusal;
use servo_protocol::message::{Request, Status};
use servo_protocol::stream::{self, Tally};

use super::hub::{Hub, Order, Wake};
use super::messages::{Action, Known, Live, Lost, MOST_MOVES, Move, Shown, ToPage, Trace, compensator, seconds};
use super::moves::{Kind, Moves};
use crate::cli::drive::Connected;
use crate::cli::drive::record_file::parameter_hash;
use crate::cli::drive::settled::Report;
use crate::link::{Capture, Drive, Error};

/// How a drive is reached, again after a link broke.
pub type Connect = Box<dyn FnMut() -> anyhow::Result<Connected> + Send>;

/// Time between two looks at the drive.
const LOOK: Duration = Duration::from_millis(20);
/// Time between two attempts to reach a drive that does not answer.
const RECONNECT: Duration = Duration::from_secs(1);
/// How long capture memory is read before the drive is looked at again.
const READ: Duration = Duration::from_millis(15);
/// Most samples of a capture from the end of the profile on: what fits a page, at 8 kHz half a second.
const SAMPLES: u32 = 4000;
/// As many samples before it as this share of those after it.
const BEFORE: u32 = 10;
/// Live traces: 500 samples a second.
const LIVE: stream::Order = stream::Order { words: Selection::ERROR_POSITION_FORCE, every_ticks: 16 };

/// Works until the hub ends.
pub fn run(hub: &Arc<Hub>, orders: &Receiver<Wake>, mut connect: Connect) {
    let mut moves = Moves::default();
    while !hub.ends() {
        let trouble = match connect() {
            Ok(connected) => Pilot::new(hub, connected, &mut moves).fly(orders).err().map(|error| words(&error)),
            Err(error) => Some(one_line(&format!("{error:#}"))),
        };
        if let Some(trouble) = trouble {
            let trouble = format!("{trouble}; trying again");
            hub.publish(&ToPage::Link { drive: None, trouble: Some(trouble.clone()) });
            pause(hub, orders, &trouble);
        }
    }
}

/// Waits for a while and refuses what is ordered meanwhile.
fn pause(hub: &Hub, orders: &Receiver<Wake>, trouble: &str) {
    let until = Instant::now() + RECONNECT;
    while !hub.ends() {
        match orders.recv_timeout(until.saturating_duration_since(Instant::now())) {
            Ok(Wake::Order { order, .. }) => order.answer(Err(trouble.to_owned())),
            Ok(Wake::Look) => {}
            Err(_) => return,
        }
    }
}

struct Pilot<'a> {
    hub: &'a Hub,
    drive: Drive,
    moves: &'a mut Moves,
    settings: Settings,
    /// Counts up whenever a parameter other than the choice of the compensator is changed.
    changes: u32,
    last_tick: Option<u32>,
    time_s: f64,
    status: Option<Status>,
    tally: Tally,
    /// Where the last move went to.
    target_ct: Option<i64>,
    course: Option<Course>,
}

/// Moves under way.
struct Course {
    limits: Limits,
    order: capture::Order,
    /// The one under way included.
    left: u32,
    target_ct: i64,
    by_ct: i64,
    moving: bool,
    /// Words of the capture that have been read.
    captured: Vec<u32>,
    /// There is, or will be, a capture to read.
    capture: bool,
}

impl<'a> Pilot<'a> {
    fn new(hub: &'a Hub, connected: Connected, moves: &'a mut Moves) -> Self {
        Pilot {
            hub,
            drive: connected.drive,
            moves,
            settings: Settings::default(),
            changes: 0,
            last_tick: None,
            time_s: 0.0,
            status: None,
            tally: Tally::default(),
            target_ct: None,
            course: None,
        }
    }

    /// Until the hub ends.
    ///
    /// # Errors
    /// The link is gone.
    fn fly(&mut self, orders: &Receiver<Wake>) -> Result<(), Error> {
        let known = Known::new(self.drive.identity());
        self.hub.publish(&ToPage::Link { drive: Some(known), trouble: None });
        self.begin()?;
        loop {
            let next = Instant::now() + LOOK;
            self.look()?;
            loop {
                if self.hub.ends() {
                    return self.stop(true);
                }
                if self.hub.take_stop() {
                    self.stop(false)?;
                }
                if self.hub.take_left() {
                    self.stop(true)?;
                }
                match orders.recv_timeout(next.saturating_duration_since(Instant::now())) {
                    Ok(Wake::Order { order, stops }) if self.hub.is_stopped(stops) => {
                        order.answer(Err("not carried out: a stop came first".to_owned()));
                    }
                    Ok(Wake::Order { order, .. }) => self.carry_out(&order)?,
                    Ok(Wake::Look) => {}
                    Err(RecvTimeoutError::Timeout) => break,
                    Err(RecvTimeoutError::Disconnected) => return self.stop(true),
                }
            }
        }
    }

    /// What a drive that has just started must be asked.
    fn begin(&mut self) -> Result<(), Error> {
        self.tally = Tally::default();
        match self.drive.stream(LIVE) {
            // Without live traces there is still everything else.
            Err(error) if !is_fatal(&error) => self.notice(&words(&error)),
            other => other?,
        }
        self.read_parameters()
    }

    /// Tells the pages what the stream has brought.
    fn live(&mut self, status: &Status) {
        let count_m = self.settings.encoder_count_m;
        let mut live = Live::default();
        for block in self.drive.blocks() {
            self.tally.count(&LIVE, &block);
            for (index, words) in block.samples(LIVE.words).enumerate() {
                let tick = block.first_tick.wrapping_add(index as u32 * u32::from(LIVE.every_ticks));
                let mut words = words;
                let [position, error, force] = std::array::from_fn(|_| words.next().unwrap_or_default());
                // The low 32 bits: those of a position near the one of the status.
                let from_status_ct = position.wrapping_sub(status.position_ct as u32) as i32;
                let behind_ticks = status.tick.wrapping_sub(tick) as i32;
                live.time_s.push(self.time_s - f64::from(behind_ticks) / f64::from(SERVO_HZ));
                live.position_m.push((status.position_ct + i64::from(from_status_ct)) as f64 * count_m);
                let error_ct = if status.state.has_torque() { error as i32 } else { 0 };
                live.error_nm.push(nm(error_ct, count_m));
                live.force_n.push(f32::from_bits(force));
            }
        }
        if !live.time_s.is_empty() {
            self.hub.publish(&ToPage::Live(live));
        }
    }

    fn read_parameters(&mut self) -> Result<(), Error> {
        self.settings = self.drive.parameters()?;
        let values: Vec<f64> = TABLE.iter().map(|row| row.get(&self.settings)).collect();
        let unsaved = Some(self.drive.parameter_store()?.unsaved);
        let hash = format!("{:016x}", parameter_hash(&self.settings));
        self.hub.publish(&ToPage::Parameters { values, unsaved, hash });
        Ok(())
    }

    /// Asks the drive how it is, tells the pages, and sees moves through.
    fn look(&mut self) -> Result<(), Error> {
        let status = match self.drive.status() {
            Err(Error::Interrupted { .. }) => {
                self.course = None;
                self.last_tick = None;
                self.notice("the drive was restarted");
                return self.begin();
            }
            status => status?,
        };
        self.time_s += seconds(status.tick.wrapping_sub(self.last_tick.unwrap_or(status.tick)));
        self.last_tick = Some(status.tick);
        self.status = Some(status);
        if !status.state.has_torque() {
            self.target_ct = None;
            if self.course.take().is_some() {
                self.notice("the bridge is off: the move was given up");
            }
        }
        let left = self.course.as_ref().map_or(0, |course| course.left);
        self.live(&status);
        let lost = Lost { line: self.drive.client().losses(), samples: self.tally.lost_samples };
        let shown = Shown::new(&status, self.time_s, self.settings.encoder_count_m, left, lost);
        self.hub.publish(&ToPage::Status(shown));
        match self.see_through(&status) {
            Err(error) if !is_fatal(&error) => {
                self.course = None;
                self.notice(&words(&error));
                Ok(())
            }
            other => other,
        }
    }

    /// One step of the moves under way.
    fn see_through(&mut self, status: &Status) -> Result<(), Error> {
        let Some(course) = &mut self.course else { return Ok(()) };
        course.moving &= status.moving;
        if course.moving {
            return Ok(());
        }
        let settling = self.drive.settling()?;
        let complete = match status.capture {
            Progress::Complete(complete) if course.capture => Some(complete),
            _ => None,
        };
        let total = course.order.samples as usize * course.order.words.count();
        let until = Instant::now() + READ;
        while complete.is_some() && course.captured.len() < total && Instant::now() < until {
            course.captured.extend(self.drive.read_words(course.captured.len())?);
        }
        let read = !course.capture || course.captured.len() >= total;
        if !read || !Report::is_ready(&settling) {
            return Ok(());
        }
        let Some(course) = self.course.take() else { return Ok(()) };
        let count_m = self.settings.encoder_count_m;
        let chosen = compensator(&self.settings);
        let kind = Kind { distance_ct: course.by_ct.unsigned_abs(), limits: course.limits, parameters: self.changes };
        if let Some(complete) = complete {
            self.hub.publish(&ToPage::Capture(trace(&course, complete, self.moves.next_number(), chosen, count_m)));
        }
        self.moves.add(course.by_ct, kind, chosen, &settling, count_m);
        let last = self.moves.last().cloned().collect();
        self.hub.publish(&ToPage::Moves { last, settling: self.moves.settling() });
        if course.left > 1 {
            self.set_off(course.target_ct - course.by_ct, -course.by_ct, course.limits, course.order, course.left - 1)?;
        }
        Ok(())
    }

    /// Carries an order out and answers it.
    ///
    /// # Errors
    /// The link is gone; the order is answered nevertheless.
    fn carry_out(&mut self, order: &Order) -> Result<(), Error> {
        let result = match &order.action {
            Action::Enable => self.drive.enable().map(|_| ()),
            Action::Disable => self.drive.order(&Request::Disable).map(|_| ()),
            Action::ClearFault => self.drive.order(&Request::ResetFault).map(|_| ()),
            Action::Move(wanted) => match self.plan(wanted) {
                Ok((target_ct, by_ct, limits, capture)) => {
                    self.set_off(target_ct, by_ct, limits, capture, wanted.count)
                }
                Err(reason) => {
                    order.answer(Err(reason));
                    return Ok(());
                }
            },
            Action::Compensator { name } => match Compensator::ALL.into_iter().find(|c| c.name() == name) {
                Some(chosen) => self.drive.order(&Request::Compensator(chosen)).and_then(|_| self.read_parameters()),
                None => {
                    order.answer(Err(format!("there is no compensator {name}")));
                    return Ok(());
                }
            },
            Action::Set { parameter, value } => self.set(*parameter, *value),
            Action::Save => self.drive.save_parameters().and_then(|_| self.read_parameters()),
            Action::Load => self.drive.order(&Request::LoadParameters).and_then(|_| {
                self.changes += 1;
                self.read_parameters()
            }),
            // The server's own business.
            Action::Hello | Action::TakeOver | Action::Stop => Ok(()),
        };
        order.answer(result.as_ref().map(|_| ()).map_err(words));
        match result {
            Err(error) if is_fatal(&error) => Err(error),
            _ => Ok(()),
        }
    }

    fn set(&mut self, id: u16, value: f64) -> Result<(), Error> {
        self.drive.set_parameters(&[(id, value)])?;
        if Parameter::by_id(id).is_some_and(|row| row.name != "compensator") {
            self.changes += 1;
        }
        self.read_parameters()
    }

    /// Target and distance (counts), limits and capture of a move that a page wants.
    fn plan(&self, wanted: &Move) -> Result<(i64, i64, Limits, capture::Order), String> {
        let at_ct = match (self.target_ct, &self.status) {
            (Some(target_ct), _) => target_ct,
            (None, Some(status)) => status.position_ct,
            (None, None) => return Err("the drive has not said where it is".to_owned()),
        };
        let within = |name: &str, value: f64, min: f64, max: f64, unit: &str| {
            let ok = value >= min && value <= max;
            if ok { Ok(value) } else { Err(format!("{name} = {value}{unit} is outside {min} … {max}{unit}")) }
        };
        within("number of moves", f64::from(wanted.count), 1.0, f64::from(MOST_MOVES), "")?;
        // The drive refuses what is outside its travel; this is what fits its integers.
        let distance_ct =
            (within("target", wanted.to_m, -10.0, 10.0, " m")? / self.settings.encoder_count_m).round() as i64;
        let longest_s = seconds(SAMPLES * 80);
        let window_s = within("window", wanted.window_s, 0.001, longest_s, " s")?;
        let ticks = (window_s * f64::from(SERVO_HZ)).round() as u32;
        let every_ticks = ticks.div_ceil(SAMPLES);
        let limits = Limits {
            velocity_m_per_s: wanted.velocity_m_per_s,
            acceleration_m_per_s2: wanted.acceleration_m_per_s2,
            jerk_m_per_s3: wanted.jerk_m_per_s3,
        };
        let target_ct = if wanted.relative { at_ct + distance_ct } else { distance_ct };
        let (words, trigger) = (Selection::ERROR_POSITION_FORCE, Trigger::MoveEnd);
        let before = ticks / every_ticks / BEFORE;
        let order = capture::Order { words, samples: before + ticks / every_ticks, before, every_ticks, trigger };
        Ok((target_ct, target_ct - at_ct, limits, order))
    }

    /// Begins a move, `left` more of which are to come with it, there and back.
    fn set_off(
        &mut self,
        target_ct: i64,
        by_ct: i64,
        limits: Limits,
        order: capture::Order,
        left: u32,
    ) -> Result<(), Error> {
        // The order is for the next profile that ends: while one runs the drive refuses the move, and its capture goes on.
        let rest = self.course.as_ref().is_none_or(|course| !course.moving);
        let capture = rest && self.drive.arm_capture(order).is_ok();
        self.drive.order(&Request::Move { target_ct, limits })?;
        self.target_ct = Some(target_ct);
        self.course =
            Some(Course { limits, order, left, target_ct, by_ct, moving: true, captured: Vec::new(), capture });
        Ok(())
    }

    /// Brakes to rest and forgets the moves to come; `only_motion`: nothing to do if nothing moves.
    fn stop(&mut self, only_motion: bool) -> Result<(), Error> {
        let moves = self.course.is_some() || self.status.is_some_and(|status| status.moving);
        self.course = None;
        self.target_ct = None;
        if only_motion && !moves {
            return Ok(());
        }
        match self.drive.order(&Request::Stop) {
            // Without torque nothing moves.
            Ok(_) | Err(Error::Refused { .. }) => Ok(()),
            Err(error) => Err(error),
        }
    }

    fn notice(&self, text: &str) {
        self.hub.publish(&ToPage::Notice { text: text.to_owned() });
    }
}

fn trace(course: &Course, complete: Complete, number: u32, compensator: Compensator, count_m: f64) -> Trace {
    let capture = Capture::new(complete, course.captured.clone());
    let column = |name: &str| capture.column(name).unwrap_or_default();
    // Counts are whole numbers of 32 bits, as a difference of such positions is.
    let from_target_ct = |ct: f64| (ct as i32).wrapping_sub(course.target_ct as i32);
    Trace {
        number,
        compensator: compensator.name(),
        sample_s: seconds(course.order.every_ticks),
        before: complete.before,
        target_m: course.target_ct as f64 * count_m,
        error_nm: column("error_ct").iter().map(|ct| nm(*ct as i32, count_m)).collect(),
        position_nm: column("position_low_ct").iter().map(|ct| nm(from_target_ct(*ct), count_m)).collect(),
        force_n: column("force_n").iter().map(|force_n| *force_n as f32).collect(),
    }
}

/// To the picometre, which no encoder resolves.
fn nm(counts: i32, count_m: f64) -> f64 {
    (f64::from(counts) * count_m * 1e12).round() / 1e3
}

/// After this there is nobody to talk to.
fn is_fatal(error: &Error) -> bool {
    matches!(error, Error::Open { .. } | Error::Broken(_) | Error::NoReply { .. } | Error::Protocol { .. })
}

/// What went wrong, for somebody who has buttons and no prompt.
fn words(error: &Error) -> String {
    match error {
        Error::Refused { refusal, .. } => {
            let help = match refusal {
                Refusal::WrongState(state) if state.has_torque() => ": disable the drive first",
                Refusal::WrongState(servo_core::state::State::Fault) => ": clear the fault first",
                Refusal::WrongState(_) => ": enable the drive first",
                _ => "",
            };
            format!("{refusal}{help}")
        }
        Error::Interrupted { what, why, .. } => format!("{what}: {why}"),
        other => one_line(&other.to_string()),
    }
}

fn one_line(text: &str) -> String {
    text.replace("\n  ", "; ")
}
