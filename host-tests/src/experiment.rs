//! The settling experiments: moves, five up and five back, on friction that is drawn anew for each.

use servo_core::config::Compensator;
use servo_core::drive::Command;
use servo_core::parameters::Settings;
use servo_core::position::Position;
use servo_core::profile::Limits;
use servo_core::refusal::Refusal;
use servo_core::settling::Settling;
use servo_sim::Stage;

use crate::bench::Bench;

/// A series of equal steps.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Steps {
    /// Length of a step, m.
    pub step_m: f64,
    /// Acceleration, m/s².
    pub acceleration_m_per_s2: f64,
    /// Time given to settle after each profile, s.
    pub dwell_s: f64,
}

/// The first experiment's steps (9.1).
pub const FIVE_MM_SLOW: Steps = Steps { step_m: 5e-3, acceleration_m_per_s2: 1.0, dwell_s: 2.0 };

/// One move of an experiment.
#[derive(Clone, Debug, PartialEq)]
pub struct Move {
    /// How it settled, as the drive saw it.
    pub settling: Settling,
    /// Position error from the end of the profile on, one value per tick, counts.
    pub error_ct: Vec<i32>,
}

impl Steps {
    /// Direction of move `index`: five up, five back.
    pub fn is_forward(index: u64) -> bool {
        index % 10 < 5
    }

    /// Target of move `index` for counts of `count_m`: steps up from `start`, then back down.
    pub fn target(&self, start: Position, index: u64, count_m: f64) -> Position {
        let within = index % 10;
        let steps = if within < 5 { within + 1 } else { 9 - within };
        start.plus((steps as f64 * self.step_m / count_m).round() as i64)
    }

    /// Speed and acceleration: the speed is never the limit.
    pub fn limits(&self, settings: &Settings) -> Limits {
        Limits {
            velocity_m_per_s: settings.velocity_max_m_per_s as f32,
            acceleration_m_per_s2: self.acceleration_m_per_s2 as f32,
            jerk_m_per_s3: None,
        }
    }

    /// Dwell in ticks.
    pub fn dwell_ticks(&self) -> u32 {
        (self.dwell_s * f64::from(servo_core::SERVO_HZ)).round() as u32
    }
}

/// Makes `moves` moves with one drive on one stage.
///
/// # Errors
/// Settings or moves that the drive refuses.
pub fn run(
    stage: &Stage,
    settings: &Settings,
    compensator: Compensator,
    steps: &Steps,
    moves: u64,
    seed: u64,
) -> Result<Vec<Move>, Refusal> {
    let mut bench = Bench::new(stage, settings, seed)?;
    bench.enable()?;
    bench.command(Command::Compensator(compensator))?;
    let count_m = settings.encoder_count_m;
    let start = Position(0);
    // Off mid-travel, to where the series begins.
    (0..moves)
        .map(|index| {
            bench.plant.redraw_friction(index);
            let target = steps.target(start, index, count_m);
            bench.command(Command::Move { target, limits: steps.limits(settings) })?;
            let mut error_ct = Vec::with_capacity(steps.dwell_ticks() as usize);
            while error_ct.len() < steps.dwell_ticks() as usize {
                let record = bench.tick(None).record;
                if record.flags & servo_core::record::flags::MOVING == 0 {
                    error_ct.push(record.error_ct);
                }
            }
            Ok(Move { settling: bench.axis.drive().settling(), error_ct })
        })
        .collect()
}
