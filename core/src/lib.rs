//! The control law of the servo drive: every decision it takes, and nothing else.
//!
//! No hardware, no allocation, no clock, no panic: samples go in, set-points and records come out. The firmware, the
//! host tests and the QEMU goldens call the same functions ([`axis::Axis`]) and get the same bits.
//!
//! # Signs
//! `error = set-point − measurement`. Positive current gives positive force, positive force gives positive
//! acceleration, and positive position is where that leads. These three are written here and used everywhere.
//!
//! # Numbers
//! Absolute position is an integer ([`position::Position`], encoder counts). Only differences become `f32`, in SI units,
//! with the unit in the name (`_m`, `_m_per_s`, `_n`, `_a`, `_v`, `_s`, `_ct`). Integrators are `f64`: an `f32` one of
//! 1 N stops counting at increments below 60 nN, which is where settling happens; the Cortex-M7 adds `f64` in hardware.
//! Transcendental functions come from `libm` by name, so that host and target agree to the bit.
//!
//! # Time
//! The current loop runs once per PWM period ([`PWM_HZ`]), the servo tick in every fifth ([`SERVO_HZ`]).
#![no_std]

pub mod alignment;
pub mod axis;
pub mod black_box;
pub mod capture;
pub mod cascade;
pub mod compensator;
pub mod config;
pub mod current;
pub mod drive;
pub mod encoder;
pub mod fault;
pub mod fingerprint;
pub mod friction;
pub mod image;
pub mod math;
pub mod measure;
pub mod monitor;
pub mod parameters;
pub mod position;
pub mod profile;
pub mod record;
pub mod refusal;
pub mod settling;
pub mod state;
pub mod store;

/// PWM and current-loop frequency, Hz.
pub const PWM_HZ: u32 = 40_000;
/// PWM periods per servo tick.
pub const PERIODS_PER_TICK: u32 = 5;
/// Servo rate, Hz.
pub const SERVO_HZ: u32 = PWM_HZ / PERIODS_PER_TICK;
/// Servo sample time, s.
pub const SERVO_DT_S: f32 = 1.0 / SERVO_HZ as f32;
/// PWM period, s.
pub const PWM_DT_S: f32 = 1.0 / PWM_HZ as f32;
/// Timer counts from valley to peak of the centre-aligned carrier: 200 MHz / (2 × 40 kHz). A compare value is the
/// high-side on-time in these counts, `0..=PWM_TOP`.
pub const PWM_TOP: u16 = 2500;
