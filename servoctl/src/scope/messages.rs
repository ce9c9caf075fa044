//! What page and server say to each other: JSON texts, one message each.

use serde::{Deserialize, Serialize};
use servo_core::capture::Progress;
use servo_core::compensator::Compensator;
use servo_core::fault::Fault;
use servo_core::parameters::{Access, GROUPS, Settings, TABLE};
use servo_core::settling::TOLERANCES_NM;
use servo_core::{SERVO_HZ, state::State};
use servo_protocol::message::{Identity, Status};

use super::moves::Moved;
use crate::link::Losses;
use crate::settling::SettlingExperiment;

/// What a page sends.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FromPage {
    /// The token that stands in the page's address.
    pub token: String,
    /// The page's number for this message; comes back with the answer.
    pub id: u32,
    /// What is wanted.
    pub action: Action,
}

/// What a page can want. Positions in m, the rest in SI units too.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(tag = "do", rename_all = "snake_case", deny_unknown_fields)]
pub enum Action {
    /// Show me what there is: the first message of a page.
    Hello,
    /// This page commands from now on.
    TakeOver,
    /// Close the loops.
    Enable,
    /// Bridge off.
    Disable,
    /// Acknowledge the fault.
    ClearFault,
    /// Brake to rest and forget the moves still to come. Every page may, whoever commands.
    Stop,
    /// Go somewhere.
    Move(Move),
    /// Choose a compensator by its name.
    Compensator {
        /// See [`Compensator::name`].
        name: String,
    },
    /// Set a parameter.
    Set {
        /// Its id.
        parameter: u16,
        /// Its value, in the unit of the table.
        value: f64,
    },
    /// Store the parameters in use.
    Save,
    /// Use the stored parameters.
    Load,
}

/// One move, or several there and back.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Move {
    /// Target, m; a distance if `relative`.
    pub to_m: f64,
    /// From where the last move went to, or the stage is if there was none.
    pub relative: bool,
    /// Speed, m/s.
    pub velocity_m_per_s: f32,
    /// Acceleration, m/s².
    pub acceleration_m_per_s2: f32,
    /// Jerk, m/s³; none: acceleration steps.
    pub jerk_m_per_s3: Option<f32>,
    /// How many moves, every second one back, `1..=MOST_MOVES`.
    pub count: u32,
    /// How much of the settling is captured, s.
    pub window_s: f64,
}

/// Most moves in one go.
pub const MOST_MOVES: u32 = 1000;

/// What the server sends.
#[derive(Clone, Debug, Serialize)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum ToPage {
    /// Who this page is, and what does not change.
    Welcome {
        /// Number of this page.
        page: u64,
        /// Servo ticks a second.
        servo_hz: u32,
        /// Tolerances of settling, nm, narrowest first.
        tolerances_nm: [u32; TOLERANCES_NM.len()],
        /// Compensators by name.
        compensators: Vec<&'static str>,
        /// Rows of the parameter table.
        table: Vec<Row>,
    },
    /// Who commands.
    Role {
        /// The page that does.
        commander: Option<u64>,
        /// Pages there are.
        pages: usize,
    },
    /// The drive answers, or why it does not.
    Link {
        /// Who it is, while it answers.
        drive: Option<Known>,
        /// What is wrong, if anything.
        trouble: Option<String>,
    },
    /// What the drive is doing.
    Status(Shown),
    /// More of the live traces.
    Live(Live),
    /// Parameters in use, in the order of the table.
    Parameters {
        /// Values.
        values: Vec<f64>,
        /// They differ from the stored ones; `None`: not known.
        unsaved: Option<bool>,
        /// Fingerprint of the values, as `servoctl capture` writes it.
        hash: String,
    },
    /// A captured settling.
    Capture(Trace),
    /// Moves made, oldest first, and what they say.
    Moves {
        /// The last of them.
        last: Vec<Moved>,
        /// Moves like the last one, without and with a compensator.
        settling: Option<SettlingExperiment>,
    },
    /// The answer to a message of this page.
    Answer {
        /// The page's number for it.
        id: u32,
        /// Why it was not done; `None`: done.
        error: Option<String>,
    },
    /// Something that nobody asked for, in words.
    Notice {
        /// The words.
        text: String,
    },
    /// Messages that this page did not get because it was too slow, since it is there.
    Dropped {
        /// How many.
        messages: u64,
    },
}

impl ToPage {
    /// As it goes over the line.
    pub fn to_json(&self) -> String {
        serde_json::to_string(self).expect("plain data with text keys")
    }
}

/// A row of the parameter table.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Row {
    id: u16,
    name: &'static str,
    unit: &'static str,
    min: f64,
    max: f64,
    default: f64,
    /// May change with torque on.
    always: bool,
    doc: &'static str,
    group: &'static str,
}

/// The whole table.
pub fn table() -> Vec<Row> {
    let row = |p: &servo_core::parameters::Parameter| Row {
        id: p.id,
        name: p.name,
        unit: p.unit,
        min: p.min,
        max: p.max,
        default: p.default,
        always: p.access == Access::Always,
        doc: p.doc,
        group: GROUPS.iter().find(|(upper, _)| *upper == p.id >> 8).map_or("", |(_, title)| title),
    };
    TABLE.iter().map(row).collect()
}

/// What never changes while a drive answers.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Known {
    board: String,
    firmware: String,
    serial: String,
    program: String,
    protocol: u16,
    servoctl: &'static str,
    is_virtual: bool,
}

impl Known {
    /// The drive that calls itself `identity`.
    pub fn new(identity: &Identity) -> Self {
        Known {
            board: identity.board.to_string(),
            firmware: identity.firmware.map(|n| n.to_string()).join("."),
            serial: identity.serial.map(|n| format!("{n:08x}")).join("-"),
            program: format!("{:016x}", identity.program),
            protocol: identity.protocol,
            servoctl: env!("CARGO_PKG_VERSION"),
            is_virtual: identity.is_virtual(),
        }
    }
}

/// The drive's status as the page shows it.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Shown {
    /// The drive's own time since the page's server began, s.
    pub time_s: f64,
    state: String,
    torque: bool,
    moving: bool,
    /// Moves still to come, the one under way included.
    moves_left: u32,
    fault: Option<ShownFault>,
    position_m: f64,
    error_m: f64,
    force_n: f32,
    bus_v: f32,
    longest_tick_cycles: u32,
    overruns: u32,
    bad_frames: u32,
    lost_records: u32,
    bad_requests: u32,
    repeated_requests: u64,
    unreadable_replies: u64,
    lost_blocks: u32,
    lost_samples: u64,
    capturing: bool,
}

#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
struct ShownFault {
    number: u16,
    cia402_code: u16,
    title: &'static str,
    cause: &'static str,
    advice: &'static str,
}

impl From<Fault> for ShownFault {
    fn from(fault: Fault) -> Self {
        ShownFault {
            number: fault.number(),
            cia402_code: fault.cia402_code(),
            title: fault.title(),
            cause: fault.cause(),
            advice: fault.advice(),
        }
    }
}

/// What did not get through.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Lost {
    /// On the line.
    pub line: Losses,
    /// Samples of the live traces.
    pub samples: u64,
}

impl Shown {
    /// `status` in the units of people; `time_s` on the drive's clock, `count_m` the length of a count.
    pub fn new(status: &Status, time_s: f64, count_m: f64, moves_left: u32, lost: Lost) -> Self {
        Shown {
            time_s,
            state: status.state.to_string(),
            torque: status.state.has_torque(),
            moving: status.moving,
            moves_left,
            fault: matches!(status.state, State::Fault | State::FaultReactionActive)
                .then(|| status.fault.map(ShownFault::from))
                .flatten(),
            position_m: status.position_ct as f64 * count_m,
            error_m: f64::from(status.error_ct) * count_m,
            force_n: status.force_n,
            bus_v: status.bus_v,
            longest_tick_cycles: status.counters.longest_tick_cycles,
            overruns: status.counters.overruns,
            bad_frames: status.counters.bad_frames,
            lost_records: status.lost_records,
            bad_requests: status.bad_requests,
            repeated_requests: lost.line.repeated,
            unreadable_replies: lost.line.unreadable,
            lost_blocks: status.lost_blocks,
            lost_samples: lost.samples,
            capturing: matches!(status.capture, Progress::Armed | Progress::Running(_)),
        }
    }
}

/// Samples of the live traces: columns of equal length, in the order of time.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Live {
    /// As in [`Shown`].
    pub time_s: Vec<f64>,
    /// Set-point − position, nm.
    pub error_nm: Vec<f64>,
    /// Position, m.
    pub position_m: Vec<f64>,
    /// Force, N.
    pub force_n: Vec<f32>,
}

/// A capture: what happened around the end of a move's profile.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Trace {
    /// Number of the move.
    pub number: u32,
    /// Compensator by name.
    pub compensator: &'static str,
    /// Time between two samples, s.
    pub sample_s: f64,
    /// Samples before the end of the profile.
    pub before: u32,
    /// Target of the move, m.
    pub target_m: f64,
    /// Set-point − position, nm.
    pub error_nm: Vec<f64>,
    /// Position, relative to the target, nm.
    pub position_nm: Vec<f64>,
    /// Force, N.
    pub force_n: Vec<f32>,
}

/// The compensator that is chosen in `settings`.
pub fn compensator(settings: &Settings) -> Compensator {
    // A value of the table is a whole number in range, or the drive would not have taken it.
    Compensator::ALL.get(settings.compensator as usize).copied().unwrap_or_default()
}

/// Duration of `ticks`, s.
pub fn seconds(ticks: u32) -> f64 {
    f64::from(ticks) / f64::from(SERVO_HZ)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_a_page_sends_is_read() {
        let read = |text: &str| serde_json::from_str::<FromPage>(text).map(|message| message.action).ok();
        assert_eq!(read(r#"{"token":"t","id":1,"action":{"do":"stop"}}"#), Some(Action::Stop));
        assert_eq!(
            read(r#"{"token":"t","id":1,"action":{"do":"set","parameter":1281,"value":1}}"#),
            Some(Action::Set { parameter: 1281, value: 1.0 })
        );
        let text = r#"{"token":"t","id":1,"action":{"do":"move","to_m":0.001,"relative":true,"velocity_m_per_s":0.1,
            "acceleration_m_per_s2":1,"jerk_m_per_s3":null,"count":1,"window_s":0.5}}"#;
        assert!(matches!(read(text), Some(Action::Move(Move { relative: true, count: 1, .. }))));
        for wrong in [
            r#"{"id":1,"action":{"do":"stop"}}"#,
            r#"{"token":"t","id":1,"action":{"do":"fly"}}"#,
            r#"{"token":"t","id":1,"action":{"do":"set","parameter":99999,"value":1}}"#,
            r#"{"token":"t","id":1,"action":{"do":"set","parameter":1}}"#,
            "stop",
        ] {
            assert_eq!(read(wrong), None, "{wrong}");
        }
    }

    #[test]
    fn the_compensator_is_the_one_of_the_parameter() {
        for (index, expected) in Compensator::ALL.into_iter().enumerate() {
            let settings = Settings { compensator: index as f64, ..Settings::default() };
            assert_eq!(compensator(&settings), expected);
        }
    }
}
