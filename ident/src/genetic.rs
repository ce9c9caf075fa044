//! Dahl's model fitted by the thesis' genetic algorithm: for comparison with [`crate::dahl`].

use rand_pcg::Pcg64;
use rand_pcg::rand_core::{Rng, SeedableRng};
use serde::Serialize;

use crate::linear::Normal;
use crate::record::Record;

/// How the algorithm searches.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Search {
    /// First guesses of σ (N/m) and F_C (N).
    pub around: [f64; 2],
    /// Organisms in a generation, at least 2 more than `kept`.
    pub organisms: usize,
    /// Fittest organisms that go into the next generation unchanged and breed the others, at least 2.
    pub kept: usize,
    /// Generations.
    pub generations: usize,
    /// Seed of everything random.
    pub seed: u64,
}

impl Default for Search {
    /// The thesis' guesses, and numbers of organisms and generations at which results of different seeds agree to about a per mille.
    fn default() -> Search {
        Search { around: [8e6, 0.6], organisms: 40, kept: 10, generations: 50, seed: 1 }
    }
}

/// What the algorithm found.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Organism {
    /// σ, N/m.
    pub sigma_n_per_m: f64,
    /// F_C, N.
    pub coulomb_n: f64,
    /// Mean square of what is left, N².
    pub mse_n2: f64,
}

/// Breeds σ and F_C.
///
/// Guesses are spread by their own size around the first; children are mixed of two of the fittest and mutated by 2 % of the
/// first guess.
///
/// # Source
/// Appendix B, corrected: the squares are those of the error, the time is real, Dahl's equation is solved exactly from sample to
/// sample, offset and initial force are fitted instead of centred away, the numbers of organisms kept and bred are not swapped,
/// and the best organism is returned. The thesis gives no numbers of organisms and generations.
pub fn fit(record: &Record, search: &Search) -> Organism {
    let mut random = Random(Pcg64::seed_from_u64(search.seed));
    let guesses = search.around;
    let judged = |genes: [f64; 2]| Organism {
        sigma_n_per_m: genes[0],
        coulomb_n: genes[1],
        mse_n2: mean_square_n2(record, genes[0], genes[1]),
    };
    let mut population: Vec<Organism> = (0..search.organisms)
        .map(|_| judged(guesses.map(|guess| (guess + guess * random.normal()).abs().max(1e-3 * guess))))
        .collect();
    let kept = search.kept.clamp(2, search.organisms.max(2));
    for _ in 0..search.generations {
        population.sort_by(|a, b| a.mse_n2.total_cmp(&b.mse_n2));
        population.truncate(kept);
        for _ in kept..search.organisms {
            let first = random.below(kept);
            let second = (first + 1 + random.below(kept - 1)) % kept;
            let (a, b) = (population[first], population[second]);
            let mut gene = |from: f64, to: f64, guess: f64| {
                let share = random.uniform();
                let mixed = share * from + (1.0 - share) * to;
                // Drawn again until it is positive.
                (0..100).map(|_| mixed + 0.02 * guess * random.normal()).find(|gene| *gene > 0.0).unwrap_or(mixed)
            };
            population.push(judged([
                gene(a.sigma_n_per_m, b.sigma_n_per_m, guesses[0]),
                gene(a.coulomb_n, b.coulomb_n, guesses[1]),
            ]));
        }
    }
    population.into_iter().min_by(|a, b| a.mse_n2.total_cmp(&b.mse_n2)).unwrap_or_else(|| judged(guesses))
}

/// Random numbers.
struct Random(Pcg64);

impl Random {
    /// In (0, 1].
    fn uniform(&mut self) -> f64 {
        ((self.0.next_u64() >> 11) + 1) as f64 / (1u64 << 53) as f64
    }

    /// Standard normal, by Box and Muller's method.
    fn normal(&mut self) -> f64 {
        let size = libm::sqrt(-2.0 * libm::log(self.uniform()));
        size * libm::cos(std::f64::consts::TAU * self.uniform())
    }

    /// From 0 to `count` − 1.
    fn below(&mut self, count: usize) -> usize {
        ((self.uniform() * count as f64) as usize).min(count - 1)
    }
}

/// Mean square of measured minus modelled force, with the best offset and initial force, N².
fn mean_square_n2(record: &Record, sigma_n_per_m: f64, coulomb_n: f64) -> f64 {
    let (mut force_n, mut fading) = (0.0f64, 1.0);
    let per_m = sigma_n_per_m / coulomb_n;
    let mut model_n = Vec::with_capacity(record.samples());
    let mut initial = Vec::with_capacity(record.samples());
    let mut before_m = record.position_m[0];
    for x in &record.position_m {
        let dx_m = x - before_m;
        before_m = *x;
        let left = libm::exp(-per_m * dx_m.abs());
        let goal_n = if dx_m < 0.0 { -coulomb_n } else { coulomb_n };
        force_n = goal_n + (force_n - goal_n) * left;
        fading *= left;
        model_n.push(force_n);
        initial.push(fading);
    }
    let seen_n = record.seen(model_n);
    let left_n: Vec<f64> = record.force_n.iter().zip(&seen_n).map(|(f, m)| f - m).collect();
    let ones = vec![1.0; left_n.len()];
    let normal = Normal::new(&[&record.seen(initial), &ones], &left_n);
    let solution = normal.solve().unwrap_or(vec![0.0; 2]);
    normal.left(&solution) / left_n.len() as f64
}
