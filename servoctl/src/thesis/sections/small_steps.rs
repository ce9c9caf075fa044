//! Small steps (9.4): 5 µm, just beyond pre-rolling, and 50 nm, inside it; both tunings.

use super::settling::{
    NIASA, conditions, faster_everywhere, range_in_words, reduction_plot, settling_plot, table, title, unsettled,
};
use super::traces::{Traces, position_plot};
use crate::reproduce::outcome::Run;
use crate::table::{MISSING, number};
use crate::thesis::section::Section;
use crate::thesis::targets::Target;
use crate::thesis::verdict::{Check, judge};

/// Finest tolerance (±, nm) at which the thesis has 0 ms with NIASA and the second tuning.
const AT_ONCE_NM: u32 = 6;

/// The section of 5 µm: a run per tuning.
pub fn five_micrometres(runs: &[&Run]) -> Section {
    let section = compared(Section::new("9.4 Steps of 5 µm"), Target::FiveMicrometres, runs);
    with_figures(section, runs, &[75, 76])
}

/// The section of 50 nm: a run per tuning; `traces` are of PID and NIASA for each tuning.
pub fn fifty_nanometres(runs: &[&Run], traces: &[Traces]) -> Section {
    let mut section = compared(Section::new("9.4 Steps of 50 nm"), Target::FiftyNanometres, runs);
    if let Some(second) = runs.get(1) {
        section = at_once(section, second);
    }
    section = with_figures(section, runs, &[77, 78]);
    for (pair, numbers) in traces.chunks_exact(2).zip([[79, 81], [80, 82]]) {
        section = section.figure(
            &numbers,
            [position_plot(&pair[0]), position_plot(&pair[1])],
            format!(
                "{} moves with the {} tuning: PID (left) and NIASA as in appendix E (right); every move drawn upwards",
                pair[0].moves.len(),
                pair[0].name
            ),
        );
    }
    section
}

fn compared(section: Section, target: Target, runs: &[&Run]) -> Section {
    let checks: Vec<Check> = runs.iter().map(|run| faster_everywhere(run)).collect();
    let moves = runs.first().map_or(0, |run| run.settling.moves);
    let of = |run: &&Run| format!("{} with the {} tuning", range_in_words(run, NIASA), title(run));
    let ours = runs.iter().map(of).collect::<Vec<_>>().join(", ");
    section.finding(target, format!("reduction {ours}; {moves} moves"), &checks).conditions(conditions(runs))
}

/// Settling times of NIASA from ±6 nm up, against 0 ms.
fn at_once(section: Section, run: &Run) -> Section {
    let niasa = &run.configs[NIASA];
    let coarse = || (0..run.settling.tolerances_nm.len()).filter(|t| run.settling.tolerances_nm[*t] >= AT_ONCE_NM);
    let check = |t: usize| {
        let mean_ms = niasa.settling.mean_ms[t];
        let shown = mean_ms.map_or(MISSING.to_owned(), |ms| number(ms, 1));
        Check::new(mean_ms == Some(0.0), format!("±{} nm {shown} ms", run.settling.tolerances_nm[t]))
    };
    let checks: Vec<Check> = coarse().map(check).collect();
    let ours =
        coarse().filter_map(|t| niasa.settling.mean_ms[t].map(|ms| number(ms, 1))).collect::<Vec<_>>().join(", ");
    let tolerances: Vec<u32> = coarse().map(|t| run.settling.tolerances_nm[t]).collect();
    let tau_d_ms = 1e3 * niasa.parameters.niasa_time_constant_s;
    let reason = niasa.end_error_rms_nm.filter(|nm| *nm > f64::from(AT_ONCE_NM)).map_or(String::new(), |nm| {
        format!(
            "When the profile ends the error is still {} nm rms: the profile lasts {} ms and τ_d is {} ms, so a first-order \
             approach has {} % of its lag left",
            number(nm, 0),
            number(run.step.profile_ms, 1),
            number(tau_d_ms, 0),
            number(100.0 * libm::exp(-run.step.profile_ms / tau_d_ms), 0)
        )
    });
    let verdict = judge(&checks).because(reason);
    section.judged(
        Target::FiftyNanometresAtOnce,
        format!("{ours} ms at {}", super::settling::tolerances(&tolerances)),
        verdict,
    )
}

fn with_figures(mut section: Section, runs: &[&Run], numbers: &[u8]) -> Section {
    for (run, number) in runs.iter().zip(numbers) {
        section = section
            .figure(
                &[*number],
                [settling_plot(run), reduction_plot(run, None)],
                format!(
                    "{} tuning: settling time after the end of the profile (left), mean ± standard deviation, and its reduction (right)",
                    title(run)
                ),
            )
            .table(&[], table(run));
    }
    match unsettled(runs) {
        Some(note) => section.text(note),
        None => section,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::thesis::sections::traces::tests::tiny_run;
    use crate::thesis::verdict::Outcome;

    #[test]
    fn settled_at_once_means_a_mean_of_zero_from_six_nanometres_up() {
        let verdict = |at_10_nm| {
            let run = tiny_run(&[(100.0, 50.0), (20.0, at_10_nm)]);
            at_once(Section::new(""), &run).findings[0].verdict.clone()
        };
        assert_eq!(verdict(0.0).outcome, Outcome::Reproduced);
        let slower = verdict(8.0);
        assert_eq!(slower.outcome, Outcome::NotReproduced);
        assert!(slower.why().contains("±10 nm 8.0 ms. When the profile ends the error is still"), "{}", slower.why());
    }
}
