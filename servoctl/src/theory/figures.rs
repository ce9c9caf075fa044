//! The data of figures 34 to 44 and 45 to 54, and their pictures.

use super::mass::{self, Verdict};
use super::{Method, TheoryError, massless};
use crate::plot::{Axis, Heat, Plot, Series};
use libm::exp;

/// k_P/σ of figures 34 to 44, in their order.
pub const KP_RATIOS: [f64; 11] = [0.05, 0.0675, 0.091, 0.123, 0.166, 0.224, 0.302, 0.407, 0.549, 0.741, 1.0];

/// δ of figures 45 to 54, in their order.
pub const DELTAS: [f64; 10] = [0.0, 0.1, 0.25, 0.5, 1.0, -0.05, -0.1, -0.3, -0.5, -0.65];

/// Range of initial errors in the maps (x_c). Figures 36 to 44 stay below 1000 % only where e0 is not near zero.
pub const E0_XC: (f64, f64) = (0.05, 1.0);

/// Range of δ in the maps, from the spread of the measured stiffness (section 7.4).
pub const DELTA: (f64, f64) = (-0.5, 1.0);

/// Levels of the maps (%).
const LEVELS_PERCENT: [f64; 11] = [-50.0, -25.0, -10.0, 0.0, 10.0, 25.0, 50.0, 100.0, 250.0, 500.0, 1000.0];

/// Half of one of figures 34 to 44: change of the 2 % settling time against δ = 0, over initial error and δ.
#[derive(Debug, Clone, PartialEq)]
pub struct Map {
    /// Control method.
    pub method: Method,
    /// k_P/σ.
    pub kp_ratio: f64,
    /// Initial errors, one per column (x_c), from the first to the last of [`E0_XC`].
    pub e0_xc: Vec<f64>,
    /// δ, one per row, from the first to the last of [`DELTA`].
    pub delta: Vec<f64>,
    /// Change row by row (%); `None` where unstable.
    pub change_percent: Vec<Option<f64>>,
}

impl Map {
    /// Computes a map; at least two columns and rows.
    ///
    /// # Errors
    /// [`TheoryError::OutOfRange`] for k_P/σ.
    pub fn new(method: Method, kp_ratio: f64, columns: usize, rows: usize) -> Result<Map, TheoryError> {
        let (e0_xc, delta) = (spread(E0_XC, columns), spread(DELTA, rows));
        let cases = delta.iter().flat_map(|&delta| e0_xc.iter().map(move |&e0_xc| (e0_xc, delta)));
        let change = |(e0_xc, delta)| {
            massless::Case { method, kp_ratio, e0_xc, delta }.settle().map(|settling| settling.change_percent)
        };
        let change_percent = cases.map(change).collect::<Result<_, _>>()?;
        Ok(Map { method, kp_ratio, e0_xc, delta, change_percent })
    }

    /// Share of the map that is unstable (0 to 1).
    pub fn unstable_share(&self) -> f64 {
        self.change_percent.iter().filter(|c| c.is_none()).count() as f64 / self.change_percent.len() as f64
    }

    /// Smallest and largest change where stable (%).
    pub fn extremes_percent(&self) -> (f64, f64) {
        let stable = self.change_percent.iter().flatten();
        stable.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), &c| (low.min(c), high.max(c)))
    }

    /// The map as a picture, red where unstable.
    pub fn plot(&self) -> Plot {
        let (x, y) = (outer_edges(E0_XC, self.e0_xc.len()), outer_edges(DELTA, self.delta.len()));
        let heat = Heat {
            x,
            y,
            columns: self.e0_xc.len(),
            values: self.change_percent.iter().map(|c| c.unwrap_or(f64::NAN)).collect(),
            levels: LEVELS_PERCENT.to_vec(),
            missing: "unstable".into(),
        };
        let title = format!("{}, k_P = {} σ: change / %", self.method.name(), self.kp_ratio);
        let axes = (Axis::linear("initial error / x_c").range(x.0, x.1), Axis::linear("δ").range(y.0, y.1));
        let description = format!("Change of settling time over initial error and δ: {title}");
        let mut plot = Plot::new(description, axes.0, axes.1).series(Series::new(title, 0).heat(heat));
        plot.height = 380.0;
        plot
    }
}

/// One line of figures 45 to 54.
#[derive(Debug, Clone, PartialEq)]
pub struct Curve {
    /// Legend entry.
    pub name: String,
    /// `false`: it oscillates for ever.
    pub settles: bool,
    /// Time (s).
    pub time_s: Vec<f64>,
    /// Position error (m).
    pub error_m: Vec<f64>,
}

/// The lines of one of figures 45 to 54: the ideal exponential, both methods without mass (where they have a course) and
/// both with mass, for [`mass::Case::thesis`], up to `end_s`.
///
/// # Errors
/// [`TheoryError::OutOfRange`] for δ or the time.
pub fn curves(delta: f64, end_s: f64) -> Result<Vec<Curve>, TheoryError> {
    const SAMPLES: usize = 1000;
    super::check("end", end_s, (1e-4, 1.0), "s")?;
    let cases = [Method::Observer, Method::Niasa].map(|method| mass::Case::thesis(method, delta));
    let ideal = |case: &mass::Case| {
        let time_s = spread((0.0, end_s), 200);
        let error_m = time_s.iter().map(|t| case.r_m * exp(-t * case.inv_tau_d_per_s)).collect();
        Curve { name: "ideal".into(), settles: true, time_s, error_m }
    };
    let mut curves = vec![ideal(&cases[0])];
    for case in &cases {
        let massless = case.massless();
        let (time_tau, error_xc): (Vec<f64>, Vec<f64>) =
            massless.course(end_s * case.inv_tau_d_per_s)?.into_iter().unzip();
        curves.push(Curve {
            name: format!("{}, massless", case.method.name()),
            settles: massless.settle()?.stable,
            time_s: time_tau.iter().map(|t| t / case.inv_tau_d_per_s).collect(),
            error_m: error_xc.iter().map(|e| e * case.coulomb_n / case.sigma_n_per_m).collect(),
        });
    }
    for case in &cases {
        let response = case.respond()?;
        let (time_s, error_m) = response.sampled(end_s, SAMPLES).into_iter().unzip();
        let settles = response.verdict == Verdict::Settles;
        curves.push(Curve { name: format!("{}, with mass", case.method.name()), settles, time_s, error_m });
    }
    curves.retain(|curve| curve.time_s.len() > 1);
    Ok(curves)
}

/// One of figures 45 to 54 as a picture. As in the thesis, the observer is left out below δ = −0.1, where it only swings.
///
/// # Errors
/// Those of [`curves`].
pub fn curve_plot(delta: f64, end_s: f64) -> Result<Plot, TheoryError> {
    let (x, y) = (Axis::linear("time / ms").range(0.0, end_s * 1e3), Axis::linear("position error / nm"));
    let plot = Plot::new(format!("Error over time, δ = {delta}"), x, y);
    // Black for the ideal; each method in its colour, the massless one beside it.
    let colours = |name: &str| match (name.starts_with(Method::Niasa.name()), name.ends_with("massless")) {
        _ if name == "ideal" => 5,
        (false, true) => 4,
        (false, false) => 1,
        (true, true) => 2,
        (true, false) => 0,
    };
    let shown = |curve: &Curve| delta >= -0.1 || !curve.name.starts_with(Method::Observer.name());
    Ok(curves(delta, end_s)?.iter().filter(|c| shown(c)).fold(plot, |plot, curve| {
        let points = curve.time_s.iter().zip(&curve.error_m).map(|(t, e)| (t * 1e3, e * 1e9));
        plot.series(Series::new(&curve.name, colours(&curve.name)).line(points))
    }))
}

/// Even values from the first to the last, both included.
fn spread((first, last): (f64, f64), count: usize) -> Vec<f64> {
    let last_index = count.max(2) - 1;
    (0..=last_index).map(|i| first + (last - first) * i as f64 / last_index as f64).collect()
}

/// Edges of the cells around values that are spread evenly.
fn outer_edges((first, last): (f64, f64), count: usize) -> (f64, f64) {
    let half = 0.5 * (last - first) / (count.max(2) - 1) as f64;
    (first - half, last + half)
}
