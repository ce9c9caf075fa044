//! Identification of σ and F_C (ch. 6, figs 19 to 33, tables 1 and 2).

use crate::plot::{Axis, Band, Plot, Series};
use crate::reproduce::identification::{Fitted, Group, Trace};
use crate::reproduce::identification_study::{Column, IdentificationStudy, Moments, Parameter};
use crate::reproduce::words::plant;
use crate::table::{MISSING, number};
use crate::thesis::section::Section;
use crate::thesis::targets::Target;
use crate::thesis::verdict::{Check, judge};
use servo_sim::stage::FrictionModel;

/// Largest bias of a mean against what was drawn (%), and largest difference of the two methods' biases.
const BIAS_PERCENT: f64 = 2.0;
/// Mean square error of the thesis' worst fit (N²).
const WORST_N2: f64 = 0.1067;

/// The section.
pub fn section(study: &IdentificationStudy) -> Section {
    let conditions = [
        ("Origin", study.origin.to_owned()),
        ("Tuning", "PID 100 Hz / 45°".to_owned()),
        ("Plant", format!("{}, redrawn per run", plant(&study.plant))),
        ("Runs", format!("{} at each of {} places and each frequency, seed {}", study.runs, study.places, study.seed)),
    ];
    let worst = study.table_1.iter().map(|column| column.worst_mse_n2).fold(f64::NAN, f64::max);
    let worst_check = Check::new(
        worst < WORST_N2,
        format!(
            "worst mean square error {} N², {} that of the thesis",
            number(worst, 4),
            if worst < WORST_N2 { "below" } else { "not below" }
        ),
    );
    let verdict = |checks: &[Check]| judge(checks).because(not_dahls(study));
    let [by_frequency_table, by_method_table] = study.tables();
    let mut section = Section::new("6 Identification of friction")
        .finding(Target::WorstFit, format!("{} N²", number(worst, 4)), &[worst_check])
        .judged(
            Target::Stiffness,
            found_in_words(&study.table_1, sigma, "drawn"),
            verdict(&bias_checks(&study.table_1, sigma)),
        )
        .judged(
            Target::Coulomb,
            found_in_words(&study.table_1, coulomb, "drawn"),
            verdict(&bias_checks(&study.table_1, coulomb)),
        )
        .judged(
            Target::ProfileAgainstSettling,
            methods_in_words(&study.table_2),
            verdict(&method_checks(&study.table_2)),
        )
        .conditions(conditions)
        .table(&[1], by_frequency_table.under("σ and F_C by frequency of the identification profile"))
        .table(&[2], by_method_table.under("identification profile, and settling of 5 mm steps"));
    for note in &study.notes {
        section = section.text(note.clone());
    }
    let (profiles, settling): (Vec<&Group>, Vec<&Group>) = study.groups.iter().partition(|g| g.frequency_hz.is_some());
    if let Some(first) = profiles.first().and_then(|group| group.traces.first()) {
        section = section.figure(
            &[19, 20],
            [position_plot(first), loop_plot(first, false)],
            format!("an identification profile ({}): position, and friction over it", first.name),
        );
    }
    let worst_trace =
        profiles.iter().filter_map(|g| g.traces.get(1)).max_by(|a, b| a.fit.mse_n2.total_cmp(&b.fit.mse_n2));
    let by_frequency = |title: &str, of: fn(&Fitted) -> f64| {
        let names = profiles.iter().filter_map(|g| g.frequency_hz).map(|hz| format!("{hz}"));
        dots(
            Axis::names("frequency / Hz", names),
            title,
            profiles.iter().map(|g| g.fits.iter().map(of).collect()).collect(),
        )
    };
    let mut panels = vec![by_frequency("mean square error / mN²", |f| f.mse_n2 * 1e6)];
    panels.extend(worst_trace.map(|trace| loop_plot(trace, false)));
    section = section.figure(
        &[21, 22],
        panels,
        "mean square errors of the fits with their mean and standard deviation, and the worst fit",
    );
    for (group, numbers) in profiles.iter().zip([[23, 24], [25, 26], [27, 28]]) {
        section = section.figure(
            &numbers,
            [by_place(group, "σ / N/µm", |f| f.sigma_n_per_m * 1e-6), by_place(group, "F_C / N", |f| f.coulomb_n)],
            format!("σ and F_C found at each place with {} Hz", group.frequency_hz.unwrap_or(0.0)),
        );
    }
    section = section.figure(
        &[29, 30],
        [by_frequency("σ / N/µm", |f| f.sigma_n_per_m * 1e-6), by_frequency("F_C / N", |f| f.coulomb_n)],
        "σ and F_C by frequency, mean ± standard deviation",
    );
    if let Some(group) = settling.first() {
        if let Some(first) = group.traces.first() {
            section = section.figure(
                &[31],
                [loop_plot(first, true)],
                format!(
                    "force of the motor, friction (which is that without the force of inertia) and Dahl's fit over position after a 5 mm \
                     step ({})",
                    first.name
                ),
            );
        }
        section = section.figure(
            &[32, 33],
            [
                histogram(group, "σ / N/µm", |f| f.sigma_n_per_m * 1e-6),
                histogram(group, "F_C / N", |f| f.coulomb_n),
                histogram(group, "mean square error / mN²", |f| f.mse_n2 * 1e6),
            ],
            format!("σ, F_C and mean square errors found from {} settling steps", group.fits.len()),
        );
    }
    section
}

/// Why Dahl's σ and F_C are not found on a stage whose curve is another; nothing on one whose curve is his.
fn not_dahls(study: &IdentificationStudy) -> String {
    let model = study.plant.friction.model;
    match model {
        FrictionModel::MaxwellSlip | FrictionModel::Dahl | FrictionModel::LuGre => String::new(),
        _ => format!(
            "What is fitted is Dahl's curve, and a stage of model {} has another: its σ and F_C are not his. The other curve is what \
             `servoctl fit maxwell` is for",
            model.name()
        ),
    }
}

fn sigma(column: &Column) -> Parameter {
    column.sigma_n_per_um
}

fn coulomb(column: &Column) -> Parameter {
    column.coulomb_n
}

fn moments(m: Moments) -> String {
    if !m.mean.is_finite() {
        return MISSING.to_owned();
    }
    format!("{} ± {}", number(m.mean, 2), number(m.std, 2))
}

fn found_in_words(columns: &[Column], of: fn(&Column) -> Parameter, drawn: &str) -> String {
    let list =
        |pick: fn(Parameter) -> Moments| columns.iter().map(|c| moments(pick(of(c)))).collect::<Vec<_>>().join(", ");
    format!("{}; {drawn} {}", list(|p| p.found), list(|p| p.truth))
}

/// Whether each mean is that of the friction drawn, and whether the thesis' lies within its own scatter of ours.
fn bias_checks(columns: &[Column], of: fn(&Column) -> Parameter) -> Vec<Check> {
    let check = |c: &Column| {
        let parameter = of(c);
        let limits = (-BIAS_PERCENT, BIAS_PERCENT);
        let near = (parameter.found.mean - parameter.thesis.mean).abs() <= parameter.thesis.std;
        let off = format!(
            "{}: {} the thesis' standard deviation of its mean",
            c.name,
            if near { "within" } else { "beyond" }
        );
        [
            Check::within(&format!("{}: bias", c.name), Some(parameter.bias_percent), limits, 2, "%"),
            Check::new(near, off),
        ]
    };
    columns.iter().flat_map(check).collect()
}

fn methods_in_words(columns: &[Column]) -> String {
    let both = |of: fn(&Column) -> Parameter, show: fn(Parameter) -> String| {
        columns.iter().map(|c| show(of(c))).collect::<Vec<_>>().join(" and ")
    };
    let bias = |of| both(of, |p| number(p.bias_percent, 2));
    let mean = |of| both(of, |p| moments(p.found));
    format!("σ {} N/µm, bias {} %; F_C {} N, bias {} %", mean(sigma), bias(sigma), mean(coulomb), bias(coulomb))
}

/// The methods see different draws of friction: what they have to agree in is their error against what was drawn. Each mean must be
/// that of the friction drawn besides.
fn method_checks(columns: &[Column]) -> Vec<Check> {
    let [profile, steps] = columns else { return Vec::new() };
    let own = |column: &Column, name: &str, of: fn(&Column) -> Parameter| {
        let (what, limits) = (format!("{name} by {}: bias", column.name), (-BIAS_PERCENT, BIAS_PERCENT));
        Check::within(&what, Some(of(column).bias_percent), limits, 2, "%")
    };
    let apart = |name: &str, of: fn(&Column) -> Parameter| {
        let difference = of(steps).bias_percent - of(profile).bias_percent;
        Check::within(
            &format!("{name}: the methods' biases differ by"),
            Some(difference),
            (-BIAS_PERCENT, BIAS_PERCENT),
            2,
            "%",
        )
    };
    let own = columns.iter().flat_map(|column| [own(column, "σ", sigma), own(column, "F_C", coulomb)]);
    [apart("σ", sigma), apart("F_C", coulomb)].into_iter().chain(own).collect()
}

/// Position over the course of a record, from its beginning (0 %) to its end.
fn position_plot(trace: &Trace) -> Plot {
    let count = trace.position_nm.len().max(2) as f64 - 1.0;
    let points = trace.position_nm.iter().enumerate().map(|(i, nm)| (100.0 * i as f64 / count, nm * 1e-3));
    Plot::new("Identification profile", Axis::linear("course of the profile / %"), Axis::linear("position / µm"))
        .series(Series::new("", 0).line(points))
}

/// Friction and model over position, with or without the force of the motor.
fn loop_plot(trace: &Trace, with_motor: bool) -> Plot {
    let line =
        |force: &[f64]| trace.position_nm.iter().map(|nm| nm * 1e-3).zip(force.iter().copied()).collect::<Vec<_>>();
    let x = Axis::linear("position / µm");
    let mut plot = Plot::new(format!("Friction over position: {}", trace.name), x, Axis::linear("force / N"));
    if with_motor {
        plot = plot.series(Series::new("motor", 5).line(line(&trace.motor_n)));
    }
    plot.series(Series::new("friction", 0).line(line(&trace.friction_n)))
        .series(Series::new("Dahl", 1).line(line(&trace.model_n)))
}

fn by_place(group: &Group, title: &str, of: fn(&Fitted) -> f64) -> Plot {
    let places = group.fits.iter().map(|f| f.place).max().map_or(0, |last| last + 1);
    let values = (0..places).map(|place| group.fits.iter().filter(|f| f.place == place).map(of).collect()).collect();
    dots(Axis::names("place", (1..=places).map(|place| place.to_string())), title, values)
}

/// Single values (faint), mean and standard deviation of each of some classes.
fn dots(x: Axis, title: &str, classes: Vec<Vec<f64>>) -> Plot {
    let plot = Plot::new(format!("{title} by {}", x.title), x, Axis::linear(title));
    let series = classes.iter().enumerate().fold(Series::new("", 0), |series, (i, values)| {
        let mean = crate::settling::mean(values).unwrap_or(f64::NAN);
        let std = crate::settling::sample_std(values).unwrap_or(0.0);
        series.dots(values.iter().map(|v| (i as f64 - 0.12, *v))).error_bar(i as f64 + 0.12, mean, std)
    });
    plot.series(series)
}

/// Outline of a histogram with the mean as a dashed line.
fn histogram(group: &Group, title: &str, of: fn(&Fitted) -> f64) -> Plot {
    const BINS: usize = 20;
    let values: Vec<f64> = group.fits.iter().map(of).collect();
    let (low, high) = values.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (l.min(*v), h.max(*v)));
    let width = ((high - low) / BINS as f64).max(f64::MIN_POSITIVE);
    let mut counts = [0u32; BINS];
    for value in &values {
        counts[(((value - low) / width) as usize).min(BINS - 1)] += 1;
    }
    let steps = counts
        .iter()
        .enumerate()
        .flat_map(|(i, count)| [i, i + 1].map(|edge| (low + edge as f64 * width, f64::from(*count))));
    let outline = [(low, 0.0)].into_iter().chain(steps).chain([(high, 0.0)]);
    let mut plot = Plot::new(format!("Distribution of {title}"), Axis::linear(title), Axis::linear("fits"))
        .series(Series::new("", 0).line(outline.filter(|_| !values.is_empty())));
    if let Some(mean) = crate::settling::mean(&values) {
        plot = plot.band(Band::x("mean", mean, mean));
    }
    plot.height = 260.0;
    plot
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::thesis::verdict::{Outcome, judge};

    fn column(bias_percent: f64, mean: f64) -> Column {
        let m = |mean| Moments { mean, std: 1.0 };
        let p = Parameter {
            thesis: m(8.23),
            found: m(mean),
            truth: m(mean),
            bias_percent,
            median_error_percent: bias_percent,
            rms_error_percent: 1.0,
            covered_percent: 95.0,
        };
        Column { name: "8 Hz".into(), fits: 10, refused: 0, sigma_n_per_um: p, coulomb_n: p, worst_mse_n2: 1e-3 }
    }

    #[test]
    fn a_mean_without_bias_near_the_thesis_is_reproduced() {
        let outcome = |bias, mean| judge(&bias_checks(&[column(bias, mean)], sigma)).outcome;
        assert_eq!(outcome(0.3, 8.6), Outcome::Reproduced);
        assert_eq!(outcome(0.3, 12.0), Outcome::Partly);
        assert_eq!(outcome(-7.0, 8.6), Outcome::Partly);
        assert_eq!(outcome(-7.0, 12.0), Outcome::NotReproduced);
    }

    #[test]
    fn methods_agree_if_their_biases_do() {
        let outcome = |a, b| judge(&method_checks(&[column(a, 8.6), column(b, 8.0)])).outcome;
        assert_eq!(outcome(0.5, -0.5), Outcome::Reproduced);
        assert_eq!(outcome(3.0, -3.0), Outcome::NotReproduced);
        assert_eq!(judge(&method_checks(&[])).outcome, Outcome::NotReproduced);
    }
}
