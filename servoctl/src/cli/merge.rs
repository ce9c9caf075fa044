//! `servoctl merge`: the parts of a campaign joined.

use std::path::PathBuf;

use anyhow::{Context, Result, ensure};

use super::output::Json;
use crate::reproduce::outcome::Outcome;
use crate::reproduce::shard::{ShardFile, fingerprint, merge};

/// Options of `merge`.
#[derive(Debug, clap::Args)]
pub struct Options {
    /// Files that `servoctl reproduce --shard` wrote, all of one campaign
    #[arg(required = true)]
    files: Vec<PathBuf>,
    #[command(flatten)]
    json: Json,
}

/// Joins and prints: what one run would have given.
///
/// # Errors
/// Files that cannot be read or do not make a whole.
pub fn run(options: &Options) -> Result<()> {
    let read = |file: &PathBuf| {
        let name = file.display().to_string();
        let text = std::fs::read_to_string(file).with_context(|| name.clone())?;
        let part: ShardFile = serde_json::from_str(&text).with_context(|| format!("{name}: not a part"))?;
        Ok((name, part))
    };
    let (request, cases, passes) = merge(options.files.iter().map(read).collect::<Result<_>>()?)?;
    let plan = request.plan()?;
    ensure!(fingerprint(&plan) == cases, "the parts were made by another version of this program");
    let outcome = Outcome::new(&plan, &passes);
    // By way of a value, as `reproduce` writes it: the same bytes.
    options.json.write(&serde_json::to_value(&outcome)?, || outcome.to_text())
}
