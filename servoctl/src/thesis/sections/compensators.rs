//! Every compensator on the same moves (ch. 4, 7, 11).

use super::settling::{conditions, sample, table, tolerances};
use crate::plot::{Axis, Plot, Series};
use crate::reproduce::outcome::{ConfigOutcome, Outcome, Run};
use crate::thesis::section::Section;
use crate::thesis::targets::Target;
use crate::thesis::verdict::{Check, Verdict, judge};

/// Caption of the table of what a settling table does not show.
const CONFIGURATIONS: &str = "rms of the position error while moving, at the end of the profile, in the 500 ms after settling to the \
     finest tolerance and in position (last 500 ms of the dwell of the moves that settled); of all moves in those last 500 ms the error \
     that stays and the unrest about it; force left over when the profile ends, and its share of F_C";

/// The section: what `reproduce compensators` found.
pub fn section(outcome: &Outcome, run: &Run) -> Section {
    let (gms_ours, gms_verdict) = gms_slope(run);
    let mut section = Section::new("4 Compensators, and the question of chapter 11");
    for (target, place) in [(Target::Feedforward, "4.2.1"), (Target::Observer, "4.2.2"), (Target::ScheduledPd, "4.2.3")]
    {
        let (ours, checks) = claims(outcome, place);
        section = section.finding(target, ours, &checks);
    }
    section = section.judged(Target::GmsSlope, gms_ours, gms_verdict).conditions(conditions(&[run]));
    if let Some(search) = &outcome.search {
        section = section
            .text(format!("Each compensator is tuned as well as this procedure can: {}.", search.procedure))
            .table(&[], search.table().under("what was chosen, and out of what"));
    }
    section
        .figure(
            &[],
            [means_plot(run)],
            "mean settling time per tolerance with every compensator, where at least half of the moves settled",
        )
        .table(&[], table(run))
        .table(&[], outcome.configurations().under(CONFIGURATIONS))
}

/// What was found on the claims of a section of the thesis that can hold or fail.
fn claims(outcome: &Outcome, place: &str) -> (String, Vec<Check>) {
    let claims = outcome.claims.iter().filter(|claim| claim.thesis_section == place);
    let judged: Vec<(&str, bool, &str)> =
        claims.filter_map(|claim| Some((claim.claim, claim.holds?, claim.found.as_str()))).collect();
    let checks = judged.iter().map(|(claim, holds, found)| {
        Check::new(*holds, format!("{claim}: {} ({found})", if *holds { "yes" } else { "no" }))
    });
    (judged.iter().map(|(_, _, found)| *found).collect::<Vec<_>>().join("; "), checks.collect())
}

/// NIASA on the slope of a Maxwell-slip model against NIASA on Dahl's: as fast, within two standard errors, or faster?
fn gms_slope(run: &Run) -> (String, Verdict) {
    let of = |name: &str| run.configs.iter().find(|config| config.settling.name == name);
    let (Some(dahl), Some(maxwell)) = (of("niasa"), of("niasa-maxwell")) else {
        return (crate::table::MISSING.to_owned(), judge(&[]));
    };
    let not_slower = |t: &usize| {
        let (dahl, maxwell) = (sample(&dahl.settling, *t), sample(&maxwell.settling, *t));
        let error = |s: &crate::thesis::verdict::Sample| s.std.unwrap_or(0.0) / libm::sqrt(s.count.max(1) as f64);
        let granted = 2.0 * libm::hypot(error(&dahl), error(&maxwell));
        dahl.mean.zip(maxwell.mean).is_some_and(|(dahl, maxwell)| maxwell <= dahl + granted)
    };
    let nm = &run.settling.tolerances_nm;
    let (good, bad): (Vec<usize>, Vec<usize>) = (0..nm.len()).partition(not_slower);
    let at = |t: &[usize]| tolerances(&t.iter().map(|t| nm[*t]).collect::<Vec<_>>());
    let mut checks = Vec::new();
    if !good.is_empty() {
        checks.push(Check::new(true, format!("as fast as on Dahl's slope, or faster, at {}", at(&good))));
    }
    if !bad.is_empty() {
        checks.push(Check::new(false, format!("slower at {}", at(&bad))));
    }
    let means = |config: &ConfigOutcome| {
        let mean = |ms: &Option<f64>| ms.map_or(crate::table::MISSING.to_owned(), |ms| crate::table::number(ms, 1));
        config.settling.mean_ms.iter().map(mean).collect::<Vec<_>>().join(", ")
    };
    (format!("{} ms; on Dahl's slope {} ms at {}", means(maxwell), means(dahl), tolerances(nm)), judge(&checks))
}

/// A line for each configuration; logarithmic, as they differ by more than ten.
fn means_plot(run: &Run) -> Plot {
    let plot = Plot::new(
        "Mean settling time with every compensator",
        super::settling::tolerance_axis(run),
        Axis::log("settling time / ms"),
    );
    let mut plot = run.configs.iter().enumerate().fold(plot, |plot, (i, config)| {
        let points: Vec<(f64, f64)> = (0..run.settling.tolerances_nm.len())
            .filter_map(|t| Some((t as f64, config.typical_ms(t).filter(|ms| *ms > 0.0)?)))
            .collect();
        if points.is_empty() {
            return plot;
        }
        // The colours repeat after eight: dots tell the second round from the first.
        let series = Series::new(&config.settling.name, i).line(points.iter().copied());
        let dotted = i >= crate::plot::COLOURS;
        plot.series(points.iter().filter(|_| dotted).fold(series, |series, (x, ms)| series.error_bar(*x, *ms, 0.0)))
    });
    plot.height = 460.0;
    plot
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::thesis::sections::traces::tests::tiny_run;
    use crate::thesis::verdict::Outcome as Verdicts;

    #[test]
    fn the_slope_of_a_better_model_is_judged_by_the_means() {
        let verdict = |maxwell: (f64, f64)| {
            let mut run = tiny_run(&[(100.0, 50.0), (40.0, 20.0), maxwell]);
            run.configs[1].settling.name = "niasa".into();
            run.configs[2].settling.name = "niasa-maxwell".into();
            gms_slope(&run).1
        };
        assert_eq!(verdict((38.0, 20.5)).outcome, Verdicts::Reproduced);
        assert_eq!(verdict((38.0, 25.0)).outcome, Verdicts::Partly);
        assert_eq!(verdict((60.0, 25.0)).outcome, Verdicts::NotReproduced);
        assert_eq!(gms_slope(&tiny_run(&[(1.0, 1.0)])).1.outcome, Verdicts::NotReproduced);
    }
}
