//! Every compensator on the same moves (ch. 4, 7).

use super::frequency::friction_turns;
use super::settling::{conditions, table};
use servo_sim::Carriage;

use crate::plot::{Axis, Plot, Series};
use crate::reproduce::compensators::{AMPLITUDE_PERCENT, OBSERVER_SCALED, WITHOUT_DEAD_BAND};
use crate::reproduce::outcome::{ConfigOutcome, Outcome, Run};
use crate::table::number;
use crate::thesis::section::Section;
use crate::thesis::targets::Target;
use crate::thesis::verdict::{Check, judge};

/// Caption of the table of what a settling table does not show.
const CONFIGURATIONS: &str = "rms of the position error while moving, at the end of the profile, in the 500 ms after settling to the \
     finest tolerance and in position (last 500 ms of the dwell of the moves that settled); of all moves in those last 500 ms the error \
     that stays and the unrest about it; force left over when the profile ends, and its share of F_C";

/// Index of ±10 nm in [`crate::settling::TOLERANCES_NM`].
const TEN_NM: usize = 2;

/// Why a friction observer is what it is here: on which moves it fails with friction as it was identified, and what the one that does
/// better than NIASA owes that to.
fn observer_reason(outcome: &Outcome, run: &Run) -> String {
    let of = |name: &str| run.configs.iter().find(|config| config.settling.name == name);
    let mut reason = Vec::new();
    let left_out: Vec<String> = [("lugre-observer", "LuGre"), ("dahl-observer", "Dahl")]
        .into_iter()
        .filter(|_| outcome.complete)
        .filter_map(|(observer, model)| {
            Some(format!("on {model}'s model {}", unsettled_by_stage(outcome, run, of(observer)?)))
        })
        .collect();
    if !left_out.is_empty() {
        let left_out = left_out.join("; ");
        reason.push(format!(
            "With friction as it was identified, moves that are not within ±10 nm at their end: {left_out}"
        ));
    }
    let niasa_ms = of("niasa").and_then(|niasa| niasa.typical_ms(TEN_NM));
    let faster =
        of(OBSERVER_SCALED).filter(|c| c.typical_ms(TEN_NM).zip(niasa_ms).is_some_and(|(ours, niasa)| ours < niasa));
    if let Some(observer) = faster {
        let tuned = outcome.search.iter().flat_map(|search| &search.tuned).find(|tuned| tuned.name == OBSERVER_SCALED);
        reason.push(format!(
            "The LuGre observer with {} is faster than NIASA: at rest its bristles are an integrator, and rolling makes them forget, which \
             an integrator of that rate must do to keep the margins of large motions",
            tuned.map_or(String::new(), |tuned| tuned.chosen.clone()),
        ));
        if let Some(bare) = of(WITHOUT_DEAD_BAND) {
            let settled = |config: &ConfigOutcome| {
                let moves = config.settling.settling_ms.len();
                format!("{} of {moves}", moves - config.settling.unsettled[TEN_NM])
            };
            reason.push(format!(
                "It needs its dead band of {} nm for that: with it {} moves settle to ±10 nm, without it {}, because the noise of |v| \
                 empties the bristles",
                number(observer.parameters.niasa_hysteresis_m * 1e9, 1),
                settled(observer),
                settled(bare)
            ));
        }
    }
    reason.join(". ")
}

/// Of how many moves a configuration does not settle to ±10 nm, by how the stage's friction in the move compares with the model's.
fn unsettled_by_stage(outcome: &Outcome, run: &Run, config: &ConfigOutcome) -> String {
    let model = [config.parameters.friction_stiffness_n_per_m, config.parameters.friction_coulomb_n];
    let mut carriage = Carriage::new(&run.plant, outcome.seed);
    let moves: Vec<([bool; 2], bool)> = (0..)
        .zip(&config.settling.settling_ms)
        .map(|(index, ms)| {
            carriage.redraw_friction(index);
            let stage = carriage.drawn_friction();
            ([0, 1].map(|i| stage[i] < model[i]), ms[TEN_NM].is_none())
        })
        .collect();
    let count = |parameter: usize, lower: bool| {
        let those: Vec<bool> =
            moves.iter().filter(|(is, _)| is[parameter] == lower).map(|(_, left_out)| *left_out).collect();
        format!("{} of {}", those.iter().filter(|left_out| **left_out).count(), those.len())
    };
    format!(
        "{} with a stage softer than the model and {} with a stiffer one; {} with less F_C than the model's and {} with more",
        count(0, true),
        count(0, false),
        count(1, true),
        count(1, false)
    )
}

/// The section: what `reproduce compensators` found.
pub fn section(outcome: &Outcome, run: &Run) -> Section {
    let mut section = Section::new("4 Compensators");
    for (target, place) in [(Target::Feedforward, "4.2.1"), (Target::Observer, "4.2.2"), (Target::ScheduledPd, "4.2.3")]
    {
        let (ours, checks) = claims(outcome, place);
        section = match target {
            Target::Observer => section.judged(target, ours, judge(&checks).because(observer_reason(outcome, run))),
            _ => section.finding(target, ours, &checks),
        };
    }
    section = section.conditions(conditions(&[run]));
    if let Some(search) = &outcome.search {
        section = section
            .text(format!("Each compensator is tuned as well as this procedure can: {}.", search.procedure))
            .text(friction_turns(&run.plant, AMPLITUDE_PERCENT))
            .table(&[], search.table().under("what was chosen, and out of what"));
    }
    section
        .figure(
            &[],
            [means_plot(run)],
            "mean settling time per tolerance with every compensator, where at least half of the moves settled; those that did not are in \
             no mean, and their number stands beside the name",
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
        let name = match config.settling.unsettled.iter().max() {
            Some(left_out) if *left_out > 0 => format!("{} ({left_out} do not settle)", config.settling.name),
            _ => config.settling.name.clone(),
        };
        // The colours repeat after eight: dots tell the second round from the first.
        let series = Series::new(name, i).line(points.iter().copied());
        let dotted = i >= crate::plot::COLOURS;
        plot.series(points.iter().filter(|_| dotted).fold(series, |series, (x, ms)| series.error_bar(*x, *ms, 0.0)))
    });
    plot.height = 460.0;
    plot
}
