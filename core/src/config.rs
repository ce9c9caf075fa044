//! Coefficients of the tick, made from parameters once, outside it.

use crate::cascade::{self, CascadeGains};
use crate::compensator::niasa;
use crate::friction::dahl;
use crate::parameters::Settings;
use crate::position::Position;
use crate::refusal::Refusal;
use crate::settling::{TOLERANCES, TOLERANCES_NM};
use crate::{PWM_HZ, SERVO_DT_S, current};

/// Which compensator acts.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Compensator {
    /// PID only.
    #[default]
    None,
    /// PID and NIASA.
    Niasa,
}

/// Everything the tick multiplies with: plain data, swapped as a whole.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Config {
    /// Metres per count.
    pub count_m: f64,
    /// Encoder reading at position 0.
    pub origin: u32,
    /// Position of electrical angle 0, counts.
    pub commutation_zero: Position,
    /// Counts per electrical turn.
    pub turn_ct: i32,
    /// Turns per count.
    pub turns_per_ct: f32,
    /// Current loop.
    pub current: current::Coefficients,
    /// A/N.
    pub amps_per_newton: f32,
    /// N.
    pub force_limit_n: f32,
    /// Bus voltage per ADC code, V.
    pub bus_v_per_code: f32,
    /// V.
    pub bus_min_v: f32,
    /// V.
    pub bus_max_v: f32,
    /// Position and velocity loop.
    pub cascade: cascade::Coefficients,
    /// kg.
    pub feedforward_mass_kg: f32,
    /// Counts.
    pub following_error_max_ct: i32,
    /// Lowest target.
    pub travel_min: Position,
    /// Highest target.
    pub travel_max: Position,
    /// m/s.
    pub velocity_max_m_per_s: f32,
    /// m/s².
    pub acceleration_max_m_per_s2: f32,
    /// Which compensator acts.
    pub compensator: Compensator,
    /// NIASA.
    pub niasa: niasa::Coefficients,
    /// Settling tolerances, counts.
    pub tolerances_ct: [i32; TOLERANCES],
    /// CPU cycles.
    pub tick_limit_cycles: u32,
}

impl Config {
    /// Converts validated settings.
    ///
    /// # Errors
    /// The first setting that is out of range.
    pub fn new(s: &Settings) -> Result<Self, Refusal> {
        s.validate()?;
        let count_m = s.encoder_count_m;
        let to_ct = |m: f64| m / count_m;
        let nearest = |m: f64| Position(libm::round(to_ct(m)) as i64);
        let gains = CascadeGains {
            position_per_s: s.position_gain_per_s,
            velocity_n_s_per_m: s.velocity_gain_n_s_per_m,
            integral_per_s: s.velocity_integral_per_s,
        };
        let (proportional_v_per_a, integral_v_per_a) =
            current::Coefficients::gains(s.current_bandwidth_hz, s.phase_resistance_ohm, s.phase_inductance_h);
        Ok(Config {
            count_m,
            origin: s.encoder_origin_ct as u32,
            commutation_zero: nearest(-s.commutation_offset_m),
            turn_ct: to_ct(s.magnet_pitch_m) as i32,
            turns_per_ct: (count_m / s.magnet_pitch_m) as f32,
            current: current::Coefficients {
                amps_per_code: (s.current_full_scale_a / 32768.0) as f32,
                proportional_v_per_a,
                integral_v_per_a,
                trip_a: s.over_current_a as f32,
                dead_time_duty: (s.dead_time_s * f64::from(PWM_HZ)) as f32,
                dead_time_per_a: (1.0 / s.dead_time_band_a) as f32,
            },
            amps_per_newton: (1.0 / s.force_constant_n_per_a) as f32,
            force_limit_n: (s.current_limit_a * s.force_constant_n_per_a) as f32,
            bus_v_per_code: (s.bus_full_scale_v / 65536.0) as f32,
            bus_min_v: s.bus_min_v as f32,
            bus_max_v: s.bus_max_v as f32,
            cascade: cascade::Coefficients::new(gains, count_m),
            feedforward_mass_kg: s.feedforward_mass_kg as f32,
            following_error_max_ct: to_ct(s.following_error_max_m).min(f64::from(i32::MAX)) as i32,
            travel_min: nearest(s.travel_min_m),
            travel_max: nearest(s.travel_max_m),
            velocity_max_m_per_s: s.velocity_max_m_per_s as f32,
            acceleration_max_m_per_s2: s.acceleration_max_m_per_s2 as f32,
            compensator: if s.compensator >= 0.5 { Compensator::Niasa } else { Compensator::None },
            niasa: niasa::Coefficients {
                friction: dahl::Coefficients {
                    stiffness_n_per_m: s.niasa_stiffness_n_per_m as f32,
                    coulomb_n: s.niasa_coulomb_n as f32,
                    exponent_per_ct: (s.niasa_stiffness_n_per_m / s.niasa_coulomb_n * count_m) as f32,
                    hysteresis_ct: libm::round(to_ct(s.niasa_hysteresis_m)).min(f64::from(i32::MAX)) as i32,
                },
                gain_m_per_ct: (count_m * f64::from(SERVO_DT_S) / s.niasa_time_constant_s) as f32,
                rate_limit_n: s.niasa_rate_limit_n as f32,
                during_profile: if s.niasa_frozen_in_profile >= 0.5 {
                    niasa::DuringProfile::Frozen
                } else {
                    niasa::DuringProfile::Active
                },
                schedule: if s.niasa_with_proportional >= 0.5 {
                    niasa::Schedule::SlopeAndProportional
                } else {
                    niasa::Schedule::Slope
                },
            },
            tolerances_ct: TOLERANCES_NM.map(|nm| to_ct(f64::from(nm) * 1e-9) as i32),
            tick_limit_cycles: s.tick_limit_cycles as u32,
        })
    }
}
