//! From an unknown stage to a tuned axis that settles with NIASA, in steps that each say what they found or why they refuse.
//!
//! A step is a function over a [`Session`]; what it finds goes into [`Found`], plain data that can be written down and gone on with.
//! However the steps end, the bridge is turned off; [`Failure::StillOn`] if the drive did not say that it is. A drive that hears nothing any
//! more turns it off by itself: its command time-out is [`SILENCE_S`] at most while the steps are done, and the user's own afterwards.
//!
//! | step | from | to |
//! |---|---|---|
//! | [`Step::Offsets`] | bridge off | offset of the current |
//! | [`Step::Alignment`] | a motor that nobody has aligned | its electrical zero |
//! | [`Step::Safety`] | cautious gains | noise, and that a force moves the stage its way |
//! | [`Step::Plant`] | tones on a slow move | plant, mass, resonances |
//! | [`Step::Tuning`] | plant | gains; margins over amplitudes |
//! | [`Step::LengthScale`] | a step | where friction begins to rule (5.3) |
//! | [`Step::Friction`] | identification profiles | σ, F_C, which model (6.2) |
//! | [`Step::Niasa`] | friction, noise | NIASA's parameters (8.1) |
//! | [`Step::Verification`] | moves | settling with and without NIASA |
//! | [`Step::Save`] | | parameters stored |

mod friction;
mod link;
mod loops;
mod on_line;
pub mod page;
mod simulated;
pub mod stages;
mod summary;
pub mod sweep;
mod verification;

use std::collections::BTreeMap;
use std::sync::atomic::AtomicBool;

use serde::{Deserialize, Serialize};
use servo_core::config::Compensator;
use servo_core::fault::Fault;
use servo_core::measure::Exceeded;
use servo_core::parameters::{Parameter, Settings, TABLE};
use servo_core::refusal::Refusal;
use servo_ident::DataError;
use servo_ident::frf::{Point, Resonance, SecondOrder};
use servo_ident::length_scale::Extreme;
use servo_ident::tuning::{Niasa, Pid, STANDARD, Stability, Wish};

pub use friction::ProfileFit;
pub use link::{Link, Order, SILENCE_S, Sample, Session, Status, from_first};
pub use loops::{CROSSOVER_HZ, PHASE_MARGIN_DEG};
pub use on_line::OnLine;
pub use simulated::{Simulated, data_sheet};
pub use summary::{Many, Summary};
pub use verification::{LEAST_GAIN, Settled, TOLERANCE_NM};

/// Why commissioning ended.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum Failure {
    /// The drive refused an order.
    #[error("the drive refused: {0}")]
    Refused(#[from] Refusal),
    /// What was measured cannot be used.
    #[error("{0}")]
    Data(#[from] DataError),
    /// The drive is in a fault.
    #[error("fault: {}", .0.explanation())]
    Fault(Fault),
    /// An excitation met a limit.
    #[error("the excitation met its limit of {}", limit_name(*.0))]
    Limit(Exceeded),
    /// A finding is not what it has to be.
    #[error("{what} = {value} is outside {min} … {max}: {why}")]
    Unfit {
        /// What, with its unit.
        what: &'static str,
        /// Its value.
        value: f64,
        /// Lowest accepted value.
        min: f64,
        /// Highest accepted value.
        max: f64,
        /// What it means.
        why: &'static str,
    },
    /// Sine and cosine are those of a new drive.
    #[error("sine and cosine: `servoctl calibrate-encoder` first")]
    Uncalibrated,
    /// An earlier step's finding is missing.
    #[error("{0} is not known: begin with the step that finds it")]
    Missing(&'static str),
    /// It took too long.
    #[error("{0} did not come in time")]
    Late(&'static str),
    /// The user wished it to end.
    #[error("ended by the user")]
    Stopped,
    /// What was found belongs to another drive.
    #[error(
        "what was found is of the drive with serial number {found}, this one has {this}: begin anew, without --from"
    )]
    OtherDrive {
        /// The drive that it was found on.
        found: String,
        /// The one that is connected.
        this: String,
    },
    /// The line failed.
    #[error("{0}")]
    Line(String),
    /// Commissioning ended, and the drive did not say that its bridge is off.
    #[error("{why}; whether the bridge is off is NOT known: {off}; {}", by_itself(*.silence_s))]
    StillOn {
        /// What ended it.
        why: Box<Failure>,
        /// Why nobody knows.
        off: Box<Failure>,
        /// The drive's command time-out (s), 0: never.
        silence_s: f64,
    },
}

impl Failure {
    /// Whether the bridge is known to be off after it has ended [`run`].
    pub fn bridge_is_off(&self) -> bool {
        !matches!(self, Failure::StillOn { .. })
    }
}

/// What a drive does that hears nothing for `silence_s`.
fn by_itself(silence_s: f64) -> String {
    if silence_s > 0.0 {
        format!(
            "without a word for {silence_s} s the drive turns it off by itself (fault 19); `servoctl params load` then brings back what was saved"
        )
    } else {
        "by itself the drive leaves it as it is: its command_timeout_s is 0".to_owned()
    }
}

fn limit_name(limit: Exceeded) -> &'static str {
    match limit {
        Exceeded::Travel => "travel",
        Exceeded::Speed => "speed",
        Exceeded::Current => "current",
    }
}

/// `Ok(value)` within `min` to `max`, else why not.
fn fit(what: &'static str, value: f64, min: f64, max: f64, why: &'static str) -> Result<f64, Failure> {
    if (min..=max).contains(&value) { Ok(value) } else { Err(Failure::Unfit { what, value, min, max, why }) }
}

/// The steps, in their order.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "kebab-case")]
pub enum Step {
    /// Offset of the current, bridge off.
    Offsets,
    /// Electrical zero of the motor, if the drive does not know it.
    Alignment,
    /// Noise at rest; a force moves the stage its way.
    Safety,
    /// Plant, mass, resonances.
    Plant,
    /// Gains, and margins over amplitudes.
    Tuning,
    /// Where friction begins to rule.
    LengthScale,
    /// σ and F_C at several places.
    Friction,
    /// NIASA's parameters.
    Niasa,
    /// Moves with and without NIASA.
    Verification,
    /// Parameters stored.
    Save,
}

impl Step {
    /// All of them.
    pub const ALL: [Step; 10] = [
        Step::Offsets,
        Step::Alignment,
        Step::Safety,
        Step::Plant,
        Step::Tuning,
        Step::LengthScale,
        Step::Friction,
        Step::Niasa,
        Step::Verification,
        Step::Save,
    ];

    /// As it is typed.
    pub fn name(self) -> String {
        clap::ValueEnum::to_possible_value(&self).map_or_else(String::new, |value| value.get_name().to_owned())
    }

    /// What it does, for a person.
    pub fn purpose(self) -> &'static str {
        match self {
            Step::Offsets => "offset of the current, bridge off",
            Step::Alignment => "electrical zero of the motor, if the drive does not know it",
            Step::Safety => "noise at rest, and a small force that has to move the stage its way",
            Step::Plant => "plant by stepped sine on a slow move",
            Step::Tuning => "gains for the wanted loop, then its margins at large and small amplitudes",
            Step::LengthScale => "where friction begins to rule, from the extremes after a step",
            Step::Friction => "friction by decaying sines at several places",
            Step::Niasa => "parameters of NIASA",
            Step::Verification => "5 mm moves with and without NIASA",
            Step::Save => "parameters stored in the drive",
        }
    }

    /// Why it may refuse, for a person.
    pub fn refuses_if(self) -> &'static str {
        match self {
            Step::Offsets => {
                "sine and cosine are not calibrated, or the offset is more than 1 % of the converter's range"
            }
            Step::Alignment => "phases, encoder or stage are not as they have to be: the drive says which",
            Step::Safety => "the noise is above 100 nm, or the stage does not move the way of the force",
            Step::Plant => "travel, speed or current leave their bounds, or what moves is no mass",
            Step::Tuning => {
                "no gains give the wanted loop, or at some amplitude the phase margin is below 30° or the gain margin below 6 dB"
            }
            Step::LengthScale => "the closed loop is not near one of second order",
            Step::Friction => {
                "the stage does not move far enough, the data are not good enough, or the result cannot be friction of guides"
            }
            Step::Niasa => "a value is outside the parameter's range",
            Step::Verification => {
                "a move does not settle with NIASA, the axis is not at rest, or NIASA saves less than 60 % of the settling time"
            }
            Step::Save => "the verification was not passed, or the flash fails",
        }
    }

    fn run(self, session: &mut Session, found: &mut Found, wish: &Wish) -> Result<String, Failure> {
        match self {
            Step::Offsets => loops::offsets(session, found),
            Step::Alignment => loops::alignment(session, found),
            Step::Safety => loops::safety(session, found),
            Step::Plant => loops::plant(session, found),
            Step::Tuning => loops::tuning(session, found, wish),
            Step::LengthScale => friction::length_scale(session, found),
            Step::Friction => friction::friction(session, found),
            Step::Niasa => friction::niasa(session, found),
            Step::Verification => verification::verification(session, found),
            Step::Save => save(session, found),
        }
    }
}

/// Everything found so far; each step fills in its own.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Found {
    /// The drive that it was found on: its chip's serial number.
    pub drive: Option<String>,
    /// Steps done, with what each says.
    pub done: Vec<(Step, String)>,
    /// The step that ended the last run, and why; nothing if all were done.
    pub ended: Option<(Step, String)>,
    /// Offset of the current (A).
    pub current_offset_a: Option<f64>,
    /// The electrical zero that was looked for (m); nothing if the drive knew it.
    pub electrical_zero_m: Option<f64>,
    /// Noise of the position (m rms).
    pub noise_m: Option<f64>,
    /// Plant: position over force (m/N).
    pub plant: Vec<Point>,
    /// Mass (kg).
    pub mass_kg: Option<f64>,
    /// Resonances of the plant.
    pub resonances: Vec<Resonance>,
    /// The loop that was wished for.
    pub wish: Option<Wish>,
    /// Gains.
    pub gains: Option<Pid>,
    /// Loop transmission at each amplitude (N), largest first.
    pub loops: Vec<(f64, Vec<Point>)>,
    /// Their margins.
    pub family: Vec<Stability>,
    /// The closed loop at the largest amplitude as one of second order (5.2).
    pub closed_loop: Option<SecondOrder>,
    /// Extremes after the step that looks for the length scale.
    pub extremes: Vec<Extreme>,
    /// Where friction begins to rule (m); nothing if the step showed none.
    pub length_scale_m: Option<f64>,
    /// Friction at each place.
    pub profiles: Vec<ProfileFit>,
    /// Whether Maxwell slip describes friction so much better than Dahl's model that it is needed, at most of the places.
    pub needs_maxwell: Option<bool>,
    /// σ, the median of the places (N/m).
    pub sigma_n_per_m: Option<f64>,
    /// F_C, the median of the places (N).
    pub coulomb_n: Option<f64>,
    /// Parameters of NIASA.
    pub niasa: Option<Niasa>,
    /// Settling without and with NIASA.
    pub settled: Option<[Settled; 2]>,
    /// Parameters in use after the last step that was done.
    pub parameters: BTreeMap<String, f64>,
}

impl Found {
    /// Settling time with NIASA, as a share less than without (0 to 1).
    pub fn gain(&self) -> Option<f64> {
        self.settled.as_ref().map(|[without, with]| 1.0 - with.mean_ms / without.mean_ms)
    }

    /// Forgets what `from` and the steps after it find; the parameters stay, to begin with.
    pub fn forget(&mut self, from: Step) {
        self.done.retain(|(step, _)| *step < from);
        let known = std::mem::take(self);
        let before = |step: Step| step < from;
        *self = Found { drive: known.drive, done: known.done, parameters: known.parameters, ..Found::default() };
        if before(Step::Offsets) {
            self.current_offset_a = known.current_offset_a;
        }
        if before(Step::Alignment) {
            self.electrical_zero_m = known.electrical_zero_m;
        }
        if before(Step::Safety) {
            self.noise_m = known.noise_m;
        }
        if before(Step::Plant) {
            (self.plant, self.mass_kg, self.resonances) = (known.plant, known.mass_kg, known.resonances);
        }
        if before(Step::Tuning) {
            (self.wish, self.gains) = (known.wish, known.gains);
            (self.loops, self.family) = (known.loops, known.family);
        }
        if before(Step::LengthScale) {
            (self.closed_loop, self.extremes) = (known.closed_loop, known.extremes);
            self.length_scale_m = known.length_scale_m;
        }
        if before(Step::Friction) {
            (self.profiles, self.needs_maxwell) = (known.profiles, known.needs_maxwell);
            (self.sigma_n_per_m, self.coulomb_n) = (known.sigma_n_per_m, known.coulomb_n);
        }
        if before(Step::Niasa) {
            self.niasa = known.niasa;
        }
        if before(Step::Verification) {
            self.settled = known.settled;
        }
    }

    /// `base` with the parameters written down.
    ///
    /// # Errors
    /// A value out of range.
    pub fn settings(&self, base: &Settings) -> Result<Settings, Refusal> {
        let mut settings = *base;
        for (name, value) in &self.parameters {
            if let Some(parameter) = Parameter::by_name(name) {
                parameter.set(&mut settings, *value)?;
            }
        }
        Ok(settings)
    }
}

/// What is to be done.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Plan {
    /// Parameters to begin with.
    pub settings: Settings,
    /// The loop that is wanted.
    pub wish: Wish,
    /// The first step.
    pub from: Step,
}

impl Plan {
    /// All steps, to the thesis' standard tuning.
    pub fn new(settings: Settings) -> Plan {
        Plan { settings, wish: STANDARD, from: Step::Offsets }
    }
}

/// What is told on the way.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Event<'a> {
    /// A step begins.
    Begins(Step),
    /// So many parts of what is under way are done, of so many.
    Done(u32, u32),
    /// A step has ended: what it found, or why it refuses.
    Ended(Step, &'a Result<String, Failure>),
}

/// Does the steps of `plan`; `said` is told of each. However it ends, the bridge is turned off.
///
/// # Errors
/// Which step ended it, and why; [`Failure::StillOn`] if the drive did not say that the bridge is off.
pub fn run(
    link: &mut dyn Link,
    plan: &Plan,
    found: &mut Found,
    stop: &AtomicBool,
    said: &mut dyn FnMut(Event),
) -> Result<(), (Step, Failure)> {
    let mut session = Session { link, stop, settings: plan.settings, silence_s: plan.settings.command_timeout_s, said };
    found.ended = None;
    let result = begin(&mut session, found, plan.from).map_err(|failure| (plan.from, failure)).and_then(|()| {
        for step in Step::ALL.into_iter().filter(|step| *step >= plan.from) {
            (session.said)(Event::Begins(step));
            let result = step.run(&mut session, found, &plan.wish);
            (session.said)(Event::Ended(step, &result));
            let words = result.map_err(|failure| (step, failure))?;
            found.done.push((step, words));
            found.parameters = TABLE.iter().map(|row| (row.name.to_owned(), row.get(&session.settings))).collect();
        }
        Ok(())
    });
    let result = end(&mut session, result);
    found.ended = result.as_ref().err().map(|(step, failure)| (*step, failure.to_string()));
    result
}

/// Brakes what moves, then turns the bridge off and looks whether it is, even if the drive took neither order; then the command time-out is
/// the user's own again. `result` with what came of it.
fn end(session: &mut Session, result: Result<(), (Step, Failure)>) -> Result<(), (Step, Failure)> {
    let ordered = [session.brake(), session.link.order(&Order::Disable)];
    let off = session.bridge_off();
    let result = result.and(ordered.into_iter().collect::<Result<(), _>>().map_err(|failure| (Step::Save, failure)));
    let Err(off) = off else { return result.and(session.leave().map_err(|failure| (Step::Save, failure))) };
    let (step, why) = result.err().unwrap_or_else(|| (Step::Save, off.clone()));
    Err((step, Failure::StillOn { why: Box::new(why), off: Box::new(off), silence_s: session.silence_s }))
}

/// Takes up what is written down of this drive, without what is to be found again; what is measured is measured without a compensator.
fn begin(session: &mut Session, found: &mut Found, from: Step) -> Result<(), Failure> {
    let this = session.link.serial();
    if let Some(other) = found.drive.as_ref().filter(|other| **other != this) {
        return Err(Failure::OtherDrive { found: other.clone(), this });
    }
    found.drive = Some(this);
    found.forget(from);
    let mut settings = found.settings(&session.settings)?;
    if from <= Step::Verification {
        settings.compensator = f64::from(Compensator::None as u8);
    }
    session.configure(settings)
}

/// Stores the parameters, if they have passed the verification: bridge off first.
fn save(session: &mut Session, found: &Found) -> Result<String, Failure> {
    if found.settled.is_none() || found.done.iter().all(|(step, _)| *step != Step::Verification) {
        return Err(Failure::Missing("a verification that was passed"));
    }
    session.off()?;
    session.leave()?;
    session.link.save()?;
    Ok("stored".to_owned())
}
