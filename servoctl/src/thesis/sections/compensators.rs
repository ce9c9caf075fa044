//! Every compensator on the same moves (ch. 4, 7).

use super::settling::{conditions, table};
use crate::plot::{Axis, Plot, Series};
use crate::reproduce::outcome::{Outcome, Run};
use crate::thesis::section::Section;
use crate::thesis::targets::Target;
use crate::thesis::verdict::{Check, judge};

/// Caption of the table of what a settling table does not show.
const CONFIGURATIONS: &str = "rms of the position error while moving, at the end of the profile, in the 500 ms after settling to the \
     finest tolerance and in position (last 500 ms of the dwell of the moves that settled); of all moves in those last 500 ms the error \
     that stays and the unrest about it; force left over when the profile ends, and its share of F_C";

/// Why a friction observer is what it is here.
const OBSERVER: &str = "With friction as it was identified, an observer limit-cycles on those moves whose friction is softer than the \
     model's (δ < 0 in 7.6). The LuGre observer with about a third of that friction and a fast error term settles all of them, faster than NIASA: at \
     rest its bristles are an integrator, and rolling makes them forget, which an integrator of that rate must do to keep the margins of \
     large motions. It does so only behind a dead band of 4.5 standard deviations of the encoder's noise: without one, the noise of |v| \
     empties the bristles within 20 ms, and no move of ten came to ±5 nm";

/// The section: what `reproduce compensators` found.
pub fn section(outcome: &Outcome, run: &Run) -> Section {
    let mut section = Section::new("4 Compensators");
    for (target, place) in [(Target::Feedforward, "4.2.1"), (Target::Observer, "4.2.2"), (Target::ScheduledPd, "4.2.3")]
    {
        let (ours, checks) = claims(outcome, place);
        section = match target {
            Target::Observer => section.judged(target, ours, judge(&checks).because(OBSERVER)),
            _ => section.finding(target, ours, &checks),
        };
    }
    section = section.conditions(conditions(&[run]));
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
