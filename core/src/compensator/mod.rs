//! What acts beside the PID to deal with friction: one of several, chosen at run time without a bump.
//!
//! A compensator sees the tick ([`Situation`]) and answers with an [`Action`]: force added at once, force added to an integrator
//! that the drive keeps, a factor on the PID's proportional and derivative part. The drive sums and limits; a compensator knows
//! nothing of limits, power or switching.

pub mod disturbance;
pub mod feedforward;
pub mod niasa;
pub mod observer;
pub mod scheduled;

use crate::position::Position;
use crate::profile::Setpoint;

/// Which compensator acts.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Compensator {
    /// PID only.
    #[default]
    None,
    /// NIASA on the Dahl model's slope (7.55).
    Niasa,
    /// NIASA on the slope of a Maxwell-slip model, which remembers more than the last reversal.
    NiasaMaxwell,
    /// A friction model driven by the reference (4.2.1).
    Feedforward,
    /// Friction observer on the LuGre model, driven by the position error (4.4, 4.5).
    LugreObserver,
    /// Friction observer on the Dahl model beside integral action (7.20).
    DahlObserver,
    /// PD gains scheduled by the Dahl model's slope, no integral action (4.2.3).
    ScheduledPd,
    /// Disturbance observer: nominal mass and a first-order filter.
    DisturbanceObserver,
}

impl Compensator {
    /// All of them; the index is the value of the parameter `compensator`.
    pub const ALL: [Compensator; 8] = [
        Compensator::None,
        Compensator::Niasa,
        Compensator::NiasaMaxwell,
        Compensator::Feedforward,
        Compensator::LugreObserver,
        Compensator::DahlObserver,
        Compensator::ScheduledPd,
        Compensator::DisturbanceObserver,
    ];

    /// Name for people and command lines.
    pub const fn name(self) -> &'static str {
        match self {
            Compensator::None => "pid",
            Compensator::Niasa => "niasa",
            Compensator::NiasaMaxwell => "niasa-maxwell",
            Compensator::Feedforward => "feedforward",
            Compensator::LugreObserver => "lugre-observer",
            Compensator::DahlObserver => "dahl-observer",
            Compensator::ScheduledPd => "scheduled-pd",
            Compensator::DisturbanceObserver => "disturbance-observer",
        }
    }
}

/// Coefficients of every compensator; the chosen one uses its own.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Coefficients {
    /// Which one acts.
    pub kind: Compensator,
    /// NIASA, on either model.
    pub niasa: niasa::Coefficients,
    /// Friction feedforward.
    pub feedforward: feedforward::Coefficients,
    /// Friction observers.
    pub observer: observer::Coefficients,
    /// Scheduled PD.
    pub scheduled: scheduled::Coefficients,
    /// Disturbance observer.
    pub disturbance: disturbance::Coefficients,
}

/// The tick as a compensator sees it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Situation {
    /// Measured position.
    pub position: Position,
    /// Movement since the last tick, counts.
    pub step_ct: i32,
    /// Set-point − position, counts.
    pub error_ct: i32,
    /// The reference.
    pub reference: Setpoint,
    /// k_P of the parallel form, N/m.
    pub proportional_n_per_m: f32,
    /// Force of the last tick, N.
    pub force_n: f32,
}

/// What a compensator does in one tick.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Action {
    /// Force added in this tick, N.
    pub direct_n: f32,
    /// Force added to the compensator's integrator, N.
    pub increment_n: f32,
    /// The cascade's own integrator stands still.
    pub replaces_integral: bool,
    /// Factor on the cascade's proportional and derivative part.
    pub gain: f32,
    /// A limit of the compensator's own acts.
    pub limited: bool,
    /// Modelled friction, N, for the record.
    pub friction_n: f32,
    /// Modelled slope of friction, N/m, for the record.
    pub slope_n_per_m: f32,
}

impl Action {
    /// Nothing.
    pub const NONE: Action = Action {
        direct_n: 0.0,
        increment_n: 0.0,
        replaces_integral: false,
        gain: 1.0,
        limited: false,
        friction_n: 0.0,
        slope_n_per_m: 0.0,
    };
}

/// The memory of the compensator that acts.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum Memory {
    /// [`Compensator::None`].
    None,
    /// [`Compensator::Niasa`].
    Niasa(niasa::OnDahl),
    /// [`Compensator::NiasaMaxwell`].
    NiasaMaxwell(niasa::OnMaxwell),
    /// [`Compensator::Feedforward`].
    Feedforward(feedforward::State),
    /// [`Compensator::LugreObserver`].
    LugreObserver(observer::OnLugre),
    /// [`Compensator::DahlObserver`].
    DahlObserver(observer::OnDahl),
    /// [`Compensator::ScheduledPd`].
    ScheduledPd(scheduled::State),
    /// [`Compensator::DisturbanceObserver`].
    DisturbanceObserver(disturbance::State),
}

impl Memory {
    /// The memory of `kind`, relaxed at `position`, while the integrators hold `integral_n`; and what they are to hold from now on.
    pub fn start(kind: Compensator, position: Position, integral_n: f64) -> (Memory, f64) {
        let memory = match kind {
            Compensator::None => Memory::None,
            Compensator::Niasa => Memory::Niasa(niasa::OnDahl::relaxed(position)),
            Compensator::NiasaMaxwell => Memory::NiasaMaxwell(niasa::OnMaxwell::relaxed(position)),
            Compensator::Feedforward => Memory::Feedforward(feedforward::State::RELAXED),
            Compensator::LugreObserver => Memory::LugreObserver(observer::OnLugre::relaxed(position)),
            Compensator::DahlObserver => Memory::DahlObserver(observer::OnDahl::relaxed(position)),
            Compensator::ScheduledPd => Memory::ScheduledPd(scheduled::State::relaxed(position)),
            // It estimates the whole of the force that the integrators held: leaving it there as well would count it twice.
            Compensator::DisturbanceObserver => {
                return (Memory::DisturbanceObserver(disturbance::State::estimating(integral_n)), 0.0);
            }
        };
        (memory, integral_n)
    }

    /// The factor on the cascade's proportional and derivative part in the last tick.
    pub fn gain(&self, k: &Coefficients, proportional_n_per_m: f32) -> f32 {
        match self {
            Memory::ScheduledPd(scheduled) => scheduled.gain(&k.scheduled, proportional_n_per_m),
            _ => 1.0,
        }
    }

    /// What to do in this tick.
    #[inline]
    pub fn act(&mut self, k: &Coefficients, tick: &Situation) -> Action {
        match self {
            Memory::None => Action::NONE,
            Memory::Niasa(niasa) => niasa.act(&k.niasa, tick),
            Memory::NiasaMaxwell(niasa) => niasa.act(&k.niasa, tick),
            Memory::Feedforward(feedforward) => feedforward.act(&k.feedforward, tick),
            Memory::LugreObserver(observer) => observer.act(&k.observer, tick),
            Memory::DahlObserver(observer) => observer.act(&k.observer, tick),
            Memory::ScheduledPd(scheduled) => scheduled.act(&k.scheduled, tick),
            Memory::DisturbanceObserver(observer) => observer.act(&k.disturbance, tick),
        }
    }
}
