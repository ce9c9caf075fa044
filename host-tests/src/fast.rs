//! The drive on the carriage alone: the same tick, no motor.
//!
//! What the thesis' experiments look at happens in the position loop and in the guides. Here the servo tick of `servo-core` and the
//! frames, the friction and the noise of `servo-sim` are those of [`crate::Bench`]; the current loop, the motor and the bridge are
//! one difference equation. A tenth of the time, the same settling (`tests/fast.rs`).

use std::f64::consts::TAU;

use servo_core::config::Config;
use servo_core::current::DUTY_SPAN;
use servo_core::drive::{Command, Drive, Inputs, Outcome, Output};
use servo_core::parameters::Settings;
use servo_core::record::flags;
use servo_core::refusal::Refusal;
use servo_core::state::State;
use servo_core::{PERIODS_PER_TICK, PWM_HZ};
use servo_sim::carriage::Step;
use servo_sim::random::{BEFORE_FIRST_MOVE, Noise, Purpose};
use servo_sim::{Carriage, Stage};

use crate::bench::{TICK_CYCLES, switched_on_at_zero};

/// Internal steps of the carriage in a PWM period: 12.5 µs, ten in a tick.
pub const STEPS_PER_PERIOD: u32 = 2;

/// The drive on the carriage.
#[derive(Clone, Debug)]
pub struct FastBench {
    /// The drive.
    pub drive: Drive,
    /// The truth.
    pub carriage: Carriage,
    current: CurrentLoop,
    step: Step,
    force_constant_n_per_a: f64,
    bus_code: u16,
    temperature_code: u16,
    /// Current at the beginning of the last period.
    measured_a: f64,
    moving: bool,
}

impl FastBench {
    /// A drive with `settings` on `stage`, at rest in mid-travel, bridge off.
    ///
    /// # Errors
    /// Settings out of range.
    pub fn new(stage: &Stage, settings: &Settings, seed: u64) -> Result<Self, Refusal> {
        Ok(FastBench {
            drive: Drive::new(switched_on_at_zero(Config::new(settings)?)),
            carriage: Carriage::new(stage, seed),
            current: CurrentLoop::new(stage, settings, seed),
            step: Step::new(stage, 1.0 / f64::from(PWM_HZ * STEPS_PER_PERIOD)),
            force_constant_n_per_a: stage.motor.force_constant_n_per_a,
            bus_code: (stage.amplifier.bus_v / stage.adc.bus_full_scale_v * 65_536.0) as u16,
            temperature_code: temperature_code(stage),
            measured_a: 0.0,
            moving: false,
        })
    }

    /// One servo period.
    #[inline]
    pub fn tick(&mut self, command: Option<Command>) -> Output {
        self.tick_disturbed(command, 0.0)
    }

    /// One servo period in which what the encoder sends goes through `alter` first.
    pub fn tick_altered(&mut self, command: Option<Command>, alter: impl FnOnce(u64) -> u64) -> Output {
        let frame = alter(self.carriage.encoder_frame());
        self.tick_on(frame, command, 0.0)
    }

    /// One servo period in which `added_a` joins the drive's current set-point: what a measurement of the loop injects.
    #[inline]
    pub fn tick_disturbed(&mut self, command: Option<Command>, added_a: f64) -> Output {
        let frame = self.carriage.encoder_frame();
        self.tick_on(frame, command, added_a)
    }

    #[inline]
    fn tick_on(&mut self, frame: u64, command: Option<Command>, added_a: f64) -> Output {
        let inputs = Inputs {
            frame,
            iq_a: self.measured_a as f32,
            bus_code: self.bus_code,
            temperature_code: self.temperature_code,
            signals: 0,
            last_tick_cycles: TICK_CYCLES,
        };
        let output = self.drive.tick(&inputs, command.as_ref());
        self.moving = output.record.flags & flags::MOVING != 0;
        let demand = output.demand;
        let setpoint_a = f64::from(demand.iq_a) + added_a;
        for _ in 0..PERIODS_PER_TICK {
            let currents_a = if demand.enabled {
                self.current.period(setpoint_a, self.carriage.position_m(), self.carriage.velocity_m_per_s())
            } else {
                self.current.off()
            };
            self.measured_a = currents_a[0];
            let [from_n, to_n] = currents_a.map(|a| a * self.force_constant_n_per_a);
            self.carriage.advance(&self.step, STEPS_PER_PERIOD, from_n, to_n);
        }
        output
    }

    /// Begins a move: [`Carriage::redraw_friction`], and the converters' noise restarted in the same way.
    pub fn redraw(&mut self, move_index: u64) {
        self.carriage.redraw_friction(move_index);
        self.current.noise = Noise::new(self.carriage.seed(), Purpose::PhaseAdc, move_index);
    }

    /// Gives a command in the next tick and returns the answer.
    ///
    /// # Errors
    /// The drive's refusal.
    pub fn command(&mut self, command: Command) -> Outcome {
        self.tick(Some(command)).outcome.unwrap_or(Ok(()))
    }

    /// Whether a profile moves the set-point, as of the last tick.
    pub fn is_moving(&self) -> bool {
        self.moving
    }

    /// Force of the motor at the end of the last period, N.
    pub fn force_n(&self) -> f64 {
        self.current.current_a * self.force_constant_n_per_a
    }

    /// Enables the drive and lets it hold for 0.1 s.
    ///
    /// # Errors
    /// The fault that keeps the drive from Operation enabled, or its refusal.
    pub fn enable(&mut self) -> Outcome {
        for _ in 0..5 {
            self.tick(None);
        }
        let answer = self.command(Command::Enable);
        if answer.is_ok() {
            for _ in 0..800 {
                self.tick(None);
            }
        }
        match (self.drive.fault(), self.drive.state()) {
            (Some(fault), _) => Err(Refusal::FaultPersists(fault)),
            (None, State::OperationEnabled) => answer,
            (None, other) => answer.and(Err(Refusal::WrongState(other))),
        }
    }
}

/// What the converter says of the heat sink.
fn temperature_code(stage: &Stage) -> u16 {
    let (zero_c, full_scale_c) = (stage.adc.temperature_zero_c, stage.adc.temperature_full_scale_c);
    ((stage.amplifier.temperature_c - zero_c) / (full_scale_c - zero_c) * 65_536.0) as u16
}

/// The current loop as the position loop sees it: the q axis alone, without angles, dead time and converters.
///
/// ```text
/// u = clamp(k_p (r − i) + k_i ∫ (r − i))      sampled once per PWM period, on the motor in the next
/// L di/dt = u − R i − e                       a straight line within a period
/// ```
/// While nothing saturates, the controller cancels the winding's pole and the loop is one of first order closed over the drive's
/// delay of one period: `i[k+1] = i[k] + ω_c T (r[k−1] − i[k−1])`. The limit matters where the acceleration steps: 18 N at once
/// would take 65 V.
#[derive(Clone, Debug, PartialEq)]
struct CurrentLoop {
    proportional_v_per_a: f64,
    integral_v_per_a: f64,
    /// What the bridge can give in every direction.
    least_limit_v: f64,
    sextants_per_m: f64,
    commutation_offset_m: f64,
    /// Trapezoidal rule for the winding: `i ← keep · i + gain_a_per_v · (u − e)`.
    keep: f64,
    gain_a_per_v: f64,
    emf_v_s_per_m: f64,
    noise_a_rms: f64,
    noise: Noise,
    current_a: f64,
    integral_v: f64,
    /// Voltage on the motor in this period.
    voltage_v: f64,
}

impl CurrentLoop {
    fn new(stage: &Stage, settings: &Settings, seed: u64) -> Self {
        let (motor, period_s) = (&stage.motor, 1.0 / f64::from(PWM_HZ));
        // Converter noise and rounding of both phases, seen along q, in the mean over all angles.
        let variance_lsb2 = 4.0 / 3.0 * (stage.adc.noise_lsb_rms * stage.adc.noise_lsb_rms + 1.0 / 12.0);
        let omega = TAU * settings.current_bandwidth_hz;
        let half_decay = 0.5 * period_s * motor.resistance_ohm / motor.inductance_h;
        // At the limit there is no room for dead-time compensation: the phase with the highest and that with the lowest voltage lose it.
        let lost_duty = 2.0 * stage.amplifier.dead_time_s / period_s;
        CurrentLoop {
            proportional_v_per_a: settings.phase_inductance_h * omega,
            integral_v_per_a: settings.phase_resistance_ohm * omega * period_s,
            least_limit_v: stage.amplifier.bus_v * (f64::from(DUTY_SPAN) - lost_duty) / libm::sqrt(3.0),
            sextants_per_m: 6.0 / motor.magnet_pitch_m,
            commutation_offset_m: motor.commutation_offset_m,
            keep: (1.0 - half_decay) / (1.0 + half_decay),
            gain_a_per_v: period_s / motor.inductance_h / (1.0 + half_decay),
            emf_v_s_per_m: motor.force_constant_n_per_a / 1.5,
            noise_a_rms: stage.amplifier.full_scale_a / 32_768.0 * libm::sqrt(variance_lsb2),
            noise: Noise::new(seed, Purpose::PhaseAdc, BEFORE_FIRST_MOVE),
            current_a: 0.0,
            integral_v: 0.0,
            voltage_v: 0.0,
        }
    }

    /// One PWM period: the currents at its beginning and at its end, A.
    #[inline]
    fn period(&mut self, setpoint_a: f64, position_m: f64, velocity_m_per_s: f64) -> [f64; 2] {
        let before_a = self.current_a;
        let emf_v = self.emf_v_s_per_m * velocity_m_per_s;
        self.current_a = self.keep * before_a + self.gain_a_per_v * (self.voltage_v - emf_v);
        let error_a = setpoint_a - before_a - self.noise_a_rms * self.noise.normal();
        let increment_v = self.integral_v_per_a * error_a;
        let wanted_v = self.proportional_v_per_a * error_a + self.integral_v + increment_v;
        let limit_v = if wanted_v.abs() > self.least_limit_v { self.limit_v(position_m) } else { self.least_limit_v };
        self.voltage_v = wanted_v.max(-limit_v).min(limit_v);
        if self.voltage_v == wanted_v || increment_v * wanted_v < 0.0 {
            self.integral_v += increment_v;
        }
        [before_a, self.current_a]
    }

    /// Largest voltage along q: the hexagon of the bridge, whose sides face the q axis at angle 0 and every 60° from there.
    #[cold]
    fn limit_v(&self, position_m: f64) -> f64 {
        let sextants = (position_m + self.commutation_offset_m) * self.sextants_per_m;
        self.least_limit_v / libm::cos((sextants - libm::round(sextants)) * (TAU / 6.0))
    }

    /// A period with the bridge off: no current.
    fn off(&mut self) -> [f64; 2] {
        (self.current_a, self.integral_v, self.voltage_v) = (0.0, 0.0, 0.0);
        [0.0; 2]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use servo_core::fault::Fault;

    #[test]
    fn far_from_saturation_the_loop_is_of_first_order_with_one_period_of_delay() {
        let mut stage = Stage::default();
        stage.adc.noise_lsb_rms = 0.0;
        let mut current = CurrentLoop::new(&stage, &Settings::default(), 1);
        current.noise_a_rms = 0.0;
        let gain = TAU * 3000.0 / f64::from(PWM_HZ);
        let (mut expected_a, mut error_a) = (0.0, 0.0);
        for period in 0..40 {
            current.period(1e-3, 0.0, 0.0);
            let before_a = expected_a;
            expected_a += gain * error_a;
            error_a = 1e-3 - before_a;
            // The pole is cancelled to the accuracy of the controller's Euler step: T R / L = 5 %.
            assert!((current.current_a - expected_a).abs() < 0.04e-3, "{period}: {} {expected_a}", current.current_a);
        }
        assert!((current.current_a - 1e-3).abs() < 1e-6);
    }

    #[test]
    fn the_bridge_gives_two_thirds_of_its_voltage_towards_a_corner_and_less_towards_a_side() {
        let current = CurrentLoop::new(&Stage::default(), &Settings::default(), 1);
        let usable_v = 48.0 * (0.90 - 2.0 * 0.02);
        for (position_m, share) in [(0.0, 1.0 / 3f64.sqrt()), (2.5e-3, 2.0 / 3.0), (5e-3, 1.0 / 3f64.sqrt())] {
            assert!((current.limit_v(position_m) / (usable_v * share) - 1.0).abs() < 1e-6, "{position_m} m");
        }
    }

    #[test]
    fn what_keeps_the_drive_from_being_enabled_is_said() {
        let mut stage = Stage::default();
        stage.amplifier.temperature_c = 200.0;
        let mut bench = FastBench::new(&stage, &Settings::default(), 1).unwrap();
        assert_eq!(bench.enable(), Err(Refusal::FaultPersists(Fault::OverTemperature)));
    }

    #[test]
    fn with_the_bridge_off_no_force_is_left() {
        let aligned = Settings { commutation_identity: 0.0, ..Settings::default() };
        let mut bench = FastBench::new(&Stage::default(), &aligned, 1).unwrap();
        bench.enable().unwrap();
        bench.tick_disturbed(None, 1.0);
        assert!(bench.force_n().abs() > 1.0);
        bench.tick(Some(Command::Disable));
        assert_eq!(bench.force_n(), 0.0);
    }
}
