//! The commissioning report.

use servo_core::parameters::Parameter;
use servo_ident::frf::Point;

use super::{Found, TOLERANCE_NM};
use crate::link::units::show_number;
use crate::plot::{Axis, Band, Plot, Series};
use crate::report::Report;
use crate::table::{Table, number};

/// The page as HTML; `caption` says what was commissioned, `ended` which step ended it, and why.
pub fn render(found: &Found, caption: &str, ended: Option<&str>) -> String {
    let summary = match (ended, found.gain()) {
        (Some(why), _) => format!("Ended: {why}."),
        (None, Some(gain)) => {
            format!("The axis settles to ±{TOLERANCE_NM} nm {:.0} % faster with NIASA.", 100.0 * gain)
        }
        (None, None) => "Not verified.".to_owned(),
    };
    let mut report = Report::new("Commissioning", summary);
    report.section("Steps").facts(found.done.iter().map(|(step, words)| (step.purpose().to_owned(), words.clone())));
    if !found.plant.is_empty() {
        report.section("Plant and loop").figure(
            [
                gain_plot("plant / m/N", [("plant".to_owned(), &found.plant[..])].into_iter()),
                gain_plot(
                    "loop transmission",
                    found.loops.iter().map(|(amplitude_n, points)| (format!("{amplitude_n} N"), &points[..])),
                ),
            ],
            format!("Plant on a slow move, and loop transmission at several amplitudes: {caption}"),
        );
        report.table(margins_table(found, caption));
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
            .table(friction_table(found, caption));
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
            .figure([plot], format!("Error after the first of ten 5 mm moves at 1 m/s²: {caption}"));
    }
    report.section("Parameters").table(parameter_table(found, caption));
    report.render()
}

fn gain_plot<'a>(title: &str, responses: impl Iterator<Item = (String, &'a [Point])>) -> Plot {
    let plot = Plot::new(title, Axis::log("frequency / Hz"), Axis::log(title));
    responses.enumerate().fold(plot, |plot, (colour, (name, points))| {
        plot.series(Series::new(name, colour).line(points.iter().map(|p| (p.frequency_hz, p.value.norm()))))
    })
}

fn margins_table(found: &Found, caption: &str) -> Table {
    let header = ["amplitude / N", "crossover / Hz", "phase margin / °", "gain margin / dB", "sensitivity peak"];
    let table = Table::new(format!("Margins over amplitudes: {caption}"), &header);
    found.family.iter().fold(table, |table, stability| {
        let margins = stability.margins;
        let show = |value: Option<f64>| value.map_or_else(|| crate::table::MISSING.to_owned(), |v| number(v, 1));
        table.row([
            number(stability.amplitude_n, 2),
            show(margins.map(|m| m.crossover_hz)),
            show(margins.map(|m| m.phase_margin_deg)),
            show(margins.and_then(|m| m.gain_margin_db)),
            number(stability.sensitivity_peak, 2),
        ])
    })
}

fn parameter_table(found: &Found, caption: &str) -> Table {
    let header = ["parameter", "value", "unit"];
    let table = Table::new(format!("Parameters in use: {caption}"), &header);
    found.parameters.iter().fold(table, |table, (name, value)| {
        let unit = Parameter::by_name(name).map_or("", |row| row.unit);
        table.row([name.clone(), show_number(*value), unit.to_owned()])
    })
}

fn friction_table(found: &Found, caption: &str) -> Table {
    let header = ["place / mm", "σ / N/µm", "95 %", "F_C / N", "95 %", "Dahl leaves / mN", "Maxwell slip leaves / mN"];
    let table = Table::new(format!("Friction found at each place: {caption}"), &header);
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
            fit.maxwell_rms_n.map_or_else(|| crate::table::MISSING.to_owned(), |rms_n| number(rms_n * 1e3, 1)),
        ])
    })
}
