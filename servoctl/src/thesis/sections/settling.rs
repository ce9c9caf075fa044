//! What the settling experiments of chapter 9 have in common: their pictures and their checks.

use crate::plot::{Axis, Band, Plot, Series};
use crate::reproduce::outcome::Run;
use crate::settling::Config;
use crate::table::{Table, number};
use crate::thesis::verdict::{Check, Sample, reduction_standard_error_percent};

/// Name of a run with a typographic minus.
pub fn title(run: &Run) -> String {
    run.name.replace('-', "−")
}

/// Index of the configuration without compensator, and of the thesis' NIASA, in every run.
pub const PID: usize = 0;
/// See [`PID`].
pub const NIASA: usize = 1;
/// Index of NIASA as in 7.55, where a run has both forms.
pub const NIASA_7_55: usize = 2;

/// What the runs of a section were made on, by name; where they differ, all of it.
pub fn conditions(runs: &[&Run]) -> Vec<(&'static str, String)> {
    let distinct = |of: &dyn Fn(&Run) -> String| {
        let mut all: Vec<String> = runs.iter().map(|run| of(run)).collect();
        all.dedup();
        all.join("; ")
    };
    vec![
        ("Origin", distinct(&|run| run.conditions().origin)),
        ("Step", distinct(&|run| run.conditions().step)),
        ("Tuning", distinct(&|run| run.conditions().tuning)),
        ("Plant", distinct(&|run| run.conditions().plant)),
        ("Moves", distinct(&|run| format!("{} per configuration", run.settling.moves))),
    ]
}

/// The settling table of a run whose conditions stand at the head of the section.
pub fn table(run: &Run) -> Table {
    let name = if run.name.is_empty() { String::new() } else { format!("{}: ", title(run)) };
    let what = if run.configs.len() <= 3 {
        let of = run.configs.get(NIASA).map_or("", |config| config.settling.name.as_str());
        format!("mean ± standard deviation; reduction by {of}; moves that did not settle, in the order of the columns")
    } else {
        "mean (reduction against PID), where at least half of the moves settled".to_owned()
    };
    run.table().under(format!("{name}settling time after the end of the profile in ms, {what}"))
}

/// Standard errors by which a mean of ours may miss a range of the thesis.
const GRANTED: f64 = 2.0;

/// Name of a configuration for a legend.
pub fn display_name(config: &str) -> String {
    match config {
        "pid" => "PID".to_owned(),
        "pid+niasa" => "PID + NIASA (App. E)".to_owned(),
        "pid+niasa-7.55" => "PID + NIASA (7.55)".to_owned(),
        other => other.to_owned(),
    }
}

/// Mean of a configuration's settling times at a tolerance, with its scatter.
pub fn sample(config: &Config, tolerance: usize) -> Sample {
    let at = |values: &[Option<f64>]| values.get(tolerance).copied().flatten();
    let unsettled = config.unsettled.get(tolerance).copied().unwrap_or(0);
    Sample { mean: at(&config.mean_ms), std: at(&config.std_ms), count: config.settling_ms.len() - unsettled }
}

/// Reduction of the mean of a configuration against PID at a tolerance (%), with its standard error.
pub fn reduction(run: &Run, config: usize, tolerance: usize) -> Option<(f64, f64)> {
    let compared = run.configs.get(config)?;
    let percent = compared.reduction_percent.get(tolerance).copied().flatten()?;
    let samples = [&run.configs[PID].settling, &compared.settling].map(|c| sample(c, tolerance));
    Some((percent, reduction_standard_error_percent(&samples[0], &samples[1])?))
}

/// Tolerances (±, nm) of a run at which a configuration is not faster than PID: none of its moves settles, or more of them than of PID's
/// do not, which are in no mean, or its mean is not below PID's. Where no move of PID's settles there is no mean to be below of.
pub fn slower_at(run: &Run, config: usize) -> Vec<u32> {
    let mean = |config: usize, t: usize| run.configs.get(config)?.settling.mean_ms.get(t).copied().flatten();
    let unsettled = |config: usize, t: usize| run.configs.get(config).map(|c| c.settling.unsettled[t]);
    let faster = |t: usize| mean(config, t).is_some_and(|after| mean(PID, t).is_none_or(|before| after < before));
    let slower = |t: &usize| !faster(*t) || unsettled(config, *t) > unsettled(PID, *t);
    (0..run.settling.tolerances_nm.len()).filter(slower).map(|t| run.settling.tolerances_nm[t]).collect()
}

/// Whether NIASA's mean is below PID's at every tolerance of a run, in words.
pub fn faster_everywhere(run: &Run) -> Check {
    let name = if run.name.is_empty() { String::new() } else { format!("{}: ", title(run)) };
    match slower_at(run, NIASA).as_slice() {
        [] => Check::new(true, format!("{name}NIASA faster at every tolerance")),
        slower => Check::new(false, format!("{name}NIASA not faster at {}", tolerances(slower))),
    }
}

/// Reductions within a range of the thesis (%), two standard errors of ours granted: what is inside, what is outside.
pub fn within_range(run: &Run, (low, high): (f64, f64)) -> Vec<Check> {
    let found = |t: usize| (run.settling.tolerances_nm[t], reduction(run, NIASA, t));
    let fits = |reduction: Option<(f64, f64)>| {
        reduction.is_some_and(|(r, s)| r + GRANTED * s >= low && r - GRANTED * s <= high)
    };
    let (inside, outside): (Vec<_>, Vec<_>) =
        (0..run.settling.tolerances_nm.len()).map(found).partition(|(_, reduction)| fits(*reduction));
    let shown = |found: &[(u32, Option<(f64, f64)>)]| {
        let one = |(tolerance, reduction): &(u32, Option<(f64, f64)>)| match reduction {
            Some((r, s)) => format!("±{tolerance} nm {} ± {} %", number(*r, 1), number(*s, 1)),
            None => format!("±{tolerance} nm without a mean"),
        };
        found.iter().map(one).collect::<Vec<_>>().join(", ")
    };
    let mut checks = Vec::new();
    if !inside.is_empty() {
        checks.push(Check::new(
            true,
            format!("within the thesis' range, two standard errors granted: {}", shown(&inside)),
        ));
    }
    if !outside.is_empty() {
        checks.push(Check::new(false, format!("outside the thesis' range: {}", shown(&outside))));
    }
    checks
}

/// `±3, ±5 nm`.
pub fn tolerances(nm: &[u32]) -> String {
    nm.iter().map(|nm| format!("±{nm}")).collect::<Vec<_>>().join(", ") + " nm"
}

/// Smallest and largest reduction of a configuration over all tolerances: `79.2 to 88.5 %`.
pub fn range_in_words(run: &Run, config: usize) -> String {
    let all = (0..run.settling.tolerances_nm.len()).filter_map(|t| Some(reduction(run, config, t)?.0));
    let (low, high) = all.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), r| (low.min(r), high.max(r)));
    if low > high { crate::table::MISSING.to_owned() } else { format!("{} to {} %", number(low, 1), number(high, 1)) }
}

/// Settling time over tolerance: mean (line) ± standard deviation (bar) of every configuration.
pub fn settling_plot(run: &Run) -> Plot {
    let title = if run.name.is_empty() { String::new() } else { format!("{}: ", title(run)) };
    let description = format!("{title}mean settling time per tolerance");
    let mut plot = Plot::new(description, tolerance_axis(run), Axis::linear(format!("{title}settling time / ms")));
    let configs = run.configs.len() as f64;
    let mut highest_ms = 0.0f64;
    for (i, config) in run.configs.iter().enumerate() {
        let beside = (i as f64 - (configs - 1.0) / 2.0) * 0.12;
        let means: Vec<(f64, f64, f64)> = (0..run.settling.tolerances_nm.len())
            .filter_map(|t| {
                let sample = sample(&config.settling, t);
                Some((t as f64 + beside, sample.mean?, sample.std.unwrap_or(0.0)))
            })
            .collect();
        highest_ms = means.iter().fold(highest_ms, |highest, (_, mean, std)| highest.max(mean + std));
        let line = Series::new(display_name(&config.settling.name), i).line(means.iter().map(|m| (m.0, m.1)));
        plot = plot.series(means.iter().fold(line, |series, (x, mean, std)| series.error_bar(*x, *mean, *std)));
    }
    if highest_ms > 0.0 {
        plot.y = plot.y.range(0.0, highest_ms * 1.05);
    }
    plot
}

/// Reduction over tolerance, mean ± standard error, with the thesis' range.
pub fn reduction_plot(run: &Run, thesis_percent: Option<(f64, f64)>) -> Plot {
    let axes = (tolerance_axis(run), Axis::linear("reduction of the mean / %"));
    let mut plot = Plot::new("Reduction of the mean settling time per tolerance", axes.0, axes.1);
    if let Some((low, high)) = thesis_percent {
        plot = plot.band(Band::y(format!("thesis: {} to {} %", number(low, 1), number(high, 1)), low, high));
    }
    plot = plot.band(Band::y("", 0.0, 0.0));
    let mut lowest = 0.0f64;
    for (i, config) in run.configs.iter().enumerate().skip(NIASA) {
        let points: Vec<(f64, f64, f64)> = (0..run.settling.tolerances_nm.len())
            .filter_map(|t| reduction(run, i, t).map(|(r, s)| (t as f64 + 0.06 * (i as f64 - 1.5), r, s)))
            .collect();
        lowest = points.iter().fold(lowest, |lowest, p| lowest.min(p.1));
        let line = Series::new(display_name(&config.settling.name), i).line(points.iter().map(|p| (p.0, p.1)));
        plot = plot.series(points.iter().fold(line, |series, (x, r, s)| series.error_bar(*x, *r, *s)));
    }
    plot.y = plot.y.range(if lowest < 0.0 { (lowest * 1.1).max(-150.0) } else { 0.0 }, 104.0);
    plot
}

/// A place for each tolerance.
pub fn tolerance_axis(run: &Run) -> Axis {
    Axis::names("tolerance / nm", run.settling.tolerances_nm.iter().map(|nm| format!("±{nm}")))
}

/// A sentence on moves that did not settle, if there are any.
pub fn unsettled(runs: &[&Run]) -> Option<String> {
    let count: usize = runs.iter().flat_map(|r| &r.configs).flat_map(|c| c.settling.unsettled.iter().max()).sum();
    (count > 0).then(|| {
        "A move that is not settled by the end of its dwell counts as unsettled and enters no mean: where the last column has \
         a number, the mean is too short."
            .to_owned()
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::thesis::sections::traces::tests::tiny_run;

    #[test]
    fn a_mean_that_is_not_below_the_baseline_is_slower() {
        // PID 100 and 10 ms, NIASA 20 and 12 ms, at ±3 and ±10 nm.
        let run = tiny_run(&[(100.0, 10.0), (20.0, 12.0)]);
        assert_eq!(slower_at(&run, NIASA), [10]);
        assert_eq!(faster_everywhere(&run).says, "NIASA not faster at ±10 nm");
        assert_eq!(range_in_words(&run, NIASA), "−20.0 to 80.0 %");
    }

    /// The mean of the few that settle says nothing of the others.
    #[test]
    fn a_configuration_that_leaves_more_moves_unsettled_is_not_faster() {
        let mut run = tiny_run(&[(100.0, 100.0), (20.0, 20.0)]);
        run.configs[NIASA].settling.unsettled = vec![3, 0];
        assert_eq!(slower_at(&run, NIASA), [3]);
        run.configs[PID].settling.unsettled = vec![3, 0];
        assert_eq!(slower_at(&run, NIASA), [0u32; 0]);
    }

    #[test]
    fn what_settles_is_faster_than_what_never_does() {
        let mut run = tiny_run(&[(100.0, 100.0), (20.0, 20.0)]);
        (run.configs[PID].settling.mean_ms[0], run.configs[PID].settling.unsettled[0]) = (None, 10);
        assert_eq!(slower_at(&run, NIASA), [0u32; 0]);
        (run.configs[NIASA].settling.mean_ms[0], run.configs[NIASA].settling.unsettled[0]) = (None, 10);
        assert_eq!(slower_at(&run, NIASA), [3]);
    }

    #[test]
    fn a_range_is_granted_two_standard_errors() {
        let run = tiny_run(&[(100.0, 100.0), (20.0, 20.0)]);
        // One standard deviation is a tenth of the mean in both, of ten moves each: 80 ± 0.89 %.
        let (r, s) = reduction(&run, NIASA, 0).unwrap();
        assert!((r - 80.0).abs() < 1e-9 && (s - 20.0 * (0.02f64 / 10.0).sqrt()).abs() < 1e-3, "{r} {s}");
        for (range, holds) in [((81.7, 90.0), true), ((81.9, 90.0), false), ((60.0, 78.3), true), ((60.0, 78.1), false)]
        {
            assert!(within_range(&run, range).iter().all(|c| c.holds == holds), "{range:?}");
        }
    }
}
