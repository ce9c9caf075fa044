//! Every number that the thesis states, as it prints it: the left-hand side of every comparison.

/// A number, or a few that belong together, of the thesis.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Target {
    /// 3.2
    Stage,
    /// 2
    Models,
    /// 5.1
    LoopByAmplitude,
    /// 5.1
    Resonance,
    /// 5.2
    SecondOrder,
    /// 5.3
    Extrema,
    /// 5.3
    LengthScale,
    /// 6.1
    WorstFit,
    /// 6.2, table 1
    Stiffness,
    /// 6.2, table 1
    Coulomb,
    /// 6.3, table 2
    ProfileAgainstSettling,
    /// 7.4
    StiffnessRange,
    /// 7.5
    MasslessObserver,
    /// 7.5
    MasslessNiasa,
    /// 7.5
    MasslessExtremes,
    /// 7.6
    MassSofterModel,
    /// 7.6
    MassObserverStifferModel,
    /// 7.6
    MassNiasaStifferModel,
    /// 7.6
    MassTuning,
    /// 8.1
    RateLimit,
    /// 8.2
    LargeCrossover,
    /// 8.2
    SmallCrossover,
    /// 8.2
    WithoutRateLimit,
    /// 9
    Profiles,
    /// 9.1
    FirstExperiment,
    /// 9.2
    SecondExperiment,
    /// 9.3, table 3
    InPosition,
    /// 9.4
    FiveMicrometres,
    /// 9.4
    FiftyNanometres,
    /// 9.4
    FiftyNanometresAtOnce,
    /// App. A, table 4
    GmsSum,
    /// 4.2.1
    Feedforward,
    /// 4.2.2
    Observer,
    /// 4.2.3
    ScheduledPd,
    /// 11
    GmsSlope,
    /// 11
    HalfWrong,
}

/// A target as the thesis has it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Printed {
    /// Section.
    pub section: &'static str,
    /// What is stated.
    pub quantity: &'static str,
    /// The numbers, in the thesis' units.
    pub thesis: &'static str,
}

impl Target {
    /// All of them, in the order of the thesis.
    pub const ALL: [Target; 36] = [
        Target::Models,
        Target::Stage,
        Target::Feedforward,
        Target::Observer,
        Target::ScheduledPd,
        Target::LoopByAmplitude,
        Target::Resonance,
        Target::SecondOrder,
        Target::Extrema,
        Target::LengthScale,
        Target::WorstFit,
        Target::Stiffness,
        Target::Coulomb,
        Target::ProfileAgainstSettling,
        Target::StiffnessRange,
        Target::MasslessObserver,
        Target::MasslessNiasa,
        Target::MasslessExtremes,
        Target::MassTuning,
        Target::MassSofterModel,
        Target::MassObserverStifferModel,
        Target::MassNiasaStifferModel,
        Target::RateLimit,
        Target::LargeCrossover,
        Target::SmallCrossover,
        Target::WithoutRateLimit,
        Target::Profiles,
        Target::FirstExperiment,
        Target::SecondExperiment,
        Target::InPosition,
        Target::FiveMicrometres,
        Target::FiftyNanometres,
        Target::FiftyNanometresAtOnce,
        Target::GmsSlope,
        Target::HalfWrong,
        Target::GmsSum,
    ];

    /// What the thesis prints.
    pub fn printed(self) -> Printed {
        let (section, quantity, thesis) = match self {
            Target::Stage => {
                ("3.2", "stage: travel, moving mass, encoder resolution, servo rate", "100 mm, 1.8 kg, 61 pm, 8 kHz")
            }
            Target::Models => (
                "2",
                "friction models fitted to one oscillation",
                "Coulomb better than viscous, both better, Dahl better still, LuGre almost the same, GMS best",
            ),
            Target::Feedforward => (
                "4.2.1",
                "friction feedforward after the profile has ended",
                "does not change the dynamics of settling",
            ),
            Target::Observer => (
                "4.2.2, 7.6",
                "friction observer with a wrong model",
                "rings, limit-cycles or settles more slowly than NIASA",
            ),
            Target::ScheduledPd => ("4.2.3", "gain-scheduled PD", "leaves some steady-state error"),
            Target::LoopByAmplitude => (
                "5.1",
                "loop transmission by amplitude, % of full current",
                "≥ 1.25 % like a mass, ≤ 0.625 % like a spring",
            ),
            Target::Resonance => ("5.1", "resonance at small amplitudes", "between 250 and 420 Hz"),
            Target::SecondOrder => ("5.2", "closed loop", "well approximated by a second-order system"),
            Target::Extrema => (
                "5.3",
                "100 µm step: time between extrema",
                "about 8 ms; 23 ms from −637 to 115 nm; 67 ms from 115 to 19 nm",
            ),
            Target::LengthScale => ("5.3", "length scale of pre-rolling", "about 600 nm; linear down to 3.81 µm"),
            Target::WorstFit => ("6.2", "worst Dahl fit, mean square error", "0.1067 N²"),
            Target::Stiffness => ("6.2, table 1", "σ at 8 / 16 / 32 Hz, N/µm", "8.23 ± 0.94, 8.99 ± 1.70, 8.74 ± 2.46"),
            Target::Coulomb => ("6.2, table 1", "F_C at 8 / 16 / 32 Hz, N", "0.61 ± 0.17, 0.66 ± 0.23, 0.63 ± 0.13"),
            Target::ProfileAgainstSettling => (
                "6.3, table 2",
                "identification profile against settling after steps",
                "σ 8.66 ± 1.84 and 8.73 ± 2.10 N/µm; F_C 0.64 ± 0.18 and 0.58 ± 0.16 N",
            ),
            Target::StiffnessRange => {
                ("7.4", "σ of 25 trials, and the δ that follow", "8.46 (4.17 to 16.79) N/µm, −0.5 < δ < 1")
            }
            Target::MasslessObserver => {
                ("7.5", "massless observer: unstable region by k_P/σ", "present up to 0.407, absent from 0.549")
            }
            Target::MasslessNiasa => ("7.5", "massless NIASA", "stable everywhere, less sensitive than the observer"),
            Target::MasslessExtremes => {
                ("7.5", "changes of settling time above 1000 %", "only for k_P/σ = 0.05 and 0.0675")
            }
            Target::MassTuning => ("7.6", "crossover and phase margin of k_P = 9e5, k_D = 850, m = 1.5", "100 Hz, 45°"),
            Target::MassSofterModel => ("7.6", "δ = 0.1, 0.25, 0.5, 1: NIASA against observer", "NIASA settles faster"),
            Target::MassObserverStifferModel => {
                ("7.6", "δ = −0.05, −0.1, −0.3, −0.5, −0.65: observer", "rings; limit cycle; unstable from −0.3")
            }
            Target::MassNiasaStifferModel => (
                "7.6",
                "δ = −0.05, −0.1, −0.3, −0.5, −0.65: NIASA",
                "settles; significant ringing at −0.5; unstable at −0.65",
            ),
            Target::RateLimit => (
                "8.1",
                "largest change of the integrator per sample, 8.1",
                "2 F_C Δt/τ_d (App. E: 25 counts of 1674 per N)",
            ),
            Target::LargeCrossover => ("8.2", "crossover at large amplitude, PID and with NIASA", "315 Hz, unchanged"),
            Target::SmallCrossover => ("8.2", "crossover at small amplitude: PID, σ̂ = 4, σ̂ = 8 N/µm", "15, 50, 90 Hz"),
            Target::WithoutRateLimit => ("8.2", "NIASA without rate limit at large amplitude", "unstable"),
            Target::Profiles => (
                "9.1, 9.2, 9.4",
                "profiles of 5 mm at 1 and 10 m/s², 5 µm at 100 mm/s² (50 nm at 1 mm/s²)",
                "143, 46, 15 ms; peak speed about 70 mm/s at 1 m/s², 223.5 mm/s at 10 m/s², 698 µm/s for 5 µm",
            ),
            Target::FirstExperiment => (
                "9.1",
                "250 × 5 mm at 1 m/s², PID 100 Hz / 45°: reduction of mean settling time, ±3 to ±100 nm",
                "80.5 to 87.4 %",
            ),
            Target::SecondExperiment => (
                "9.2",
                "500 × 5 mm at 10 m/s², PID 315 Hz / 50°, feedforward: reduction of mean settling time, ±3 to ±100 nm",
                "50.5 to 73.0 %",
            ),
            Target::InPosition => (
                "9.3, table 3",
                "noise in position, nm rms: PID, + NIASA; high performance PID, + NIASA",
                "0.48, 0.50; 0.49, 0.48",
            ),
            Target::FiveMicrometres => ("9.4", "500 × 5 µm, both tunings", "NIASA faster at every tolerance"),
            Target::FiftyNanometres => ("9.4", "500 × 50 nm, both tunings", "NIASA faster at every tolerance"),
            Target::FiftyNanometresAtOnce => {
                ("9.4", "50 nm with the 315 Hz tuning and NIASA: settling time from ±6 nm up", "0 ms")
            }
            Target::GmsSlope => {
                ("11", "question: NIASA with the slope of a GMS model", "\"could [it] perform similarly?\"")
            }
            Target::HalfWrong => ("11", "σ̂ and F̂_C wrong by ±50 %", "substantial performance quite likely"),
            Target::GmsSum => ("App. A, table 4", "sum of the elements' saturation forces", "0.4302 N"),
        };
        Printed { section, quantity, thesis }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::HashSet;

    #[test]
    fn every_target_appears_once_and_has_a_number_or_a_statement() {
        assert_eq!(Target::ALL.iter().collect::<HashSet<_>>().len(), Target::ALL.len());
        // The last variant of the enumeration is not the last of the list; its number is the count.
        assert_eq!(Target::ALL.iter().map(|t| *t as usize).max(), Some(Target::ALL.len() - 1));
        for printed in Target::ALL.map(Target::printed) {
            assert!([printed.section, printed.quantity, printed.thesis].iter().all(|text| !text.is_empty()));
        }
    }
}
