//! Confidence intervals from residuals that are not independent.

use serde::Serialize;

use crate::linear::{Normal, solve};
use crate::record::Record;

/// Fewest blocks: legs are divided until there are as many.
const MIN_BLOCKS: usize = 24;

/// A closed interval, low and high.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Interval(pub [f64; 2]);

impl Interval {
    pub(crate) const NONE: Interval = Interval([f64::NEG_INFINITY, f64::INFINITY]);

    /// Whether `value` lies within.
    pub fn contains(&self, value: f64) -> bool {
        (self.0[0]..=self.0[1]).contains(&value)
    }
}

/// Covariance of estimated parameters.
pub(crate) struct Covariance {
    /// Row by row.
    pub matrix: Vec<f64>,
    /// Two-sided 95 % quantile of a parameter over its standard error.
    pub quantile: f64,
}

/// Ends of the blocks within which residuals may be correlated in any way: the legs of the motion, whose turning points carry an
/// error into all that follows up to the next, divided evenly if there are few of them.
pub(crate) fn blocks(record: &Record) -> Vec<usize> {
    let pieces = MIN_BLOCKS.div_ceil(record.legs.len());
    let ends =
        record.legs.iter().flat_map(|leg| (1..=pieces).map(move |k| leg.from + (leg.to - leg.from) * k / pieces));
    let mut ends: Vec<usize> = ends.collect();
    if let Some(last) = ends.last_mut() {
        *last = record.samples();
    }
    ends.dedup();
    ends
}

/// Covariance of least-squares parameters, whose derivatives are `columns`, with `left` as residuals.
///
/// The jackknife over blocks: leaving out block `b` changes the parameters by `−(JᵀJ − J_bᵀJ_b)⁻¹ J_bᵀ r_b`, and the sum of the
/// squares of these changes is the covariance. Blocks have to be independent of each other; within one anything goes. A block
/// without which the parameters cannot be told counts with the change that it makes to the whole.
pub(crate) fn covariance(columns: &[&[f64]], left: &[f64], ends: &[usize]) -> Option<Covariance> {
    let n = columns.len();
    let whole = Normal::new(columns, left);
    let mut matrix = vec![0.0; n * n];
    let mut from = 0;
    for end in ends {
        let parts: Vec<&[f64]> = columns.iter().map(|column| &column[from..*end]).collect();
        let block = Normal::new(&parts, &left[from..*end]);
        let others: Vec<f64> = whole.gram().iter().zip(block.gram()).map(|(all, part)| all - part).collect();
        let change = solve(&others, block.moment()).or_else(|| solve(whole.gram(), block.moment()))?;
        for i in 0..n {
            for j in 0..n {
                matrix[i * n + j] += change[i] * change[j];
            }
        }
        from = *end;
    }
    let count = ends.len() as f64;
    matrix.iter_mut().for_each(|c| *c *= (count - 1.0) / count);
    Some(Covariance { matrix, quantile: student_quantile(count - 1.0) })
}

/// Two-sided 95 % quantile of Student's distribution with `freedom` degrees, at least 4, to 0.5 %.
///
/// # Source
/// Cornish-Fisher expansion, Abramowitz and Stegun 26.7.5.
pub(crate) fn student_quantile(freedom: f64) -> f64 {
    let z: f64 = 1.959_963_984_540_054;
    let v = freedom.max(4.0);
    let (z3, z5, z7) = (z.powi(3), z.powi(5), z.powi(7));
    z + (z3 + z) / (4.0 * v)
        + (5.0 * z5 + 16.0 * z3 + 3.0 * z) / (96.0 * v * v)
        + (3.0 * z7 + 19.0 * z5 + 17.0 * z3 - 15.0 * z) / (384.0 * v * v * v)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn students_quantiles_are_the_tabulated_ones() {
        for (freedom, quantile) in [(4.0, 2.776), (9.0, 2.262), (23.0, 2.069), (60.0, 2.000), (1e6, 1.960)] {
            assert!(
                (student_quantile(freedom) / quantile - 1.0).abs() < 5e-3,
                "{freedom}: {}",
                student_quantile(freedom)
            );
        }
    }
}
