//! The page that `cargo xtask demo` writes: one settling experiment on a board, with its traces.

use crate::plot::{Axis, Band, Plot, Series};
use crate::report::Report;
use crate::settling::{BoardRun, SettlingExperiment};
use crate::table::{Conditions, MISSING, Table, number, settling_table};

/// Half height of the two error plots.
const WIDE_UM: f64 = 2.0;
const NARROW_NM: f64 = 100.0;

/// Tolerance shaded in the narrow error plot (±, nm), and the one that the summary speaks of.
const SHOWN_TOLERANCE_NM: u32 = 10;

/// Everything the page shows.
#[derive(Debug, Clone, PartialEq)]
pub struct DemoData {
    /// Results and drive facts.
    pub run: BoardRun,
    /// What it ran on; goes into every caption.
    pub conditions: Conditions,
    /// Seed of all random numbers.
    pub seed: u64,
    /// Command that repeats the run.
    pub command: String,
    /// Traces, one entry per configuration, in the order of the results.
    pub traces: Vec<ConfigTraces>,
}

/// The traces of one configuration.
#[derive(Debug, Clone, PartialEq)]
pub struct ConfigTraces {
    /// Name as it stands in the legends.
    pub name: String,
    /// Error over time of each move.
    pub moves: Vec<MoveTrace>,
    /// Friction force over displacement of one move.
    pub force: ForceTrace,
}

/// Position error of one move; samples beyond the shorter of the two lists are not shown.
#[derive(Debug, Clone, PartialEq)]
pub struct MoveTrace {
    /// Time after the end of the motion profile (s); negative during the profile.
    pub time_s: Vec<f64>,
    /// Set-point minus measurement (nm).
    pub error_nm: Vec<f64>,
}

/// Force over displacement of one move; samples beyond the shorter of the two lists are not shown.
#[derive(Debug, Clone, PartialEq)]
pub struct ForceTrace {
    /// Displacement from where the trace begins or from the target (nm).
    pub displacement_nm: Vec<f64>,
    /// Force (N).
    pub force_n: Vec<f64>,
}

/// The page as HTML.
pub fn render(data: &DemoData) -> String {
    let experiment = &data.run.settling;
    let caption = data.conditions.caption(experiment.moves);
    let mut report = Report::new("First move: settling with and without NIASA", summary(data));

    report.section("Settling time").table(settling_table(experiment, &data.conditions));
    if experiment.configs.iter().any(|c| c.unsettled.iter().any(|&n| n > 0)) {
        report.paragraph(
            "A move that had not settled by the end of its dwell counts as unsettled and enters no mean: \
             the mean of a column with unsettled moves is too short.",
        );
    }
    report.figure(
        [settling_plot(experiment)],
        format!("Settling time per tolerance, mean ± standard deviation (strong) and single moves (faint): {caption}"),
    );

    report.section("Error after the move").figure(
        [error_plot(data, ErrorScale::Wide), error_plot(data, ErrorScale::Narrow)],
        format!("Position error of every move after the end of its profile, coarse and fine: {caption}"),
    );

    report.section("Friction").figure(
        [force_plot(data)],
        format!("Friction force over displacement, one move of each configuration: {caption}"),
    );

    report.section("In position").table(in_position_table(experiment, &caption));

    let tick = &data.run.servo_tick;
    report.section("Drive").facts([
        ("Target", data.run.target.clone()),
        ("Servo tick", format!("{} Hz, {} ticks, {} overruns", tick.rate_hz, tick.count, tick.overruns)),
        (
            "Longest tick",
            format!(
                "{} µs = {} % of the period",
                number(tick.max_us, 2),
                number(tick.max_us * f64::from(tick.rate_hz) * 1e-4, 1)
            ),
        ),
    ]);
    if data.run.told.is_empty() {
        report.paragraph("The emulator had nothing to tell about the firmware's use of the part.");
    } else {
        report
            .paragraph("What the emulator told about the firmware's use of the part:")
            .list(data.run.told.iter().cloned());
    }

    let Conditions { origin, step, tuning, plant } = &data.conditions;
    report.section("To repeat this").facts([
        ("Command", data.command.clone()),
        ("Seed", data.seed.to_string()),
        ("Firmware (SHA-256)", data.run.elf_sha256.clone()),
        ("Origin", origin.clone()),
        ("Step", step.clone()),
        ("Tuning", tuning.clone()),
        ("Plant", plant.clone()),
    ]);
    report.render()
}

/// Where the numbers come from and what the comparison says at [`SHOWN_TOLERANCE_NM`].
fn summary(data: &DemoData) -> String {
    let conditions = data.conditions.caption(data.run.settling.moves);
    match finding(&data.run.settling) {
        Some(finding) => format!("{finding} Conditions: {conditions}."),
        None => format!("Conditions: {conditions}."),
    }
}

fn finding(experiment: &SettlingExperiment) -> Option<String> {
    let [baseline, compared, ..] = experiment.configs.as_slice() else { return None };
    let t = experiment.tolerances_nm.iter().position(|&tol| tol == SHOWN_TOLERANCE_NM)?;
    let (before, after) = ((*baseline.mean_ms.get(t)?)?, (*compared.mean_ms.get(t)?)?);
    let reduction = (*experiment.reduction_percent.get(t)?)?;
    let verdict = if reduction >= 0.0 { "shorter" } else { "longer" };
    Some(format!(
        "{} settles to ±{SHOWN_TOLERANCE_NM} nm in {} ms on average, {} in {} ms: {} % {verdict}.",
        baseline.name,
        number(before, 1),
        compared.name,
        number(after, 1),
        number(reduction.abs(), 1)
    ))
}

/// Mean ± standard deviation per tolerance with every single move behind it.
pub fn settling_plot(experiment: &SettlingExperiment) -> Plot {
    let names = experiment.tolerances_nm.iter().map(|tol| format!("±{tol}"));
    let all_ms = experiment.configs.iter().flat_map(|c| c.settling_ms.iter().flatten().flatten());
    let longest_ms = all_ms.fold(0.0f64, |longest, &ms| longest.max(ms));
    let mut y = Axis::linear("settling time / ms");
    if longest_ms > 0.0 {
        y = y.range(0.0, longest_ms * 1.08);
    }
    let mut plot = Plot::new("Settling time per tolerance", Axis::names("tolerance / nm", names), y);
    let configs = experiment.configs.len() as f64;
    for (i, config) in experiment.configs.iter().enumerate() {
        let centre = (i as f64 - (configs - 1.0) / 2.0) * 0.36;
        let mut series = Series::new(&config.name, i);
        for t in 0..experiment.tolerances_nm.len() {
            let x = t as f64 + centre;
            let moves = config.settling_ms.iter().filter_map(|row| row.get(t).copied().flatten());
            series = series.dots(moves.map(|ms| (x - 0.09, ms)));
            if let Some(mean) = config.mean_ms.get(t).copied().flatten() {
                series = series.error_bar(x + 0.05, mean, config.std_ms.get(t).copied().flatten().unwrap_or(0.0));
            }
        }
        plot = plot.series(series);
    }
    plot
}

#[derive(Clone, Copy, PartialEq)]
enum ErrorScale {
    /// ± [`WIDE_UM`], with the end of the profile, until every move has settled to the coarsest tolerance.
    Wide,
    /// ± [`NARROW_NM`], from the end of the profile until every move has settled to the finest tolerance.
    Narrow,
}

fn error_plot(data: &DemoData, scale: ErrorScale) -> Plot {
    let x = Axis::linear("time after end of profile / ms");
    let times = data.traces.iter().flat_map(|c| &c.moves).flat_map(|m| m.time_s.iter().copied());
    let (first_s, last_s) = times.fold((0.0f64, 0.0f64), |(low, high), t| (low.min(t), high.max(t)));
    let tolerances = 0..data.run.settling.tolerances_nm.len();
    let by_tolerance = |&t: &usize| data.run.settling.tolerances_nm[t];
    let end_ms = |tolerance: Option<usize>, times: f64| {
        let settled_ms = tolerance.and_then(|t| slowest_ms(&data.run.settling, t)).filter(|&ms| ms > 0.0);
        settled_ms.map_or(last_s * 1e3, |ms| (ms * times).min(last_s * 1e3)).ceil()
    };
    let (mut plot, per_nm) = match scale {
        ErrorScale::Wide => {
            let end_ms = end_ms(tolerances.max_by_key(by_tolerance), 1.5);
            let y = Axis::linear("position error / µm").range(-WIDE_UM, WIDE_UM);
            let start_ms = (first_s * 1e3).max(-0.1 * end_ms);
            let plot = Plot::new("Position error, coarse", x.range(start_ms, end_ms), y);
            (if start_ms < 0.0 { plot.band(Band::x("profile", start_ms, 0.0)) } else { plot }, 1e-3)
        }
        ErrorScale::Narrow => {
            let end_ms = end_ms(tolerances.min_by_key(by_tolerance), 1.15);
            let y = Axis::linear("position error / nm").range(-NARROW_NM, NARROW_NM);
            let shown_nm = f64::from(SHOWN_TOLERANCE_NM);
            let band = Band::y(format!("±{SHOWN_TOLERANCE_NM} nm"), -shown_nm, shown_nm);
            (Plot::new("Position error, fine", x.range(0.0, end_ms), y).band(band), 1.0)
        }
    };
    for (i, config) in data.traces.iter().enumerate() {
        plot = plot.series(config.moves.iter().fold(Series::new(&config.name, i), |series, m| {
            series.line(m.time_s.iter().zip(&m.error_nm).map(|(t, e)| (t * 1e3, e * per_nm)))
        }));
    }
    plot
}

/// The longest settling time of all moves at a tolerance index (ms); `None` if a move had not settled.
fn slowest_ms(experiment: &SettlingExperiment, tolerance: usize) -> Option<f64> {
    let times = experiment.configs.iter().flat_map(|c| &c.settling_ms).map(|row| row.get(tolerance).copied().flatten());
    times.into_iter().try_fold(0.0f64, |slowest, ms| Some(slowest.max(ms?)))
}

/// One loop per configuration; the unit of displacement follows from its span.
fn force_plot(data: &DemoData) -> Plot {
    let all = data.traces.iter().flat_map(|c| c.force.displacement_nm.iter().copied()).filter(|d| d.is_finite());
    let (low, high) = all.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), d| (low.min(d), high.max(d)));
    let (unit, per_nm) = match high - low {
        span if span >= 2e6 => ("mm", 1e-6),
        span if span >= 2e3 => ("µm", 1e-3),
        _ => ("nm", 1.0),
    };
    let x = Axis::linear(format!("displacement / {unit}"));
    let plot = Plot::new("Friction force over displacement", x, Axis::linear("friction force / N"));
    data.traces.iter().enumerate().fold(plot, |plot, (i, config)| {
        let points = config.force.displacement_nm.iter().zip(&config.force.force_n);
        plot.series(Series::new(&config.name, i).line(points.map(|(d, f)| (d * per_nm, *f))))
    })
}

fn in_position_table(experiment: &SettlingExperiment, conditions: &str) -> Table {
    let caption = format!("Error in position, after settling to the finest tolerance: {conditions}");
    experiment.configs.iter().fold(Table::new(caption, &["configuration", "rms / nm"]), |table, config| {
        let rms = config.in_position_rms_nm.map_or(MISSING.to_owned(), |rms| number(rms, 2));
        table.row([config.name.clone(), rms])
    })
}

#[cfg(test)]
mod tests;
