//! Parts of a campaign as files: a batch system computes them, [`merge`] joins them.

use std::collections::BTreeSet;

use serde::{Deserialize, Serialize};
use servo_core::fingerprint::Fingerprint;
use servo_core::parameters::TABLE;

use super::campaign::{Passes, Shard};
use super::experiments::{Plan, Request};

/// What a file of a part begins with.
pub const FORMAT: &str = "servoctl shard 2";

/// A part: what was asked for, and the passes that it has.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ShardFile {
    /// [`FORMAT`].
    pub format: String,
    /// Fingerprint of every parameter of every case: parts of different programs do not mix.
    pub cases: String,
    /// Which part.
    pub shard: Shard,
    /// Whether it has all of its passes.
    pub complete: bool,
    /// What was asked for.
    pub request: Request,
    /// The passes.
    pub passes: Passes,
}

/// Why parts do not make a whole.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum MergeError {
    /// Nothing to merge.
    #[error("no file given")]
    Nothing,
    /// Not a part.
    #[error("{file}: not a part of an experiment (format `{found}`, expected `{FORMAT}`)")]
    Format {
        /// The file.
        file: String,
        /// What it says it is.
        found: String,
    },
    /// A part of something else.
    #[error("{file}: {what} differs from {first}")]
    Different {
        /// The file.
        file: String,
        /// What differs.
        what: &'static str,
        /// The file that it is compared with.
        first: String,
    },
    /// A pass that two files have.
    #[error("{file}: pass {pass} is in another file too")]
    Twice {
        /// The second file.
        file: String,
        /// The pass.
        pass: u64,
    },
    /// Passes that no file has.
    #[error("{count} of {of} passes are missing, the first is {first} (part {shard}/{parts})")]
    Missing {
        /// How many.
        count: usize,
        /// Of how many.
        of: u64,
        /// The first of them.
        first: u64,
        /// Number of the part it belongs to.
        shard: u64,
        /// Number of parts.
        parts: u64,
    },
}

impl ShardFile {
    /// The file of a part.
    pub fn new(plan: &Plan, shard: Shard, passes: Passes) -> ShardFile {
        ShardFile {
            format: FORMAT.to_owned(),
            cases: fingerprint(plan),
            shard,
            complete: passes.len() == plan.campaign.passes_of(shard).len(),
            request: plan.request.clone(),
            passes,
        }
    }
}

/// Fingerprint of what the program makes of a request.
pub fn fingerprint(plan: &Plan) -> String {
    let bits = plan.campaign.cases.iter().flat_map(|case| TABLE.iter().map(|p| p.get(&case.settings).to_bits()));
    let words: Vec<u32> = bits.flat_map(|bits| [bits as u32, (bits >> 32) as u32]).collect();
    format!("{:016x}", Fingerprint::default().with_words(&words).0)
}

/// Joins named parts: the passes of the whole, as if they had been computed at once.
///
/// # Errors
/// Files that are not parts of the same whole, or do not make it complete.
pub fn merge(files: Vec<(String, ShardFile)>) -> Result<(Request, String, Passes), MergeError> {
    let Some((first, model)) = files.first().cloned() else { return Err(MergeError::Nothing) };
    let mut passes = Passes::new();
    for (file, part) in files {
        let different = |what| MergeError::Different { file: file.clone(), what, first: first.clone() };
        if part.format != FORMAT {
            return Err(MergeError::Format { file, found: part.format });
        }
        if part.request != model.request {
            return Err(different("what was asked for (experiment, moves, seed, mass errors or stage)"));
        }
        if part.cases != model.cases {
            return Err(different("the program that made it (parameters of the drive)"));
        }
        for (pass, moves) in part.passes {
            if passes.insert(pass, moves).is_some() {
                return Err(MergeError::Twice { file, pass });
            }
        }
    }
    let of = model.request.moves.div_ceil(super::pass::MOVES);
    let missing: BTreeSet<u64> = (0..of).filter(|pass| !passes.contains_key(pass)).collect();
    if let Some(&first) = missing.first() {
        let parts = model.shard.of;
        return Err(MergeError::Missing { count: missing.len(), of, first, shard: first % parts + 1, parts });
    }
    Ok((model.request, model.cases, passes))
}
