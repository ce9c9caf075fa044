//! The 100 µm step and the length scale of pre-rolling (5.3, figs 1, 2, 17, 18).

use crate::plot::{Axis, Plot, Series};
use crate::reproduce::outcome::ORIGIN;
use servo_ident::length_scale::End;

use crate::reproduce::step_100um::{Finding, Step, Step100Um};
use crate::reproduce::words::plant;
use crate::table::{MISSING, number};
use crate::thesis::section::Section;
use crate::thesis::targets::Target;
use crate::thesis::verdict::{Check, Verdict, judge};

/// Times between extremes in the thesis (ms): linear, the first that is not, the one after.
const LEGS_MS: [f64; 3] = [8.0, 23.0, 67.0];
/// How far "about every 8 ms" may be off (ms).
const ABOUT_MS: f64 = 1.0;
/// Length scale and end of linearity in the thesis (nm).
const SCALE_NM: f64 = 600.0;
/// See [`SCALE_NM`].
const LINEAR_NM: f64 = 3810.0;
/// Distances and such legs depend on the friction of one move: they may differ by this factor.
const FACTOR: f64 = 2.0;

/// What is said where there is no finding.
const NONE: &str = "no leg that is not the linear loop's";

/// The section.
pub fn section(step: &Step100Um) -> Section {
    let found = step.finding.as_ref();
    let linear_ms = step.linear_leg_ms.map_or(MISSING.to_owned(), |ms| number(ms, 1));
    let legs = format!("{linear_ms} ms; {}", found.map_or(NONE.to_owned(), leg_in_words));
    let scale = format!("{}; {}", found.map_or(NONE.to_owned(), scale_in_words), spread(step));
    let conditions = [
        ("Origin", ORIGIN.to_owned()),
        ("Step", "100 µm".to_owned()),
        ("Tuning", "100 Hz / 45°, no feedforward".to_owned()),
        ("Plant", plant(&step.plant)),
        ("Moves", format!("1; {} with friction redrawn", step.redrawn.len())),
    ];
    Section::new("5.3 The length scale of pre-rolling")
        .judged(Target::Extrema, legs, legs_verdict(step))
        .judged(Target::LengthScale, scale, judge(&scale_checks(found)).because(why_longer(step)))
        .conditions(conditions)
        .figure(
            &[1, 2, 17, 18],
            [swings(step, 100.0, (-100e3, 100e3), 1e-3), swings(step, 200.0, (-1000.0, 1000.0), 1.0)],
            "a 100 µm step and the same drive and mass without friction, which stands for the linear approximation; the last \
             micrometre (right)",
        )
        .table(&[], step.extremes_table().under("extremes, and beside them those without friction"))
        .table(&[], step.finding_table())
        .table(&[], step.friction_table())
}

/// The leg from the length scale, and the one after it.
fn leg_in_words(found: &Finding) -> String {
    let to = match found.end {
        End::Creeps => ", to the target",
        End::Short => ", short of the target",
        End::Untimely => "",
    };
    let next = found.next_leg_ms.map_or("no further extreme".to_owned(), |ms| format!("{} ms", number(ms, 1)));
    format!("{} ms from ±{} nm{to}; then {next}", number(found.leg_ms, 1), number(found.length_scale_nm, 0))
}

fn scale_in_words(found: &Finding) -> String {
    let [scale, linear] = [number(found.length_scale_nm, 0), number(found.linear_down_to_nm * 1e-3, 2)];
    format!("{scale} nm; linear down to {linear} µm")
}

fn factor_of(nm: f64) -> (f64, f64) {
    (nm / FACTOR, nm * FACTOR)
}

fn legs_verdict(step: &Step100Um) -> Verdict {
    let found = step.finding.as_ref();
    let linear = (LEGS_MS[0] - ABOUT_MS, LEGS_MS[0] + ABOUT_MS);
    judge(&[
        Check::within("linear leg", step.linear_leg_ms, linear, 1, "ms"),
        Check::within("leg from the length scale", found.map(|f| f.leg_ms), factor_of(LEGS_MS[1]), 1, "ms"),
        Check::within("leg after it", found.and_then(|f| f.next_leg_ms), factor_of(LEGS_MS[2]), 1, "ms"),
    ])
    .because(match found.filter(|f| f.end != End::Untimely) {
        None => String::new(),
        Some(f) => format!(
            "Nearer than F_C/k_P = {} nm the proportional force alone cannot overcome friction: from {} nm on the stage {}",
            number(step.stuck_within_nm, 0),
            number(f.length_scale_nm, 0),
            if f.end == End::Creeps { "creeps to the target and turns no more" } else { "comes to a stop short of the target" }
        ),
    })
}

fn scale_checks(found: Option<&Finding>) -> [Check; 2] {
    [
        Check::within("length scale", found.map(|f| f.length_scale_nm), factor_of(SCALE_NM), 0, "nm"),
        Check::within("linear down to", found.map(|f| f.linear_down_to_nm), factor_of(LINEAR_NM), 0, "nm"),
    ]
}

/// Why the length scale is another one than in the thesis: where a stage that creeps begins to, and with how much friction it would not.
fn why_longer(step: &Step100Um) -> String {
    let Some(found) = step.finding.as_ref().filter(|f| f.end != End::Untimely) else { return String::new() };
    let next = found.extreme + 1;
    let linear_nm = step.linear.swing.extremes.get(next).map(|extreme| (extreme.error_m * 1e9).abs());
    let half_nm = 0.5 * linear_nm.unwrap_or(f64::INFINITY);
    let swings = step.by_friction.iter().find(|less| less.extreme_nm.get(next).is_some_and(|nm| nm.abs() > half_nm));
    let less = swings.map_or(String::new(), |less| {
        let extremes: Vec<String> = less.extreme_nm.iter().map(|nm| number(*nm, 0)).collect();
        format!(
            ". With F_C = {} N instead of {} N the same step swings on to {} nm: the thesis' extremes at 3810, −637, 115 and 19 nm are \
             those of a step that met a fraction of the friction of its table 1",
            number(less.coulomb_n, 2),
            number(step.plant.friction.coulomb_n, 2),
            extremes.join(", ")
        )
    });
    format!(
        "The procedure takes the extreme from which the first leg begins that is not the linear loop's. Friction takes about \
         F_C/k_P = {} nm off every swing: the one after {} nm, which would go {} nm beyond the target without friction, ends before it, and \
         the integrator creeps from there{less}",
        number(step.stuck_within_nm, 0),
        number(found.length_scale_nm, 0),
        linear_nm.map_or(MISSING.to_owned(), |nm| number(nm, 0)),
    )
}

/// Length scales of steps with friction drawn for each, in words.
fn spread(step: &Step100Um) -> String {
    let mut scales: Vec<f64> = step.redrawn.iter().flatten().map(|f| f.length_scale_nm).collect();
    scales.sort_by(f64::total_cmp);
    match scales.as_slice() {
        [] => "none in steps with friction drawn for each".to_owned(),
        [first, ..] => format!(
            "{} to {} nm in {} steps with friction drawn for each",
            number(*first, 0),
            number(scales[scales.len() - 1], 0),
            step.redrawn.len()
        ),
    }
}

/// Error of both swings over time.
fn swings(step: &Step100Um, end_ms: f64, (low, high): (f64, f64), per_nm: f64) -> Plot {
    let unit = if per_nm < 1.0 { "µm" } else { "nm" };
    let x = Axis::linear("time / ms").range(0.0, end_ms);
    let y = Axis::linear(format!("position − target / {unit}")).range(low * per_nm, high * per_nm);
    let line =
        |step: &Step| step.time_ms.iter().copied().zip(step.error_nm.iter().map(|nm| nm * per_nm)).collect::<Vec<_>>();
    Plot::new("A 100 µm step", x, y)
        .series(Series::new("without friction", 5).line(line(&step.linear)))
        .series(Series::new("stage", 0).line(line(&step.stage)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::thesis::verdict::Outcome;
    use servo_ident::length_scale::Swing;
    use servo_sim::Stage;

    fn step(finding: Option<Finding>) -> Step100Um {
        let swing = Swing { extremes: vec![], settled_s: 1.0 };
        let made = Step { time_ms: vec![], error_nm: vec![], swing };
        Step100Um {
            experiment: "",
            thesis_section: "",
            origin: "",
            seed: 1,
            moves_requested: 0,
            complete: true,
            stage: made.clone(),
            linear: made,
            linear_leg_ms: Some(8.1),
            stuck_within_nm: 1474.0,
            finding,
            linear_finding: None,
            redrawn: vec![],
            by_friction: vec![],
            plant: Stage::default(),
        }
    }

    #[test]
    fn the_thesis_own_numbers_are_reproduced_and_a_creeping_stage_is_in_part() {
        let thesis = Finding {
            linear_down_to_nm: 3810.0,
            length_scale_nm: 637.0,
            extreme: 3,
            leg_ms: 23.0,
            end: End::Untimely,
            next_leg_ms: Some(67.0),
        };
        let outcomes =
            |step: &Step100Um| section(step).findings.into_iter().map(|f| f.verdict.outcome).collect::<Vec<_>>();
        assert_eq!(outcomes(&step(Some(thesis.clone()))), [Outcome::Reproduced; 2]);
        let creeping = step(Some(Finding { end: End::Creeps, next_leg_ms: None, ..thesis }));
        assert_eq!(outcomes(&creeping), [Outcome::Partly, Outcome::Reproduced]);
        assert!(legs_verdict(&creeping).why().contains("creeps to the target"));
        assert_eq!(outcomes(&step(None)), [Outcome::Partly, Outcome::NotReproduced]);
        assert!(section(&step(None)).findings.iter().all(|finding| finding.ours.contains(NONE)));
    }
}
