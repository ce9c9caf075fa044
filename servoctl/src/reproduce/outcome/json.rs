//! How an outcome is written as JSON.

use std::collections::BTreeMap;

use serde::ser::SerializeMap;
use serde::{Serialize, Serializer};
use servo_core::parameters::{Settings, TABLE};

use super::{Claim, Outcome, Run, Search};
use crate::settling::SettlingExperiment;

/// What every comparison is a part of.
#[derive(Clone, Copy, Serialize)]
struct Head<'a> {
    experiment: &'a str,
    thesis_section: &'a str,
    origin: &'a str,
    seed: u64,
    moves_requested: u64,
    complete: bool,
}

#[derive(Serialize)]
struct Document<'a> {
    #[serde(flatten)]
    head: Head<'a>,
    results_hash: &'a str,
    #[serde(skip_serializing_if = "Option::is_none")]
    search: &'a Option<Search>,
    #[serde(skip_serializing_if = "<[Claim]>::is_empty")]
    claims: &'a [Claim],
    #[serde(flatten)]
    only: &'a Option<Run>,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    runs: Vec<Part<'a>>,
}

/// A comparison that can stand alone.
#[derive(Serialize)]
struct Part<'a> {
    #[serde(flatten)]
    head: Head<'a>,
    #[serde(flatten)]
    run: &'a Run,
}

impl Serialize for Outcome {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let head = Head {
            experiment: &self.experiment,
            thesis_section: &self.thesis_section,
            origin: &self.origin,
            seed: self.seed,
            moves_requested: self.moves_requested,
            complete: self.complete,
        };
        let document = Document {
            head,
            results_hash: &self.results_hash,
            search: &self.search,
            claims: &self.claims,
            only: &self.only,
            runs: self.runs.iter().map(|run| Part { head, run }).collect(),
        };
        document.serialize(serializer)
    }
}

/// A settling experiment without its configurations, which stand beside it in full.
pub(super) fn without_configs<S: Serializer>(
    experiment: &SettlingExperiment,
    serializer: S,
) -> Result<S::Ok, S::Error> {
    let mut map = serializer.serialize_map(None)?;
    map.serialize_entry("moves", &experiment.moves)?;
    map.serialize_entry("tolerances_nm", &experiment.tolerances_nm)?;
    map.serialize_entry("reduction_percent", &experiment.reduction_percent)?;
    map.end()
}

/// Parameters by their names, which carry the units.
pub(super) fn by_name<S: Serializer>(settings: &Settings, serializer: S) -> Result<S::Ok, S::Error> {
    let named: BTreeMap<&str, f64> = TABLE.iter().map(|p| (p.name, p.get(settings))).collect();
    named.serialize(serializer)
}
