//! Crossovers at small amplitude (8.2): what they are, and why they are not the thesis'.

use std::f64::consts::TAU;

use servo_host_tests::tuning::conservative_friction;

use super::frequency::{at, first_crossover, first_crossovers, name};
use crate::reproduce::loop_transmission::{Curve, LoopTransmission, RATES_PER_S, SECTION_8_2_PERCENT};
use crate::table::{MISSING, number};
use crate::thesis::verdict::{Check, Verdict, judge};

/// Crossover in the thesis: PID, σ̂ = 4 and 8 N/µm (Hz).
const SMALL_HZ: [f64; 3] = [15.0, 50.0, 90.0];
/// Resonance beside it (Hz).
const THESIS_RESONANCE_HZ: f64 = 400.0;
/// How far a crossover may be off where the thesis says "about" (share).
const ABOUT: f64 = 0.2;

/// The amplitude that section 8.2 calls small: the largest whose force alone cannot make the stage roll.
fn small_percent(measured: &LoopTransmission) -> f64 {
    let holds = |c: &&Curve| c.amplitude_n < measured.plant.friction.coulomb_n;
    let largest = measured.section_8_2.iter().filter(holds).map(|c| c.amplitude_percent).fold(f64::NAN, f64::max);
    if largest.is_nan() { SECTION_8_2_PERCENT[SECTION_8_2_PERCENT.len() - 1] } else { largest }
}

/// The small amplitude, the crossovers there in words, and the verdict.
pub(super) fn small_crossovers(measured: &LoopTransmission) -> (f64, String, Verdict) {
    let percent = small_percent(measured);
    let curves = at(measured, percent);
    let of_rate =
        |rate: f64| curves.iter().filter(move |c| c.rate_per_s.is_some_and(|r| (r / rate - 1.0).abs() < 0.01));
    let mut checks = Vec::new();
    let range = |hz: f64| (hz * (1.0 - ABOUT), hz * (1.0 + ABOUT));
    if let Some(pid) = curves.first() {
        checks.push(Check::within("PID", first_crossover(pid), range(SMALL_HZ[0]), 1, "Hz"));
        let lifted = curves[1..].iter().all(|c| first_crossover(c) > first_crossover(pid));
        checks.push(Check::new(
            lifted,
            format!("NIASA {} it in every case", if lifted { "lifts" } else { "does not lift" }),
        ));
    }
    let mut words = vec![curves.first().map_or(String::new(), |pid| first_crossovers(&[pid]))];
    for rate in RATES_PER_S {
        for (curve, hz) in of_rate(rate).zip(&SMALL_HZ[1..]) {
            let what = format!("{} at {} 1/s", name(curve), number(rate, 0));
            checks.push(Check::within(&what, first_crossover(curve), range(*hz), 1, "Hz"));
        }
        let both: Vec<&Curve> = of_rate(rate).copied().collect();
        words.push(format!("{} with 1/τ_d = {} 1/s", first_crossovers(&both), number(rate, 0)));
    }
    let words = words.join("; ").replacen(MISSING, "below 3", 1);
    (percent, format!("at {percent} % of full current {words}"), judge(&checks).because(reason(measured)))
}

/// Why the small-amplitude crossovers are not the thesis': what sets them here, and what its own numbers ask for.
fn reason(measured: &LoopTransmission) -> String {
    let spring = 2.0 * measured.plant.friction.stiffness_n_per_m;
    let hz_of = |n_per_m_s: f64, spring: f64| n_per_m_s / spring / TAU;
    let resonance = measured.plant.mechanics.mass_kg * libm::pow(TAU * THESIS_RESONANCE_HZ, 2.0);
    let asked = SMALL_HZ[0] * TAU * resonance;
    let [slow, fast] = RATES_PER_S.map(|rate| [4e6, 8e6].map(|s| number(SMALL_HZ[0] + hz_of(s * rate, resonance), 0)));
    format!(
        "On a contact that is a spring k, the loop crosses over where its integral action does, at (k_I + σ̂/τ_d)/2πk. Here \
         k = 2σ = {} N/µm and k_I = {} N/(m s) (a cascade with this crossover and margin could have {}), so PID alone \
         crosses over at {} Hz; the thesis' 15 Hz with its resonance near {} Hz, which is k = {} N/µm at this mass, ask for \
         k_I = {} N/(m s). With such a k and k_I the same formula gives {}, {} and {} Hz with 1/τ_d = 100 1/s and {}, {} and \
         {} Hz with 2π·100 1/s: the thesis' numbers are those of the second reading. Both are shown, neither is claimed",
        number(spring * 1e-6, 1),
        power(measured.section_8_2_ki_n_per_m_s),
        power(measured.section_8_2_ki_most_n_per_m_s),
        number(hz_of(measured.section_8_2_ki_n_per_m_s, spring), 1),
        number(THESIS_RESONANCE_HZ, 0),
        number(resonance * 1e-6, 1),
        power(asked),
        number(SMALL_HZ[0], 0),
        slow[0],
        slow[1],
        number(SMALL_HZ[0], 0),
        fast[0],
        fast[1],
    )
}

/// `2.9·10⁸`, for k_I.
fn power(value: f64) -> String {
    let exponent = libm::floor(libm::log10(value.max(1.0)));
    let digits: String =
        (exponent as i32).to_string().chars().map(|c| "⁰¹²³⁴⁵⁶⁷⁸⁹".chars().nth(c as usize - 48).unwrap_or(c)).collect();
    format!("{}·10{digits}", number(value / libm::pow(10.0, exponent), 1))
}

/// Motion at the first crossover, PID first, and how far a reversal's slope reaches, in words: what happens between spring and mass.
pub(super) fn between(measured: &LoopTransmission) -> String {
    let percent = SECTION_8_2_PERCENT[1];
    let moves = |c: &&Curve| {
        let hz = first_crossover(c)?;
        let nearest = |i: &usize| (c.frequency_hz[*i] / hz).ln().abs();
        let i = (0..c.frequency_hz.len()).min_by(|a, b| nearest(a).total_cmp(&nearest(b)))?;
        Some(format!("{} Hz ({} nm)", number(hz, 1), number(*c.motion_nm.get(i)?, 0)))
    };
    let curves = at(measured, percent);
    let coulomb_n = conservative_friction(&measured.plant).1;
    let mut reach_nm: Vec<f64> = curves.iter().filter_map(|c| Some(coulomb_n / c.stiffness_n_per_m? * 1e9)).collect();
    reach_nm.dedup();
    reach_nm.truncate(2);
    let reach: Vec<String> = reach_nm.iter().map(|nm| number(*nm, 0)).collect();
    format!(
        "At {percent} % of full current, between spring and mass, PID alone happens to cross over where the thesis says, but \
         the contact gives way there: the first crossovers and the amplitudes of the motion at them are {}. That is far \
         beyond F̂_C/σ̂ = {} nm, over which the scheduled slope fades; twice the σ̂ changes nothing, as what NIASA adds in a \
         cycle is bounded by F̂_C and its rate limit.",
        curves.iter().filter_map(moves).collect::<Vec<_>>().join(", "),
        reach.join(" and ")
    )
}

/// What the spring alone would give.
pub(super) fn expected_in_words(measured: &LoopTransmission) -> String {
    let spring = 2.0 * measured.plant.friction.stiffness_n_per_m;
    let of = |rate: f64| {
        let of_rate = |c: &&Curve| c.rate_per_s.is_some_and(|r| (r / rate - 1.0).abs() < 0.01);
        let smallest = at(measured, SECTION_8_2_PERCENT[SECTION_8_2_PERCENT.len() - 1]);
        let pairs = smallest.into_iter().filter(of_rate).map(|c| {
            let integral = measured.section_8_2_ki_n_per_m_s + c.stiffness_n_per_m.unwrap_or(0.0) * rate;
            let hz = integral / spring / TAU;
            format!("{} Hz (measured {})", number(hz, 1), first_crossovers(&[c]))
        });
        format!("with 1/τ_d = {} 1/s {}", number(rate, 0), pairs.collect::<Vec<_>>().join(" and "))
    };
    RATES_PER_S.map(of).join(", ")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::thesis::sections::frequency::tests::measured;
    use crate::thesis::verdict::Outcome;

    #[test]
    fn crossovers_are_held_against_15_50_and_90_hz_for_both_rates() {
        let verdict = |hz| small_crossovers(&measured(hz)).2;
        assert_eq!(verdict([15.0, 50.0, 90.0, 50.0, 90.0]).outcome, Outcome::Reproduced);
        let partly = verdict([15.0, 22.0, 28.0, 56.0, 94.0]);
        assert_eq!(partly.outcome, Outcome::Partly);
        assert_eq!(partly.fails.len(), 2, "{:?}", partly.fails);
        assert_eq!(verdict([3.0, 2.0, 2.0, 2.0, 2.0]).outcome, Outcome::NotReproduced);
    }

    /// The thesis' own numbers: a resonance near 400 Hz of 1.8 kg and 15 Hz of PID give 50 and 86 Hz for 4 and 8 N/µm with 2π·100 1/s.
    #[test]
    fn the_reason_counts_what_the_thesis_numbers_ask_for() {
        let reason = reason(&measured([15.0; 5]));
        for words in
            ["k = 11.4 N/µm", "15, 21 and 26 Hz", "15, 50 and 85 Hz", "k_I = 2.0·10⁸ N/(m s)", "at 1.8 Hz", "1.1·10⁹"]
        {
            assert!(reason.contains(words), "{words}: {reason}");
        }
    }
}
