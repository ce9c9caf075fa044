//! All parameters of the drive: one table of id, name, unit, range, default, access and meaning.
//!
//! From it come the [`Settings`] struct, its validation, the wire ids and the names that a person types.

use crate::encoder::sincos::Signals;
use crate::position::Position;
use crate::refusal::{Field, Refusal};

/// When a parameter may change.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Access {
    /// Any time; the change is bumpless.
    Always,
    /// Only with the bridge off.
    BridgeOff,
}

/// One row of the table.
#[derive(Clone, Copy, Debug)]
pub struct Parameter {
    /// Number on the wire and in stored images; never reused.
    pub id: u16,
    /// Name as typed; the field of [`Settings`].
    pub name: &'static str,
    /// Unit of the value; empty for pure numbers and choices.
    pub unit: &'static str,
    /// Lowest allowed value.
    pub min: f64,
    /// Highest allowed value.
    pub max: f64,
    /// Value of a new drive.
    pub default: f64,
    /// When it may change.
    pub access: Access,
    /// What it does.
    pub doc: &'static str,
    get: fn(&Settings) -> f64,
    get_mut: fn(&mut Settings) -> &mut f64,
}

impl Parameter {
    /// The row with this id.
    pub fn by_id(id: u16) -> Option<&'static Parameter> {
        TABLE.iter().find(|p| p.id == id)
    }

    /// The row with this name.
    pub fn by_name(name: &str) -> Option<&'static Parameter> {
        TABLE.iter().find(|p| p.name == name)
    }

    /// Its value in `settings`.
    pub fn get(&self, settings: &Settings) -> f64 {
        (self.get)(settings)
    }

    /// Puts `value` into `settings`.
    ///
    /// # Errors
    /// Outside the row's range (or NaN): refused, nothing changed.
    pub fn set(&self, settings: &mut Settings, value: f64) -> Result<(), Refusal> {
        *(self.get_mut)(settings) = Refusal::check(Field::Parameter(self.id), value, self.min, self.max)?;
        Ok(())
    }
}

/// Titles of the groups of parameters, by the upper byte of their ids.
pub const GROUPS: [(u16, &str); 6] = [
    (0x01, "Encoder"),
    (0x02, "Motor, power stage, supply"),
    (0x03, "Position loop"),
    (0x04, "Motion"),
    (0x05, "Compensators"),
    (0x06, "Supervision"),
];

macro_rules! parameters {
    ($($id:literal $name:ident $unit:literal [$min:expr, $max:expr] $default:expr, $access:ident, $doc:literal;)+) => {
        /// Values of all parameters, in the units of the table.
        #[derive(Clone, Copy, Debug, PartialEq)]
        pub struct Settings {
            $(#[doc = $doc] #[doc = concat!("\n\nUnit: ", $unit)] pub $name: f64,)+
        }

        impl Default for Settings {
            fn default() -> Self {
                Settings { $($name: $default,)+ }
            }
        }

        /// Number of parameters.
        pub const COUNT: usize = [$($id),+].len();

        /// Every parameter, by ascending id.
        pub static TABLE: &[Parameter] = &[$(Parameter {
            id: $id, name: stringify!($name), unit: $unit, min: $min, max: $max, default: $default, access: Access::$access, doc: $doc,
            get: |s| s.$name, get_mut: |s| &mut s.$name,
        },)+];
    };
}

parameters! {
    0x0101 encoder_count_m "m" [1e-12, 1e-6] 4e-6 / 65536.0, BridgeOff, "Length of one encoder count.";
    0x0102 encoder_origin_ct "ct" [0.0, 4_294_967_295.0] 2_147_483_648.0, BridgeOff, "Encoder reading at position 0.";
    0x0103 encoder_jump_m "m" [1e-9, 1.0] 1e-6, BridgeOff, "A change of the movement from tick to tick beyond this is a fault; above what the motor's force can do in a tick.";
    0x0104 encoder_frozen_ticks "ticks" [0.0, 60_000.0] 80.0, BridgeOff, "So many equal readings in a row at rest are a fault, and as many equal codes of a phase current, one a tick; 0: never, for readings coarser than their noise.";
    0x0105 encoder_kind "" [0.0, 1.0] 0.0, BridgeOff, "0: BiSS-C. 1: sine and cosine of 1 Vpp, with a counter of their edges.";
    0x0106 sincos_amplitude "" [0.05, 1.0] 0.75, BridgeOff, "Amplitude of the cosine, as a share of half the converter's range.";
    0x0107 sincos_cos_offset "" [-0.3, 0.3] 0.0, BridgeOff, "Offset of the cosine, as a share of its amplitude.";
    0x0108 sincos_sin_offset "" [-0.3, 0.3] 0.0, BridgeOff, "Offset of the sine, as a share of the cosine's amplitude.";
    0x0109 sincos_gain "" [0.7, 1.4] 1.0, BridgeOff, "Amplitude of the sine, as a share of the cosine's.";
    0x010a sincos_phase_rad "rad" [-0.35, 0.35] 0.0, BridgeOff, "What the sine is ahead of its 90° from the cosine.";
    0x010b sincos_amplitude_min "" [0.1, 1.0] 0.6, BridgeOff, "A smaller amplitude, as a share of the nominal one, is a fault.";
    0x010c sincos_amplitude_max "" [1.0, 2.0] 1.3, BridgeOff, "A larger amplitude, as a share of the nominal one, is a fault.";
    0x010d encoder_identity "" [0.0, 4_294_967_295.0] 0.0, BridgeOff, "Number of the absolute encoder, say its serial number: to be changed when the encoder or the motor is. Its frames do not tell it.";
    0x0201 magnet_pitch_m "m" [1e-3, 1.0] 0.03, BridgeOff, "Length of one electrical turn of the motor (a pair of poles).";
    0x0202 commutation_offset_m "m" [-1.0, 1.0] 0.0, BridgeOff, "Added to the position before it becomes an electrical angle.";
    0x0203 force_constant_n_per_a "N/A" [0.1, 1000.0] 7.8, BridgeOff, "Force per ampere of the dq frame's q axis (peak).";
    0x0204 phase_resistance_ohm "Ω" [0.01, 100.0] 3.0, BridgeOff, "Phase to star resistance.";
    0x0205 phase_inductance_h "H" [1e-5, 0.1] 1.5e-3, BridgeOff, "Phase to star inductance.";
    0x0206 current_bandwidth_hz "Hz" [100.0, 5000.0] 3000.0, BridgeOff, "Closed-loop bandwidth of the current loop.";
    0x0207 current_full_scale_a "A" [0.1, 200.0] 10.0, BridgeOff, "Phase current at either end of the converter's range.";
    0x0208 current_limit_a "A" [0.01, 200.0] 8.0, BridgeOff, "Largest current set-point; with the force constant, the force limit.";
    0x0209 over_current_a "A" [0.01, 200.0] 9.5, BridgeOff, "A phase current above this is a fault in the same period.";
    0x020a dead_time_s "s" [0.0, 5e-6] 0.5e-6, BridgeOff, "Dead time to compensate; 0 turns the compensation off.";
    0x020b dead_time_band_a "A" [1e-3, 10.0] 0.1, BridgeOff, "Phase current at which dead time takes its full toll.";
    0x020c bus_full_scale_v "V" [1.0, 1000.0] 80.0, BridgeOff, "Bus voltage at the end of the converter's range.";
    0x020d bus_min_v "V" [1.0, 1000.0] 24.0, BridgeOff, "Below this the bridge is not turned on, and off if it was.";
    0x020e bus_max_v "V" [1.0, 1000.0] 60.0, BridgeOff, "Above this the bridge is off.";
    0x020f temperature_zero_c "°C" [-300.0, 1000.0] -50.0, BridgeOff, "Temperature of the power stage at the lower end of the converter's range, whose lowest hundredth is taken for a sensor without its wire.";
    0x0210 temperature_full_scale_c "°C" [-300.0, 1000.0] 280.0, BridgeOff, "Temperature of the power stage at the upper end of the converter's range.";
    0x0211 temperature_max_c "°C" [-50.0, 200.0] 80.0, BridgeOff, "Above this the bridge is off.";
    0x0212 continuous_current_a "A" [0.01, 200.0] 4.0, BridgeOff, "Current that the motor takes for ever; the thermal model allows more for a time.";
    0x0213 thermal_time_constant_s "s" [0.1, 1000.0] 10.0, BridgeOff, "Time constant of the motor's thermal model (i²t).";
    0x0214 commutation_identity "" [-1.0, 4_294_967_295.0] -1.0, BridgeOff, "encoder_identity for which commutation_offset_m holds; −1: for none, the motor was never aligned. With another one than the encoder's, or an incremental encoder, the motor is to be aligned before it is enabled.";
    0x0215 alignment_current_a "A" [0.1, 200.0] 5.0, BridgeOff, "Amplitude of the current vector that looks for the electrical zero; current_limit_a if that is less.";
    0x0216 alignment_travel_m "m" [1e-6, 0.01] 200e-6, BridgeOff, "The stage may go so far from where it was while the electrical zero is looked for.";
    0x0301 position_gain_per_s "1/s" [0.0, 1e5] 431.974_539_479_188_14, Always, "Position loop gain K_p.";
    0x0302 velocity_gain_n_s_per_m "N s/m" [1e-3, 1e6] 912.0, Always, "Velocity loop gain K_v; k_D of the parallel form.";
    0x0303 velocity_integral_per_s "1/s" [0.0, 1e5] 40.613_179_819_057_46, Always, "Integral rate K_i of the velocity loop.";
    0x0304 feedforward_mass_kg "kg" [0.0, 1000.0] 0.0, Always, "Acceleration feedforward.";
    0x0305 following_error_max_m "m" [1e-7, 1.0] 200e-6, Always, "A larger position error is a fault.";
    0x0306 overspeed_m_per_s "m/s" [1e-6, 20.0] 1.0, Always, "A higher speed is a fault.";
    0x0307 runaway_m_per_s "m/s" [1e-6, 20.0] 0.1, Always, "A faster growth of the position error is a fault.";
    0x0308 commutation_check_n "N" [1e-3, 1e4] 6.0, Always, "With more force than this the stage must not move and accelerate against it; above friction, static load and steps of load.";
    0x0309 position_window_m "m" [1e-10, 1.0] 20e-9, Always, "Target reached: largest position error.";
    0x030a position_window_s "s" [0.0, 10.0] 0.01, Always, "Target reached: time inside the window.";
    0x0401 travel_min_m "m" [-10.0, 10.0] -0.05, BridgeOff, "Lowest position a move may have as target.";
    0x0402 travel_max_m "m" [-10.0, 10.0] 0.05, BridgeOff, "Highest position a move may have as target.";
    0x0403 velocity_max_m_per_s "m/s" [1e-6, 10.0] 0.5, Always, "Highest speed a move may ask for.";
    0x0404 acceleration_max_m_per_s2 "m/s²" [1e-6, 500.0] 20.0, Always, "Highest acceleration a move may ask for, and that of a stop.";
    0x0405 travel_margin_m "m" [1e-6, 1.0] 1e-4, BridgeOff, "A position further outside the travel than this is a fault.";
    0x0406 quick_stop_m_per_s2 "m/s²" [1e-6, 500.0] 30.0, Always, "Deceleration of the quick-stop ramp.";
    0x0407 quick_stop_option "" [0.0, 6.0] 2.0, Always, "0: bridge off at once. 1: slow-down ramp (acceleration_max), then off. 2: quick-stop ramp, then off. 5, 6: as 1, 2 and held at rest in Quick stop active.";
    0x0408 halt_option "" [1.0, 2.0] 1.0, Always, "1: slow-down ramp. 2: quick-stop ramp. Then held at rest in Operation enabled.";
    0x0409 disable_option "" [0.0, 1.0] 0.0, Always, "Disable operation and shutdown, controlwords 0x07 and 0x06 (`servoctl disable` is disable voltage, at once). 0: bridge off at once. 1: slow-down ramp first.";
    0x040a fault_reaction_option "" [0.0, 2.0] 0.0, Always, "Faults that may brake first. 0: bridge off at once. 1: slow-down ramp first. 2: quick-stop ramp first.";
    0x0501 compensator "" [0.0, 7.0] 0.0, Always, "0: none. 1: NIASA. 2: NIASA on Maxwell slip. 3: friction feedforward. 4: LuGre observer. 5: Dahl observer. 6: scheduled PD. 7: disturbance observer.";
    0x0502 niasa_stiffness_n_per_m "N/m" [1e3, 1e9] 4e6, Always, "σ̂ of the friction model; better too low than too high (8.1.1).";
    0x0503 niasa_coulomb_n "N" [1e-3, 1e3] 0.6, Always, "F̂_C of the friction model.";
    0x0504 niasa_time_constant_s "s" [1e-4, 10.0] 0.01, Always, "τ_d: time constant of settling.";
    0x0505 niasa_rate_limit_n "N" [1e-6, 1e3] 0.015, Always, "Largest change of the nonlinear integrator per tick (8.1): 2·F̂_C·dt/τ_d.";
    0x0506 niasa_hysteresis_m "m" [0.0, 1e-6] 2e-9, Always, "Return from an extreme that counts as a velocity reversal; four to five times the encoder's rms noise.";
    0x0507 niasa_frozen_in_profile "" [0.0, 1.0] 1.0, Always, "0: acts always. 1: frozen while the profile moves (8.1.2).";
    0x0508 niasa_with_proportional "" [0.0, 1.0] 1.0, Always, "0: schedules dF/dx beside the linear integral (App. E). 1: schedules dF/dx + k_P instead of it (7.55).";
    0x0509 niasa_elements "" [0.0, 1.0] 0.0, Always, "Elements of NIASA on Maxwell slip, scaled to σ̂ and F̂_C. 0: a Dahl model's curve. 1: the curve of table 4.";
    0x0511 friction_stiffness_n_per_m "N/m" [1e3, 1e9] 8.66e6, Always, "σ (σ_0 of LuGre) of the model in feedforward, friction observers and scheduled PD.";
    0x0512 friction_coulomb_n "N" [1e-3, 1e3] 0.64, Always, "F_C of that model.";
    0x0513 friction_static_n "N" [1e-3, 1e3] 0.64, Always, "F_S of that model: static friction of the Stribeck curve, at least F_C.";
    0x0514 friction_stribeck_m_per_s "m/s" [1e-9, 10.0] 1e-3, Always, "Stribeck velocity of that model.";
    0x0515 friction_damping_n_s_per_m "N s/m" [0.0, 1e6] 0.0, Always, "σ_1 of LuGre.";
    0x0516 friction_viscous_n_s_per_m "N s/m" [0.0, 1e6] 0.0, Always, "Viscous friction of that model.";
    0x0517 feedforward_model "" [0.0, 4.0] 0.0, Always, "0: Coulomb. 1: Stribeck. 2: Dahl. 3: LuGre. 4: generalised Maxwell slip.";
    0x0518 observer_time_constant_s "s" [1e-5, 10.0] 0.01, Always, "Time constant of the error term that drives a friction observer (τ_d in 7.23).";
    0x0519 schedule_share "" [0.0, 10.0] 0.1, Always, "Share of the modelled slope that joins k_P in scheduled PD.";
    0x051a disturbance_mass_kg "kg" [1e-3, 1000.0] 1.8, Always, "Nominal mass of the disturbance observer.";
    0x051b disturbance_bandwidth_hz "Hz" [0.1, 1000.0] 30.0, Always, "Bandwidth of the disturbance observer.";
    0x0601 tick_limit_cycles "cycles" [100.0, 65_000.0] 10_000.0, BridgeOff, "A servo tick longer than this is a fault; the default is one PWM period at 400 MHz.";
    0x0602 command_timeout_s "s" [0.0, 3600.0] 0.0, Always, "Without a request from the host for longer than this the bridge goes off; 0: never.";
}

impl Settings {
    /// Sine and cosine as they are taken to be.
    pub fn signals(&self) -> Signals {
        Signals {
            amplitude: self.sincos_amplitude,
            cos_offset: self.sincos_cos_offset,
            sin_offset: self.sincos_sin_offset,
            gain: self.sincos_gain,
            phase_rad: self.sincos_phase_rad,
        }
    }

    /// The same settings with the electrical zero at a position, as found with the encoder in use.
    #[must_use]
    pub fn with_commutation_zero(self, zero: Position) -> Settings {
        let commutation_offset_m = -(zero.0 as f64) * self.encoder_count_m;
        Settings { commutation_offset_m, commutation_identity: self.encoder_identity, ..self }
    }

    /// The same settings with sine and cosine as they have been found.
    #[must_use]
    pub fn with_signals(self, signals: &Signals) -> Settings {
        Settings {
            sincos_amplitude: signals.amplitude,
            sincos_cos_offset: signals.cos_offset,
            sincos_sin_offset: signals.sin_offset,
            sincos_gain: signals.gain,
            sincos_phase_rad: signals.phase_rad,
            ..self
        }
    }

    /// Checks every value against its row, and the pairs that must be in order.
    ///
    /// # Errors
    /// The first value that is out of range, with the range.
    pub fn validate(&self) -> Result<(), Refusal> {
        for parameter in TABLE {
            Refusal::check(Field::Parameter(parameter.id), parameter.get(self), parameter.min, parameter.max)?;
        }
        Refusal::check(Field::Parameter(0x020e), self.bus_max_v, self.bus_min_v, self.bus_full_scale_v)?;
        // A reading stuck at an end of its range is to be above it.
        let readable_a = 0.995 * self.current_full_scale_a;
        Refusal::check(Field::Parameter(0x0209), self.over_current_a, self.current_limit_a, readable_a)?;
        Refusal::check(
            Field::Parameter(0x0211),
            self.temperature_max_c,
            self.temperature_zero_c,
            self.temperature_full_scale_c - 1.0,
        )?;
        Refusal::check(Field::Parameter(0x0513), self.friction_static_n, self.friction_coulomb_n, 1e3)?;
        // Distances and the electrical turn are computed in 32-bit counts.
        Refusal::check(
            Field::Parameter(0x0402),
            self.travel_max_m,
            self.travel_min_m,
            self.travel_min_m + 4.2e9 * self.encoder_count_m,
        )?;
        Refusal::check(
            Field::Parameter(0x0201),
            self.magnet_pitch_m,
            1e3 * self.encoder_count_m,
            1e9 * self.encoder_count_m,
        )?;
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cascade::{CascadeGains, ParallelGains};

    #[test]
    fn the_defaults_are_valid() {
        assert_eq!(Settings::default().validate(), Ok(()));
    }

    #[test]
    fn ids_and_names_are_unique_and_in_order() {
        for pair in TABLE.windows(2) {
            assert!(pair[0].id < pair[1].id, "{:#06x}", pair[1].id);
        }
        for p in TABLE {
            assert_eq!(Parameter::by_id(p.id).unwrap().name, p.name);
            assert_eq!(Parameter::by_name(p.name).unwrap().id, p.id);
        }
    }

    #[test]
    fn every_parameter_refuses_what_is_outside_its_range_and_keeps_the_old_value() {
        for p in TABLE {
            for value in [p.min - 1.0, p.max + 1.0, f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
                let mut settings = Settings::default();
                let Err(Refusal::OutOfRange { field, value: named, min, max }) = p.set(&mut settings, value) else {
                    panic!("{} took {value}", p.name)
                };
                assert_eq!((field, min, max), (Field::Parameter(p.id), p.min, p.max));
                assert_eq!(named.to_bits(), value.to_bits());
                assert_eq!(settings, Settings::default());
            }
            let mut settings = Settings::default();
            p.set(&mut settings, p.max).unwrap();
            assert_eq!(p.get(&settings), p.max);
        }
    }

    #[test]
    fn a_negative_time_constant_is_refused_by_name() {
        let refused =
            Parameter::by_name("niasa_time_constant_s").unwrap().set(&mut Settings::default(), -0.01).unwrap_err();
        extern crate std;
        use std::string::ToString;
        assert_eq!(refused.to_string(), "niasa_time_constant_s = -0.01 s is outside 0.0001 … 10 s");
    }

    #[test]
    fn the_default_gains_are_the_standard_tuning_of_the_thesis() {
        let s = Settings::default();
        let cascade = CascadeGains {
            position_per_s: s.position_gain_per_s,
            velocity_n_s_per_m: s.velocity_gain_n_s_per_m,
            integral_per_s: s.velocity_integral_per_s,
        };
        let parallel = cascade.to_parallel();
        let standard = ParallelGains { kp_n_per_m: 4.31e5, ki_n_per_m_s: 1.6e7, kd_n_s_per_m: 912.0 };
        assert!((parallel.kp_n_per_m / standard.kp_n_per_m - 1.0).abs() < 1e-3, "{parallel:?}");
        assert!((parallel.ki_n_per_m_s / standard.ki_n_per_m_s - 1.0).abs() < 1e-3, "{parallel:?}");
    }
}
