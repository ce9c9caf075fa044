//! Requests and replies.
//!
//! The order of the variants is the wire format: [`Request::Identity`] and [`Reply::Identity`] never change, a request that is new at the
//! end disturbs nobody, and any other change raises [`PROTOCOL`]. [`crate::endpoint::ENDPOINTS`] says of every request what answers it and whether it may be repeated.

use heapless::{String, Vec};
use serde::{Deserialize, Serialize};
use servo_core::capture::{Order, Progress};
use servo_core::cascade::ParallelGains;
use servo_core::config::Compensator;
use servo_core::drive::Counters;
use servo_core::fault::Fault;
use servo_core::image::Invalid;
use servo_core::measure::{self, Reading};
use servo_core::profile::Limits;
use servo_core::record::{TickRecord, flags};
use servo_core::refusal::Refusal;
use servo_core::settling::Settling;
use servo_core::state::{ControlWord, State};
use servo_core::store::Current;

use crate::stream::{self, Block};

/// Number of this version of the messages.
pub const PROTOCOL: u16 = 4;

/// Words in one block of capture data.
pub const BLOCK_WORDS: usize = 90;

/// Parameters in one request.
pub const PARAMETERS_PER_REQUEST: usize = 16;

/// Parameters in one reply.
pub const PARAMETERS_PER_REPLY: usize = 40;

/// What the host asks.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[expect(clippy::large_enum_variant, reason = "there is no allocator to box with")]
pub enum Request {
    /// Who are you? Answered by every version: [`Reply::Identity`].
    Identity,
    /// [`Reply::Status`].
    Status,
    /// Close the loops at the present position.
    Enable,
    /// Bridge off.
    Disable,
    /// Acknowledge a fault.
    ResetFault,
    /// Move to a position.
    Move {
        /// Target, counts.
        target_ct: i64,
        /// Speed and acceleration.
        limits: Limits,
    },
    /// Brake to rest.
    Stop,
    /// Choose the compensator.
    Compensator(Compensator),
    /// Set the cascade from gains of the parallel form.
    Gains(ParallelGains),
    /// Set parameters by id, all or none.
    SetParameters(Vec<(u16, f64), PARAMETERS_PER_REQUEST>),
    /// [`Reply::Parameter`].
    GetParameter(u16),
    /// How the last move settled: [`Reply::Settling`].
    Settling,
    /// Order a capture.
    Capture(Order),
    /// Read captured words from this index on: [`Reply::Capture`].
    ReadCapture {
        /// Index of the first word.
        first: u32,
    },
    /// Read parameters in the order of their ids: [`Reply::Parameters`].
    ReadParameters {
        /// Lowest id wanted.
        first: u16,
    },
    /// Begin to store the parameters in use; [`Request::ParameterStore`] tells how it goes on.
    SaveParameters,
    /// Use the stored parameters.
    LoadParameters,
    /// Use the parameters of a new drive.
    ResetParameters,
    /// [`Reply::ParameterStore`].
    ParameterStore,
    /// Start the firmware anew; refused with torque on.
    Restart,
    /// Begin a stream in place of the one under way: [`Reply::Block`]s with the number of this request, behind its answer.
    Stream(stream::Order),
    /// Read words of the black box from this index on: [`Reply::BlackBox`]. They stay what they are while it is sealed and the bridge
    /// is off (see [`crate::black_box`]).
    ReadBlackBox {
        /// Index of the first word.
        first: u32,
    },
    /// Play an excitation, in place of one under way; [`Request::Excitation`] tells how it goes on.
    Excite(measure::Request),
    /// What the excitation under way, or the last one, has found: [`Reply::Excitation`].
    Excitation,
    /// Look for the motor's electrical zero; the bridge is off when it has ended. What is found becomes a parameter, what fails a fault.
    Align,
    /// Collect sine and cosine from now on, while the stage moves; refused with another encoder.
    CollectSignals,
    /// Correct sine and cosine by the ellipse that fits what has been collected. What is found becomes a parameter; the position changes
    /// by what the error was.
    CorrectSignals,
    /// The controlword of CiA 402 (object 6040), for masters that walk through the states themselves.
    Control(ControlWord),
}

/// What the drive answers.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum Reply {
    /// To [`Request::Identity`].
    Identity(Identity),
    /// Done.
    Done {
        /// The servo tick that carried it out: a [`Status`] of this tick or a later one shows its effect.
        tick: u32,
    },
    /// Not done, and why.
    Refused(Refusal),
    /// To [`Request::Status`].
    Status(Status),
    /// To [`Request::GetParameter`].
    Parameter {
        /// Its id.
        id: u16,
        /// Its value, in the unit of the table.
        value: f64,
    },
    /// To [`Request::Settling`].
    Settling(Settling),
    /// To [`Request::ReadCapture`]: words of a complete capture's ring, up to a block.
    Capture {
        /// Index of the first word.
        first: u32,
        /// The words: samples of as many words as were ordered, the oldest one where [`Progress`] says.
        words: Vec<u32, BLOCK_WORDS>,
    },
    /// To [`Request::ReadParameters`]: ids and values, up to [`PARAMETERS_PER_REPLY`]; fewer are the last.
    Parameters(Vec<(u16, f64), PARAMETERS_PER_REPLY>),
    /// To [`Request::ParameterStore`].
    ParameterStore(ParameterStore),
    /// Some samples of a stream.
    Block(Block),
    /// To [`Request::ReadBlackBox`]: a block, shorter at the end of the [`crate::black_box::WORDS`] words, then empty.
    BlackBox {
        /// Index of the first word.
        first: u32,
        /// The words.
        words: Vec<u32, BLOCK_WORDS>,
    },
    /// To [`Request::Excitation`].
    Excitation {
        /// The reading is of this servo tick: one before the order's is that of an earlier excitation.
        tick: u32,
        /// What has been found.
        reading: Reading,
    },
}

/// Who the drive is. Frozen: every protocol has this message in this form.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Identity {
    /// [`PROTOCOL`] of the firmware.
    pub protocol: u16,
    /// Firmware version: major, minor, patch.
    pub firmware: [u16; 3],
    /// Fingerprint of the program in flash, see [`servo_core::fingerprint`]: tells which ELF the log is to be decoded with.
    pub program: u64,
    /// Name of the board.
    pub board: String<32>,
    /// The chip's serial number.
    pub serial: [u32; 3],
}

/// Serial number of a virtual board's chip. Where a real one has its production lot, seven ASCII characters, it says `VIRTUAL`.
pub const VIRTUAL_SERIAL: [u32; 3] = [0, u32::from_le_bytes(*b"\0VIR"), u32::from_le_bytes(*b"TUAL")];

impl Identity {
    /// Whether the chip's lot is that of [`VIRTUAL_SERIAL`]: board, motor and stage are simulated, whatever line leads there.
    pub fn is_virtual(&self) -> bool {
        // The lowest byte is the number of the wafer.
        [self.serial[1] & !0xff, self.serial[2]] == VIRTUAL_SERIAL[1..]
    }
}

/// What is stored, and how the last save went.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct ParameterStore {
    /// The newest image.
    pub image: Option<Current>,
    /// Why, at start, sector A and sector B gave no parameters.
    pub invalid: Option<[Invalid; 2]>,
    /// Parameters in use differ from the stored ones, or nothing valid is stored.
    pub unsaved: bool,
    /// The last save.
    pub save: SaveProgress,
}

/// How far a save is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum SaveProgress {
    /// There was none since start.
    #[default]
    None,
    /// In progress: steps done.
    Running {
        /// Of [`Save::STEPS`](servo_core::store::Save::STEPS); the first one takes nearly all the time.
        done: u16,
    },
    /// Complete and read back.
    Done,
    /// The flash failed; the parameters stored before are still there.
    Failed,
}

/// What the drive is doing.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Status {
    /// Everything here is of this servo tick or a later one.
    pub tick: u32,
    /// Power state.
    pub state: State,
    /// First fault since the last reset.
    pub fault: Option<Fault>,
    /// A profile moves the reference.
    pub moving: bool,
    /// Measured position, counts.
    pub position_ct: i64,
    /// Set-point − position, counts.
    pub error_ct: i32,
    /// Force, N.
    pub force_n: f32,
    /// Bus voltage, V.
    pub bus_v: f32,
    /// Counts since start.
    pub counters: Counters,
    /// Where the capture stands.
    pub capture: Progress,
    /// Frames from the host that could not be read.
    pub bad_requests: u32,
    /// Tick records that no task took in time.
    pub lost_records: u32,
    /// Blocks of streams that found the line busy.
    pub lost_blocks: u32,
    /// Health of an encoder with sine and cosine: estimated sub-divisional error, peak, m, over the last motion; `None` before enough of
    /// it, and with another encoder. See [`servo_core::encoder::sincos::Interpolator::error_periods`].
    pub subdivisional_error_m: Option<f32>,
    /// The statusword of CiA 402 (object 6041), bits as in [`servo_core::state::status`].
    pub status_word: u16,
    /// What else is true of the tick, the limits that act among it: bits of [`flags`].
    pub flags: u16,
}

impl Status {
    /// Of the tick of `record`, with what the drive tells besides; nothing lost on the way and no health of the encoder, which are the
    /// caller's to add.
    pub fn of(record: &TickRecord, status_word: u16, counters: Counters, capture: Progress) -> Self {
        Status {
            tick: record.sequence,
            state: record.state,
            fault: record.fault,
            moving: record.flags & flags::MOVING != 0,
            position_ct: record.position.0,
            error_ct: record.error_ct,
            force_n: record.force_n,
            bus_v: record.bus_v,
            counters,
            capture,
            bad_requests: 0,
            lost_records: 0,
            lost_blocks: 0,
            subdivisional_error_m: None,
            status_word,
            flags: record.flags,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_virtual_board_is_known_by_the_lot_of_its_chip() {
        let of = |serial| Identity { protocol: 0, firmware: [0; 3], program: 0, board: String::new(), serial };
        assert!(of(VIRTUAL_SERIAL).is_virtual());
        assert!(of([0x0021_0017, VIRTUAL_SERIAL[1] | 0x19, VIRTUAL_SERIAL[2]]).is_virtual());
        // Wafer 0x28, lot `3133511` of a chip on a NUCLEO, and no serial number at all.
        let lot = [u32::from_le_bytes([0x28, b'3', b'1', b'3']), u32::from_le_bytes(*b"3511")];
        assert!(!of([0x0021_0017, lot[0], lot[1]]).is_virtual() && !of([0; 3]).is_virtual());
    }
}
