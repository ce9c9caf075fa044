//! A simulated drive on a simulated stage, as a link.

use std::sync::atomic::AtomicBool;

use servo_core::SERVO_DT_S;
use servo_core::capture::{self, Capture};
use servo_core::config::Config;
use servo_core::drive::{self, Command};
use servo_core::measure::{self, Reading};
use servo_core::parameters::{Access, Settings, TABLE};
use servo_core::position::Position;
use servo_core::record::{TickRecord, flags};
use servo_core::refusal::Refusal;
use servo_host_tests::{FastBench, tuning};
use servo_sim::Stage;

use super::Failure;
use super::link::{Link, Order, Status};
use super::loops::LIGHTEST_KG;
use crate::link::Capture as Captured;

/// The drive of `servo-core` on the carriage of `servo-sim`, and what is captured.
pub struct Simulated {
    bench: FastBench,
    settings: Settings,
    capture: Capture,
    /// Its ring.
    words: Vec<u32>,
    last: TickRecord,
    /// Parameters of the last save.
    pub saved: Option<Settings>,
}

/// What data sheets say of a stage: motor, encoder, amplifier and travel. Everything else is that of a new drive: nobody has aligned the motor
/// or calibrated sine and cosine, and the encoder's largest jump is that of the lightest mass that is commissioned.
///
/// # Errors
/// A stage that the drive's parameters cannot describe.
pub fn data_sheet(stage: &Stage) -> Result<Settings, Refusal> {
    let mut lightest = *stage;
    lightest.mechanics.mass_kg = LIGHTEST_KG;
    let (known, new) = (tuning::uncalibrated(&lightest, &tuning::STANDARD)?, Settings::default());
    Ok(Settings {
        commutation_offset_m: new.commutation_offset_m,
        commutation_identity: new.commutation_identity,
        position_gain_per_s: new.position_gain_per_s,
        velocity_gain_n_s_per_m: new.velocity_gain_n_s_per_m,
        velocity_integral_per_s: new.velocity_integral_per_s,
        feedforward_mass_kg: new.feedforward_mass_kg,
        niasa_stiffness_n_per_m: new.niasa_stiffness_n_per_m,
        niasa_coulomb_n: new.niasa_coulomb_n,
        niasa_rate_limit_n: new.niasa_rate_limit_n,
        niasa_hysteresis_m: new.niasa_hysteresis_m,
        friction_stiffness_n_per_m: new.friction_stiffness_n_per_m,
        friction_coulomb_n: new.friction_coulomb_n,
        friction_static_n: new.friction_static_n,
        friction_stribeck_m_per_s: new.friction_stribeck_m_per_s,
        friction_damping_n_s_per_m: new.friction_damping_n_s_per_m,
        friction_viscous_n_s_per_m: new.friction_viscous_n_s_per_m,
        disturbance_mass_kg: new.disturbance_mass_kg,
        ..known
    })
}

impl Simulated {
    /// A drive that knows the stage's data sheets, at rest with the bridge off. There is no motor that could be aligned; sine and cosine are
    /// calibrated.
    ///
    /// # Errors
    /// A stage that the drive's parameters cannot describe.
    pub fn new(stage: &Stage, seed: u64) -> Result<Simulated, Refusal> {
        let sheet = data_sheet(stage)?;
        let mut settings = Settings { commutation_identity: sheet.encoder_identity, ..sheet };
        if settings.encoder_kind != 0.0 {
            settings = tuning::calibrated(stage, &settings)?;
        }
        Simulated::with_parameters(stage, &settings, seed)
    }

    /// A drive that starts with these parameters, at rest with the bridge off.
    ///
    /// # Errors
    /// Parameters out of range.
    pub fn with_parameters(stage: &Stage, settings: &Settings, seed: u64) -> Result<Simulated, Refusal> {
        let mut simulated = Simulated {
            bench: FastBench::new(stage, settings, seed)?,
            settings: *settings,
            capture: Capture::default(),
            words: Vec::new(),
            last: TickRecord::default(),
            saved: None,
        };
        for _ in 0..8 {
            simulated.tick(None)?;
        }
        Ok(simulated)
    }

    /// Parameters in use.
    pub fn settings(&self) -> &Settings {
        &self.settings
    }

    /// Whether the bridge is on.
    pub fn bridge_is_on(&self) -> bool {
        self.last.flags & flags::BRIDGE_ON != 0
    }

    /// Whether the stage moves less than a micrometre in a tenth of a second.
    pub fn is_at_rest(&mut self) -> bool {
        let from = self.last.position;
        self.pass(0.1);
        (f64::from(self.last.position.minus(from)) * self.settings.encoder_count_m).abs() < 1e-6
    }

    /// Lets time pass in which nobody asks anything, s.
    pub fn pass(&mut self, seconds: f64) {
        for _ in 0..(seconds / f64::from(SERVO_DT_S)).ceil() as u64 {
            let _ = self.tick(None);
        }
    }

    fn tick(&mut self, command: Option<Command>) -> drive::Outcome {
        let output = self.bench.tick(command);
        self.last = output.record;
        if let Some(sample) = self.capture.step(&output.record) {
            // None from before the trigger is ever asked for: they come in their order.
            self.words.extend(&sample.words[..sample.count as usize]);
        }
        output.outcome.unwrap_or(Ok(()))
    }

    fn counts(&self, position_m: f64) -> Position {
        Position((position_m / self.settings.encoder_count_m).round() as i64)
    }
}

impl Link for Simulated {
    /// There is no chip.
    fn serial(&self) -> String {
        "simulated".to_owned()
    }

    fn configure(&mut self, settings: &Settings) -> Result<(), Failure> {
        let config = Config::new(settings)?;
        let differs = |row: &&servo_core::parameters::Parameter| row.get(settings) != row.get(&self.settings);
        let needs_bridge_off = TABLE.iter().filter(differs).any(|row| row.access == Access::BridgeOff);
        self.tick(Some(Command::Configure { config, needs_bridge_off }))?;
        self.settings = *settings;
        Ok(())
    }

    fn order(&mut self, order: &Order) -> Result<(), Failure> {
        let command = match *order {
            Order::Enable => Command::Enable,
            Order::Disable => Command::Disable,
            Order::Stop => Command::Stop,
            Order::Move { target_m, limits } => Command::Move { target: self.counts(target_m), limits },
            Order::Excite(ref request) => Command::Excite(measure::Order::new(request, self.settings.encoder_count_m)?),
            Order::Compensator(compensator) => Command::Compensator(compensator),
        };
        Ok(self.tick(Some(command))?)
    }

    fn status(&mut self) -> Result<Status, Failure> {
        Ok(Status {
            state: self.bench.drive.state(),
            fault: self.bench.drive.fault(),
            position_m: self.last.position.0 as f64 * self.settings.encoder_count_m,
            moving: self.last.flags & flags::MOVING != 0,
        })
    }

    fn reading(&mut self) -> Result<Reading, Failure> {
        Ok(self.bench.drive.measured())
    }

    fn arm(&mut self, order: capture::Order) -> Result<(), Failure> {
        self.words.clear();
        self.capture.arm(order);
        Ok(())
    }

    fn captured(&mut self) -> Result<Option<Captured>, Failure> {
        match self.capture.progress() {
            capture::Progress::Complete(complete) => Ok(Some(Captured::new(complete, std::mem::take(&mut self.words)))),
            _ => Ok(None),
        }
    }

    /// Whoever waits has just asked something, which is a sign of life.
    fn wait(&mut self, seconds: f64) -> Result<(), Failure> {
        self.tick(Some(Command::KeepAlive))?;
        self.pass(seconds - f64::from(SERVO_DT_S));
        Ok(())
    }

    /// There is no motor whose zero could be unknown: the force is what the drive asks for.
    fn align(&mut self, _: &AtomicBool) -> Result<Settings, Failure> {
        Ok(self.settings)
    }

    fn save(&mut self) -> Result<(), Failure> {
        self.tick(Some(Command::BeginSave))?;
        self.saved = Some(self.settings);
        self.tick(Some(Command::EndSave))?;
        Ok(())
    }
}
