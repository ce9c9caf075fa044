//! The commissioning report.

use servo_core::parameters::Parameter;
use servo_ident::frf::Point;
use servo_ident::tuning;

use super::loops::SAMPLE_S;
use super::{Failure, Found, Settled, Step, TOLERANCE_NM};
use crate::link::units::show_number;
use crate::plot::{Axis, Band, Plot, Series};
use crate::report::Report;
use crate::table::{MISSING, Table, number};

/// Parameters that commissioning sets.
const SET: [&str; 11] = [
    "commutation_offset_m",
    "commutation_identity",
    "position_gain_per_s",
    "velocity_gain_n_s_per_m",
    "velocity_integral_per_s",
    "niasa_stiffness_n_per_m",
    "niasa_coulomb_n",
    "niasa_time_constant_s",
    "niasa_rate_limit_n",
    "niasa_hysteresis_m",
    "compensator",
];

/// The page as HTML; `caption` says what was commissioned, `ended` which step ended it, and why.
pub fn render(found: &Found, caption: &str, ended: Option<(Step, &Failure)>) -> String {
    let summary = match (ended, found.gain()) {
        (Some((step, why)), _) => {
            format!("Ended at {}: {why}.{}", step.name(), if why.bridge_is_off() { " The bridge is off." } else { "" })
        }
        (None, Some(gain)) => format!(
            "Settling to ±{TOLERANCE_NM} nm takes {:.0} % less time with NIASA than with the tuned PID, in ten moves of 5 mm at 1 m/s² each; \
             parameters are stored.",
            100.0 * gain
        ),
        (None, None) => "Not verified.".to_owned(),
    };
    let mut report = Report::new("Commissioning", format!("{summary} Commissioned: {caption}."));
    let facts = Step::ALL.map(|step| (format!("{}: {}", step.name(), step.purpose()), outcome(found, step, ended)));
    report.section("Steps").facts(facts);
    if !found.plant.is_empty() {
        plant_and_loop(&mut report, found, caption);
    }
    if !found.extremes.is_empty() {
        length_scale(&mut report, found, caption);
    }
    if let Some(profile) = found.profiles.first() {
        let line = |column: usize| profile.loop_nm_n.iter().map(move |p| (p[0], p[column]));
        report
            .section("Friction")
            .figure(
                [Plot::new("Friction over position", Axis::linear("position / nm"), Axis::linear("force / N"))
                    .series(Series::new("measured", 0).line(line(1)))
                    .series(Series::new("Dahl's model", 1).line(line(2)))],
                format!("Friction force over position at the first place: {caption}"),
            )
            .table(friction_table(found, caption))
            .paragraph(
                "The 95 % intervals hold for a stage that follows Dahl's model. Where Maxwell slip leaves clearly less, the stage does not: \
                 then they say how well Dahl's curve fits these data, and the true values of elements in parallel may lie outside.",
            );
    }
    if let Some([without, with]) = &found.settled {
        let trace = |name: &str, colour, trace_nm: &[f64]| {
            Series::new(name, colour).line(trace_nm.iter().enumerate().map(|(ms, e)| (ms as f64, *e)))
        };
        let plot = Plot::new(
            "Error after a move",
            Axis::linear("time after the profile / ms").range(0.0, 500.0),
            Axis::linear("error / nm").range(-100.0, 100.0),
        )
        .band(Band::y("tolerance", -TOLERANCE_NM, TOLERANCE_NM))
        .series(trace("without NIASA", 0, &without.trace_nm))
        .series(trace("with NIASA", 1, &with.trace_nm));
        report
            .section("Settling")
            .figure([plot], format!("Error after the first of ten 5 mm moves at 1 m/s²: {caption}"))
            .table(settling_table([without, with], found, caption));
    }
    if !found.parameters.is_empty() {
        let (set, others): (Vec<_>, Vec<_>) =
            found.parameters.iter().partition(|(name, _)| SET.contains(&name.as_str()));
        report
            .section("Parameters")
            .table(parameter_table(&format!("Parameters that commissioning sets: {caption}"), &set))
            .table(parameter_table("The others, as they were in use", &others));
    }
    report.section("Why a step may refuse").facts(Step::ALL.into_iter().map(|step| (step.name(), step.refuses_if())));
    report.render()
}

/// What became of a step.
fn outcome(found: &Found, step: Step, ended: Option<(Step, &Failure)>) -> String {
    let done = found.done.iter().find(|(done, _)| *done == step).map(|(_, words)| words.clone());
    match ended {
        Some((at, Failure::Stopped)) if at == step => "ended by the user".to_owned(),
        Some((at, why)) if at == step => format!("refused: {why}"),
        _ => done.unwrap_or_else(|| "not done".to_owned()),
    }
}

fn plant_and_loop(report: &mut Report, found: &Found, caption: &str) {
    let transmissions =
        found.loops.iter().map(|(amplitude_n, points)| (format!("{amplitude_n} N"), points.clone())).collect();
    report.section("Plant and loop").figure(
        [
            gain_plot("plant / m/N", vec![("plant".to_owned(), found.plant.clone())]),
            gain_plot("loop transmission", transmissions),
        ],
        format!("Plant on a slow move, and loop transmission at several amplitudes: {caption}"),
    );
    report.table(margins_table(found, caption)).paragraph(
        "The gains are for the plant as it slides; friction adds to the phase margin, and at small amplitudes it holds the stage like a spring. \
         Where the gain never falls through 1 there are no margins; the sensitivity peak is then held to 2.",
    );
    if let (Some(second_order), Some(gains), Some((amplitude_n, points))) =
        (&found.closed_loop, &found.gains, found.loops.first())
    {
        let measured = tuning::closed_loop_without_zeros(points, gains, SAMPLE_S);
        let model =
            measured.iter().map(|p| Point { value: second_order.at(p.frequency_hz), ..*p }).collect::<Vec<Point>>();
        report.figure(
            [gain_plot("closed loop", vec![("measured".to_owned(), measured), ("second order".to_owned(), model)])],
            format!(
                "Closed loop at {amplitude_n} N without the zeros of its controller, and the loop of second order that is nearest up to twice \
                 its {:.0} Hz: {caption}",
                second_order.natural_hz
            ),
        );
    }
}

/// The swing of section 5.3 and what can be told from it.
fn length_scale(report: &mut Report, found: &Found, caption: &str) {
    let header = ["extreme", "time after the profile / ms", "from the target / nm", "since the last / ms"];
    let table = Table::new(format!("Extremes after a step of 100 µm: {caption}"), &header);
    let table = found.extremes.iter().enumerate().fold(table, |table, (i, extreme)| {
        let since_s = i.checked_sub(1).map(|before| extreme.time_s - found.extremes[before].time_s);
        table.row([
            (i + 1).to_string(),
            number(extreme.time_s * 1e3, 1),
            number(extreme.error_m * 1e9, 0),
            since_s.map_or_else(|| MISSING.to_owned(), |s| number(s * 1e3, 1)),
        ])
    });
    report.section("Length scale").paragraph(
        "As section 5.3 of the thesis has it: as long as the loop is linear it swings to and fro across the target, in the time of the loop of \
         second order. The length scale is the distance of the first extreme from which it does not: the next one comes 1.5 times later or \
         sooner, or short of the target, or not at all.",
    );
    report.paragraph(found.length_scale_m.map_or_else(
        || "This step shows none: friction is then identified with the smallest profile.".to_owned(),
        |m| format!("This step shows {:.0} nm.", m * 1e9),
    ));
    if let (Some(gains), Some(coulomb_n)) = (&found.gains, found.coulomb_n) {
        report.paragraph(format!(
            "Nearer to the target than F_C/k_P = {:.0} nm the proportional force alone cannot move the stage against its friction: a swing that \
             does not reach farther ends there, and the integral creeps the rest.",
            coulomb_n / gains.kp_n_per_m * 1e9
        ));
    }
    report.table(table);
}

fn gain_plot(title: &str, responses: Vec<(String, Vec<Point>)>) -> Plot {
    let plot = Plot::new(title, Axis::log("frequency / Hz"), Axis::log(title));
    responses.into_iter().enumerate().fold(plot, |plot, (colour, (name, points))| {
        plot.series(Series::new(name, colour).line(points.iter().map(|p| (p.frequency_hz, p.value.norm()))))
    })
}

fn margins_table(found: &Found, caption: &str) -> Table {
    let header = ["amplitude / N", "crossover / Hz", "phase margin / °", "gain margin / dB", "sensitivity peak"];
    let table = Table::new(format!("Margins over amplitudes: {caption}"), &header);
    found.family.iter().fold(table, |table, stability| {
        let margins = stability.margins;
        let show = |value: Option<f64>| value.map_or_else(|| MISSING.to_owned(), |v| number(v, 1));
        table.row([
            number(stability.amplitude_n, 2),
            show(margins.map(|m| m.crossover_hz)),
            show(margins.map(|m| m.phase_margin_deg)),
            show(margins.and_then(|m| m.gain_margin_db)),
            number(stability.sensitivity_peak, 2),
        ])
    })
}

fn settling_table(settled: [&Settled; 2], found: &Found, caption: &str) -> Table {
    let tuned =
        found.wish.map_or_else(String::new, |w| format!(", PID {} Hz / {}°", w.crossover_hz, w.phase_margin_deg));
    let caption = format!(
        "Settling to ±{TOLERANCE_NM} nm of ten 5 mm moves at 1 m/s² each{tuned}; a move that does not settle counts with its dwell: \
         {caption}"
    );
    let header = ["", "mean / ms", "least / ms", "largest / ms", "unsettled", "at rest / nm rms"];
    let rows = settled.into_iter().zip(["without NIASA", "with NIASA"]);
    rows.fold(Table::new(caption, &header), |table, (settled, name)| {
        let times = || settled.settling_ms.iter().copied();
        table.row([
            name.to_owned(),
            number(settled.mean_ms, 1),
            number(times().fold(f64::INFINITY, f64::min), 1),
            number(times().fold(0.0, f64::max), 1),
            settled.unsettled.to_string(),
            number(settled.rest_rms_nm, 2),
        ])
    })
}

fn parameter_table(caption: &str, parameters: &[(&String, &f64)]) -> Table {
    let header = ["parameter", "value", "unit"];
    parameters.iter().fold(Table::new(caption, &header), |table, (name, value)| {
        let unit = Parameter::by_name(name).map_or("", |row| row.unit);
        table.row([(*name).clone(), show_number(**value), unit.to_owned()])
    })
}

fn friction_table(found: &Found, caption: &str) -> Table {
    let header = ["place / mm", "σ / N/µm", "95 %", "F_C / N", "95 %", "Dahl / mN", "slip / mN"];
    let caption = format!(
        "Friction found at each place with Dahl's model, and what its fit and that of Maxwell slip leave of the force (rms): {caption}"
    );
    let table = Table::new(caption, &header);
    found.profiles.iter().fold(table, |table, fit| {
        let [low, high] = fit.sigma_ci95_n_per_m.map(|v| number(v * 1e-6, 2));
        let [least, most] = fit.coulomb_ci95_n.map(|v| number(v, 3));
        table.row([
            number(fit.place_m * 1e3, 1),
            number(fit.sigma_n_per_m * 1e-6, 2),
            format!("{low} … {high}"),
            number(fit.coulomb_n, 3),
            format!("{least} … {most}"),
            number(fit.dahl_rms_n * 1e3, 1),
            fit.maxwell_rms_n.map_or_else(|| MISSING.to_owned(), |rms_n| number(rms_n * 1e3, 1)),
        ])
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_parameters_that_it_sets_are_parameters() {
        assert!(SET.iter().all(|name| Parameter::by_name(name).is_some()));
    }

    #[test]
    fn what_was_refused_and_what_was_not_done_is_told() {
        let found = Found { done: vec![(Step::Offsets, "offset 3 mA".to_owned())], ..Found::default() };
        let page = render(&found, "a drive", Some((Step::Alignment, &Failure::Late("the end"))));
        for part in ["Ended at alignment: the end did not come in time", "offset 3 mA", "refused: the end", "not done"]
        {
            assert!(page.contains(part), "{part}");
        }
    }
}
