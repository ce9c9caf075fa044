//! How settling depends on each of NIASA's parameters (8.1, ch. 11), and on a stage that is not what the model says (7.4).

use super::settling::{conditions, range_in_words, reduction, slower_at, table, tolerances};
use crate::plot::{Axis, Band, Plot, Series};
use crate::reproduce::outcome::Run;
use crate::table::{MISSING, Table};
use crate::thesis::section::Section;
use crate::thesis::targets::Target;
use crate::thesis::verdict::{Check, judge};

/// Tolerance that the pictures show (±, nm).
const SHOWN_NM: u32 = 10;
/// Positions of half and twice the nominal value among a parameter's five, after PID.
const HALF_AND_TWICE: [usize; 2] = [2, 4];

/// The section: a run per parameter and form, then one per corner of the stage.
pub fn section(runs: &[&Run]) -> Section {
    let corner = |run: &&&Run| run.name.starts_with('δ');
    let parameters: Vec<&Run> = runs.iter().filter(|run| !corner(run)).copied().collect();
    let corners: Vec<&Run> = runs.iter().filter(corner).copied().collect();
    let half_wrong: Vec<&Run> =
        parameters.iter().filter(|run| run.name == "σ̂, App. E" || run.name == "F̂_C, App. E").copied().collect();
    let ours: Vec<String> = half_wrong
        .iter()
        .flat_map(|run| HALF_AND_TWICE.iter().filter_map(|i| Some((*run, *i, run.configs.get(*i)?))))
        .map(|(run, i, config)| format!("{}: {}", config.settling.name, range_in_words(run, i)))
        .collect();
    let section = Section::new("8.1, 11 Sensitivity")
        .judged(Target::HalfWrong, format!("reduction with {}", ours.join("; ")), judge(&checks(&half_wrong)))
        .conditions(conditions(&parameters))
        .figure(
            &[],
            parameters.iter().map(|run| parameter_plot(run)).collect::<Vec<_>>(),
            format!("reduction of the mean settling time to ±{SHOWN_NM} nm, each parameter by itself"),
        )
        .table(&[], corner_table(&corners));
    parameters.iter().fold(section, |section, run| section.table(&[], table(run)))
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

fn corner_table(corners: &[&Run]) -> Table {
    let header = ["stage", "reduction (App. E)", "not faster at", "reduction (7.55)", "not faster at"];
    let title = "Stages at the corners of what was measured, the drive unchanged, friction not redrawn";
    let table = Table::new(title, &header);
    corners.iter().fold(table, |table, run| {
        let slower = |config: usize| match slower_at(run, config).as_slice() {
            [] => MISSING.to_owned(),
            slower => tolerances(slower),
        };
        let name = run.name.replace('-', "−");
        table.row([name, range_in_words(run, 1), slower(1), range_in_words(run, 2), slower(2)])
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::thesis::sections::traces::tests::tiny_run;
    use crate::thesis::verdict::Outcome;

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
