//! Confidence intervals from residuals that are not independent.

use serde::Serialize;

use crate::linear::{Normal, solve};
use crate::record::Record;

/// Fewest blocks: legs are divided until there are as many.
const MIN_BLOCKS: usize = 24;

/// Groups by distance from the turning point.
const DISTANCES: usize = 12;

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

/// Samples that belong together, by number: residuals may be correlated within a group in any way, and not between groups.
pub(crate) struct Grouping {
    /// Group of every sample.
    of: Vec<usize>,
    /// Number of groups.
    count: usize,
}

impl Grouping {
    /// Groups that end before the samples `ends`, one after the other.
    pub(crate) fn by_ends(ends: &[usize]) -> Grouping {
        let mut from = 0;
        let of = ends
            .iter()
            .enumerate()
            .flat_map(|(group, end)| std::iter::repeat_n(group, end - std::mem::replace(&mut from, *end)));
        Grouping { of: of.collect(), count: ends.len() }
    }

    /// By time: the legs of the motion, whose turning points carry an error into all that follows up to the next, divided evenly if
    /// there are few of them.
    pub(crate) fn by_leg(record: &Record) -> Grouping {
        let pieces = MIN_BLOCKS.div_ceil(record.legs.len());
        let ends =
            record.legs.iter().flat_map(|leg| (1..=pieces).map(move |k| leg.from + (leg.to - leg.from) * k / pieces));
        let mut ends: Vec<usize> = ends.collect();
        if let Some(last) = ends.last_mut() {
            *last = record.samples();
        }
        ends.dedup();
        Grouping::by_ends(&ends)
    }

    /// By distance from the turning point, as many samples in each group: where the true curve is not the model's, it is so in every
    /// leg.
    pub(crate) fn by_distance(record: &Record) -> Grouping {
        let x = &record.position_m;
        let mut distance_m = vec![0.0; x.len()];
        for leg in &record.legs {
            (leg.from..=leg.to).for_each(|i| distance_m[i] = (x[i] - x[leg.from]).abs());
        }
        let mut order: Vec<usize> = (0..x.len()).collect();
        order.sort_by(|i, j| distance_m[*i].total_cmp(&distance_m[*j]));
        let mut of = vec![0; x.len()];
        for (rank, sample) in order.into_iter().enumerate() {
            of[sample] = rank * DISTANCES / x.len();
        }
        Grouping { of, count: DISTANCES }
    }

    /// What belongs together by both.
    fn and(&self, other: &Grouping) -> Grouping {
        let of = self.of.iter().zip(&other.of).map(|(a, b)| a * other.count + b);
        Grouping { of: of.collect(), count: self.count * other.count }
    }
}

/// Covariance of least-squares parameters, whose derivatives are `columns`, with `left` as residuals.
///
/// The jackknife over groups: leaving out group `g` changes the parameters by `−(JᵀJ − J_gᵀJ_g)⁻¹ J_gᵀ r_g`, and the sum of the
/// squares of these changes is the covariance. A group without which the parameters cannot be told counts with the change that it
/// makes to the whole.
pub(crate) fn covariance(columns: &[&[f64]], left: &[f64], grouping: &Grouping) -> Option<Covariance> {
    let n = columns.len();
    let whole = Normal::new(columns, left);
    let mut grams = vec![0.0; grouping.count * n * n];
    let mut moments = vec![0.0; grouping.count * n];
    for (sample, group) in grouping.of.iter().enumerate() {
        for i in 0..n {
            moments[group * n + i] += columns[i][sample] * left[sample];
            for j in 0..n {
                grams[(group * n + i) * n + j] += columns[i][sample] * columns[j][sample];
            }
        }
    }
    let mut matrix = vec![0.0; n * n];
    for (gram, moment) in grams.chunks(n * n).zip(moments.chunks(n)) {
        let others: Vec<f64> = whole.gram().iter().zip(gram).map(|(all, part)| all - part).collect();
        let change = solve(&others, moment).or_else(|| solve(whole.gram(), moment))?;
        for i in 0..n {
            for j in 0..n {
                matrix[i * n + j] += change[i] * change[j];
            }
        }
    }
    let count = grouping.count as f64;
    matrix.iter_mut().for_each(|c| *c *= (count - 1.0) / count);
    Some(Covariance { matrix, quantile: student_quantile(count - 1.0) })
}

/// [`covariance`] with residuals that may be correlated along a leg, and at one distance from all turning points.
///
/// # Source
/// Cameron, Gelbach, Miller 2011: the sum of both covariances counts what both have in common twice.
pub(crate) fn covariance_of_legs(columns: &[&[f64]], left: &[f64], record: &Record) -> Option<Covariance> {
    let (by_leg, by_distance) = (Grouping::by_leg(record), Grouping::by_distance(record));
    let along = covariance(columns, left, &by_leg)?;
    let across = covariance(columns, left, &by_distance)?;
    let common = covariance(columns, left, &by_leg.and(&by_distance))?;
    let n = columns.len();
    let mut matrix: Vec<f64> = (0..n * n).map(|i| along.matrix[i] + across.matrix[i] - common.matrix[i]).collect();
    // A difference of estimates need not be positive: no less than the larger of the two.
    if (0..n).any(|i| matrix[i * n + i] < along.matrix[i * n + i].max(across.matrix[i * n + i])) {
        matrix = if along.matrix[0] > across.matrix[0] { along.matrix } else { across.matrix };
    }
    Some(Covariance { matrix, quantile: along.quantile.max(across.quantile) })
}

/// Two-sided 95 % quantile of Student's distribution with `freedom` degrees, at least 4, to 0.5 %.
///
/// # Source
/// Cornish-Fisher expansion, Abramowitz and Stegun 26.7.5.
pub(crate) fn student_quantile(freedom: f64) -> f64 {
    let z: f64 = 1.959_963_984_540_054;
    let v = freedom.max(4.0);
    let z3 = z * z * z;
    let z5 = z3 * z * z;
    let z7 = z5 * z * z;
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
