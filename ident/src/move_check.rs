//! Mass, viscous and Coulomb friction, and a check of the force constant, from a long move.

use serde::Serialize;

use crate::confidence::{self, Interval};
use crate::error::{DataError, within};
use crate::filter::{self, LowPass};
use crate::linear::Normal;
use crate::record::{FORCE_CONSTANT_RANGE_N_PER_A, check, check_saturation};

/// Corner of the filter that everything goes through, Hz.
const CORNER_HZ: f64 = 100.0;
/// Samples slower than this share of the highest speed say nothing of Coulomb friction: there it has not developed.
const SLOW_SHARE: f64 = 0.05;
/// Blocks of independent residuals.
const BLOCKS: usize = 24;

/// What a move says. Forces are in newton of the given force constant: a wrong one is wrong in the same ratio in all of them.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct MoveFit {
    /// Mass, kg.
    pub mass_kg: f64,
    /// 95 % interval of the mass, kg.
    pub mass_ci95_kg: Interval,
    /// Viscous friction, N s/m.
    pub viscous_n_s_per_m: f64,
    /// Coulomb friction, N.
    pub coulomb_n: f64,
    /// Constant force, N.
    pub offset_n: f64,
    /// Root mean square of what is left, N.
    pub rms_n: f64,
    /// Samples used.
    pub samples: usize,
}

impl MoveFit {
    /// The force constant with which the move shows `mass_kg` (known otherwise), N/A.
    pub fn force_constant_n_per_a(&self, assumed_n_per_a: f64, mass_kg: f64) -> f64 {
        assumed_n_per_a * mass_kg / self.mass_kg
    }
}

/// Fits `K_t i = m ẍ + d ẋ + F_C sgn ẋ + F_0` where the stage moves.
///
/// # Errors
/// Data that are not what they should be; a force constant out of range or of the wrong sign; [`DataError::Undetermined`] if the
/// move does not tell the four apart.
///
/// # Source
/// Equation 4.1, friction as in 2.1 and 2.3.
pub fn fit(
    time_s: &[f64],
    position_m: &[f64],
    current_a: &[f64],
    force_constant_n_per_a: f64,
) -> Result<MoveFit, DataError> {
    let [least, greatest] = FORCE_CONSTANT_RANGE_N_PER_A;
    within("force-constant", force_constant_n_per_a.abs(), least, greatest)?;
    let sample_s = check(time_s, &[("position_m", position_m), ("current_a", current_a)])?;
    check_saturation(current_a)?;
    let low_pass = LowPass::new(CORNER_HZ.min(0.1 / sample_s), sample_s);
    let position_m = low_pass.apply(&position_m.iter().map(|x| x - position_m[0]).collect::<Vec<f64>>());
    let force_n: Vec<f64> = low_pass.apply(current_a).iter().map(|i_a| force_constant_n_per_a * i_a).collect();
    let velocity = filter::derivative(&position_m, sample_s);
    let acceleration = filter::second_derivative(&position_m, sample_s);
    let fastest = velocity.iter().fold(0.0f64, |fastest, v| fastest.max(v.abs()));
    let used: Vec<usize> = (0..velocity.len()).filter(|i| velocity[*i].abs() > SLOW_SHARE * fastest).collect();
    let of = |signal: &[f64]| -> Vec<f64> { used.iter().map(|i| signal[*i]).collect() };
    let (acceleration, velocity, force_n) = (of(&acceleration), of(&velocity), of(&force_n));
    let direction: Vec<f64> = velocity.iter().map(|v| v.signum()).collect();
    let ones = vec![1.0; used.len()];
    let one_way = direction.windows(2).all(|d| d[0] == d[1]);
    let undetermined = |why: &str| DataError::Undetermined { what: "mass_kg", why: why.to_owned() };
    if one_way {
        return Err(DataError::NoReversal);
    }
    let columns: [&[f64]; 4] = [&acceleration, &velocity, &direction, &ones];
    let normal = Normal::new(&columns, &force_n);
    let solution = normal.solve().ok_or_else(|| undetermined("the move has no acceleration of its own"))?;
    let [mass_kg, viscous_n_s_per_m, coulomb_n, offset_n] = [solution[0], solution[1], solution[2], solution[3]];
    if mass_kg < 0.0 {
        let work_j = -acceleration.iter().zip(&force_n).map(|(a, f)| a * f).sum::<f64>().abs() * sample_s;
        return Err(DataError::WrongSign { field: "force-constant", value: force_constant_n_per_a, work_j });
    }
    let left_n: Vec<f64> = (0..used.len())
        .map(|i| force_n[i] - columns.iter().zip(&solution).map(|(column, x)| column[i] * x).sum::<f64>())
        .collect();
    let ends: Vec<usize> = (1..=BLOCKS).map(|k| used.len() * k / BLOCKS).collect();
    let covariance = confidence::covariance(&columns, &left_n, &confidence::Grouping::by_ends(&ends))
        .ok_or_else(|| undetermined("the move has no acceleration of its own"))?;
    let reach_kg = covariance.quantile * covariance.matrix[0].sqrt();
    if reach_kg > 0.5 * mass_kg {
        return Err(undetermined("its interval is wider than itself: accelerate more"));
    }
    Ok(MoveFit {
        mass_kg,
        mass_ci95_kg: Interval([mass_kg - reach_kg, mass_kg + reach_kg]),
        viscous_n_s_per_m,
        coulomb_n,
        offset_n,
        rms_n: (normal.left(&solution) / used.len() as f64).sqrt(),
        samples: used.len(),
    })
}
