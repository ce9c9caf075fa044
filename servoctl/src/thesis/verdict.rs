//! Verdicts: what the thesis states, held against what was computed. Pure functions of the data; nothing is typed in.

use serde::Serialize;

use crate::table::{MISSING, number};

/// How a statement of the thesis fares.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Outcome {
    /// All of it holds.
    Reproduced,
    /// Some of it holds.
    Partly,
    /// None of it holds.
    NotReproduced,
    /// This run did not compute it.
    NotComputed,
}

impl Outcome {
    /// In words.
    pub fn words(self) -> &'static str {
        match self {
            Outcome::Reproduced => "reproduced",
            Outcome::Partly => "partly reproduced",
            Outcome::NotReproduced => "not reproduced",
            Outcome::NotComputed => "not computed",
        }
    }
}

/// One thing that a statement of the thesis says, and whether the data say it too.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Check {
    /// Whether it holds.
    pub holds: bool,
    /// What the data say, with numbers; reads well whether it holds or not.
    pub says: String,
}

impl Check {
    /// A statement.
    pub fn new(holds: bool, says: impl Into<String>) -> Check {
        Check { holds, says: says.into() }
    }

    /// A number between two limits, both included; a number that does not exist is outside.
    pub fn within(what: &str, value: Option<f64>, (low, high): (f64, f64), decimals: usize, unit: &str) -> Check {
        let holds = value.is_some_and(|v| (low..=high).contains(&v));
        let shown = value.map_or(MISSING.to_owned(), |v| number(v, decimals));
        let limits = format!("{} to {}", number(low, decimals), number(high, decimals));
        let place = if holds { "within" } else { "outside" };
        Check::new(holds, with_unit(&format!("{what} {shown}"), unit) + &format!(" ({place} {limits})"))
    }
}

/// A verdict: the outcome, and why in words.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Verdict {
    /// How the statement fares.
    pub outcome: Outcome,
    /// What the data say otherwise, with numbers.
    pub fails: Vec<String>,
    /// What they confirm, with numbers.
    pub holds: Vec<String>,
    /// Why something fails; may be empty.
    pub reason: String,
}

impl Verdict {
    /// The verdict on something that the run did not get to.
    pub fn not_computed() -> Verdict {
        let none = Vec::new;
        Verdict { outcome: Outcome::NotComputed, fails: none(), holds: none(), reason: String::new() }
    }

    /// Adds a reason; a verdict that is [`Outcome::Reproduced`] needs none and stays as it is.
    #[must_use]
    pub fn because(mut self, reason: impl Into<String>) -> Verdict {
        if self.outcome != Outcome::Reproduced {
            self.reason = reason.into();
        }
        self
    }

    /// All of it in words: what fails, what holds, the reason.
    pub fn why(&self) -> String {
        let (fails, holds) = (self.fails.join("; "), self.holds.join("; "));
        let what = match (fails.is_empty(), holds.is_empty()) {
            (false, false) => format!("Not: {fails}. But: {holds}"),
            (false, true) => fails,
            _ => holds,
        };
        if self.reason.is_empty() { what } else { format!("{what}. {}", self.reason) }
    }

    /// In short: what fails; nothing if nothing does.
    pub fn brief(&self) -> String {
        self.fails.join("; ")
    }
}

/// Reproduced if every check holds, not if none does (or there is none), else partly.
pub fn judge(checks: &[Check]) -> Verdict {
    let (held, failed): (Vec<&Check>, Vec<&Check>) = checks.iter().partition(|check| check.holds);
    let outcome = match (held.is_empty(), failed.is_empty()) {
        (false, true) => Outcome::Reproduced,
        (false, false) => Outcome::Partly,
        (true, _) => Outcome::NotReproduced,
    };
    let said = |checks: &[&Check]| checks.iter().map(|check| check.says.clone()).collect::<Vec<_>>();
    let fails = if checks.is_empty() { vec!["there are no data".to_owned()] } else { said(&failed) };
    Verdict { outcome, fails, holds: said(&held), reason: String::new() }
}

/// A text with a unit behind it, if there is one.
fn with_unit(text: &str, unit: &str) -> String {
    if unit.is_empty() { text.to_owned() } else { format!("{text} {unit}") }
}

/// Standard error of the reduction of one mean against another (%), from means, sample standard deviations and numbers of
/// samples; the two series count as independent. `None` where a mean is missing or the baseline's is not positive.
///
/// For r = 100 (1 − b/a) to first order: s_r = 100 (b/a) √((s_a/a)²/n_a + (s_b/b)²/n_b).
pub fn reduction_standard_error_percent(baseline: &Sample, compared: &Sample) -> Option<f64> {
    let (a, b) = (baseline.mean?, compared.mean?);
    if a <= 0.0 || baseline.count == 0 || compared.count == 0 {
        return None;
    }
    let error = |s: &Sample| s.std.unwrap_or(0.0) / libm::sqrt(s.count as f64);
    // (b/a)·s_b/b is written s_b/a: it exists where b is zero.
    Some(100.0 * libm::hypot(b / a * error(baseline) / a, error(compared) / a))
}

/// Mean and scatter of one series.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sample {
    /// Arithmetic mean.
    pub mean: Option<f64>,
    /// Sample standard deviation.
    pub std: Option<f64>,
    /// Number of values.
    pub count: usize,
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn check(holds: bool) -> Check {
        Check::new(holds, if holds { "a holds" } else { "b fails" })
    }

    #[test]
    fn all_is_reproduced_some_is_partly_none_is_not() {
        assert_eq!(judge(&[check(true), check(true)]).outcome, Outcome::Reproduced);
        assert_eq!(judge(&[check(true), check(false)]).outcome, Outcome::Partly);
        assert_eq!(judge(&[check(false)]).outcome, Outcome::NotReproduced);
    }

    #[test]
    fn without_data_nothing_is_reproduced() {
        assert_eq!(judge(&[]).outcome, Outcome::NotReproduced);
        assert!(!Check::within("x", None, (0.0, 1.0), 1, "").holds);
        assert!(!Check::within("x", Some(f64::NAN), (0.0, 1.0), 1, "").holds);
    }

    #[test]
    fn a_verdict_in_part_says_what_fails_and_then_what_holds() {
        assert_eq!(judge(&[check(true), check(false)]).why(), "Not: b fails. But: a holds");
        assert_eq!(judge(&[check(true), check(false)]).brief(), "b fails");
        assert_eq!(judge(&[]).why(), "there are no data");
    }

    #[test]
    fn a_number_is_shown_with_its_limits() {
        let says = |value| Check::within("±3 nm", Some(value), (80.5, 87.4), 1, "%").says;
        assert_eq!(says(81.0), "±3 nm 81.0 % (within 80.5 to 87.4)");
        assert_eq!(says(88.46), "±3 nm 88.5 % (outside 80.5 to 87.4)");
    }

    #[test]
    fn a_reason_is_given_only_where_something_fails() {
        assert_eq!(judge(&[check(true)]).because("Of the mass").why(), "a holds");
        assert_eq!(judge(&[check(false)]).because("Of the mass").why(), "b fails. Of the mass");
    }

    #[test]
    fn the_error_of_a_reduction_is_that_of_both_means() {
        let sample = |mean, std| Sample { mean: Some(mean), std: Some(std), count: 25 };
        // 100 ± 10 and 20 ± 5 of 25: b/a = 0.2, errors of the means 2 and 1.
        let error = reduction_standard_error_percent(&sample(100.0, 10.0), &sample(20.0, 5.0)).unwrap();
        assert!((error - 100.0 * (0.004f64.powi(2) + 0.01f64.powi(2)).sqrt()).abs() < 1e-12);
        assert_eq!(reduction_standard_error_percent(&sample(0.0, 1.0), &sample(20.0, 5.0)), None);
        let at_once = reduction_standard_error_percent(&sample(100.0, 10.0), &sample(0.0, 0.0)).unwrap();
        assert_eq!(at_once, 0.0);
    }

    proptest! {
        #[test]
        fn the_outcome_depends_only_on_how_many_hold(holds in proptest::collection::vec(any::<bool>(), 1..12)) {
            let checks: Vec<Check> = holds.iter().map(|h| check(*h)).collect();
            let expected = match holds.iter().filter(|h| **h).count() {
                0 => Outcome::NotReproduced,
                n if n == holds.len() => Outcome::Reproduced,
                _ => Outcome::Partly,
            };
            prop_assert_eq!(judge(&checks).outcome, expected);
        }
    }
}
