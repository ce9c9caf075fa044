//! Parallel springs that slide, found without a start value.

use serde::{Deserialize, Serialize};

use crate::error::DataError;
use crate::linear::Normal;
use crate::record::Record;

/// Saturation displacements of the grid, evenly spaced in the logarithm.
const GRID: usize = 48;
/// The shortest one as a share of the longest.
const SHORTEST_SHARE: f64 = 1e-3;
/// Share of the span that a motion has to cover at one go before the states of the elements are taken as known.
const SWEEP_SHARE: f64 = 0.9;
/// Elements that carry less than this share of the force are not reported.
const NEGLIGIBLE: f64 = 1e-3;
/// Rounds in which the displacements of the merged elements are improved.
const REFINEMENTS: usize = 4;
/// Number of elements that [`fit`] is usually asked for: as many as the thesis uses.
pub const USUAL_ELEMENTS: usize = 8;
/// Most elements that can be asked for.
pub const MAX_ELEMENTS: usize = 12;

/// A spring that slides at a certain force.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Element {
    /// Stiffness k_i, N/m.
    pub stiffness_n_per_m: f64,
    /// Saturation F_i^sat, N.
    pub saturation_n: f64,
}

/// Maxwell-slip friction as it fits a record best.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct MaxwellFit {
    /// The elements, those that slide first first. One that never slides in the record has, as its saturation, the force that it
    /// reaches there: the least that it can be.
    pub elements: Vec<Element>,
    /// Root mean square of what the model leaves, N.
    pub rms_n: f64,
    /// Number of samples compared.
    pub samples: usize,
    /// First sample compared: from there on the states of all elements are known.
    pub first_sample: usize,
    /// Constant force beside friction, N.
    pub offset_n: f64,
    /// Stiffness of the last element if it never slides in the record, otherwise 0, N/m.
    pub unsaturated_n_per_m: f64,
}

impl MaxwellFit {
    /// Level of Coulomb friction, `Σ F_i^sat`, N (A.5).
    pub fn coulomb_n(&self) -> f64 {
        self.elements.iter().map(|element| element.saturation_n).sum()
    }

    /// Half the stiffness of all elements: Dahl's σ for the same slope after a reversal at saturation, N/m.
    pub fn sigma_n_per_m(&self) -> f64 {
        0.5 * self.elements.iter().map(|element| element.stiffness_n_per_m).sum::<f64>()
    }

    /// The model's force at every sample of the record, offset included, as measured force would show it, N. Not to be trusted before
    /// `first_sample`.
    pub fn force_n(&self, record: &Record) -> Vec<f64> {
        let mut force_n = vec![self.offset_n; record.samples()];
        let sliding = self.elements.len() - usize::from(self.unsaturated_n_per_m > 0.0);
        for element in &self.elements[..sliding] {
            let stretch_m = record.seen(stretch(&record.position_m, element.saturation_n / element.stiffness_n_per_m));
            for (f, z) in force_n.iter_mut().zip(stretch_m) {
                *f += element.stiffness_n_per_m * z;
            }
        }
        for (f, x) in force_n.iter_mut().zip(record.seen(record.position_m.clone())) {
            *f += self.unsaturated_n_per_m * x;
        }
        force_n
    }
}

/// Fits at most `elements` (1 to [`MAX_ELEMENTS`]) elements and an offset.
///
/// On a grid of saturation displacements the force is linear in the stiffnesses, which have to be positive: a least-squares
/// problem with one solution. Elements that are neighbours in it are one between two points of the grid and are merged; then
/// those that differ least, until `elements` are left, whose displacements are improved one by one. Initial forces need not be
/// known: what slid during the largest motion has forgotten them, and what did not is a plain spring.
///
/// # Errors
/// Number of elements out of range; [`DataError::Undetermined`] if nothing slides.
///
/// # Source
/// Equations A.1 to A.5 (A.4 corrected: `F_i ← clip(F_i + k_i dz)`), without Stribeck effect and damping.
pub fn fit(record: &Record, elements: usize) -> Result<MaxwellFit, DataError> {
    if !(1..=MAX_ELEMENTS).contains(&elements) {
        return Err(DataError::OutOfRange {
            field: "elements",
            value: elements as f64,
            min: 1.0,
            max: MAX_ELEMENTS as f64,
        });
    }
    let first_sample = known_from(record);
    let longest_m = 0.5 * widest(&record.position_m[..=first_sample]);
    let problem = Problem { record, first_sample, longest_m };
    let grid: Vec<f64> =
        (0..GRID).map(|i| longest_m * libm::pow(SHORTEST_SHARE, 1.0 - i as f64 / (GRID - 1) as f64)).collect();
    let mut chosen = merge_neighbours(&grid, &problem.stiffnesses(&grid).stiffness);
    while chosen.len() > elements {
        merge_closest(&mut chosen);
    }
    let mut length_m: Vec<f64> = chosen.iter().map(|e| e.saturation_n / e.stiffness_n_per_m).collect();
    for round in 0..REFINEMENTS {
        problem.improve(&mut length_m, 0.5f64.powi(round as i32));
    }
    problem.result(&length_m).ok_or_else(|| DataError::Undetermined {
        what: "elements",
        why: format!("no element slides in the record, with a motion of {:e} m", record.span_m()),
    })
}

/// What is fitted: the samples from `first_sample` on.
struct Problem<'a> {
    record: &'a Record,
    first_sample: usize,
    longest_m: f64,
}

/// A solution for given saturation displacements.
struct Solution {
    /// Of the elements, then of the spring that never slides, N/m.
    stiffness: Vec<f64>,
    offset_n: f64,
    /// Sum of the squares that are left, N².
    left_n2: f64,
}

impl Problem<'_> {
    fn stiffnesses(&self, length_m: &[f64]) -> Solution {
        let x = &self.record.position_m;
        let mut columns: Vec<Vec<f64>> = length_m.iter().map(|l| self.record.seen(stretch(x, *l))).collect();
        columns.push(self.record.seen(x.clone()));
        columns.push(vec![1.0; x.len()]);
        let parts: Vec<&[f64]> = columns.iter().map(|column| &column[self.first_sample..]).collect();
        let normal = Normal::new(&parts, &self.record.force_n[self.first_sample..]);
        let offset = columns.len() - 1;
        let mut solution = normal.solve_non_negative(|j| j == offset);
        let left_n2 = normal.left(&solution);
        Solution { offset_n: solution.pop().unwrap_or(0.0), stiffness: solution, left_n2 }
    }

    /// Tries every displacement a step longer and shorter, and keeps what is better.
    fn improve(&self, length_m: &mut [f64], share: f64) {
        let step = 0.5 * libm::pow(SHORTEST_SHARE, -share / (GRID - 1) as f64) + 0.5;
        let mut best = self.stiffnesses(length_m).left_n2;
        for i in 0..length_m.len() {
            for factor in [step, 1.0 / step] {
                loop {
                    let before_m = length_m[i];
                    length_m[i] = (before_m * factor).min(self.longest_m);
                    let left_n2 = self.stiffnesses(length_m).left_n2;
                    if left_n2 < best {
                        best = left_n2;
                    } else {
                        length_m[i] = before_m;
                        break;
                    }
                }
            }
        }
    }

    fn result(&self, length_m: &[f64]) -> Option<MaxwellFit> {
        let Solution { stiffness, offset_n, left_n2 } = self.stiffnesses(length_m);
        let (spring, stiffness) = stiffness.split_last()?;
        let sliding = stiffness.iter().zip(length_m);
        let mut elements: Vec<Element> =
            sliding.map(|(k, l)| Element { stiffness_n_per_m: *k, saturation_n: k * l }).collect();
        let total_n: f64 = elements.iter().map(|e| e.saturation_n).sum();
        elements.retain(|e| e.saturation_n > NEGLIGIBLE * total_n);
        if elements.is_empty() {
            return None;
        }
        let reached_n = spring * self.longest_m;
        let unsaturated_n_per_m = if reached_n > NEGLIGIBLE * total_n { *spring } else { 0.0 };
        if unsaturated_n_per_m > 0.0 {
            elements.push(Element { stiffness_n_per_m: *spring, saturation_n: reached_n });
        }
        let samples = self.record.samples() - self.first_sample;
        Some(MaxwellFit {
            elements,
            rms_n: (left_n2 / samples as f64).sqrt(),
            samples,
            first_sample: self.first_sample,
            offset_n,
            unsaturated_n_per_m,
        })
    }
}

/// The sample from which on the states of the elements are known: the end of the first motion in one direction that covers most of
/// the span. If that is past the middle of the record, the first sample: the friction is then taken for virgin there.
fn known_from(record: &Record) -> usize {
    let sweep_m = SWEEP_SHARE * record.span_m();
    let swept = |leg: &&crate::legs::Leg| (record.position_m[leg.to] - record.position_m[leg.from]).abs() >= sweep_m;
    let end = record.legs.iter().find(swept).map_or(0, |leg| leg.to);
    if 2 * end <= record.samples() { end } else { 0 }
}

/// Longest way between any two samples, m.
fn widest(position_m: &[f64]) -> f64 {
    let low = position_m.iter().copied().fold(f64::INFINITY, f64::min);
    position_m.iter().copied().fold(f64::NEG_INFINITY, f64::max) - low
}

/// Stretch of a spring that slides beyond ±`length_m`, unstretched at first.
fn stretch(position_m: &[f64], length_m: f64) -> Vec<f64> {
    let (mut z, mut before_m) = (0.0f64, position_m[0]);
    position_m
        .iter()
        .map(|x| {
            z = (z + x - before_m).max(-length_m).min(length_m);
            before_m = *x;
            z
        })
        .collect()
}

/// Force of elements along the loop that a motion between ±`half_span_m` closes, N: at `points` positions at equal distances on the way up,
/// then as many on the way down. Elements that do not slide on it are springs that are relaxed in the middle.
pub fn steady_loop_n(elements: &[Element], half_span_m: f64, points: usize) -> Vec<f64> {
    let up = (1..=points).map(|i| half_span_m * (2.0 * i as f64 / points as f64 - 1.0));
    let down = (1..=points).map(|i| half_span_m * (1.0 - 2.0 * i as f64 / points as f64));
    // From the middle to one end and to the other: from there on the loop is closed.
    let position_m: Vec<f64> = [0.0, half_span_m, -half_span_m].into_iter().chain(up).chain(down).collect();
    let mut force_n = vec![0.0; 2 * points];
    for element in elements {
        let stretch_m = stretch(&position_m, element.saturation_n / element.stiffness_n_per_m);
        force_n.iter_mut().zip(&stretch_m[3..]).for_each(|(f, z)| *f += element.stiffness_n_per_m * z);
    }
    force_n
}

/// Elements of a grid, those without a gap between them as one.
fn merge_neighbours(length_m: &[f64], stiffness: &[f64]) -> Vec<Element> {
    let parts = length_m.iter().zip(stiffness);
    let parts: Vec<Element> = parts.map(|(l, k)| Element { stiffness_n_per_m: *k, saturation_n: k * l }).collect();
    let total_n: f64 = parts.iter().map(|e| e.saturation_n).sum();
    parts
        .chunk_by(|a, b| a.stiffness_n_per_m > 0.0 && b.stiffness_n_per_m > 0.0)
        .flat_map(|run| run.chunks(2))
        .map(|pair| pair.iter().copied().reduce(joined).unwrap_or(pair[0]))
        .filter(|e| e.saturation_n > 1e-6 * total_n)
        .collect()
}

fn joined(a: Element, b: Element) -> Element {
    Element {
        stiffness_n_per_m: a.stiffness_n_per_m + b.stiffness_n_per_m,
        saturation_n: a.saturation_n + b.saturation_n,
    }
}

/// Joins the two neighbours whose union changes the curve least: the area between the two broken lines is
/// `F_a F_b |l_a − l_b| / 2 (F_a + F_b)`-like, small where they slide together or one of them is weak.
fn merge_closest(elements: &mut Vec<Element>) {
    let cost = |pair: &[Element]| {
        let [a, b] = [pair[0], pair[1]];
        let apart = (a.saturation_n / a.stiffness_n_per_m) / (b.saturation_n / b.stiffness_n_per_m);
        let (f, g) = (a.saturation_n, b.saturation_n);
        f * g / (f + g) * libm::log(apart).abs()
    };
    let closest = (0..elements.len().saturating_sub(1))
        .min_by(|i, j| cost(&elements[*i..*i + 2]).total_cmp(&cost(&elements[*j..*j + 2])));
    if let Some(i) = closest {
        let second = elements.remove(i + 1);
        elements[i] = joined(elements[i], second);
    }
}
