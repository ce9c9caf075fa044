//! The moves that were made, and what those like the last one say about settling.

use std::collections::VecDeque;

use serde::Serialize;
use servo_core::compensator::Compensator;
use servo_core::profile::Limits;
use servo_core::settling::{Settling, TOLERANCES, TOLERANCES_NM};

use crate::cli::drive::settled::Report;
use crate::settling::{Config, SettlingExperiment};

/// Moves that are remembered.
const REMEMBERED: usize = 200;
/// Moves of a kind that the statistics take in.
const IN_STATISTICS: usize = 20;

/// A move that was made, and how it settled.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Moved {
    /// Counted from 1.
    pub number: u32,
    /// Distance, m, with its sign.
    pub by_m: f64,
    /// Compensator by name.
    pub compensator: &'static str,
    /// Time from the end of the profile to the last error beyond each tolerance, ms; `None`: still outside when it was looked at.
    pub settling_ms: [Option<f64>; TOLERANCES],
    /// How far it went past the target, nm.
    pub overshoot_nm: f64,
    /// Root mean square of the error in position, nm; `None`: it was still creeping when it was looked at.
    pub rms_nm: Option<f64>,
    /// Largest minus smallest error in position, nm.
    pub peak_to_peak_nm: Option<f64>,
    #[serde(skip)]
    kind: Kind,
}

/// What makes moves comparable: distance, limits and all parameters but the choice of the compensator.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Kind {
    /// Distance without sign, counts.
    pub distance_ct: u64,
    /// Limits.
    pub limits: Limits,
    /// Counts up whenever a parameter is changed.
    pub parameters: u32,
}

/// The moves of one server.
#[derive(Clone, Debug, Default)]
pub struct Moves {
    made: u32,
    last: VecDeque<Moved>,
}

impl Moves {
    /// Number of the next move.
    pub fn next_number(&self) -> u32 {
        self.made + 1
    }

    /// Takes in a move over `by_ct` counts of `count_m` that settled like this.
    pub fn add(&mut self, by_ct: i64, kind: Kind, compensator: Compensator, settling: &Settling, count_m: f64) {
        self.made += 1;
        let nm = |counts: f64| counts * count_m * 1e9;
        // In position only: what is still creeping is no noise.
        let noise = settling.noise_ct2.filter(|_| Report::is_quiet(settling));
        if self.last.len() == REMEMBERED {
            self.last.pop_front();
        }
        self.last.push_back(Moved {
            number: self.made,
            by_m: by_ct as f64 * count_m,
            compensator: compensator.name(),
            settling_ms: std::array::from_fn(|index| settling.settled_after_s(index).map(|s| 1e3 * s)),
            overshoot_nm: nm(f64::from(settling.overshoot_ct)),
            rms_nm: noise.map(|square| nm(f64::from(square).sqrt())),
            peak_to_peak_nm: noise.map(|_| nm(f64::from(settling.noise_peak_to_peak_ct))),
            kind,
        });
    }

    /// The last moves, oldest first.
    pub fn last(&self) -> impl Iterator<Item = &Moved> {
        self.last.iter()
    }

    /// Moves like the last one: first those without compensator, then those with the one that was used last. `None` before the
    /// first move; a configuration without moves is left out.
    pub fn settling(&self) -> Option<SettlingExperiment> {
        let kind = self.last.back()?.kind;
        let alike = || self.last.iter().rev().filter(|moved| moved.kind == kind);
        let none = Compensator::None.name();
        let other = alike().map(|moved| moved.compensator).find(|name| *name != none);
        let configs = [Some(none), other].into_iter().flatten().filter_map(|name| {
            let moves: Vec<&Moved> = alike().filter(|moved| moved.compensator == name).take(IN_STATISTICS).collect();
            let times: Vec<Vec<Option<f64>>> = moves.iter().map(|moved| moved.settling_ms.to_vec()).collect();
            let squares: Vec<f64> = moves.iter().filter_map(|moved| Some(moved.rms_nm?.powi(2))).collect();
            let rms = (!squares.is_empty()).then(|| (squares.iter().sum::<f64>() / squares.len() as f64).sqrt());
            (!moves.is_empty()).then(|| Config::new(name, &TOLERANCES_NM, &times, rms))
        });
        Some(SettlingExperiment::new(&TOLERANCES_NM, configs.collect()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const COUNT_M: f64 = 1e-10;
    const KIND: Kind = Kind {
        distance_ct: 50_000_000,
        limits: Limits { velocity_m_per_s: 0.1, acceleration_m_per_s2: 1.0, jerk_m_per_s3: None },
        parameters: 0,
    };

    /// All tolerances left for the last time after so many ms.
    fn settled(after_ms: u32) -> Settling {
        Settling {
            ticks: 16_000,
            settled_after_ticks: [8 * after_ms; TOLERANCES],
            noise_ct2: Some(100.0),
            ..Settling::default()
        }
    }

    #[test]
    fn a_move_is_shown_in_the_units_of_people() {
        let mut moves = Moves::default();
        let settling = Settling { overshoot_ct: 70, noise_peak_to_peak_ct: 40, ..settled(20) };
        moves.add(-50_000_000, KIND, Compensator::Niasa, &settling, COUNT_M);
        let moved = moves.last().next().unwrap();
        assert_eq!((moved.number, moved.compensator), (1, "niasa"));
        assert!((moved.by_m + 5e-3).abs() < 1e-15);
        assert_eq!(moved.settling_ms[0], Some(20.0));
        let near = |value: f64, expected: f64| (value - expected).abs() < 1e-9;
        assert!(near(moved.overshoot_nm, 7.0) && near(moved.rms_nm.unwrap(), 1.0));
        assert!(near(moved.peak_to_peak_nm.unwrap(), 4.0));
    }

    #[test]
    fn creeping_is_no_noise() {
        let mut moves = Moves::default();
        moves.add(1, KIND, Compensator::None, &settled(1900), COUNT_M);
        let moved = moves.last().next().unwrap();
        assert_eq!((moved.rms_nm, moved.peak_to_peak_nm), (None, None));
    }

    #[test]
    fn without_and_with_are_compared_over_moves_of_one_kind() {
        let mut moves = Moves::default();
        assert!(moves.settling().is_none());
        let other = Kind { distance_ct: 1, ..KIND };
        let retuned = Kind { parameters: 1, ..KIND };
        for (kind, compensator, after_ms) in [
            (other, Compensator::None, 900),
            (retuned, Compensator::None, 800),
            (KIND, Compensator::None, 100),
            (KIND, Compensator::None, 300),
            (KIND, Compensator::Feedforward, 70),
            (KIND, Compensator::Niasa, 50),
        ] {
            moves.add(50_000_000, kind, compensator, &settled(after_ms), COUNT_M);
        }
        let settling = moves.settling().unwrap();
        let names: Vec<_> = settling.configs.iter().map(|config| config.name.as_str()).collect();
        assert_eq!(names, ["pid", "niasa"]);
        assert_eq!((settling.configs[0].mean_ms[0], settling.configs[1].mean_ms[0]), (Some(200.0), Some(50.0)));
        assert_eq!(settling.reduction_percent[0], Some(75.0));
    }

    #[test]
    fn old_moves_are_forgotten_but_counted() {
        let mut moves = Moves::default();
        for _ in 0..REMEMBERED + 5 {
            moves.add(1, KIND, Compensator::None, &settled(1), COUNT_M);
        }
        assert_eq!((moves.last().count(), moves.next_number()), (REMEMBERED, REMEMBERED as u32 + 6));
        assert_eq!(moves.settling().unwrap().configs[0].settling_ms.len(), IN_STATISTICS);
    }
}
