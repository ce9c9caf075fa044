//! The thread that owns the drive: carries out orders, looks at the drive fifty times a second, sees moves through.

use std::sync::Arc;
use std::sync::mpsc::{Receiver, RecvTimeoutError};
use std::time::{Duration, Instant};

use servo_core::SERVO_HZ;
use servo_core::capture;
use servo_core::compensator::Compensator;
use servo_core::parameters::{Parameter, Settings, TABLE};
use servo_core::profile::Limits;
use servo_core::refusal::Refusal;
use servo_protocol::message::{Request, Status};

use super::hub::{Hub, Order, Wake};
use super::messages::{Action, Known, MOST_MOVES, Move, Shown, ToPage, Trace, compensator, seconds};
use super::moves::{Kind, Moves};
use crate::cli::drive::Connected;
use crate::cli::drive::capture::parameter_hash;
use crate::cli::drive::settled::is_known;
use crate::link::{Captured, Drive, Error};

/// How a drive is reached, again after a link broke.
pub type Connect = Box<dyn FnMut() -> anyhow::Result<Connected> + Send>;

/// Time between two looks at the drive.
const LOOK: Duration = Duration::from_millis(20);
/// Time between two attempts to reach a drive that does not answer.
const RECONNECT: Duration = Duration::from_secs(1);
/// How long capture memory is read before the drive is looked at again.
const READ: Duration = Duration::from_millis(15);
/// Samples of a capture: what fits a page, at 8 kHz half a second.
const SAMPLES: u32 = 4000;

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
            Ok(Wake::Order(order)) => order.answer(Err(trouble.to_owned())),
            Ok(Wake::Look) => {}
            Err(_) => return,
        }
    }
}

struct Pilot<'a> {
    hub: &'a Hub,
    drive: Drive,
    is_virtual: bool,
    moves: &'a mut Moves,
    settings: Settings,
    /// Counts up whenever a parameter other than the choice of the compensator is changed.
    changes: u32,
    last_tick: Option<u32>,
    time_s: f64,
    status: Option<Status>,
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
    captured: Vec<Captured>,
    /// There is, or will be, a capture to read.
    capture: bool,
}

impl<'a> Pilot<'a> {
    fn new(hub: &'a Hub, connected: Connected, moves: &'a mut Moves) -> Self {
        Pilot {
            hub,
            drive: connected.drive,
            is_virtual: connected.is_virtual,
            moves,
            settings: Settings::default(),
            changes: 0,
            last_tick: None,
            time_s: 0.0,
            status: None,
            target_ct: None,
            course: None,
        }
    }

    /// Until the hub ends.
    ///
    /// # Errors
    /// The link is gone.
    fn fly(&mut self, orders: &Receiver<Wake>) -> Result<(), Error> {
        let known = Known::new(self.drive.identity(), self.is_virtual);
        self.hub.publish(&ToPage::Link { drive: Some(known), trouble: None });
        self.read_parameters()?;
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
                    Ok(Wake::Order(order)) => self.carry_out(&order)?,
                    Ok(Wake::Look) => {}
                    Err(RecvTimeoutError::Timeout) => break,
                    Err(RecvTimeoutError::Disconnected) => return self.stop(true),
                }
            }
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
                return self.read_parameters();
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
        let losses = self.drive.client().losses();
        let shown = Shown::new(&status, self.time_s, self.settings.encoder_count_m, left, losses);
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
        if course.capture && matches!(status.capture, capture::Progress::Complete(_)) {
            let until = Instant::now() + READ;
            while course.captured.len() < course.order.samples as usize && Instant::now() < until {
                course.captured.extend(self.drive.read_captured(course.captured.len() as u32)?);
            }
        }
        let read = !course.capture || course.captured.len() >= course.order.samples as usize;
        if !read || !is_known(&settling) {
            return Ok(());
        }
        let Some(course) = self.course.take() else { return Ok(()) };
        let count_m = self.settings.encoder_count_m;
        let chosen = compensator(&self.settings);
        let kind = Kind { distance_ct: course.by_ct.unsigned_abs(), limits: course.limits, parameters: self.changes };
        if course.capture {
            self.hub.publish(&ToPage::Capture(trace(&course, self.moves.next_number(), chosen, count_m)));
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
        Ok((target_ct, target_ct - at_ct, limits, capture::Order { samples: ticks / every_ticks, every_ticks }))
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

fn trace(course: &Course, number: u32, compensator: Compensator, count_m: f64) -> Trace {
    let nm = |counts: i32| (f64::from(counts) * count_m * 1e12).round() / 1e3;
    let samples = &course.captured;
    Trace {
        number,
        compensator: compensator.name(),
        sample_s: seconds(course.order.every_ticks),
        target_m: course.target_ct as f64 * count_m,
        error_nm: samples.iter().map(|s| nm(s.error_ct)).collect(),
        position_nm: samples.iter().map(|s| nm(s.position_ct.wrapping_sub(course.target_ct as u32) as i32)).collect(),
        force_n: samples.iter().map(|s| s.force_n).collect(),
    }
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
