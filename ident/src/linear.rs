//! Small systems of linear equations and least squares with and without signs.

/// A symmetric matrix and what it is to be divided into: the normal equations of a least-squares problem.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Normal {
    size: usize,
    /// `Jᵀ J`, row by row.
    gram: Vec<f64>,
    /// `Jᵀ y`.
    moment: Vec<f64>,
    /// `yᵀ y`.
    square: f64,
}

impl Normal {
    /// Of columns of equal length and the signal that they are to explain.
    pub(crate) fn new(columns: &[&[f64]], signal: &[f64]) -> Normal {
        let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
        let size = columns.len();
        let mut gram = vec![0.0; size * size];
        for i in 0..size {
            for j in 0..=i {
                let value = dot(columns[i], columns[j]);
                (gram[i * size + j], gram[j * size + i]) = (value, value);
            }
        }
        Normal {
            size,
            gram,
            moment: columns.iter().map(|column| dot(column, signal)).collect(),
            square: dot(signal, signal),
        }
    }

    /// `Jᵀ J`, row by row.
    pub(crate) fn gram(&self) -> &[f64] {
        &self.gram
    }

    /// The least-squares solution; nothing if the columns are not independent.
    pub(crate) fn solve(&self) -> Option<Vec<f64>> {
        solve(&self.gram, &self.moment)
    }

    /// Sum of the squares that `solution` leaves.
    pub(crate) fn left(&self, solution: &[f64]) -> f64 {
        let n = self.size;
        let explained: f64 = (0..n)
            .map(|i| {
                let row: f64 = (0..n).map(|j| self.gram[i * n + j] * solution[j]).sum();
                solution[i] * (2.0 * self.moment[i] - row)
            })
            .sum();
        (self.square - explained).max(0.0)
    }

    /// The least-squares solution in which the columns that `signed` does not name have no negative coefficient.
    ///
    /// # Source
    /// Lawson and Hanson 1974, chapter 23, on the normal equations.
    pub(crate) fn solve_non_negative(&self, signed: impl Fn(usize) -> bool) -> Vec<f64> {
        let n = self.size;
        let mut solution = vec![0.0; n];
        let mut active: Vec<bool> = (0..n).map(&signed).collect();
        if let Some(start) = self.solve_of(&active) {
            solution = start;
        }
        // Each round takes in one column; as many rounds as columns are usual, three times as many are the limit.
        for _ in 0..3 * n {
            let pull = |j: usize| {
                let row: f64 = (0..n).map(|k| self.gram[j * n + k] * solution[k]).sum();
                (self.moment[j] - row) / self.gram[j * n + j].max(f64::MIN_POSITIVE).sqrt()
            };
            let candidate = (0..n).filter(|j| !active[*j]).map(|j| (j, pull(j))).max_by(|a, b| a.1.total_cmp(&b.1));
            let Some((joining, strength)) = candidate else { break };
            if strength <= 1e-10 * self.square.sqrt() {
                break;
            }
            active[joining] = true;
            while let Some(wanted) = self.solve_of(&active) {
                let leaving = |j: &usize| active[*j] && !signed(*j) && wanted[*j] <= 0.0;
                let way = |j: usize| solution[j] / (solution[j] - wanted[j]).max(f64::MIN_POSITIVE);
                let nearest = (0..n).filter(leaving).map(|j| (j, way(j))).min_by(|a, b| a.1.total_cmp(&b.1));
                let Some((blocked, share)) = nearest else {
                    solution = wanted;
                    break;
                };
                for j in 0..n {
                    solution[j] += share * (wanted[j] - solution[j]);
                }
                (solution[blocked], active[blocked]) = (0.0, false);
            }
        }
        solution
    }

    /// Least squares with some of the columns only, 0 for the others.
    fn solve_of(&self, active: &[bool]) -> Option<Vec<f64>> {
        let chosen: Vec<usize> = (0..self.size).filter(|j| active[*j]).collect();
        let gram: Vec<f64> =
            chosen.iter().flat_map(|i| chosen.iter().map(move |j| self.gram[i * self.size + j])).collect();
        let moment: Vec<f64> = chosen.iter().map(|i| self.moment[*i]).collect();
        let mut solution = vec![0.0; self.size];
        for (j, value) in chosen.iter().zip(solve(&gram, &moment)?) {
            solution[*j] = value;
        }
        Some(solution)
    }
}

/// `x` in `A x = b` for a symmetric positive definite `A` (row by row), by Cholesky on unit diagonal; nothing if it is not.
pub(crate) fn solve(a: &[f64], b: &[f64]) -> Option<Vec<f64>> {
    let n = b.len();
    let scale: Vec<f64> = (0..n).map(|i| 1.0 / a[i * n + i].sqrt()).collect();
    if scale.iter().any(|s| !s.is_finite()) {
        return None;
    }
    let mut lower = vec![0.0; n * n];
    for i in 0..n {
        for j in 0..=i {
            let known: f64 = (0..j).map(|k| lower[i * n + k] * lower[j * n + k]).sum();
            let left = a[i * n + j] * scale[i] * scale[j] - known;
            lower[i * n + j] = if i == j {
                if left < 1e-13 {
                    return None;
                }
                left.sqrt()
            } else {
                left / lower[j * n + j]
            };
        }
    }
    let mut x: Vec<f64> = b.iter().zip(&scale).map(|(b, s)| b * s).collect();
    for i in 0..n {
        let known: f64 = (0..i).map(|k| lower[i * n + k] * x[k]).sum();
        x[i] = (x[i] - known) / lower[i * n + i];
    }
    for i in (0..n).rev() {
        let known: f64 = (i + 1..n).map(|k| lower[k * n + i] * x[k]).sum();
        x[i] = (x[i] - known) / lower[i * n + i];
    }
    Some(x.iter().zip(&scale).map(|(x, s)| x * s).collect())
}

/// The lowest point of `of` between `low` and `high`, by golden sections to a relative width of `tolerance`, if it has one minimum.
pub(crate) fn minimum(low: f64, high: f64, tolerance: f64, mut of: impl FnMut(f64) -> f64) -> f64 {
    let golden = 0.5 * (5f64.sqrt() - 1.0);
    let (mut a, mut b) = (low, high);
    let (mut c, mut d) = (b - golden * (b - a), a + golden * (b - a));
    let (mut at_c, mut at_d) = (of(c), of(d));
    while (b - a).abs() > tolerance * (a.abs() + b.abs()).max(tolerance) {
        if at_c < at_d {
            (b, d, at_d) = (d, c, at_c);
            c = b - golden * (b - a);
            at_c = of(c);
        } else {
            (a, c, at_c) = (c, d, at_d);
            d = a + golden * (b - a);
            at_d = of(d);
        }
    }
    0.5 * (a + b)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn a_system_with_very_different_units_is_solved() {
        // Diagonal 1e12, 1, 1e-12 around a well-conditioned core.
        let scale = [1e6, 1.0, 1e-6];
        let core = [[4.0, 1.0, 0.5], [1.0, 3.0, -1.0], [0.5, -1.0, 2.0]];
        let a: Vec<f64> = (0..9).map(|k| core[k / 3][k % 3] * scale[k / 3] * scale[k % 3]).collect();
        let wanted = [2e-6, -3.0, 5e6];
        let b: Vec<f64> = (0..3).map(|i| (0..3).map(|j| a[3 * i + j] * wanted[j]).sum()).collect();
        for (x, wanted) in solve(&a, &b).unwrap().iter().zip(wanted) {
            assert!((x / wanted - 1.0).abs() < 1e-12, "{x} {wanted}");
        }
    }

    #[test]
    fn dependent_columns_have_no_solution() {
        let one = [1.0, 2.0, 3.0];
        let two = [2.0, 4.0, 6.0];
        assert_eq!(Normal::new(&[&one, &two], &[1.0, 0.0, 0.0]).solve(), None);
    }

    #[test]
    fn golden_sections_find_the_lowest_point() {
        let lowest = minimum(0.0, 5.0, 1e-9, |x| (x - 1.25).powi(2));
        assert!((lowest - 1.25).abs() < 1e-7, "{lowest}");
    }

    proptest! {
        /// The Karush-Kuhn-Tucker conditions: no negative coefficient, and no column that would still help if it were let in.
        #[test]
        fn non_negative_least_squares_is_optimal(
            entries in prop::collection::vec(-1.0f64..1.0, 6 * 20), signal in prop::collection::vec(-1.0f64..1.0, 20),
        ) {
            let columns: Vec<&[f64]> = entries.chunks(20).collect();
            let normal = Normal::new(&columns, &signal);
            let x = normal.solve_non_negative(|j| j == 0);
            for (j, column) in columns.iter().enumerate() {
                let left = |i: usize| signal[i] - (0..6).map(|k| columns[k][i] * x[k]).sum::<f64>();
                let pull: f64 = (0..20).map(|i| column[i] * left(i)).sum();
                prop_assert!(j == 0 || x[j] >= 0.0);
                prop_assert!(pull < 1e-8, "column {j}: {pull}");
                prop_assert!(pull > -1e-8 || (j > 0 && x[j] == 0.0), "column {j}: {pull}");
            }
            let direct: f64 = (0..20).map(|i| (signal[i] - (0..6).map(|k| columns[k][i] * x[k]).sum::<f64>()).powi(2)).sum();
            prop_assert!((normal.left(&x) - direct).abs() < 1e-9);
        }
    }
}
