//! The second experiment (9.2): 500 steps of 5 mm at 10 m/s², PID 315 Hz / 50° with acceleration feedforward.

use super::settling::{
    NIASA, PID, conditions, faster_everywhere, range_in_words, reduction, settling_plot, slower_at, table, title,
    tolerance_axis, tolerances, unsettled, within_range,
};
use super::traces::{Traces, error_plot};
use crate::plot::{Axis, Band, Plot, Series};
use crate::reproduce::outcome::Run;
use crate::table::{MISSING, Table, number};
use crate::thesis::section::Section;
use crate::thesis::targets::Target;
use crate::thesis::verdict::{Check, judge};

/// Reduction of the mean settling time in the thesis (%), over all tolerances.
pub const THESIS_PERCENT: (f64, f64) = (50.5, 73.0);

/// Tolerance that single numbers are shown for (±, nm).
const SHOWN_NM: u32 = 10;

/// The section: a run per mass error; `traces` are of PID and NIASA for each of some runs, in pairs.
pub fn section(runs: &[&Run], traces: &[Traces]) -> Section {
    let checks = checks(runs);
    let ours =
        runs.iter().map(|run| format!("{}: {}", title(run), range_in_words(run, NIASA))).collect::<Vec<_>>().join("; ");
    let mut section = Section::new("9.2 Second experiment: 5 mm at 10 m/s²")
        .judged(Target::SecondExperiment, ours, judge(&checks).because(why_slower(runs)))
        .conditions(conditions(runs).into_iter().map(|(name, value)| (name, if name == "Tuning" { tuning(runs) } else { value })))
        .text(
            "How large the error of the feedforward mass was, the thesis does not say. It decides: while the stage brakes, the loop \
             holds (m − m_ff)·a; when the profile ends, that force is left over, and it has to be unlearned against friction. \
             One per cent of 1.8 kg at 10 m/s² is 0.18 N, more than a quarter of F_C.",
        )
        .table(&[], left_over_table(runs))
        .figure(&[70], [reductions_plot(runs)], "reduction of the mean settling time by NIASA (App. E)")
        .figure(
            &[69],
            runs.iter().map(|run| settling_plot(run)).collect::<Vec<_>>(),
            "settling time after the end of the profile, mean ± standard deviation",
        );
    for pair in traces.chunks_exact(2) {
        let (name, moves) = (pair[0].name.replace('-', "−"), pair[0].moves.len());
        section = section
            .figure(
                &[71, 73],
                [error_plot(&pair[0], 250.0, 1000.0), error_plot(&pair[1], 250.0, 1000.0)],
                format!("position error after the profile, {name}: PID (left) and with NIASA (right), {moves} moves"),
            )
            .figure(
                &[72, 74],
                [error_plot(&pair[0], 250.0, 100.0), error_plot(&pair[1], 250.0, 100.0)],
                format!("the last 100 nm of the same moves, {name}: PID (left) and with NIASA (right)"),
            );
    }
    section = runs.iter().fold(section, |section, run| section.table(&[], table(run)));
    match unsettled(runs) {
        Some(note) => section.text(note),
        None => section,
    }
}

/// The tuning that the runs have in common.
fn tuning(runs: &[&Run]) -> String {
    let crossover = runs
        .first()
        .map_or(String::new(), |r| format!("{} Hz / {}°", r.tuning.crossover_hz, r.tuning.phase_margin_deg));
    format!("{crossover}, acceleration feedforward with the mass error shown")
}

/// Faster at every tolerance, for each mass error; and within the thesis' range for at least one of them.
fn checks(runs: &[&Run]) -> Vec<Check> {
    let mut checks: Vec<Check> = runs.iter().map(|run| faster_everywhere(run)).collect();
    let fitting: Vec<String> = runs
        .iter()
        .filter(|run| within_range(run, THESIS_PERCENT).iter().all(|check| check.holds))
        .map(|run| title(run))
        .collect();
    checks.push(match fitting.as_slice() {
        [] => Check::new(false, "in the thesis' range at all tolerances for no mass error"),
        some => Check::new(true, format!("in the thesis' range at all tolerances for {}", some.join(", "))),
    });
    checks
}

/// For each run in which NIASA is slower somewhere: the force left over, and how far PID alone is by then.
fn why_slower(runs: &[&Run]) -> String {
    let reason = |run: &&Run| {
        let slower = slower_at(run, NIASA);
        let coarsest = slower.iter().max()?;
        let t = run.settling.tolerances_nm.iter().position(|nm| nm == coarsest)?;
        let pid_ms = run.configs[PID].settling.mean_ms[t]?;
        let niasa_ms = run.configs[NIASA].settling.mean_ms[t]?;
        Some(format!(
            "at {} {} N are left over ({} % of F_C) and PID alone is inside ±{coarsest} nm {} ms after the profile, NIASA {} ms",
            title(run),
            number(run.tuning.terminal_force_n, 2),
            number(100.0 * run.tuning.terminal_force_per_coulomb, 0),
            number(pid_ms, 1),
            number(niasa_ms, 1),
        ))
    };
    let reasons: Vec<String> = runs.iter().filter_map(reason).collect();
    if reasons.is_empty() {
        return String::new();
    }
    format!(
        "Where NIASA is slower there is little to unlearn: {}. An integral that acts on so little pushes the stage out again",
        reasons.join("; ")
    )
}

fn left_over_table(runs: &[&Run]) -> Table {
    let header = [
        "mass error",
        "left over / N",
        "of F_C / %",
        "error at the end / nm rms",
        "PID to ±10 nm / ms",
        "NIASA to ±10 nm / ms",
        "reduction / %",
        "NIASA not faster at",
    ];
    let title = "Force left over when the profile ends, and what it does";
    runs.iter().fold(Table::new(title, &header), |table, run| {
        let t = run.settling.tolerances_nm.iter().position(|nm| *nm == SHOWN_NM);
        let mean = |config: usize| t.and_then(|t| run.configs.get(config)?.settling.mean_ms[t]);
        let shown = |value: Option<f64>, decimals| value.map_or(MISSING.to_owned(), |v| number(v, decimals));
        let slower = slower_at(run, NIASA);
        table.row([
            run.tuning.feedforward_mass_error_percent.map_or(MISSING.to_owned(), |p| format!("{} %", signed(p))),
            number(run.tuning.terminal_force_n, 3),
            number(100.0 * run.tuning.terminal_force_per_coulomb, 0),
            shown(run.configs[PID].end_error_rms_nm, 0),
            shown(mean(PID), 1),
            shown(mean(NIASA), 1),
            shown(t.and_then(|t| reduction(run, NIASA, t)).map(|r| r.0), 1),
            if slower.is_empty() { MISSING.to_owned() } else { tolerances(&slower) },
        ])
    })
}

/// A line per mass error.
fn reductions_plot(runs: &[&Run]) -> Plot {
    let x = runs.first().map_or(Axis::linear("tolerance / nm"), |run| tolerance_axis(run));
    let y = Axis::linear("reduction of the mean / %").range(-100.0, 100.0);
    let thesis = format!("thesis: {} to {} %", number(THESIS_PERCENT.0, 1), number(THESIS_PERCENT.1, 1));
    let plot = Plot::new("Reduction of the mean settling time per tolerance and mass error", x, y)
        .band(Band::y(thesis, THESIS_PERCENT.0, THESIS_PERCENT.1))
        .band(Band::y("", 0.0, 0.0));
    let mut plot = runs.iter().enumerate().fold(plot, |plot, (i, run)| {
        let points =
            (0..run.settling.tolerances_nm.len()).filter_map(|t| Some((t as f64, reduction(run, NIASA, t)?.0)));
        let name = run.tuning.feedforward_mass_error_percent.map_or(run.name.clone(), |p| format!("{} %", signed(p)));
        let points: Vec<(f64, f64)> = points.collect();
        let series = Series::new(name, i).line(points.iter().copied());
        plot.series(points.iter().fold(series, |series, (x, r)| series.error_bar(*x, *r, 0.0)))
    });
    plot.height = 360.0;
    plot
}

/// A number with its sign, for a zero none.
fn signed(percent: f64) -> String {
    let digits = number(percent, if percent.fract() == 0.0 { 0 } else { 1 });
    if percent > 0.0 { format!("+{digits}") } else { digits }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::thesis::sections::traces::tests::tiny_run;
    use crate::thesis::verdict::Outcome;

    fn named(name: &str, times_ms: &[(f64, f64)]) -> Run {
        Run { name: name.into(), ..tiny_run(times_ms) }
    }

    #[test]
    fn faster_everywhere_and_in_range_for_one_mass_error_is_reproduced() {
        let fitting = named("a", &[(100.0, 100.0), (40.0, 40.0)]);
        let faster = named("b", &[(100.0, 100.0), (5.0, 5.0)]);
        assert_eq!(judge(&checks(&[&fitting, &faster])).outcome, Outcome::Reproduced);
        assert_eq!(why_slower(&[&fitting, &faster]), "");
    }

    #[test]
    fn slower_somewhere_is_in_part_and_says_where_and_why() {
        let fitting = named("a", &[(100.0, 100.0), (40.0, 40.0)]);
        let slower = named("b", &[(100.0, 2.0), (5.0, 8.8)]);
        let verdict = judge(&checks(&[&fitting, &slower])).because(why_slower(&[&fitting, &slower]));
        assert_eq!(verdict.outcome, Outcome::Partly);
        for expected in
            ["b: NIASA not faster at ±10 nm", "PID alone is inside ±10 nm 2.0 ms after the profile, NIASA 8.8 ms"]
        {
            assert!(verdict.why().contains(expected), "{}", verdict.why());
        }
    }
}
