//! Settings that fit a stage.

use std::f64::consts::TAU;

use servo_core::cascade::{CascadeGains, ParallelGains};
use servo_core::drive::Command;
use servo_core::parameters::Settings;
use servo_core::position::Position;
use servo_core::profile::Limits;
use servo_core::refusal::Refusal;
use servo_core::{PWM_HZ, SERVO_HZ};
use servo_sim::Stage;
use servo_sim::stage::encoder::Kind;

use crate::FastBench;

/// What a position loop is tuned for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tuning {
    /// Crossover frequency of the loop transmission on the free mass, Hz.
    pub crossover_hz: f64,
    /// Phase margin there, degrees.
    pub phase_margin_deg: f64,
    /// Integral gain over the small-signal contact stiffness 2σ, 1/s: how fast the linear integral alone creeps to the target
    /// inside the pre-rolling regime.
    pub creep_per_s: f64,
    /// Acceleration feedforward as a share of the stage's mass: 0 none, 1 exact.
    pub feedforward: f64,
}

/// The first experiment's: 100 Hz, 45°, no feedforward (9.1).
pub const STANDARD: Tuning =
    Tuning { crossover_hz: 100.0, phase_margin_deg: 45.0, creep_per_s: 0.92, feedforward: 0.0 };

/// The second experiment's: 315 Hz, 50°, acceleration feedforward (9.2).
pub const HIGH_PERFORMANCE: Tuning =
    Tuning { crossover_hz: 315.0, phase_margin_deg: 50.0, creep_per_s: 11.5, feedforward: 1.0 };

/// Delay from a position sample to the middle of the servo period that acts on it, s: one PWM period of computation and half
/// a servo period of hold.
const DELAY_S: f64 = 1.0 / PWM_HZ as f64 + 0.5 / SERVO_HZ as f64;

impl Tuning {
    /// Gains for a free mass behind a first-order current loop of `current_bandwidth_hz` and the drive's delay.
    ///
    /// `|C(jω)|·|P(jω)| = 1` and the phase margin give two equations for k_P and k_D; k_I follows from `stiffness_n_per_m` (σ), at
    /// most what a cascade can have.
    pub fn gains(&self, mass_kg: f64, stiffness_n_per_m: f64, current_bandwidth_hz: f64) -> ParallelGains {
        let omega = TAU * self.crossover_hz;
        // The difference that makes the D part is half a sample older than the position that makes the P part.
        let difference_phase = 0.5 * omega / f64::from(SERVO_HZ);
        let lag = omega * DELAY_S + libm::atan2(self.crossover_hz, current_bandwidth_hz);
        let loss = libm::hypot(1.0, self.crossover_hz / current_bandwidth_hz);
        let (size, phase) = (mass_kg * omega * omega * loss, self.phase_margin_deg.to_radians() + lag);
        // C = k_P − j k_I/ω + k_D·jω·e^(−j·difference_phase) = size·e^(j·phase)
        let wanted_ki = self.creep_per_s * 2.0 * stiffness_n_per_m;
        let kd = (size * libm::sin(phase) + wanted_ki / omega) / (omega * libm::cos(difference_phase));
        let kp = size * libm::cos(phase) - kd * omega * libm::sin(difference_phase);
        let possible_ki = 0.999 * kp * kp / (4.0 * kd);
        ParallelGains { kp_n_per_m: kp, ki_n_per_m_s: wanted_ki.min(possible_ki), kd_n_s_per_m: kd }
    }
}

/// Friction estimates that a careful person would give NIASA for this stage: the thesis' 4 N/µm for a mean of 8.66 N/µm and 0.6 N
/// for 0.64 N (8.1.1), scaled to the stage's nominal values.
pub fn conservative_friction(stage: &Stage) -> (f64, f64) {
    (stage.friction.stiffness_n_per_m * (4.0 / 8.66), stage.friction.coulomb_n * (0.6 / 0.64))
}

/// Settings for a stage: its motor, encoder and friction as they are, the motor aligned, the position loop by `tuning`, NIASA ready
/// (τ_d 10 ms) but off. Sine and cosine are calibrated on a move.
///
/// # Errors
/// A stage that the drive's parameters cannot describe.
pub fn settings(stage: &Stage, tuning: &Tuning) -> Result<Settings, Refusal> {
    let settings = uncalibrated(stage, tuning)?;
    if settings.encoder_kind == 0.0 { Ok(settings) } else { calibrated(stage, &settings) }
}

/// Settings with sine and cosine as they are found on a move of 0.1 mm.
///
/// # Errors
/// Settings that the drive refuses, or signals that cannot be corrected.
pub fn calibrated(stage: &Stage, settings: &Settings) -> Result<Settings, Refusal> {
    let mut bench = FastBench::new(stage, settings, 0)?;
    bench.enable()?;
    bench.command(Command::CollectSignals)?;
    let limits = Limits { velocity_m_per_s: 0.97e-3, acceleration_m_per_s2: 0.1, jerk_m_per_s3: None };
    bench.command(Command::Move { target: Position((1e-4 / settings.encoder_count_m) as i64), limits })?;
    for _ in 0..SERVO_HZ / 8 {
        bench.tick(None);
    }
    let fit = bench.drive.signal_fit().ok_or(Refusal::NoSignals)?;
    Ok(settings.with_signals(&fit.solve().map_err(Refusal::Signals)?))
}

/// [`settings`] with sine and cosine of the stage's amplitude and otherwise as they should be.
///
/// # Errors
/// A stage that the drive's parameters cannot describe.
pub fn uncalibrated(stage: &Stage, tuning: &Tuning) -> Result<Settings, Refusal> {
    let defaults = Settings::default();
    let gains = tuning.gains(stage.mechanics.mass_kg, stage.friction.stiffness_n_per_m, defaults.current_bandwidth_hz);
    let cascade = CascadeGains::from_parallel(gains)?;
    let amplitude = match stage.encoder.kind {
        Kind::BissC { .. } => None,
        Kind::SinCos(signals) => Some(signals.amplitude),
    };
    let (stiffness, coulomb) = conservative_friction(stage);
    let settings = Settings {
        encoder_count_m: stage.encoder.count_m,
        encoder_kind: if amplitude.is_some() { 1.0 } else { 0.0 },
        sincos_amplitude: amplitude.unwrap_or(defaults.sincos_amplitude),
        magnet_pitch_m: stage.motor.magnet_pitch_m,
        commutation_offset_m: stage.motor.commutation_offset_m,
        commutation_identity: defaults.encoder_identity,
        force_constant_n_per_a: stage.motor.force_constant_n_per_a,
        phase_resistance_ohm: stage.motor.resistance_ohm,
        phase_inductance_h: stage.motor.inductance_h,
        current_full_scale_a: stage.amplifier.full_scale_a,
        current_limit_a: 0.8 * stage.amplifier.full_scale_a,
        over_current_a: 0.95 * stage.amplifier.full_scale_a,
        dead_time_s: stage.amplifier.dead_time_s,
        dead_time_band_a: stage.amplifier.dead_time_band_a,
        bus_full_scale_v: stage.adc.bus_full_scale_v,
        bus_min_v: 0.5 * stage.amplifier.bus_v,
        bus_max_v: 1.25 * stage.amplifier.bus_v,
        temperature_zero_c: stage.adc.temperature_zero_c,
        temperature_full_scale_c: stage.adc.temperature_full_scale_c,
        continuous_current_a: 0.4 * stage.amplifier.full_scale_a,
        // Twice what the largest current does to the mass in a tick.
        encoder_jump_m: (2.0 * 0.8 * stage.amplifier.full_scale_a * stage.motor.force_constant_n_per_a
            / stage.mechanics.mass_kg
            / f64::from(SERVO_HZ * SERVO_HZ))
        .max(defaults.encoder_jump_m),
        // Without noise, what is at rest reads the same for ever.
        encoder_frozen_ticks: if stage.encoder.noise_m_rms > 2.0 * stage.encoder.count_m
            && stage.adc.noise_lsb_rms > 0.5
        {
            80.0
        } else {
            0.0
        },
        position_gain_per_s: cascade.position_per_s,
        velocity_gain_n_s_per_m: cascade.velocity_n_s_per_m,
        velocity_integral_per_s: cascade.integral_per_s,
        feedforward_mass_kg: tuning.feedforward * stage.mechanics.mass_kg,
        travel_min_m: -0.5 * stage.mechanics.travel_m,
        travel_max_m: 0.5 * stage.mechanics.travel_m,
        niasa_stiffness_n_per_m: stiffness,
        niasa_coulomb_n: coulomb,
        niasa_rate_limit_n: 2.0 * coulomb / (f64::from(SERVO_HZ) * defaults.niasa_time_constant_s),
        niasa_hysteresis_m: (4.5 * stage.encoder.noise_m_rms).min(1e-6),
        friction_stiffness_n_per_m: stage.friction.stiffness_n_per_m,
        friction_coulomb_n: stage.friction.coulomb_n,
        friction_static_n: stage.friction.static_n.unwrap_or(stage.friction.coulomb_n),
        friction_stribeck_m_per_s: stage.friction.stribeck_m_per_s.unwrap_or(defaults.friction_stribeck_m_per_s),
        friction_damping_n_s_per_m: stage.friction.damping_n_s_per_m,
        friction_viscous_n_s_per_m: stage.mechanics.viscous_n_s_per_m,
        disturbance_mass_kg: stage.mechanics.mass_kg,
        ..defaults
    };
    settings.validate()?;
    Ok(settings)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Gains computed independently of this crate, for a delay of a quarter of a servo period and a 3 kHz current loop.
    #[test]
    fn the_two_tunings_of_the_experiments_come_out_as_computed_elsewhere() {
        for (tuning, kp, ki, kd) in [(STANDARD, 4.31e5, 1.6e7, 912.0), (HIGH_PERFORMANCE, 1.98e6, 2e8, 3382.0)] {
            let gains = tuning.gains(1.8, 8.66e6, 3000.0);
            for (ours, theirs) in [(gains.kp_n_per_m, kp), (gains.ki_n_per_m_s, ki), (gains.kd_n_s_per_m, kd)] {
                assert!((ours / theirs - 1.0).abs() < 0.05, "{gains:?}");
            }
        }
    }
}
