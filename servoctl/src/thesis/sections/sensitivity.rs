//! How settling depends on each of NIASA's parameters (8.1, ch. 11), on a stage that is not what the model says (7.4), and on the
//! model whose slope NIASA takes (ch. 11).

use super::settling::{
    NIASA, NIASA_7_55, PID, conditions, range_in_words, reduction, sample, slower_at, table, tolerances,
};
use servo_sim::friction::Element;

use crate::plot::{Axis, Band, Plot, Series};
use crate::reproduce::outcome::{ConfigOutcome, Run};
use crate::reproduce::sensitivity::ON_TABLE_4;
use crate::table::{MISSING, Table, number};
use crate::thesis::section::Section;
use crate::thesis::targets::Target;
use crate::thesis::verdict::{Check, Sample, Verdict, judge};

/// Tolerance that the pictures show (±, nm).
const SHOWN_NM: u32 = 10;
/// Index of the finest tolerance.
const FINEST: usize = 0;
/// Positions of half and twice the nominal value among a parameter's five, after PID.
const HALF_AND_TWICE: [usize; 2] = [2, 4];

/// The section: a run per parameter and form, then one per corner of the stage, then one per form on the curve of table 4.
pub fn section(runs: &[&Run]) -> Section {
    let named = |begins: &str| runs.iter().filter(|run| run.name.starts_with(begins)).copied().collect::<Vec<&Run>>();
    let (corners, slopes) = (named("δ"), named(ON_TABLE_4));
    let others = |run: &&&Run| !run.name.starts_with('δ') && !run.name.starts_with(ON_TABLE_4);
    let parameters: Vec<&Run> = runs.iter().filter(others).copied().collect();
    let (gms_ours, gms_verdict) = gms_slope(&slopes);
    let half_wrong: Vec<&Run> =
        parameters.iter().filter(|run| run.name == "σ̂, App. E" || run.name == "F̂_C, App. E").copied().collect();
    let ours: Vec<String> = half_wrong
        .iter()
        .flat_map(|run| HALF_AND_TWICE.iter().filter_map(|i| Some((*run, *i, run.configs.get(*i)?))))
        .map(|(run, i, config)| format!("{}: {}", config.settling.name, range_in_words(run, i)))
        .collect();
    let section = Section::new("8.1, 11 Sensitivity")
        .judged(Target::HalfWrong, format!("reduction with {}", ours.join("; ")), judge(&checks(&half_wrong)))
        .judged(Target::GmsSlope, gms_ours, gms_verdict)
        .conditions(conditions(&parameters))
        .figure(
            &[],
            parameters.iter().map(|run| parameter_plot(run)).collect::<Vec<_>>(),
            format!(
                "reduction of the mean settling time to ±{SHOWN_NM} nm, each parameter by itself; moves that did not settle are in no mean \
                 (see below)"
            ),
        )
        .table(&[], corner_table(&corners));
    let section = restless(runs).into_iter().chain(at_once(&corners)).fold(section, Section::text);
    let section = section.text(
        "Chapter 11 asks whether the slope of a GMS model could do what Dahl's does. Here the stage has the curve of table 4, steeper at first \
         and longer than an exponential, with the σ and F_C of the other stages. NIASA takes the slope of Dahl's model, of Maxwell slip \
         with Dahl's curve, and of Maxwell slip with the stage's own curve; with the careful σ̂ and F̂_C of 8.1.1 and, “true”, with \
         those of the stage.",
    );
    slopes.iter().chain(&parameters).fold(section, |section, run| section.table(&[], table(run)))
}

/// NIASA on the slope of the stage's own elements against NIASA on Dahl's, with the same σ̂ and F̂_C: as fast, within two standard
/// errors, or faster?
fn gms_slope(runs: &[&Run]) -> (String, Verdict) {
    let (mut words, mut checks) = (Vec::new(), Vec::new());
    for run in runs {
        let of = |name: &str| run.configs.iter().find(|config| config.settling.name == name);
        let form = run.name.split(", ").nth(1).unwrap_or("");
        for (model, dahl, elements) in
            [("", "dahl", "maxwell-table-4"), (", true", "dahl-true", "maxwell-table-4-true")]
        {
            let Some((dahl, elements)) = of(dahl).zip(of(elements)) else { continue };
            let error = |sample: &Sample| sample.std.unwrap_or(0.0) / libm::sqrt(sample.count.max(1) as f64);
            let slower = |t: usize| {
                let [dahl, elements] = [dahl, elements].map(|config| sample(&config.settling, t));
                let granted = 2.0 * libm::hypot(error(&dahl), error(&elements));
                let slow = !dahl.mean.zip(elements.mean).is_some_and(|(dahl, elements)| elements <= dahl + granted);
                let shown = |sample: &Sample| {
                    sample
                        .mean
                        .map_or(MISSING.to_owned(), |ms| format!("{} ± {}", number(ms, 1), number(error(sample), 1)))
                };
                let nm = run.settling.tolerances_nm[t];
                slow.then(|| format!("±{nm} nm ({} against {} ms)", shown(&elements), shown(&dahl)))
            };
            let slow: Vec<String> = (0..run.settling.tolerances_nm.len()).filter_map(slower).collect();
            let says = match slow.as_slice() {
                [] => "as fast as on Dahl's slope at every tolerance".to_owned(),
                slow => format!("slower at {}", slow.join(", ")),
            };
            checks.push(Check::new(slow.is_empty(), format!("{form}{model}: {says}")));
            let t = run.settling.tolerances_nm.iter().position(|nm| *nm == SHOWN_NM).unwrap_or(0);
            let ms = |c: &ConfigOutcome| c.settling.mean_ms[t].map_or(MISSING.to_owned(), |ms| number(ms, 1));
            words.push(format!("{form}{model}: {} ms, on Dahl's slope {} ms", ms(elements), ms(dahl)));
        }
    }
    let words = if words.is_empty() { MISSING.to_owned() } else { format!("to ±{SHOWN_NM} nm {}", words.join("; ")) };
    (words, judge(&checks).because(runs.first().map_or(String::new(), |run| slope_near_the_target(run))))
}

/// How the slopes of the two models differ where a move ends: after a reversal, until the first element slides again.
fn slope_near_the_target(run: &Run) -> String {
    let friction = &run.plant.friction;
    let elements = friction.scaled_elements();
    let reach_m = |element: &Element| element.saturation_n / element.stiffness_n_per_m;
    let Some(first) = elements.as_slice().iter().min_by(|a, b| reach_m(a).total_cmp(&reach_m(b))) else {
        return String::new();
    };
    let way_m = 2.0 * reach_m(first);
    let left = 1.0 - first.stiffness_n_per_m / elements.stiffness_n_per_m();
    let dahl = libm::exp(-friction.stiffness_n_per_m * way_m / friction.coulomb_n);
    format!(
        "After a reversal the slope of the stage's elements is down to {} % within {} nm, where the first of them slides again; Dahl's is \
         still at {} %. The integral of 7.55 is little else than that slope, and weaker by as much over the last nanometres; appendix E \
         has the linear one beside it",
        number(100.0 * left, 0),
        number(way_m * 1e9, 1),
        number(100.0 * dahl, 0)
    )
}

/// Half and twice the nominal value, which is more than ±50 %: faster than PID at every tolerance?
fn checks(runs: &[&Run]) -> Vec<Check> {
    let of = |run: &&Run| {
        let run = *run;
        HALF_AND_TWICE.map(move |i| {
            let name = run.configs.get(i)?.settling.name.clone();
            Some(match slower_at(run, i).as_slice() {
                [] => Check::new(true, format!("{name}: faster than PID at every tolerance")),
                slower => Check::new(false, format!("{name}: not faster at {}", tolerances(slower))),
            })
        })
    };
    runs.iter().flat_map(of).flatten().collect()
}

/// Reduction at one tolerance for each value of a parameter.
fn parameter_plot(run: &Run) -> Plot {
    let names = run.configs.iter().skip(1).map(|c| c.settling.name.split(' ').nth(1).unwrap_or("").to_owned());
    let unit = run.configs.get(1).and_then(|c| c.settling.name.split(' ').nth(2)).unwrap_or("");
    let what = run.name.split(',').next().unwrap_or("");
    let t = run.settling.tolerances_nm.iter().position(|nm| *nm == SHOWN_NM).unwrap_or(0);
    let x = Axis::names(format!("{what} / {unit} ({})", run.name.split(", ").nth(1).unwrap_or("")), names);
    let points: Vec<(f64, f64, f64)> =
        (1..run.configs.len()).filter_map(|i| reduction(run, i, t).map(|(r, s)| ((i - 1) as f64, r, s))).collect();
    let lowest = points.iter().fold(0.0f64, |lowest, p| lowest.min(p.1));
    let y = Axis::linear("reduction / %").range(if lowest < 0.0 { (1.2 * lowest).max(-100.0) } else { 0.0 }, 104.0);
    let mut plot = Plot::new(format!("Reduction over {what}"), x, y).band(Band::y("", 0.0, 0.0));
    let line = Series::new("", 1).line(points.iter().map(|p| (p.0, p.1)));
    plot = plot.series(points.iter().fold(line, |series, (x, r, s)| series.error_bar(*x, *r, *s)));
    plot.height = 240.0;
    plot
}

/// Which configurations leave moves that never come to rest, if there are any.
fn restless(runs: &[&Run]) -> Option<String> {
    let all = runs.iter().flat_map(|run| run.configs.iter().skip(NIASA).map(|config| (run.name.as_str(), config)));
    let found = all.filter_map(|(run, config)| {
        let left_out = config.settling.unsettled.last().filter(|left_out| **left_out > 0)?;
        let of = config.settling.settling_ms.len();
        let unrest = config.restless_nm.map_or(MISSING.to_owned(), |nm| number(nm, 0));
        let name = format!("{}, {}", run.replace('-', "−"), config.settling.name);
        Some(format!("{name}: {left_out} of {of} ({unrest} nm rms over all moves)"))
    });
    let found: Vec<String> = found.collect();
    (!found.is_empty()).then(|| {
        format!(
            "Not every move comes to rest. At the end of their dwell these are still outside every tolerance: {}. They swing: with a modelled \
             friction that is too large for the stage the rate limit lets the integrator gain more in a quarter of a swing than there is \
             friction to hold it. How large F̂_C may be is in docs/control.md; section 8.1.1 of the thesis asks for a conservative one.",
            found.join("; ")
        )
    })
}

/// What a reduction far below zero is relative to: a PID that is inside a coarse tolerance almost at once.
fn at_once(corners: &[&Run]) -> Option<String> {
    let found = |run: &&Run| {
        let run = *run;
        let coarsest = run.settling.tolerances_nm.len().checked_sub(1)?;
        let ms = |config: usize| run.configs.get(config)?.settling.mean_ms[coarsest];
        let (pid, niasa, niasa_7_55) = (ms(PID)?, ms(NIASA)?, ms(NIASA_7_55)?);
        (pid < niasa.min(niasa_7_55)).then(|| {
            format!(
                "{} to ±{} nm: PID {} ms, NIASA {} (App. E) and {} ms (7.55)",
                run.name.replace('-', "−"),
                run.settling.tolerances_nm[coarsest],
                number(pid, 1),
                number(niasa, 1),
                number(niasa_7_55, 1)
            )
        })
    };
    let found: Vec<String> = corners.iter().filter_map(found).collect();
    let words = "Where friction is large for its stiffness, it may stop the stage inside a coarse tolerance, and there is nothing to gain";
    (!found.is_empty()).then(|| format!("{words}: {}.", found.join("; ")))
}

fn corner_table(corners: &[&Run]) -> Table {
    let header = [
        "stage",
        "reduction (App. E)",
        "not faster at",
        "reduction (7.55)",
        "not faster at",
        "do not settle to ±3 nm: PID / App. E / 7.55",
    ];
    let title = "Stages at the corners of what was measured, the drive unchanged, friction not redrawn";
    let table = Table::new(title, &header);
    corners.iter().fold(table, |table, run| {
        let slower = |config: usize| match slower_at(run, config).as_slice() {
            [] => MISSING.to_owned(),
            slower if slower.len() == run.settling.tolerances_nm.len() => "any".to_owned(),
            slower => tolerances(slower),
        };
        let name = run.name.replace('-', "−");
        let unsettled: Vec<String> = run.configs.iter().map(|c| c.settling.unsettled[FINEST].to_string()).collect();
        table.row([
            name,
            range_in_words(run, NIASA),
            slower(NIASA),
            range_in_words(run, NIASA_7_55),
            slower(NIASA_7_55),
            unsettled.join(" / "),
        ])
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::thesis::sections::traces::tests::tiny_run;
    use crate::thesis::verdict::Outcome;

    #[test]
    fn the_slope_of_a_better_model_is_judged_by_the_means() {
        let verdict = |elements: (f64, f64)| {
            let mut run = tiny_run(&[(100.0, 50.0), (40.0, 20.0), elements]);
            run.name = "table 4, App. E".into();
            run.configs[1].settling.name = "dahl".into();
            run.configs[2].settling.name = "maxwell-table-4".into();
            gms_slope(&[&run]).1.outcome
        };
        assert_eq!(verdict((38.0, 20.5)), Outcome::Reproduced);
        assert_eq!(verdict((60.0, 20.5)), Outcome::NotReproduced);
        assert_eq!(gms_slope(&[]).1.outcome, Outcome::NotReproduced);
    }

    #[test]
    fn moves_that_end_outside_every_tolerance_are_counted_by_name_and_those_only() {
        let mut run = tiny_run(&[(100.0, 50.0), (30.0, 20.0), (30.0, 20.0)]);
        run.name = "δ -0.5".into();
        run.configs[NIASA].settling.unsettled = vec![4, 0];
        assert_eq!(restless(&[&run]), None);
        run.configs[NIASA_7_55].settling.unsettled = vec![7, 7];
        let said = restless(&[&run]).unwrap();
        assert!(said.contains("δ −0.5, pid+niasa-7.55: 7 of 10"), "{said}");
        assert_eq!(said.matches(" of 10 ").count(), 1, "{said}");
    }

    #[test]
    fn a_pid_that_is_inside_at_once_is_what_a_reduction_far_below_zero_is_relative_to() {
        assert_eq!(at_once(&[&tiny_run(&[(100.0, 50.0), (30.0, 20.0), (30.0, 20.0)])]), None);
        let said = at_once(&[&tiny_run(&[(100.0, 1.0), (30.0, 3.0), (30.0, 32.0)])]).unwrap();
        assert!(said.ends_with("to ±10 nm: PID 1.0 ms, NIASA 3.0 (App. E) and 32.0 ms (7.55)."), "{said}");
    }

    #[test]
    fn half_and_twice_the_value_have_to_be_faster_than_pid() {
        let verdict = |twice: (f64, f64)| {
            let others = [(30.0, 20.0); 3];
            let all = [&[(100.0, 50.0)], others.as_slice(), &[twice, (90.0, 80.0)]].concat();
            judge(&checks(&[&tiny_run(&all)]))
        };
        assert_eq!(verdict((30.0, 20.0)).outcome, Outcome::Reproduced);
        assert_eq!(verdict((30.0, 60.0)).outcome, Outcome::Partly);
        assert_eq!(judge(&checks(&[])).outcome, Outcome::NotReproduced);
    }
}
