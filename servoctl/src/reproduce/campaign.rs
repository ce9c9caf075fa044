//! Campaigns: many passes of several configurations, computed in parallel, in any order, in any number of parts.

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicBool, Ordering};

use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use servo_core::refusal::Refusal;

use super::pass::{self, Case, MoveResult};

/// Everything that a settling experiment computes.
#[derive(Debug, Clone, PartialEq)]
pub struct Campaign {
    /// Seed of every random number.
    pub seed: u64,
    /// Moves of each case.
    pub moves: u64,
    /// The configurations; each is computed once, however many comparisons it appears in.
    pub cases: Vec<Case>,
}

/// The part of a campaign that one machine computes: every `of`-th pass.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Shard {
    /// Number of this part, from 1.
    pub number: u64,
    /// Number of parts.
    pub of: u64,
}

impl Shard {
    /// The whole.
    pub const ALL: Shard = Shard { number: 1, of: 1 };

    fn contains(self, pass: u64) -> bool {
        pass % self.of == self.number - 1
    }
}

impl std::str::FromStr for Shard {
    type Err = String;

    /// `i/n` with `1 ≤ i ≤ n`.
    fn from_str(text: &str) -> Result<Self, String> {
        let numbers = text.split_once('/').and_then(|(i, n)| Some((i.parse::<u64>().ok()?, n.parse::<u64>().ok()?)));
        match numbers {
            Some((number, of)) if (1..=of).contains(&number) => Ok(Shard { number, of }),
            _ => Err("expected I/N with 1 ≤ I ≤ N, such as 2/8".to_owned()),
        }
    }
}

/// Finished passes: number of the pass → moves of each case, in the order of the cases.
pub type Passes = BTreeMap<u64, Vec<Vec<MoveResult>>>;

/// How a computation is watched and ended from outside.
#[derive(Clone, Copy)]
pub struct Watch<'a> {
    /// Set it, and no further pass is begun.
    pub stop: &'a AtomicBool,
    /// Called with the number of moves just finished, from any thread.
    pub finished: &'a (dyn Fn(u64) + Sync),
}

/// A flag that nobody sets.
static NEVER: AtomicBool = AtomicBool::new(false);

impl Watch<'_> {
    /// Nobody watches.
    pub const NOBODY: Watch<'static> = Watch { stop: &NEVER, finished: &|_| () };
}

impl Campaign {
    /// Number of passes.
    pub fn passes(&self) -> u64 {
        self.moves.div_ceil(pass::MOVES)
    }

    /// Passes of a part.
    pub fn passes_of(&self, shard: Shard) -> Vec<u64> {
        (0..self.passes()).filter(|pass| shard.contains(*pass)).collect()
    }

    /// Moves of a pass.
    pub fn moves_in(&self, pass: u64) -> u64 {
        (self.moves - pass * pass::MOVES).min(pass::MOVES)
    }

    /// Moves of all cases in a part.
    pub fn moves_of(&self, shard: Shard) -> u64 {
        self.passes_of(shard).iter().map(|pass| self.moves_in(*pass)).sum::<u64>() * self.cases.len() as u64
    }

    /// Computes a part on all threads of the current pool. Only passes in which every case is finished count: comparisons are of
    /// the same moves.
    ///
    /// # Errors
    /// Settings or moves that the drive refuses, with the name of the case.
    pub fn run(&self, shard: Shard, watch: Watch) -> Result<Passes, CampaignError> {
        let units: Vec<(u64, usize)> = self
            .passes_of(shard)
            .into_iter()
            .flat_map(|pass| (0..self.cases.len()).map(move |case| (pass, case)))
            .collect();
        let results: Vec<Option<Vec<MoveResult>>> = units
            .par_iter()
            .with_max_len(1)
            .map(|&(pass, case)| {
                if watch.stop.load(Ordering::Relaxed) {
                    return Ok(None);
                }
                let case = &self.cases[case];
                let moves = pass::run(case, self.seed, pass, self.moves_in(pass))
                    .map_err(|refusal| CampaignError { case: case.name.clone(), refusal })?;
                (watch.finished)(moves.len() as u64);
                Ok(Some(moves))
            })
            .collect::<Result<_, CampaignError>>()?;
        let of_pass = units.chunks(self.cases.len()).zip(results.chunks(self.cases.len()));
        Ok(of_pass
            .filter_map(|(units, moves)| Some((units[0].0, moves.iter().cloned().collect::<Option<_>>()?)))
            .collect())
    }
}

/// A configuration that the drive refuses.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("{case}: {refusal}")]
pub struct CampaignError {
    /// Name of the case.
    pub case: String,
    /// The drive's answer.
    pub refusal: Refusal,
}
