//! What the drive is told in the recorded run: enough to pass through every branch that a move, a refusal, a change of
//! configuration or a fault takes.

use servo_core::capture::{Order, Trigger};
use servo_core::config::{Compensator, Config};
use servo_core::drive::Command;
use servo_core::encoder::sincos;
use servo_core::math;
use servo_core::parameters::Settings;
use servo_core::position::Position;
use servo_core::profile::Limits;
use servo_core::record::Selection;
use servo_core::refusal::Refusal;

/// Servo ticks of the run.
pub const TICKS: u32 = 5_600;

/// Before this tick the drive is switched off and on with another encoder, one with sine and cosine: [`sin_cos_config`], [`signals`].
pub const SIN_COS_TICK: u32 = 4_830;

/// In this tick, before its command, [`CAPTURE`] is ordered.
pub const CAPTURE_TICK: u32 = 99;

/// The captured samples: from the end of the first profile on.
pub const CAPTURE: Order = Order {
    words: Selection::ERROR_POSITION_FORCE,
    samples: 500,
    before: 0,
    every_ticks: 2,
    trigger: Trigger::MoveEnd,
};

/// 5 mm in counts of 61.035 pm.
pub const FIVE_MM: Position = Position(81_920_000);

/// The first move: a triangle of 141 ms.
pub const LIMITS: Limits = Limits { velocity_m_per_s: 0.5, acceleration_m_per_s2: 1.0, jerk_m_per_s3: None };

const HOME: Position = Position(0);

/// Settings at the start: those of a new drive whose motor has been aligned.
pub fn settings() -> Settings {
    Settings { commutation_identity: 0.0, ..Settings::default() }
}

/// The command of a tick, if there is one.
///
/// # Errors
/// Settings that the drive refuses.
pub fn command(tick: u32) -> Result<Option<Command>, Refusal> {
    let fed_forward = Settings { feedforward_mass_kg: 1.8, ..settings() };
    let compensated = Settings { compensator: 1.0, ..fed_forward };
    let always = Settings { niasa_frozen_in_profile: 0.0, niasa_with_proportional: 0.0, ..compensated };
    // Little current: what the stage gains from stuck frames it has lost when the drive is enabled again.
    let retuned = Settings { current_bandwidth_hz: 2_000.0, current_limit_a: 0.2, ..compensated };
    Ok(Some(match tick {
        3 => go(FIVE_MM, 0.5, 1.0), // refused: bridge off
        4 => Command::Stop,
        10 => Command::Enable,
        60 => go(Position(1 << 40), 0.5, 1.0), // refused: beyond the travel
        61 => go(FIVE_MM, 0.5, f32::NAN),      // refused
        100 => Command::Move { target: FIVE_MM, limits: LIMITS },
        500 => go(HOME, 0.5, 1.0), // refused: moving
        900 => configure(&fed_forward, false)?,
        1_700 => Command::Compensator(Compensator::Niasa),
        1_800 => go(HOME, 0.1, 10.0), // a trapezoid, 60 ms
        2_900 => Command::Compensator(Compensator::None),
        2_950 => Command::Compensator(Compensator::Niasa),
        3_000 => configure(&always, false)?,
        3_010 => go(Position(819_200), 0.5, 1.0),
        3_400 => configure(&compensated, false)?,
        3_410 => go(FIVE_MM, 0.5, 10.0),
        3_500 => Command::Stop,
        3_800 => configure(&retuned, true)?, // refused: bridge on
        3_910 => Command::Enable,            // refused: three bad frames at 3,900
        3_920 => Command::ResetFault,
        3_930 => Command::Enable,
        4_020 => Command::ResetFault, // over-current at 4,000
        4_030 => configure(&retuned, true)?,
        4_040 => Command::Enable,
        4_160 => Command::ResetFault, // under-voltage at 4,150
        4_170 => Command::Enable,
        4_300 => go(HOME, 0.02, 10.0),
        4_600 => Command::ResetFault, // frames stuck from 4,310 on
        4_610 => Command::Enable,
        // Every compensator in turn, each with a short move of its own.
        4_620..4_790 if tick.is_multiple_of(20) => {
            Command::Compensator(Compensator::ALL[(tick as usize - 4_620) / 20 % 8])
        }
        4_620..4_790 if tick % 20 == 1 => go(Position(if tick % 40 == 1 { 16_340_000 } else { 16_356_384 }), 0.5, 10.0),
        4_800 => Command::Disable,
        4_840 => Command::Enable,
        4_860 => go(Position(819_200), 0.97e-3, 10.0), // 50 µm in 52 ms: all of the signal period, a dozen times
        5_400 => go(HOME, 0.5, 10.0),
        _ => return Ok(None),
    }))
}

/// What the drive is started with at [`SIN_COS_TICK`]: as if it had been aligned since.
///
/// # Errors
/// Settings that the drive refuses.
pub fn sin_cos_config() -> Result<Config, Refusal> {
    let settings = Settings { encoder_kind: 1.0, compensator: 1.0, feedforward_mass_kg: 1.8, ..settings() };
    Ok(Config { commutation_stored: true, ..Config::new(&settings)? })
}

/// What an encoder with sine and cosine tells at a position: a little out of true, so that the drive has something to learn.
pub fn signals(position: Position) -> sincos::Sample {
    let turns = (position.0 & 0xffff) as f32 / sincos::PERIOD_CT as f32;
    let (sin, cos) = math::sin_cos_turns(turns);
    let code = |share: f32| (32_768.0 + 24_576.0 * share) as u16;
    sincos::Sample { sin: code(1.01 * sin - 0.01), cos: code(cos + 0.01), edges: (position.0 >> 14) as u16 }
}

fn go(target: Position, velocity_m_per_s: f32, acceleration_m_per_s2: f32) -> Command {
    Command::Move { target, limits: Limits { velocity_m_per_s, acceleration_m_per_s2, jerk_m_per_s3: None } }
}

fn configure(settings: &Settings, needs_bridge_off: bool) -> Result<Command, Refusal> {
    Ok(Command::Configure { config: Config::new(settings)?, needs_bridge_off })
}
