//! Friction models fitted to one oscillation (ch. 2, figs 4 to 10 and 83; App. A, table 4).

use servo_sim::friction::GMS_TABLE_4;

use crate::plot::{Axis, Plot, Series};
use crate::reproduce::models::{Model, Models, ORIGIN};
use crate::table::{Table, number};
use crate::thesis::section::Section;
use crate::thesis::targets::Target;
use crate::thesis::verdict::Check;

/// How near the residuals of Dahl and LuGre are where the thesis calls them "almost exactly the same" (share).
const ALMOST: f64 = 0.1;

/// The section.
pub fn section(models: &Models) -> Section {
    let residuals: Vec<String> =
        models.fits.iter().map(|fit| format!("{} {} %", fit.name, number(fit.rms_percent, 1))).collect();
    let sum_n: f64 = GMS_TABLE_4.iter().map(|element| element.saturation_n).sum();
    let sum = Check::within("sum", Some(sum_n), (0.43015 - 0.0001, 0.43015 + 0.0001), 4, "N");
    let section = Section::new("2 Friction models")
        .finding(Target::Models, format!("left over, of the force: {}", residuals.join(", ")), &checks(&models.fits))
        .finding(Target::GmsSum, format!("{} N", number(sum_n, 4)), &[sum])
        .text(
            "The thesis' measured data are not printed. The elements of its table 4, which it fitted to them, stand for the stage here, \
             so that a GMS model comes as near as its elements are like those: the fit looks for reaches a constant factor apart and \
             leaves away elements that would have to push. The other models show what they cannot follow.",
        )
        .figure(
            &[4],
            motion(models),
            format!("decaying oscillation, and the friction along it; {ORIGIN}"),
        )
        .table(&[], models.table());
    let section = section.figure(
        &[5, 6, 7],
        of_figures(models, 5..=7),
        format!("classical models (orange) fitted to that friction (blue): viscous, Coulomb, both; {ORIGIN}"),
    );
    let section = section.figure(
        &[8, 9, 10, 83],
        of_figures(models, 8..=10),
        format!("models with a state (orange) fitted to that friction (blue): Dahl, LuGre, GMS; {ORIGIN}"),
    );
    section.table(&[4], table_4())
}

/// Residual of the model shown in a figure (% of the force).
fn residual(fits: &[Model], figure: u32) -> Option<f64> {
    fits.iter().find(|fit| fit.figure == figure).map(|fit| fit.rms_percent)
}

fn checks(fits: &[Model]) -> Vec<Check> {
    let below = |better: u32, worse: u32, says: &str| {
        let pair = residual(fits, better).zip(residual(fits, worse));
        let holds = pair.is_some_and(|(better, worse)| better < worse);
        let numbers = pair.map_or(String::new(), |(b, w)| format!(" ({} against {} %)", number(b, 1), number(w, 1)));
        Check::new(holds, format!("{says}{}{numbers}", if holds { "" } else { ": no" }))
    };
    let same =
        residual(fits, 8).zip(residual(fits, 9)).is_some_and(|(dahl, lugre)| (lugre / dahl - 1.0).abs() < ALMOST);
    let least = fits.iter().min_by(|a, b| a.rms_percent.total_cmp(&b.rms_percent));
    vec![
        below(6, 5, "Coulomb fits better than viscous"),
        below(7, 6, "both better than Coulomb"),
        below(8, 7, "Dahl better than both"),
        Check::new(same, format!("LuGre {} Dahl", if same { "almost the same as" } else { "differs from" })),
        Check::new(least.is_some_and(|l| l.figure == 10), format!("{} fits best", least.map_or("nothing", |l| l.name))),
    ]
}

/// Displacement over time, force over displacement.
fn motion(models: &Models) -> [Plot; 2] {
    let motion = &models.motion;
    let time = motion.time_s.iter().copied();
    let um = |m: &f64| m * 1e6;
    [
        Plot::new("The oscillation", Axis::linear("time / s"), Axis::linear("displacement / µm"))
            .series(Series::new("", 0).line(time.zip(motion.position_m.iter().map(um)))),
        Plot::new("Friction along it", Axis::linear("displacement / µm"), Axis::linear("friction / N"))
            .series(Series::new("", 0).line(motion.position_m.iter().map(um).zip(motion.force_n.iter().copied()))),
    ]
}

/// Data and model, a panel for each figure.
fn of_figures(models: &Models, figures: std::ops::RangeInclusive<u32>) -> Vec<Plot> {
    let position_um = || models.motion.position_m.iter().map(|m| m * 1e6);
    let panel = |fit: &Model| {
        Plot::new(format!("Fit: {}", fit.name), Axis::linear("displacement / µm"), Axis::linear("friction / N"))
            .series(Series::new("data", 0).line(position_um().zip(models.motion.force_n.iter().copied())))
            .series(Series::new(fit.name, 1).line(position_um().zip(fit.force_n.iter().copied())))
    };
    models.fits.iter().filter(|fit| figures.contains(&fit.figure)).map(panel).collect()
}

fn table_4() -> Table {
    let header = ["element", "k_i / N/µm", "F_i^sat / N", "saturates after / nm"];
    let caption = "the eight elements, as the thesis prints them and the simulation has them";
    (1..).zip(GMS_TABLE_4).fold(Table::new(caption, &header), |table, (i, element)| {
        table.row([
            i.to_string(),
            number(element.stiffness_n_per_m * 1e-6, 4),
            number(element.saturation_n, 4),
            number(element.saturation_n / element.stiffness_n_per_m * 1e9, 2),
        ])
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::thesis::verdict::{Outcome, judge};

    fn fits(residuals_percent: [f64; 6]) -> Vec<Model> {
        let model = |(figure, rms_percent)| Model {
            figure,
            name: "model",
            parameters: vec![],
            rms_n: 0.0,
            rms_percent,
            force_n: vec![],
        };
        (5..).zip(residuals_percent).map(model).collect()
    }

    #[test]
    fn each_model_has_to_fit_better_than_the_one_before_and_lugre_as_dahl() {
        assert_eq!(judge(&checks(&fits([80.0, 40.0, 30.0, 10.0, 9.9, 1.0]))).outcome, Outcome::Reproduced);
        assert_eq!(judge(&checks(&fits([80.0, 40.0, 30.0, 10.0, 5.0, 1.0]))).outcome, Outcome::Partly);
        assert_eq!(judge(&checks(&fits([1.0, 2.0, 3.0, 4.0, 5.0, 6.0]))).outcome, Outcome::NotReproduced);
        assert_eq!(judge(&checks(&[])).outcome, Outcome::NotReproduced);
    }
}
