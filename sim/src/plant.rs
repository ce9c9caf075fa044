//! The plant: motor, mass and friction advanced together, and what its sensors say.

use serde::{Deserialize, Serialize};

use crate::adc;
use crate::carriage::{self, Carriage};
use crate::motor::{BridgeState, Drive, Motor};
use crate::random::{BEFORE_FIRST_MOVE, Noise, Purpose};
use crate::stage::Stage;

/// Longest internal step, ns: a quarter of a 40 kHz period.
///
/// With the built-in stage, halving it moves a settling stage by less than 0.1 nm (a test).
pub const SUBSTEP_MAX_NS: u64 = 6_250;

/// The simulated stage with its electronics. All of its state can be stored and continued with the same bits.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Plant {
    carriage: Carriage,
    force_n: f64,
    motor: Motor,
    phase_noise: Noise,
    slow_noise: Noise,
    /// Phases A and B of the motor are on each other's terminals.
    exchanged: bool,
}

impl Plant {
    /// The stage at rest in mid-travel, without current, friction virgin and nominal until [`Plant::redraw_friction`].
    pub fn new(stage: &Stage, seed: u64) -> Plant {
        let noise = |purpose| Noise::new(seed, purpose, BEFORE_FIRST_MOVE);
        Plant {
            carriage: Carriage::new(stage, seed),
            force_n: 0.0,
            motor: Motor::new(stage),
            phase_noise: noise(Purpose::PhaseAdc),
            slow_noise: noise(Purpose::SlowAdc),
            exchanged: false,
        }
    }

    /// [`Carriage::redraw_friction`], and the noise of the converters restarted in the same way.
    pub fn redraw_friction(&mut self, move_index: u64) {
        self.carriage.redraw_friction(move_index);
        let noise = |purpose| Noise::new(self.carriage.seed(), purpose, move_index);
        (self.phase_noise, self.slow_noise) = (noise(Purpose::PhaseAdc), noise(Purpose::SlowAdc));
    }

    /// Advances the truth by `dt_ns` (0 is nothing) with a constant average bridge output.
    pub fn advance(&mut self, dt_ns: u64, bridge: &BridgeState) {
        self.advance_in_steps(dt_ns, bridge, SUBSTEP_MAX_NS);
    }

    fn advance_in_steps(&mut self, dt_ns: u64, bridge: &BridgeState, longest_ns: u64) {
        let steps = dt_ns.div_ceil(longest_ns);
        let dt_s = dt_ns as f64 * 1e-9 / steps as f64;
        let [a, b, c] = bridge.duty;
        let bridge = if self.exchanged { &BridgeState { duty: [b, a, c], ..*bridge } } else { bridge };
        let step = Step::new(self.stage(), bridge, dt_s);
        for _ in 0..steps {
            self.step(&step);
        }
    }

    /// Drift, kick, drift: half a step of motion, all forces there, the other half with the new velocity.
    #[inline]
    fn step(&mut self, step: &Step) {
        self.carriage.drift(&step.carriage);
        self.force_n = self.motor.step(&step.drive, self.carriage.position_m(), self.carriage.velocity_m_per_s());
        self.carriage.kick(&step.carriage, self.force_n);
        self.carriage.drift(&step.carriage);
    }

    /// Wires the motor wrongly: its phases A and B are on each other's terminals, where the current sensors are.
    pub fn exchange_phases(&mut self) {
        self.exchanged = true;
    }

    /// [`Carriage::reverse_encoder`].
    pub fn reverse_encoder(&mut self) {
        self.carriage.reverse_encoder();
    }

    /// [`Motor::set_open_phase`].
    pub fn set_open_phase(&mut self, phase: Option<usize>) {
        self.motor.set_open_phase(phase);
    }

    /// From now on the supply has this voltage, V: a surge or a sag.
    pub fn set_bus_v(&mut self, bus_v: f64) {
        self.carriage.set_bus_v(bus_v);
    }

    /// From now on something pushes the carriage with this force, N.
    pub fn set_external_force_n(&mut self, external_n: f64) {
        self.carriage.set_external_force_n(external_n);
    }

    /// The pins of the phase A and B current channels, each with the noise of one conversion, as a fraction of full scale
    /// in `0.0..=1.0`: 0.5 at 0 A, 1.0 at `full_scale_a` into the motor.
    pub fn phase_adc(&mut self) -> [f64; 2] {
        let [a, b, _] = self.currents_a();
        [a, b].map(|current_a| {
            adc::bipolar(
                current_a,
                self.stage().amplifier.full_scale_a,
                self.stage().adc.noise_lsb_rms,
                &mut self.phase_noise,
            )
        })
    }

    /// [`Plant::phase_adc`] as 16-bit codes, 32768 at 0 A.
    pub fn phase_codes(&mut self) -> [u16; 2] {
        self.phase_adc().map(adc::code)
    }

    /// The pin of the bus-voltage channel with the noise of one conversion: 1.0 at `bus_full_scale_v`.
    pub fn bus_adc(&mut self) -> f64 {
        let (scale, bus_v) = (self.stage().adc, self.stage().amplifier.bus_v);
        adc::linear(bus_v, 0.0, scale.bus_full_scale_v, scale.noise_lsb_rms, &mut self.slow_noise)
    }

    /// The pin of the heat sink's temperature channel with the noise of one conversion: linear from `temperature_zero_c` at
    /// 0.0 to `temperature_full_scale_c` at 1.0.
    pub fn temperature_adc(&mut self) -> f64 {
        let (scale, temperature_c) = (self.stage().adc, self.stage().amplifier.temperature_c);
        let (zero_c, full_scale_c) = (scale.temperature_zero_c, scale.temperature_full_scale_c);
        adc::linear(temperature_c, zero_c, full_scale_c, scale.noise_lsb_rms, &mut self.slow_noise)
    }

    /// [`Carriage::encoder_frame`].
    pub fn encoder_frame(&mut self) -> u64 {
        self.carriage.encoder_frame()
    }

    /// [`Carriage::encoder_signals`].
    pub fn encoder_signals(&mut self) -> Option<crate::encoder::sincos::Reading> {
        self.carriage.encoder_signals()
    }

    /// The stage file's values.
    pub fn stage(&self) -> &Stage {
        self.carriage.stage()
    }

    /// True position, m, 0 in mid-travel.
    pub fn position_m(&self) -> f64 {
        self.carriage.position_m()
    }

    /// True velocity, m/s.
    pub fn velocity_m_per_s(&self) -> f64 {
        self.carriage.velocity_m_per_s()
    }

    /// Force of the rolling friction, N; positive opposes positive motion.
    pub fn friction_n(&self) -> f64 {
        self.carriage.friction_n()
    }

    /// Force of the motor in the last internal step, N.
    pub fn force_n(&self) -> f64 {
        self.force_n
    }

    /// Current out of the terminals A, B, C, A.
    pub fn currents_a(&self) -> [f64; 3] {
        let [a, b, c] = self.motor.currents_a();
        if self.exchanged { [b, a, c] } else { [a, b, c] }
    }
}

/// What is the same in every internal step of an interval.
struct Step {
    drive: Drive,
    carriage: carriage::Step,
}

impl Step {
    fn new(stage: &Stage, bridge: &BridgeState, dt_s: f64) -> Step {
        Step { drive: Drive::new(stage, bridge, dt_s), carriage: carriage::Step::new(stage, dt_s) }
    }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::TAU;

    use super::*;

    /// A plant oscillating freely with a small amplitude; the mean time between two upward passages, s.
    fn free_period_s(plant: &mut Plant, amplitude_m: f64, periods: u32) -> f64 {
        let stiffness_n_per_m = 2.0 * plant.stage().friction.stiffness_n_per_m;
        plant.carriage.set_velocity(amplitude_m * libm::sqrt(stiffness_n_per_m / plant.stage().mechanics.mass_kg));
        let (mut passages_s, mut before_m) = (Vec::new(), 1.0);
        for step in 0.. {
            plant.advance(SUBSTEP_MAX_NS, &BridgeState::OFF);
            if before_m < 0.0 && plant.position_m() >= 0.0 {
                let fraction = before_m / (before_m - plant.position_m());
                passages_s.push((f64::from(step) + fraction) * SUBSTEP_MAX_NS as f64 * 1e-9);
            }
            before_m = plant.position_m();
            if passages_s.len() > periods as usize {
                break;
            }
        }
        (passages_s[periods as usize] - passages_s[0]) / f64::from(periods)
    }

    #[test]
    fn small_motions_resonate_at_twice_sigma_over_the_mass() {
        for (mass_kg, stiffness_n_per_m) in [(1.8, 8.66e6), (1.2, 14.0e6), (1.8, 4.17e6)] {
            let mut stage = Stage::default();
            (stage.mechanics.mass_kg, stage.friction.stiffness_n_per_m) = (mass_kg, stiffness_n_per_m);
            // Half a nanometre is less than the first element's reach.
            let period_s = free_period_s(&mut Plant::new(&stage, 0), 0.5e-9, 20);
            let expected_s = TAU / libm::sqrt(2.0 * stiffness_n_per_m / mass_kg);
            assert!((period_s / expected_s - 1.0).abs() < 1e-3, "{period_s} s, {expected_s} s");
        }
    }

    #[test]
    fn viscous_friction_takes_velocity_with_its_time_constant() {
        let mut stage = Stage::default();
        stage.mechanics.viscous_n_s_per_m = 180.0;
        stage.friction.coulomb_n = 1e-6;
        let mut plant = Plant::new(&stage, 0);
        plant.carriage.set_velocity(0.5);
        plant.advance(10_000_000, &BridgeState::OFF); // the mass over the drag
        assert!((plant.velocity_m_per_s() / 0.5 - libm::exp(-1.0)).abs() < 1e-6);
    }

    /// Position over time, one sample a tick of 125 µs, of a rough controller that steps the stage by `step_m`.
    fn settling(stage: &Stage, step_m: f64, ticks: usize, longest_ns: u64) -> Vec<f64> {
        let (k_p, k_i, k_d) = (4.31e5, 1.6e7, 912.0);
        let (mut plant, mut integral_n, mut before_m) = (Plant::new(stage, 0), 0.0, 0.0);
        (0..ticks)
            .map(|_| {
                let error_m = step_m - plant.position_m();
                integral_n += k_i * error_m * 125e-6;
                let wanted_n = k_p * error_m + integral_n - k_d * (plant.position_m() - before_m) / 125e-6;
                before_m = plant.position_m();
                let angle = TAU * plant.position_m() / 0.03;
                let shape = [0.0, TAU / 3.0, -TAU / 3.0].map(|phase| -libm::sin(angle - phase));
                let q_a = plant.currents_a().iter().zip(shape).map(|(i, s)| i * s).sum::<f64>() / 1.5;
                let q_v = 3.0 * wanted_n / 7.8 + 5.0 * (wanted_n / 7.8 - q_a);
                let duty = shape.map(|part| 0.5 + q_v * part / 48.0);
                plant.advance_in_steps(125_000, &BridgeState { duty, enabled: true, dead_time_s: 0.5e-6 }, longest_ns);
                plant.position_m()
            })
            .collect()
    }

    #[test]
    fn half_the_internal_step_gives_the_same_settling() {
        for step_m in [50e-9, 1e-6, 5e-6, 20e-6] {
            let coarse = settling(&Stage::default(), step_m, 4_000, SUBSTEP_MAX_NS);
            let fine = settling(&Stage::default(), step_m, 4_000, SUBSTEP_MAX_NS / 2);
            let difference_m: Vec<f64> = coarse.iter().zip(&fine).map(|(a, b)| (a - b).abs()).collect();
            let worst_m = |from_tick: usize| difference_m[from_tick..].iter().copied().fold(0.0, f64::max);
            assert!(worst_m(0) < 2e-4 * step_m, "{step_m} m: {} m during the step", worst_m(0));
            assert!(worst_m(200) < 0.1e-9, "{step_m} m: {} m after 25 ms", worst_m(200));
        }
    }
}
