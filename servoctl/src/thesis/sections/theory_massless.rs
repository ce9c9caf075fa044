//! Settling without inertia (7.4, 7.5): figures 34 to 44.

use super::super::section::Section;
use super::super::targets::Target;
use super::super::verdict::Check;
use crate::table::{MISSING, Table, number};
use crate::theory::figures::{DELTA, KP_RATIOS, Map};
use crate::theory::{Method, TheoryError};
use servo_sim::Stage;

/// Points of a map in each direction.
const POINTS: usize = 61;

/// Largest k_P/σ at which the thesis' observer has an unstable region.
const LAST_UNSTABLE: f64 = 0.407;
/// Largest k_P/σ at which the thesis shows a change of more than 1000 %.
const LAST_ABOVE_1000_PERCENT: f64 = 0.0675;
/// σ of the 25 trials: mean, least, most (N/µm).
const TRIALS_N_PER_UM: (f64, f64, f64) = (8.46, 4.17, 16.79);

/// One figure of the thesis: NIASA and observer at one k_P/σ.
#[derive(Debug, Clone, PartialEq)]
pub struct Pair {
    /// k_P/σ.
    pub kp_ratio: f64,
    /// Left half.
    pub niasa: Map,
    /// Right half.
    pub observer: Map,
}

/// All figures.
///
/// # Errors
/// None that the built-in ranges could cause.
pub fn compute() -> Result<Vec<Pair>, TheoryError> {
    let map = |method, kp_ratio| Map::new(method, kp_ratio, POINTS, POINTS);
    let pair = |kp_ratio| {
        Ok(Pair { kp_ratio, niasa: map(Method::Niasa, kp_ratio)?, observer: map(Method::Observer, kp_ratio)? })
    };
    KP_RATIOS.into_iter().map(pair).collect()
}

/// The section.
pub fn section(pairs: &[Pair], stage: &Stage) -> Section {
    let section = Section::new("7.4, 7.5 Theory without inertia")
        .finding(Target::StiffnessRange, stiffness_in_words(stage), &stiffness_checks(stage))
        .finding(Target::MasslessObserver, shares_in_words(pairs), &observer_checks(pairs))
        .finding(Target::MasslessNiasa, niasa_in_words(pairs), &niasa_checks(pairs))
        .finding(Target::MasslessExtremes, extremes_in_words(pairs), &extremes_checks(pairs))
        .text(
            "Computed, not simulated: equations 7.31 and 7.32 with the factor (1 + δ) where it belongs, at the plant's exponential \
             alone. As printed, they have no unstable region. Unstable means that the denominator reaches zero on the way.",
        )
        .table(&[], table(pairs));
    pairs.iter().zip(34..).fold(section, |section, (pair, number)| {
        section.figure(
            &[number],
            [pair.niasa.plot(), pair.observer.plot()],
            format!(
                "change of the 2 % settling time over initial error and δ, k_P = {} σ, against a perfect model: NIASA (left) and \
                 friction observer (right).",
                pair.kp_ratio
            ),
        )
    })
}

fn observer_checks(pairs: &[Pair]) -> Vec<Check> {
    let check = |(low, high): (f64, f64), unstable: bool| {
        let of = |pair: &&Pair| (low..=high).contains(&pair.kp_ratio);
        let wrong: Vec<String> = pairs
            .iter()
            .filter(of)
            .filter(|pair| (pair.observer.unstable_share() > 0.0) != unstable)
            .map(|pair| pair.kp_ratio.to_string())
            .collect();
        let what = if unstable { "an unstable region" } else { "no unstable region" };
        match wrong.as_slice() {
            [] => Check::new(true, format!("{what} for k_P/σ from {low} to {high}")),
            wrong => Check::new(false, format!("{what} expected, but not found, at k_P/σ = {}", wrong.join(", "))),
        }
    };
    vec![check((KP_RATIOS[0], LAST_UNSTABLE), true), check((0.549, 1.0), false)]
}

fn shares_in_words(pairs: &[Pair]) -> String {
    let unstable: Vec<&Pair> = pairs.iter().filter(|pair| pair.observer.unstable_share() > 0.0).collect();
    match (unstable.first(), unstable.last()) {
        (Some(first), Some(last)) => format!(
            "present from {} ({} % of the map) to {} ({} %), absent above",
            first.kp_ratio,
            number(100.0 * first.observer.unstable_share(), 0),
            last.kp_ratio,
            number(100.0 * last.observer.unstable_share(), 0)
        ),
        _ => "absent everywhere".to_owned(),
    }
}

/// Cells of a pair where both methods are stable: number, and how many in which NIASA changes more.
fn more_sensitive(pair: &Pair) -> (usize, usize) {
    let both = pair.niasa.change_percent.iter().zip(&pair.observer.change_percent);
    let both: Vec<(f64, f64)> = both.filter_map(|(n, o)| Some(((*n)?, (*o)?))).collect();
    (both.len(), both.iter().filter(|(niasa, observer)| niasa.abs() > observer.abs() + 1e-9).count())
}

fn niasa_checks(pairs: &[Pair]) -> Vec<Check> {
    let unstable = pairs.iter().filter(|pair| pair.niasa.unstable_share() > 0.0).count();
    let (cells, worse) = pairs.iter().map(more_sensitive).fold((0, 0), |(c, w), (cells, worse)| (c + cells, w + worse));
    vec![
        Check::new(unstable == 0, format!("NIASA unstable in {unstable} of {} maps", pairs.len())),
        Check::new(worse == 0, format!("NIASA more sensitive in {worse} of the {cells} points where both are stable")),
    ]
}

fn niasa_in_words(pairs: &[Pair]) -> String {
    let changes = |map: fn(&Pair) -> &Map| {
        let all = pairs.iter().map(|pair| map(pair).extremes_percent());
        let (low, high) = all.fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), (low, high)| (l.min(low), h.max(high)));
        format!("{} to {} %", number(low, 0), number(high, 0))
    };
    format!("changes of {}; observer where stable {}", changes(|p| &p.niasa), changes(|p| &p.observer))
}

fn extremes_checks(pairs: &[Pair]) -> Vec<Check> {
    pairs
        .iter()
        .filter(|pair| pair.kp_ratio <= 0.091)
        .map(|pair| {
            let most = pair.observer.extremes_percent().1.max(pair.niasa.extremes_percent().1);
            let holds = (most > 1000.0) == (pair.kp_ratio <= LAST_ABOVE_1000_PERCENT);
            Check::new(holds, format!("at {} up to {} %", pair.kp_ratio, number(most, 0)))
        })
        .collect()
}

fn extremes_in_words(pairs: &[Pair]) -> String {
    let above = pairs.iter().filter(|pair| pair.observer.extremes_percent().1 > 1000.0);
    let names: Vec<String> = above.map(|pair| pair.kp_ratio.to_string()).collect();
    if names.is_empty() { "for none".to_owned() } else { format!("for k_P/σ = {} (observer)", names.join(", ")) }
}

fn stiffness_in_words(stage: &Stage) -> String {
    let sigma = stage.friction.stiffness_n_per_m * 1e-6;
    match &stage.friction.spread {
        None => format!("{} N/µm, not drawn", number(sigma, 2)),
        Some(spread) => format!(
            "{} ({} to {}) N/µm drawn per move; δ {} to {} of the mean of the trials",
            number(sigma, 2),
            number(spread.stiffness_min_n_per_m * 1e-6, 2),
            number(spread.stiffness_max_n_per_m * 1e-6, 2),
            number(spread.stiffness_min_n_per_m * 1e-6 / TRIALS_N_PER_UM.0 - 1.0, 2),
            number(spread.stiffness_max_n_per_m * 1e-6 / TRIALS_N_PER_UM.0 - 1.0, 2),
        ),
    }
}

fn stiffness_checks(stage: &Stage) -> Vec<Check> {
    let limits = stage.friction.spread.as_ref();
    let delta = |sigma: Option<f64>| sigma.map(|n_per_m| n_per_m * 1e-6 / TRIALS_N_PER_UM.0 - 1.0);
    let near = |value: f64| (value - 0.02, value + 0.02);
    vec![
        Check::within("least δ", delta(limits.map(|l| l.stiffness_min_n_per_m)), near(DELTA.0), 3, ""),
        Check::within("largest δ", delta(limits.map(|l| l.stiffness_max_n_per_m)), near(DELTA.1), 3, ""),
    ]
}

fn table(pairs: &[Pair]) -> Table {
    let header = [
        "k_P/σ",
        "observer unstable / % of map",
        "observer, change / %",
        "NIASA unstable / % of map",
        "NIASA, change / %",
    ];
    let caption = "Change of the 2 % settling time against a perfect model, least to largest over the stable part of each map \
                   (0.05 ≤ e0 ≤ 1 x_c, −0.5 ≤ δ ≤ 1). Computed";
    pairs.iter().fold(Table::new(caption, &header), |table, pair| {
        let change = |map: &Map| match map.extremes_percent() {
            (low, high) if low <= high => format!("{} to {}", number(low, 0), number(high, 0)),
            _ => MISSING.to_owned(),
        };
        let share = |map: &Map| number(100.0 * map.unstable_share(), 1);
        table.row([
            pair.kp_ratio.to_string(),
            share(&pair.observer),
            change(&pair.observer),
            share(&pair.niasa),
            change(&pair.niasa),
        ])
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::thesis::verdict::{Outcome, judge};

    #[test]
    fn the_claims_of_section_7_5_hold() {
        let section = section(&compute().unwrap(), &Stage::default());
        for finding in &section.findings {
            assert_eq!(finding.verdict.outcome, Outcome::Reproduced, "{finding:?}");
        }
    }

    #[test]
    fn a_stable_observer_or_an_unstable_niasa_would_be_seen() {
        let mut pairs = compute().unwrap();
        // Exchanged, everything that section 7.5 says is wrong.
        for pair in &mut pairs {
            std::mem::swap(&mut pair.niasa, &mut pair.observer);
        }
        assert_eq!(judge(&observer_checks(&pairs)).outcome, Outcome::Partly);
        assert_eq!(judge(&niasa_checks(&pairs)).outcome, Outcome::NotReproduced);
    }
}
