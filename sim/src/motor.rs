//! The three-phase linear motor on its bridge: currents from voltages, force from currents.

use std::f64::consts::TAU;

use serde::{Deserialize, Serialize};

use crate::stage::Stage;

/// What the bridge does over an interval.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct BridgeState {
    /// Fraction of the period for which the high side of phases A, B, C is asked to be on; limited to `0.0..=1.0`, NaN is 0.
    pub duty: [f64; 3],
    /// Whether the outputs switch. If not, all six switches are open and only their diodes conduct; `duty` is ignored.
    pub enabled: bool,
    /// Dead time, s, taken from every on-time that the current's sign does not restore; limited to half a period.
    pub dead_time_s: f64,
}

impl BridgeState {
    /// All switches open.
    pub const OFF: BridgeState = BridgeState { duty: [0.5; 3], enabled: false, dead_time_s: 0.0 };
}

/// The motor's state: its phase currents, and the angle it is commutated at.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Motor {
    /// Current into phases A, B, C, A; the sum is zero to rounding.
    currents_a: [f64; 3],
    /// Force per current and voltage per velocity of a phase, N/A = V s/m: the force constant over 1.5.
    phase_constant_n_per_a: f64,
    commutation: Commutation,
    /// A phase that carries no current: its wire is broken.
    open_phase: Option<usize>,
}

/// What is constant while the bridge's state is: voltages, and the coefficients of a step of `dt_s`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Drive {
    enabled: bool,
    /// Ideal voltage of each terminal above their mean, V: what is left of it with a floating star point.
    terminal_v: [f64; 3],
    /// Voltage that the dead time costs at full effect, V.
    dead_time_v: f64,
    /// One over the current at which the effect is full, 1/A.
    per_band_a: f64,
    half_bus_v: f64,
    /// Trapezoidal rule for `L di/dt = u − R i`: `i ← keep · i + gain_a_per_v · u`.
    keep: f64,
    gain_a_per_v: f64,
}

impl Drive {
    /// The drive of a bridge for internal steps of `dt_s`.
    pub fn new(stage: &Stage, bridge: &BridgeState, dt_s: f64) -> Drive {
        let (motor, amplifier) = (&stage.motor, &stage.amplifier);
        let period_s = 1.0 / amplifier.pwm_hz;
        let half_decay = 0.5 * dt_s * motor.resistance_ohm / motor.inductance_h;
        let duty = bridge.duty.map(|duty| limited(duty, 1.0));
        let mean = (duty[0] + duty[1] + duty[2]) / 3.0;
        Drive {
            enabled: bridge.enabled,
            terminal_v: duty.map(|duty| amplifier.bus_v * (duty - mean)),
            dead_time_v: amplifier.bus_v * limited(bridge.dead_time_s, 0.5 * period_s) / period_s,
            per_band_a: 1.0 / amplifier.dead_time_band_a,
            half_bus_v: 0.5 * amplifier.bus_v,
            keep: (1.0 - half_decay) / (1.0 + half_decay),
            gain_a_per_v: dt_s / motor.inductance_h / (1.0 + half_decay),
        }
    }
}

/// `value` limited to `0.0..=limit`; NaN is 0.
fn limited(value: f64, limit: f64) -> f64 {
    if value > 0.0 { value.min(limit) } else { 0.0 }
}

impl Motor {
    /// The motor without current.
    pub fn new(stage: &Stage) -> Motor {
        Motor {
            currents_a: [0.0; 3],
            phase_constant_n_per_a: stage.motor.force_constant_n_per_a / 1.5,
            commutation: Commutation::new(stage.motor.magnet_pitch_m, stage.motor.commutation_offset_m),
            open_phase: None,
        }
    }

    /// Breaks the wire of a phase (0, 1, 2: A, B, C); what flowed in it ends. `None`: all are whole.
    pub fn set_open_phase(&mut self, phase: Option<usize>) {
        self.open_phase = phase.filter(|k| *k < 3);
        if let Some(k) = self.open_phase {
            let (i, j) = ((k + 1) % 3, (k + 2) % 3);
            let shared_a = 0.5 * (self.currents_a[i] - self.currents_a[j]);
            self.currents_a[k] = 0.0;
            (self.currents_a[i], self.currents_a[j]) = (shared_a, -shared_a);
        }
    }

    /// Current into phases A, B, C, A.
    pub fn currents_a(&self) -> [f64; 3] {
        self.currents_a
    }

    /// Advances the currents by the drive's step, at a position and velocity taken as constant, and returns the mean
    /// force over the step, N.
    ///
    /// `L di/dt = u − R i − e` per phase with a floating star point, by the trapezoidal rule.
    #[inline]
    pub fn step(&mut self, drive: &Drive, position_m: f64, velocity_m_per_s: f64) -> f64 {
        let shape = self.commutation.shape(position_m);
        let before_a = self.currents_a;
        if drive.enabled {
            self.step_switching(drive, shape, velocity_m_per_s);
        } else if before_a != [0.0; 3] {
            self.step_diodes(drive, shape, velocity_m_per_s);
        } else {
            return 0.0;
        }
        let sum: f64 = (0..3).map(|k| (before_a[k] + self.currents_a[k]) * shape[k]).sum();
        0.5 * self.phase_constant_n_per_a * sum
    }

    /// Bridge on. In each dead time the current chooses the rail, and always the one that opposes it.
    #[inline]
    fn step_switching(&mut self, drive: &Drive, shape: [f64; 3], velocity_m_per_s: f64) {
        let opposed = self.currents_a.map(|current_a| soft_sign(current_a * drive.per_band_a));
        let mean = (opposed[0] + opposed[1] + opposed[2]) * (1.0 / 3.0);
        let emf_v = self.phase_constant_n_per_a * velocity_m_per_s;
        let u = |k: usize| drive.terminal_v[k] - drive.dead_time_v * (opposed[k] - mean) - emf_v * shape[k];
        let after_a = |k: usize, u: f64| drive.keep * self.currents_a[k] + drive.gain_a_per_v * u;
        if let Some(open) = self.open_phase {
            // The other two in series: half of what is between them for each.
            let (i, j) = ((open + 1) % 3, (open + 2) % 3);
            let shared_a = after_a(i, 0.5 * (u(i) - u(j)));
            self.currents_a[open] = 0.0;
            (self.currents_a[i], self.currents_a[j]) = (shared_a, -shared_a);
            return;
        }
        let (a, b) = (after_a(0, u(0)), after_a(1, u(1)));
        self.currents_a = [a, b, -(a + b)];
    }

    /// Bridge off. A phase with current is tied by a diode to the rail that opposes it; one without floats. Currents end
    /// at exactly zero and stay there: a back-EMF above the bus voltage, which would turn the diodes on again, is not
    /// modelled (here it takes 5 m/s).
    fn step_diodes(&mut self, drive: &Drive, shape: [f64; 3], velocity_m_per_s: f64) {
        let before_a = self.currents_a;
        let conducting = before_a.map(|current_a| current_a != 0.0);
        let emf_v = self.phase_constant_n_per_a * velocity_m_per_s;
        let u: [f64; 3] = std::array::from_fn(|k| -drive.half_bus_v * before_a[k].signum() - emf_v * shape[k]);
        let on = || (0..3).filter(|k| conducting[*k]);
        let star_v = on().map(|k| u[k]).sum::<f64>() / on().count() as f64;
        let mut after_a = [0.0; 3];
        for k in on() {
            after_a[k] = drive.keep * before_a[k] + drive.gain_a_per_v * (u[k] - star_v);
        }
        let kept = |k: usize| after_a[k] * before_a[k] > 0.0;
        let mut rest = (0..3).filter(|k| kept(*k));
        self.currents_a = match (rest.next(), rest.next(), rest.next()) {
            (Some(_), Some(_), Some(_)) => after_a,
            (Some(j), Some(k), None) if before_a[j] * before_a[k] < 0.0 => {
                let shared_a = 0.5 * (after_a[j] - after_a[k]);
                let mut two_a = [0.0; 3];
                (two_a[j], two_a[k]) = (shared_a, -shared_a);
                two_a
            }
            _ => [0.0; 3],
        };
    }
}

/// Odd, smooth, ±1 outside ±1: `(3 x − x³) / 2` between.
fn soft_sign(x: f64) -> f64 {
    let x = if x > 1.0 { 1.0 } else { x };
    let x = if x < -1.0 { -1.0 } else { x };
    x * (1.5 - 0.5 * x * x)
}

/// The part of the q axis in each phase, at the electrical angle `2π (x + offset) / pitch`.
///
/// It is kept until the stage has moved by [`Commutation::REACH_RAD`]: a settling stage, moving by nanometres, does
/// without trigonometry. The kept value serves force and back-EMF alike, so no energy is lost or made.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct Commutation {
    rad_per_m: f64,
    offset_m: f64,
    reach_m: f64,
    position_m: f64,
    shape: [f64; 3],
}

impl Commutation {
    /// Half a micrometre at 30 mm pitch. It changes the force by 5e-9 of itself.
    const REACH_RAD: f64 = 1e-4;

    fn new(pitch_m: f64, offset_m: f64) -> Commutation {
        let rad_per_m = TAU / pitch_m;
        let reach_m = Self::REACH_RAD / rad_per_m;
        let mut commutation = Commutation { rad_per_m, offset_m, reach_m, position_m: 0.0, shape: [0.0; 3] };
        commutation.move_to(0.0);
        commutation
    }

    #[inline]
    fn shape(&mut self, position_m: f64) -> [f64; 3] {
        if (position_m - self.position_m).abs() > self.reach_m {
            self.move_to(position_m);
        }
        self.shape
    }

    /// `−sin θ`, `−sin(θ − 2π/3)`, `−sin(θ + 2π/3)`.
    #[cold]
    fn move_to(&mut self, position_m: f64) {
        let (sin, cos) = libm::sincos(self.rad_per_m * (position_m + self.offset_m));
        let (half, side) = (0.5 * sin, SQRT_3_HALF * cos);
        self.position_m = position_m;
        self.shape = [-sin, half + side, half - side];
    }
}

/// √3 / 2.
const SQRT_3_HALF: f64 = 0.866_025_403_784_438_6;

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    const DT_S: f64 = 6.25e-6;

    fn bridge(duty: [f64; 3]) -> BridgeState {
        BridgeState { duty, enabled: true, dead_time_s: 0.0 }
    }

    /// Phase values of a vector along the d and the q axis at a position of the built-in stage.
    fn phases(position_m: f64, d: f64, q: f64) -> [f64; 3] {
        let angle = TAU * position_m / 0.03;
        [0.0, TAU / 3.0, -TAU / 3.0].map(|phase| d * libm::cos(angle - phase) - q * libm::sin(angle - phase))
    }

    fn duties(position_m: f64, d_v: f64, q_v: f64) -> [f64; 3] {
        phases(position_m, d_v, q_v).map(|volts| 0.5 + volts / 48.0)
    }

    /// The motor after `time_s` at a fixed position and velocity, and its last force.
    fn run(
        mut motor: Motor,
        bridge: &BridgeState,
        position_m: f64,
        velocity_m_per_s: f64,
        time_s: f64,
    ) -> (Motor, f64) {
        let drive = Drive::new(&Stage::default(), bridge, DT_S);
        let force_n = (0..(time_s / DT_S) as usize).fold(0.0, |_, _| motor.step(&drive, position_m, velocity_m_per_s));
        (motor, force_n)
    }

    #[test]
    fn a_q_voltage_gives_the_current_of_the_resistance_and_the_force_of_the_constant() {
        for position_m in [0.0, 2.5e-3, -7.5e-3, 11e-3, 0.031] {
            let (motor, force_n) =
                run(Motor::new(&Stage::default()), &bridge(duties(position_m, 0.0, 6.0)), position_m, 0.0, 0.01);
            for (current_a, expected_a) in motor.currents_a().into_iter().zip(phases(position_m, 0.0, 2.0)) {
                assert!((current_a - expected_a).abs() < 1e-6, "at {position_m} m: {current_a} A, {expected_a} A");
            }
            assert!((force_n - 15.6).abs() < 1e-5, "at {position_m} m: {force_n} N");
        }
    }

    #[test]
    fn with_an_open_phase_the_other_two_carry_one_current_between_them() {
        for open in 0..3 {
            let mut motor = Motor::new(&Stage::default());
            motor.set_open_phase(Some(open));
            let volts = phases(4e-3, 0.0, 6.0);
            let (motor, _) = run(motor, &bridge(duties(4e-3, 0.0, 6.0)), 4e-3, 0.0, 0.01);
            let (i, j) = ((open + 1) % 3, (open + 2) % 3);
            let expected_a = (volts[i] - volts[j]) / 6.0;
            assert!((motor.currents_a()[i] - expected_a).abs() < 1e-6, "{:?}", motor.currents_a());
            assert_eq!((motor.currents_a()[open], motor.currents_a()[j]), (0.0, -motor.currents_a()[i]));
        }
    }

    #[test]
    fn a_d_voltage_gives_no_force() {
        let (motor, force_n) = run(Motor::new(&Stage::default()), &bridge(duties(4e-3, 6.0, 0.0)), 4e-3, 0.0, 0.01);
        assert!((motor.currents_a()[0] - phases(4e-3, 2.0, 0.0)[0]).abs() < 1e-6);
        assert!(force_n.abs() < 1e-9, "{force_n} N");
    }

    #[test]
    fn the_commutation_offset_shifts_the_angle() {
        let mut stage = Stage::default();
        stage.motor.commutation_offset_m = 3e-3;
        let (_, force_n) = run(Motor::new(&stage), &bridge(duties(5e-3, 0.0, 6.0)), 2e-3, 0.0, 0.01);
        assert!((force_n - 15.6).abs() < 1e-5, "{force_n} N");
    }

    #[test]
    fn the_voltage_that_balances_the_back_emf_drives_no_current() {
        // 7.8 N/A of a dq frame that counts two thirds of the phases' power is 5.2 V s/m.
        let (motor, force_n) = run(Motor::new(&Stage::default()), &bridge(duties(1e-3, 0.0, 5.2)), 1e-3, 1.0, 0.01);
        assert!(motor.currents_a().into_iter().all(|current_a| current_a.abs() < 1e-9), "{:?}", motor.currents_a());
        assert!(force_n.abs() < 1e-8);
    }

    #[test]
    fn a_short_circuited_current_decays_with_l_over_r() {
        let mut motor = Motor::new(&Stage::default());
        motor.currents_a = [2.0, -0.5, -1.5];
        let (after, _) = run(motor.clone(), &bridge([0.3; 3]), 0.0, 0.0, 1.5e-3 / 3.0);
        for (before_a, after_a) in motor.currents_a.into_iter().zip(after.currents_a) {
            assert!((after_a / before_a / libm::exp(-1.0) - 1.0).abs() < 1e-4);
        }
    }

    #[test]
    fn dead_time_costs_each_phase_its_share_of_the_bus_against_the_current() {
        // 0.5 µs of 25 µs at 48 V: 0.96 V. With A driving and B and C returning, a third of 4 × 0.96 V is missing in A.
        let with_dead_time = |q_v| BridgeState { dead_time_s: 0.5e-6, ..bridge([0.5 + q_v / 48.0, 0.5, 0.5]) };
        for (step_v, expected_a) in [(9.0, (6.0 - 1.28) / 3.0), (-9.0, (-6.0 + 1.28) / 3.0), (0.0, 0.0)] {
            let (motor, _) = run(Motor::new(&Stage::default()), &with_dead_time(step_v), 0.0, 0.0, 0.01);
            assert!((motor.currents_a()[0] - expected_a).abs() < 1e-6, "{step_v} V: {:?}", motor.currents_a());
        }
    }

    #[test]
    fn a_small_current_meets_the_dead_time_as_a_resistance() {
        // Well inside the band of 0.1 A: 3/2 × 0.96 V / 0.1 A = 14.4 Ω, and 3 Ω of the winding.
        let small = BridgeState { dead_time_s: 0.5e-6, ..bridge(duties(0.0, 0.0, 0.0174)) };
        let (motor, _) = run(Motor::new(&Stage::default()), &small, 0.0, 0.0, 0.01);
        assert!((motor.currents_a()[1] / phases(0.0, 0.0, 1e-3)[1] - 1.0).abs() < 1e-3, "{:?}", motor.currents_a());
    }

    #[test]
    fn nonsense_from_a_bridge_is_limited() {
        let drive =
            |duty, dead_time_s| Drive::new(&Stage::default(), &BridgeState { duty, enabled: true, dead_time_s }, DT_S);
        assert_eq!(drive([2.0, -1.0, f64::NAN], 1.0), drive([1.0, 0.0, 0.0], 12.5e-6));
        assert_eq!(drive([0.5; 3], -1.0), drive([0.5; 3], 0.0));
        assert_eq!(drive([0.5; 3], f64::NAN), drive([0.5; 3], 0.0));
    }

    proptest! {
        #[test]
        fn electrical_power_is_copper_loss_and_mechanical_power_and_magnetic_energy(
            duty in prop::array::uniform3(0.0..1.0),
            position_m in -0.05..0.05,
            velocity_m_per_s in -1.0..1.0,
        ) {
            let drive = Drive::new(&Stage::default(), &bridge(duty), DT_S);
            let mut motor = Motor::new(&Stage::default());
            for _ in 0..50 {
                let before_a = motor.currents_a;
                let force_n = motor.step(&drive, position_m, velocity_m_per_s);
                let mean_a: [f64; 3] = std::array::from_fn(|k| 0.5 * (before_a[k] + motor.currents_a[k]));
                let sum = |term: &dyn Fn(usize) -> f64| (0..3).map(term).sum::<f64>();
                let electrical_w = sum(&|k| 48.0 * duty[k] * mean_a[k]);
                let copper_w = sum(&|k| 3.0 * mean_a[k] * mean_a[k]);
                let magnetic_w = sum(&|k| 0.5 * 1.5e-3 * (motor.currents_a[k].powi(2) - before_a[k].powi(2)) / DT_S);
                let balance_w = electrical_w - copper_w - magnetic_w - force_n * velocity_m_per_s;
                prop_assert!(balance_w.abs() < 1e-9 * (1.0 + electrical_w.abs()), "{} W of {} W", balance_w, electrical_w);
            }
        }

        #[test]
        fn with_the_bridge_off_every_current_falls_to_zero_without_changing_sign(
            a in -10.0..10.0, b in -10.0..10.0, position_m in -0.05..0.05, velocity_m_per_s in -1.0..1.0, dt_s in 1e-7..6.25e-6,
        ) {
            let drive = Drive::new(&Stage::default(), &BridgeState::OFF, dt_s);
            let mut motor = Motor::new(&Stage::default());
            motor.currents_a = [a, b, -(a + b)];
            // At worst 20 A against half the bus less the back-EMF of 1 m/s, 24 V − 5.2 V, through 1.5 mH: 1.6 ms.
            let mut steps = (1.6e-3 / dt_s) as usize;
            while motor.currents_a != [0.0; 3] {
                prop_assert!(steps > 0, "still {:?}", motor.currents_a);
                steps -= 1;
                let before_a = motor.currents_a;
                motor.step(&drive, position_m, velocity_m_per_s);
                for (before_a, after_a) in before_a.into_iter().zip(motor.currents_a) {
                    prop_assert!(before_a * after_a >= 0.0, "{} A became {} A", before_a, after_a);
                    prop_assert!(before_a != 0.0 || after_a == 0.0, "an open phase stays open");
                }
                prop_assert!(motor.currents_a.iter().sum::<f64>().abs() < 1e-10);
            }
            prop_assert_eq!(motor.step(&drive, position_m, velocity_m_per_s), 0.0);
            prop_assert_eq!(motor.currents_a, [0.0; 3]);
        }
    }
}
