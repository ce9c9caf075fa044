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
        let after_a = |k: usize| {
            let u = drive.terminal_v[k] - drive.dead_time_v * (opposed[k] - mean) - emf_v * shape[k];
            drive.keep * self.currents_a[k] + drive.gain_a_per_v * u
        };
        let (a, b) = (after_a(0), after_a(1));
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
