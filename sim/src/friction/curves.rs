//! The friction models side by side: the data of figures 4 to 10.
//!
//! The thesis measured a crossed-roller stage and fitted every model to the same data; the data are not printed, but the eight
//! elements of its best fit are (table 4). They stand for the measurement here, and every model is fitted to them by least squares.

use super::{Dahl, Element, Elements, Friction, Gms, Level, LuGre, gms, lugre};

/// Amplitude of the first oscillation, m: far enough for every element of table 4 to slide. The thesis does not give its own.
pub const AMPLITUDE_M: f64 = 20e-6;
/// Frequency of the sine wave, Hz (as in figure 19).
pub const FREQUENCY_HZ: f64 = 8.0;
/// Time in which the amplitude decays by e, s.
pub const DECAY_S: f64 = 0.2;
/// Length of the record, s: the last oscillation has 135 nm.
pub const DURATION_S: f64 = 1.0;
/// Sample rate of the record, Hz.
pub const SAMPLE_HZ: f64 = 2_000.0;

/// A decaying oscillation with the friction force along it: figure 4.
#[derive(Clone, Debug, PartialEq)]
pub struct Motion {
    /// Time, s.
    pub time_s: Vec<f64>,
    /// Displacement, m.
    pub position_m: Vec<f64>,
    /// Mean velocity since the sample before, m/s.
    pub velocity_m_per_s: Vec<f64>,
    /// Friction force, N.
    pub force_n: Vec<f64>,
}

/// A model fitted to a [`Motion`].
#[derive(Clone, Debug, PartialEq)]
pub struct Fit {
    /// Number of the figure.
    pub figure: u32,
    /// The model.
    pub name: &'static str,
    /// What was fitted: names as in the stage file, SI units.
    pub parameters: Vec<(String, f64)>,
    /// Force of the model, one for each sample, N.
    pub force_n: Vec<f64>,
    /// Root mean square of what is left, N.
    pub rms_n: f64,
}

/// Figure 4: the motion, and the force of table 4's elements along it.
pub fn figure_4() -> Motion {
    let samples = (DURATION_S * SAMPLE_HZ) as usize;
    let time_s: Vec<f64> = (0..=samples).map(|i| i as f64 / SAMPLE_HZ).collect();
    let at = |t: &f64| AMPLITUDE_M * libm::exp(-t / DECAY_S) * libm::sin(std::f64::consts::TAU * FREQUENCY_HZ * t);
    let position_m: Vec<f64> = time_s.iter().map(at).collect();
    let measured = Friction::Gms(parallel(Elements::table_4()));
    let force_n = along(measured, &position_m, 1.0 / SAMPLE_HZ);
    let mut velocity_m_per_s = vec![0.0];
    velocity_m_per_s.extend(position_m.windows(2).map(|pair| (pair[1] - pair[0]) * SAMPLE_HZ));
    Motion { time_s, position_m, velocity_m_per_s, force_n }
}

/// Figures 5 to 10, each model fitted to the motion: viscous, Coulomb, both, Dahl, LuGre and GMS. The last three search: seconds.
pub const FIGURES_5_TO_10: [fn(&Motion) -> Fit; 6] = [viscous, coulomb, coulomb_and_viscous, dahl, lugre, gms];

/// The force of a model that is moved through the positions (m), from rest at 0, `dt_s` apart.
pub fn along(mut friction: Friction, position_m: &[f64], dt_s: f64) -> Vec<f64> {
    let mut before_m = 0.0;
    let step = |to_m: &f64| friction.advance(to_m - std::mem::replace(&mut before_m, *to_m), dt_s);
    position_m.iter().map(step).collect()
}

/// The positions (m) from 0 through the turning points in steps of at most `step_m` (positive): a path for [`along`].
pub fn through(turning_points_m: &[f64], step_m: f64) -> Vec<f64> {
    let mut path_m = vec![0.0];
    for to_m in turning_points_m {
        let from_m = path_m[path_m.len() - 1];
        let steps = ((to_m - from_m).abs() / step_m - 1e-6).ceil().max(1.0);
        path_m.extend((1..=steps as usize).map(|i| from_m + (to_m - from_m) * i as f64 / steps));
    }
    path_m
}

/// The force of a model in steady motion at each velocity (m/s, not 0): what is left after `settle_m` (positive) of it.
pub fn over_velocity(friction: &Friction, velocity_m_per_s: &[f64], settle_m: f64) -> Vec<f64> {
    let steady = |velocity: &f64| {
        let (mut friction, dx_m) = (friction.clone(), 1e-3 * settle_m.copysign(*velocity));
        (0..1_000).map(|_| friction.advance(dx_m, dx_m / velocity)).fold(0.0, |_, force_n| force_n)
    };
    velocity_m_per_s.iter().map(steady).collect()
}

fn parallel(elements: Elements) -> Gms {
    let level = Level::constant(elements.coulomb_n());
    let law = gms::Law::Attraction { attraction_n_per_s: f64::INFINITY };
    Gms::new(gms::Parameters { elements, level, damping_n_s_per_m: 0.0, viscous_n_s_per_m: 0.0, law })
}

fn viscous(motion: &Motion) -> Fit {
    linear(5, "viscous", &[(VISCOUS, &motion.velocity_m_per_s)], motion)
}

fn coulomb(motion: &Motion) -> Fit {
    linear(6, "Coulomb", &[(COULOMB, &direction(motion))], motion)
}

fn coulomb_and_viscous(motion: &Motion) -> Fit {
    let columns: [(&str, &[f64]); 2] = [(COULOMB, &direction(motion)), (VISCOUS, &motion.velocity_m_per_s)];
    linear(7, "Coulomb and viscous", &columns, motion)
}

const VISCOUS: &str = "viscous_n_s_per_m";
const COULOMB: &str = "coulomb_n";

/// Sign of the velocity, 0 where there is none.
fn direction(motion: &Motion) -> Vec<f64> {
    motion.velocity_m_per_s.iter().map(|v| if *v == 0.0 { 0.0 } else { v.signum() }).collect()
}

/// A force that is a sum of columns, each with a parameter of its own.
fn linear(figure: u32, name: &'static str, columns: &[(&str, &[f64])], motion: &Motion) -> Fit {
    let (names, columns): (Vec<&str>, Vec<&[f64]>) = columns.iter().copied().unzip();
    let weights = least_squares(&columns, &motion.force_n);
    let force_n = combine(&columns, &weights);
    finish(figure, name, names.iter().map(|name| name.to_string()).zip(weights).collect(), force_n, motion)
}

fn dahl(motion: &Motion) -> Fit {
    let force_n = |[stiffness, coulomb]: [f64; 2]| {
        along(Friction::Dahl(Dahl::new(stiffness, coulomb)), &motion.position_m, 1.0 / SAMPLE_HZ)
    };
    let best = minimise(|p| rms(&force_n(p), &motion.force_n), [1e6, 0.5]);
    finish(8, "Dahl", names(["stiffness_n_per_m", "coulomb_n"], best), force_n(best), motion)
}

/// σ1 and σ2 are linear in the force and solved for σ0 and F_C given.
fn lugre(motion: &Motion) -> Fit {
    let with = |[stiffness, coulomb]: [f64; 2]| {
        let parameters = lugre::Parameters {
            stiffness_n_per_m: stiffness,
            damping_n_s_per_m: 0.0,
            viscous_n_s_per_m: 0.0,
            level: Level::constant(coulomb),
        };
        let spring_n = along(Friction::LuGre(LuGre::new(parameters)), &motion.position_m, 1.0 / SAMPLE_HZ);
        let mut rate = vec![0.0];
        rate.extend(spring_n.windows(2).map(|pair| (pair[1] - pair[0]) / stiffness * SAMPLE_HZ));
        let left_n: Vec<f64> = motion.force_n.iter().zip(&spring_n).map(|(f, s)| f - s).collect();
        let columns: [&[f64]; 2] = [&rate, &motion.velocity_m_per_s];
        let weights = least_squares(&columns, &left_n);
        let force_n: Vec<f64> = spring_n.iter().zip(combine(&columns, &weights)).map(|(s, d)| s + d).collect();
        (weights, force_n)
    };
    let best = minimise(|p| rms(&with(p).1, &motion.force_n), [1e6, 0.5]);
    let (weights, force_n) = with(best);
    let mut parameters = names(["stiffness_n_per_m", "coulomb_n"], best);
    parameters.extend(names(["damping_n_s_per_m", "viscous_n_s_per_m"], [weights[0], weights[1]]));
    finish(9, "LuGre", parameters, force_n, motion)
}

/// Eight elements whose reaches `F_i^sat/k_i` are a constant factor apart: the force is linear in the stiffnesses, and the first
/// reach and the factor are searched. Elements that would have to push are left away.
fn gms(motion: &Motion) -> Fit {
    let with = |[first_m, factor]: [f64; 2]| {
        let reaches_m: Vec<f64> = (0..8).map(|i| first_m * libm::pow(factor, f64::from(i))).collect();
        let columns: Vec<Vec<f64>> = reaches_m.iter().map(|reach_m| stretch(&motion.position_m, *reach_m)).collect();
        let columns: Vec<&[f64]> = columns.iter().map(Vec::as_slice).collect();
        let stiffness = least_squares(&columns, &motion.force_n);
        let force_n = combine(&columns, &stiffness);
        let elements = stiffness.into_iter().zip(reaches_m).filter(|(k, _)| *k > 0.0);
        let elements: Vec<Element> =
            elements.map(|(k, reach_m)| Element { stiffness_n_per_m: k, saturation_n: k * reach_m }).collect();
        (elements, force_n)
    };
    // There are several valleys: which elements are left away depends on the pair.
    let cost = |p| rms(&with(p).1, &motion.force_n);
    let starts = [0.5e-9, 1e-9, 3e-9].into_iter().flat_map(|first_m| [2.5, 3.5, 5.0].map(|factor| [first_m, factor]));
    let best = starts.map(|start| minimise(cost, start)).min_by(|a, b| cost(*a).total_cmp(&cost(*b)));
    let (elements, force_n) = with(best.unwrap_or([1e-9, 4.0]));
    let parameters = elements.iter().enumerate().flat_map(|(i, element)| {
        [
            (format!("element_stiffness_n_per_m[{i}]"), element.stiffness_n_per_m),
            (format!("element_saturation_n[{i}]"), element.saturation_n),
        ]
    });
    finish(10, "GMS", parameters.collect(), force_n, motion)
}

/// How far a slider of that reach (m) is drawn out along the positions (m): its force for a stiffness of one (A.4 corrected).
fn stretch(position_m: &[f64], reach_m: f64) -> Vec<f64> {
    let (mut before_m, mut stretch_m) = (0.0, 0.0f64);
    let step = |to_m: &f64| {
        stretch_m = (stretch_m + to_m - std::mem::replace(&mut before_m, *to_m)).clamp(-reach_m, reach_m);
        stretch_m
    };
    position_m.iter().map(step).collect()
}

fn names<const N: usize>(names: [&str; N], values: [f64; N]) -> Vec<(String, f64)> {
    names.into_iter().map(str::to_string).zip(values).collect()
}

fn finish(figure: u32, name: &'static str, parameters: Vec<(String, f64)>, force_n: Vec<f64>, motion: &Motion) -> Fit {
    let rms_n = rms(&force_n, &motion.force_n);
    Fit { figure, name, parameters, force_n, rms_n }
}

/// Root mean square of the difference.
fn rms(a: &[f64], b: &[f64]) -> f64 {
    libm::sqrt(a.iter().zip(b).map(|(a, b)| (a - b) * (a - b)).sum::<f64>() / a.len() as f64)
}

/// `Σ weight · column`.
fn combine(columns: &[&[f64]], weights: &[f64]) -> Vec<f64> {
    let rows = columns.first().map_or(0, |column| column.len());
    (0..rows).map(|row| columns.iter().zip(weights).map(|(column, weight)| column[row] * weight).sum()).collect()
}

/// The weights, none negative, with which the columns come nearest to `wanted`: normal equations on columns of unit length, one weight
/// after the other until none moves.
fn least_squares(columns: &[&[f64]], wanted: &[f64]) -> Vec<f64> {
    let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
    let lengths: Vec<f64> = columns.iter().map(|column| libm::sqrt(dot(column, column))).collect();
    let unit = |i: usize, product: f64| product / lengths[i];
    let n = columns.len();
    let gram: Vec<Vec<f64>> =
        (0..n).map(|i| (0..n).map(|j| unit(i, unit(j, dot(columns[i], columns[j])))).collect()).collect();
    let goal: Vec<f64> = (0..n).map(|i| unit(i, dot(columns[i], wanted))).collect();
    let mut weights = vec![0.0; n];
    for _ in 0..2_000 {
        let mut moved = 0.0f64;
        for i in 0..n {
            let others: f64 = (0..n).filter(|j| *j != i).map(|j| gram[i][j] * weights[j]).sum();
            let next = (goal[i] - others).max(0.0);
            moved = moved.max((next - weights[i]).abs());
            weights[i] = next;
        }
        if moved <= 1e-10 * goal.iter().fold(0.0, |largest, g| f64::max(largest, g.abs())) {
            break;
        }
    }
    weights.into_iter().zip(lengths).map(|(weight, length)| weight / length).collect()
}

/// The positive pair with the smallest `cost`, near `start`: each in turn and both at once are stretched and shrunk by a factor that
/// grows while that helps and is halved (its logarithm) when it does not, down to ten parts in a million.
fn minimise(cost: impl Fn([f64; 2]) -> f64 + Copy, start: [f64; 2]) -> [f64; 2] {
    let (mut best, mut least, mut log_step) = (start, cost(start), 0.5);
    while log_step > 1e-5 {
        let before = least;
        // A narrow valley is rarely parallel to an axis.
        for direction in [[1.0, 0.0], [0.0, 1.0], [1.0, 1.0], [1.0, -1.0]] {
            for way in [log_step, -log_step] {
                let tried = [0, 1].map(|i| best[i] * libm::exp(way * direction[i]));
                let tried_cost = cost(tried);
                if tried_cost < least {
                    (best, least) = (tried, tried_cost);
                }
            }
        }
        log_step *= if least < before * (1.0 - 1e-4) { 1.5 } else { 0.5 };
    }
    best
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::friction::{MaxwellSlip, Stribeck};

    #[test]
    fn the_models_of_figures_5_to_10_come_nearer_and_nearer() {
        let motion = figure_4();
        let fits = FIGURES_5_TO_10.map(|fit| fit(&motion));
        assert_eq!(fits.iter().map(|fit| fit.figure).collect::<Vec<_>>(), [5, 6, 7, 8, 9, 10]);
        let [viscous, coulomb, both, dahl, lugre, gms] = [0, 1, 2, 3, 4, 5].map(|i| fits[i].rms_n);
        // What the thesis sees in its figures, in words.
        assert!(viscous > coulomb && coulomb >= both && both > 1.5 * dahl, "{viscous} {coulomb} {both} {dahl}");
        assert!(lugre <= dahl && lugre > 0.9 * dahl, "figure 9 looks like figure 8: {dahl} {lugre}");
        assert!(gms < 0.2 * dahl, "and GMS comes nearest: {dahl} {gms}");
    }

    #[test]
    fn the_rate_dependent_terms_of_lugre_are_insignificant() {
        let motion = figure_4();
        let (dahl, lugre) = (dahl(&motion), lugre(&motion));
        for i in 0..2 {
            let (a, b) = (dahl.parameters[i].1, lugre.parameters[i].1);
            assert!((a / b - 1.0).abs() < 0.15, "{:?} {:?}", dahl.parameters[i], lugre.parameters[i]);
        }
        assert!(rms(&dahl.force_n, &lugre.force_n) < 0.3 * dahl.rms_n, "{} N", rms(&dahl.force_n, &lugre.force_n));
    }

    #[test]
    fn a_model_is_found_again_in_its_own_data() {
        let mut motion = figure_4();
        let truth = Friction::Dahl(Dahl::new(3.3e6, 0.45));
        motion.force_n = along(truth, &motion.position_m, 1.0 / SAMPLE_HZ);
        let fit = dahl(&motion);
        assert!((fit.parameters[0].1 / 3.3e6 - 1.0).abs() < 1e-4 && (fit.parameters[1].1 / 0.45 - 1.0).abs() < 1e-5);
        motion.force_n = motion.velocity_m_per_s.iter().map(|v| 0.4 * v.signum() + 55.0 * v).collect();
        motion.force_n[0] = 0.0;
        let both = coulomb_and_viscous(&motion);
        assert!((both.parameters[0].1 - 0.4).abs() < 1e-9 && (both.parameters[1].1 - 55.0).abs() < 1e-6);
    }

    #[test]
    fn a_path_goes_through_its_turning_points() {
        let path_m = through(&[10e-9, -5e-9], 1e-9);
        assert_eq!(path_m.len(), 26, "with as few steps as may be");
        for (index, position_m) in [(0, 0.0), (10, 10e-9), (15, 5e-9), (25, -5e-9)] {
            assert!((path_m[index] - position_m).abs() < 1e-20, "{index}: {} m", path_m[index]);
        }
        let slip = Friction::MaxwellSlip(MaxwellSlip::new(12, 8.66e6, 0.64));
        assert_eq!(along(slip, &path_m, 1e-3).len(), 26);
    }

    #[test]
    fn over_velocity_a_model_shows_its_level() {
        let level = Level { coulomb_n: 0.6, static_n: 0.9, stribeck_m_per_s: 1e-3, stribeck_shape: 1.0 };
        let forces_n = over_velocity(&Friction::Stribeck(Stribeck::new(level, 3.0)), &[1e-3, -1e-2], 1e-4);
        assert!(
            (forces_n[0] - level.at(1e-3) - 3e-3).abs() < 1e-12 && (forces_n[1] + level.at(1e-2) + 3e-2).abs() < 1e-12
        );
    }
}
