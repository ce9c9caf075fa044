//! Coefficients of the tick, made from parameters once, outside it.

use crate::cascade::{self, CascadeGains};
pub use crate::compensator::Compensator;
use crate::compensator::niasa::{self, DuringProfile, Schedule};
use crate::compensator::{self, disturbance, feedforward, observer, scheduled};
use crate::encoder::sincos;
use crate::friction::{coulomb, dahl, gms, lugre, maxwell_slip, shaped_dahl, stribeck};
use crate::parameters::Settings;
use crate::position::Position;
use crate::refusal::Refusal;
use crate::settling::{TOLERANCES, TOLERANCES_NM};
use crate::{PWM_HZ, SERVO_DT_S, alignment, current, monitor};

/// Everything the tick multiplies with: plain data, swapped as a whole.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Config {
    /// Metres per count.
    pub count_m: f64,
    /// Encoder reading at position 0.
    pub origin: u32,
    /// Sine and cosine; `None`: BiSS-C.
    pub sin_cos: Option<sincos::Coefficients>,
    /// Position of electrical angle 0, counts.
    pub commutation_zero: Position,
    /// `commutation_zero` is that of the encoder in use.
    pub commutation_stored: bool,
    /// How it is looked for.
    pub alignment: alignment::Plan,
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
    /// What is watched.
    pub monitor: monitor::Coefficients,
    /// Target reached: largest position error, counts.
    pub window_ct: i32,
    /// Target reached: ticks inside the window.
    pub window_ticks: u32,
    /// What quick stop, halt, disable and faults do.
    pub options: Options,
    /// Lowest target.
    pub travel_min: Position,
    /// Highest target.
    pub travel_max: Position,
    /// m/s.
    pub velocity_max_m_per_s: f32,
    /// m/s².
    pub acceleration_max_m_per_s2: f32,
    /// Compensators.
    pub compensator: compensator::Coefficients,
    /// Settling tolerances, counts.
    pub tolerances_ct: [i32; TOLERANCES],
}

/// Option codes of CiA 402 (objects 605A to 605E) and the ramps they choose from.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Options {
    /// Ramp of quick stop; `None`: bridge off at once.
    pub quick_stop_m_per_s2: Option<f32>,
    /// After quick stop the stage is held in Quick stop active.
    pub stays_stopped: bool,
    /// Ramp of halt.
    pub halt_m_per_s2: f32,
    /// Ramp before disable operation and shutdown; `None`: bridge off at once.
    pub disable_m_per_s2: Option<f32>,
    /// Ramp of faults that may brake first; `None`: bridge off at once.
    pub fault_m_per_s2: Option<f32>,
}

impl Options {
    fn new(s: &Settings) -> Self {
        let (slow, quick) = (s.acceleration_max_m_per_s2 as f32, s.quick_stop_m_per_s2 as f32);
        let ramps = [None, Some(slow), Some(quick), None, None, Some(slow), Some(quick)];
        Options {
            quick_stop_m_per_s2: choice(&ramps, s.quick_stop_option),
            stays_stopped: libm::round(s.quick_stop_option) >= 5.0,
            halt_m_per_s2: choice(&[slow, slow, quick], s.halt_option),
            disable_m_per_s2: choice(&ramps[..2], s.disable_option),
            fault_m_per_s2: choice(&ramps[..3], s.fault_reaction_option),
        }
    }
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
        let parallel = gains.to_parallel();
        let (proportional_v_per_a, integral_v_per_a) =
            current::Coefficients::gains(s.current_bandwidth_hz, s.phase_resistance_ohm, s.phase_inductance_h);
        Ok(Config {
            count_m,
            origin: s.encoder_origin_ct as u32,
            sin_cos: (s.encoder_kind >= 0.5).then(|| sincos::Coefficients {
                correction: sincos::Correction::new(&s.signals()),
                least2: (s.sincos_amplitude_min * s.sincos_amplitude_min) as f32,
                most2: (s.sincos_amplitude_max * s.sincos_amplitude_max) as f32,
            }),
            commutation_zero: nearest(-s.commutation_offset_m),
            // An incremental encoder begins somewhere else each time.
            commutation_stored: s.encoder_kind < 0.5 && s.commutation_identity == s.encoder_identity,
            alignment: alignment::Plan {
                current_a: s.alignment_current_a.min(s.current_limit_a) as f32,
                newtons_per_amp: s.force_constant_n_per_a as f32,
                turns_per_ct: (count_m / s.magnet_pitch_m) as f32,
                travel_max_ct: to_ct(s.alignment_travel_m).min(f64::from(i32::MAX)) as i32,
                proportional_n_per_ct: (parallel.kp_n_per_m * count_m) as f32,
                derivative_n_per_ct: (parallel.kd_n_s_per_m * count_m / f64::from(SERVO_DT_S)) as f32,
            },
            turn_ct: to_ct(s.magnet_pitch_m) as i32,
            turns_per_ct: (count_m / s.magnet_pitch_m) as f32,
            current: current::Coefficients {
                amps_per_code: (s.current_full_scale_a / 32768.0) as f32,
                proportional_v_per_a,
                integral_v_per_a,
                trip_a: s.over_current_a as f32,
                frozen_ticks: frozen_ticks(s),
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
            monitor: monitor(s),
            window_ct: to_ct(s.position_window_m).min(f64::from(i32::MAX)) as i32,
            window_ticks: libm::ceil(s.position_window_s / f64::from(SERVO_DT_S)) as u32,
            options: Options::new(s),
            travel_min: nearest(s.travel_min_m),
            travel_max: nearest(s.travel_max_m),
            velocity_max_m_per_s: s.velocity_max_m_per_s as f32,
            acceleration_max_m_per_s2: s.acceleration_max_m_per_s2 as f32,
            compensator: compensator(s),
            tolerances_ct: TOLERANCES_NM.map(|nm| to_ct(f64::from(nm) * 1e-9) as i32),
        })
    }
}

impl Config {
    /// Takes over what may change with the bridge on; all else is the same in both. A third less to copy in the tick than everything.
    pub fn adopt(&mut self, new: &Config) {
        self.cascade = new.cascade;
        self.alignment = new.alignment;
        self.feedforward_mass_kg = new.feedforward_mass_kg;
        self.monitor = new.monitor;
        self.window_ct = new.window_ct;
        self.window_ticks = new.window_ticks;
        self.options = new.options;
        self.velocity_max_m_per_s = new.velocity_max_m_per_s;
        self.acceleration_max_m_per_s2 = new.acceleration_max_m_per_s2;
        self.compensator = new.compensator;
    }
}

/// Equal readings in a row that are none.
fn frozen_ticks(s: &Settings) -> u16 {
    if s.encoder_frozen_ticks < 1.0 { u16::MAX } else { s.encoder_frozen_ticks as u16 }
}

/// Thresholds of the monitors.
fn monitor(s: &Settings) -> monitor::Coefficients {
    let window_s = f64::from(monitor::WINDOW_S);
    let to_ct = |m: f64| (m / s.encoder_count_m).min(f64::from(i32::MAX));
    // The code whose value is the limit or next to it on the safe side.
    let highest = |share: f64| libm::floor(share * 65536.0).clamp(0.0, 65535.0) as u16;
    let lowest = |share: f64| libm::ceil(share * 65536.0).clamp(0.0, 65535.0) as u16;
    let celsius = s.temperature_full_scale_c - s.temperature_zero_c;
    let end = |m: f64, margin_m: f64| Position(libm::round((m + margin_m) / s.encoder_count_m) as i64);
    monitor::Coefficients {
        bus_min_code: lowest(s.bus_min_v / s.bus_full_scale_v),
        bus_max_code: highest(s.bus_max_v / s.bus_full_scale_v),
        temperature_max_code: highest((s.temperature_max_c - s.temperature_zero_c) / celsius),
        frozen_ticks: frozen_ticks(s),
        following_error_max_ct: to_ct(s.following_error_max_m) as i32,
        overspeed_ct: to_ct(s.overspeed_m_per_s * window_s) as i32,
        jump_ct: to_ct(s.encoder_jump_m) as i32,
        tick_limit_cycles: s.tick_limit_cycles as u32,
        runaway_ct: to_ct(s.runaway_m_per_s * window_s) as u32,
        opposed_a: (2.0 * s.commutation_check_n / s.force_constant_n_per_a) as f32,
        // Far above noise, far below what so much force does in a window.
        opposed_ct: (to_ct(s.encoder_jump_m) / 50.0) as i32 + 1,
        overload_a2: (s.continuous_current_a * s.continuous_current_a) as f32,
        overload_share: (window_s / s.thermal_time_constant_s) as f32,
        position_min: end(s.travel_min_m, -s.travel_margin_m),
        position_max: end(s.travel_max_m, s.travel_margin_m),
        silent_windows: match libm::round(s.command_timeout_s / window_s) as u32 {
            0 => u32::MAX,
            windows => windows,
        },
    }
}

/// Coefficients of all compensators.
fn compensator(s: &Settings) -> compensator::Coefficients {
    let count_m = s.encoder_count_m;
    let dt_s = f64::from(SERVO_DT_S);
    let hysteresis_ct = libm::round(s.niasa_hysteresis_m / count_m).min(f64::from(i32::MAX)) as i32;
    let dahl = |stiffness: f64, coulomb: f64| dahl::Coefficients {
        stiffness_n_per_m: stiffness as f32,
        coulomb_n: coulomb as f32,
        exponent_per_ct: (stiffness / coulomb * count_m) as f32,
        hysteresis_ct,
    };
    let like_dahl = |stiffness: f64, coulomb: f64| {
        maxwell_slip::Elements::like_dahl(maxwell_slip::MAX_ELEMENTS, stiffness as f32, coulomb as f32)
    };
    let shaped_like_table_4 =
        |stiffness: f64, coulomb: f64| maxwell_slip::GMS_TABLE_4.scaled(stiffness as f32, coulomb as f32);
    let niasa_elements = if s.niasa_elements >= 0.5 { shaped_like_table_4 } else { like_dahl };
    let level = stribeck::Level {
        coulomb_n: s.friction_coulomb_n as f32,
        static_n: s.friction_static_n as f32,
        stribeck_m_per_s: s.friction_stribeck_m_per_s as f32,
        stribeck_shape: 1.0,
    };
    let viscous_n_s_per_m = s.friction_viscous_n_s_per_m as f32;
    let lugre = lugre::Coefficients {
        stiffness_n_per_m: s.friction_stiffness_n_per_m as f32,
        damping_n_s_per_m: s.friction_damping_n_s_per_m as f32,
        viscous_n_s_per_m,
        level,
    };
    let kp_n_per_m = s.velocity_gain_n_s_per_m * (s.position_gain_per_s + s.velocity_integral_per_s);
    compensator::Coefficients {
        kind: choice(&Compensator::ALL, s.compensator),
        niasa: niasa::Coefficients {
            friction: dahl(s.niasa_stiffness_n_per_m, s.niasa_coulomb_n),
            maxwell: maxwell_slip::Coefficients {
                elements: niasa_elements(s.niasa_stiffness_n_per_m, s.niasa_coulomb_n),
                count_m: count_m as f32,
                hysteresis_ct,
            },
            gain_m_per_ct: (count_m * dt_s / s.niasa_time_constant_s) as f32,
            rate_limit_n: s.niasa_rate_limit_n as f32,
            during_profile: choice(&[DuringProfile::Active, DuringProfile::Frozen], s.niasa_frozen_in_profile),
            schedule: choice(&[Schedule::Slope, Schedule::SlopeAndProportional], s.niasa_with_proportional),
        },
        feedforward: feedforward::Coefficients {
            model: choice(&feedforward::Model::ALL, s.feedforward_model),
            coulomb: coulomb::Coefficients { coulomb_n: level.coulomb_n, viscous_n_s_per_m },
            stribeck: stribeck::Coefficients { level, viscous_n_s_per_m },
            dahl: shaped_dahl::Coefficients {
                stiffness_n_per_m: s.friction_stiffness_n_per_m as f32,
                coulomb_n: level.coulomb_n,
                shape: 1.0,
            },
            lugre,
            gms: gms::Coefficients {
                elements: like_dahl(s.friction_stiffness_n_per_m, s.friction_coulomb_n),
                level,
                damping_n_s_per_m: s.friction_damping_n_s_per_m as f32,
                viscous_n_s_per_m,
                law: gms::Law::Attraction { attraction_n_per_s: f32::INFINITY },
            },
        },
        observer: observer::Coefficients {
            lugre,
            // The driving term is to be the integral action k_P/τ_d (7.23): σ_0·k = k_P/τ_d.
            drive_m_per_s_per_ct: (count_m * kp_n_per_m / s.friction_stiffness_n_per_m / s.observer_time_constant_s)
                as f32,
            speed_m_per_s_per_ct: (count_m / dt_s) as f32,
            play_ct: hysteresis_ct,
            limit_n: (s.current_limit_a * s.force_constant_n_per_a) as f32,
            dahl: dahl(s.friction_stiffness_n_per_m, s.friction_coulomb_n),
            integral_m_per_ct: (count_m * dt_s / s.observer_time_constant_s) as f32,
        },
        scheduled: scheduled::Coefficients {
            friction: dahl(s.friction_stiffness_n_per_m, s.friction_coulomb_n),
            share: s.schedule_share as f32,
        },
        disturbance: disturbance::Coefficients {
            bandwidth_per_s: (core::f64::consts::TAU * s.disturbance_bandwidth_hz) as f32,
            momentum_n_s_per_ct: (s.disturbance_mass_kg * count_m / dt_s) as f32,
        },
    }
}

/// The alternative that a number stands for: the nearest one there is.
fn choice<T: Copy>(alternatives: &[T], number: f64) -> T {
    alternatives[(libm::round(number) as usize).min(alternatives.len() - 1)]
}
