//! The first experiment (9.1): 250 steps of 5 mm at 1 m/s², PID 100 Hz / 45° without feedforward.

use super::settling::{
    NIASA, NIASA_7_55, conditions, faster_everywhere, range_in_words, reduction_plot, settling_plot, table, unsettled,
    within_range,
};
use super::traces::{Traces, error_plot};
use crate::reproduce::outcome::Run;
use crate::table::number;
use crate::thesis::section::Section;
use crate::thesis::targets::Target;
use crate::thesis::verdict::{Check, judge};

/// Reduction of the mean settling time in the thesis (%), over all tolerances.
pub const THESIS_PERCENT: (f64, f64) = (80.5, 87.4);

/// What a reduction is relative to.
fn baseline(run: &Run) -> String {
    format!(
        "A reduction is against the PID, and how long that takes is set by its k_I, which the thesis does not print: here {}·10⁶ N/(m s), \
         so that inside pre-rolling it creeps with the time constant 2σ/k_I = {} s",
        number(run.tuning.ki_n_per_m_s * 1e-6, 1),
        number(2.0 * run.plant.friction.stiffness_n_per_m / run.tuning.ki_n_per_m_s, 2)
    )
}

/// The section; `traces` are of PID and of NIASA.
pub fn section(run: &Run, traces: &[Traces]) -> Section {
    let mut checks: Vec<Check> = vec![faster_everywhere(run)];
    checks.extend(within_range(run, THESIS_PERCENT));
    let ours = format!(
        "{} as in appendix E, {} as in 7.55; {} moves",
        range_in_words(run, NIASA),
        range_in_words(run, NIASA_7_55),
        run.settling.moves
    );
    let mut section = Section::new("9.1 First experiment: 5 mm at 1 m/s²")
        .judged(Target::FirstExperiment, ours, judge(&checks).because(baseline(run)))
        .conditions(conditions(&[run]))
        .figure(
            &[3, 63, 64],
            [settling_plot(run), reduction_plot(run, Some(THESIS_PERCENT))],
            "settling time after the end of the profile (left), mean ± standard deviation, and its reduction by NIASA (right), mean \
             ± standard error",
        )
        .table(&[], table(run));
    if let Some(note) = unsettled(&[run]) {
        section = section.text(note);
    }
    if let [pid, niasa] = traces {
        section = section
            .figure(
                &[65],
                [error_plot(pid, 400.0, 1000.0), error_plot(pid, 400.0, 100.0)],
                format!("position error after the profile with PID alone, {} moves, coarse and fine", pid.moves.len()),
            )
            .figure(
                &[66, 67],
                [error_plot(niasa, 400.0, 1000.0), error_plot(niasa, 400.0, 100.0)],
                "the same moves with NIASA as in appendix E, coarse and fine",
            );
    }
    section.text(
        "Appendix E adds the slope of the modelled friction to a linear integral that stays as it is; equation 7.55 has k_P in the \
         integral too, and the drive freezes it while the profile moves. Both are shown; the thesis' numbers are held against \
         appendix E, which is what its drive ran.",
    )
}
