//! Commissioning of stages drawn at random: how often it succeeds, and how near to the truth it comes.

use std::f64::consts::FRAC_1_SQRT_2;
use std::sync::atomic::AtomicBool;

use rayon::prelude::*;
use serde::Serialize;
use servo_core::refusal::Refusal;
use servo_sim::random::{Noise, Purpose};
use servo_sim::{Stage, StageError};

use super::{Found, Simulated, Step, run};
use crate::table::{Table, number};

/// Ranges that mass (kg), σ (N/µm) and F_C (N) are drawn from, evenly.
pub const RANGES: [[f64; 2]; 3] = [[0.8, 3.0], [4.0, 17.0], [0.3, 1.1]];
/// The stage with the friction of table 4 (generalised Maxwell slip); it comes first.
const GMS_TOML: &str = include_str!("../../../sim/stages/gms-table-4.toml");

/// How a stage was commissioned.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Commissioned {
    /// Number of the stage; 0 is that of table 4.
    pub stage: u64,
    /// Model of its friction.
    pub model: String,
    /// Its mass (kg).
    pub true_mass_kg: f64,
    /// Its σ (N/m).
    pub true_sigma_n_per_m: f64,
    /// Its F_C (N).
    pub true_coulomb_n: f64,
    /// The step that ended it, and why; nothing if all were done.
    pub ended: Option<(Step, String)>,
    /// Whether the bridge was off afterwards.
    pub bridge_off: bool,
    /// What was found.
    pub found: Found,
}

/// Stage `index`: odd ones with Dahl's model, even ones with Maxwell slip, friction the same in every move.
///
/// # Errors
/// A stage file that cannot be read: none, while the tests pass.
pub fn stage(seed: u64, index: u64) -> Result<Stage, StageError> {
    if index == 0 {
        return Stage::from_toml(GMS_TOML);
    }
    let mut noise = Noise::new(seed, Purpose::Friction, index);
    // The normal distribution's own integral makes an even draw of a normal one.
    let mut even = |[low, high]: [f64; 2]| low + (high - low) * 0.5 * libm::erfc(-FRAC_1_SQRT_2 * noise.normal());
    let mut stage = Stage::default();
    stage.mechanics.mass_kg = even(RANGES[0]);
    stage.friction.stiffness_n_per_m = 1e6 * even(RANGES[1]);
    stage.friction.coulomb_n = even(RANGES[2]);
    stage.friction.spread = None;
    if index % 2 == 1 {
        stage.friction.model = servo_sim::stage::FrictionModel::Dahl;
    }
    Ok(stage)
}

/// Commissions a stage, unattended.
///
/// # Errors
/// A stage that the drive's parameters cannot describe.
pub fn commission(stage: &Stage, seed: u64, index: u64, stop: &AtomicBool) -> Result<Commissioned, Refusal> {
    let mut link = Simulated::new(stage, seed.wrapping_add(index))?;
    let (settings, mut found) = (*link.settings(), Found::default());
    let ended = run(&mut link, &settings, &mut found, Step::Offsets, stop, |_, _| ()).err();
    Ok(Commissioned {
        stage: index,
        model: format!("{:?}", stage.friction.model),
        true_mass_kg: stage.mechanics.mass_kg,
        true_sigma_n_per_m: stage.friction.stiffness_n_per_m,
        true_coulomb_n: stage.friction.coulomb_n,
        ended: ended.map(|(step, failure)| (step, failure.to_string())),
        bridge_off: !link.bridge_is_on(),
        found,
    })
}

/// Commissions the stages `from` to `to`, several at a time; `finished` is called after each.
///
/// # Errors
/// As for [`commission`], in words.
pub fn commission_all(
    seed: u64,
    stages: std::ops::Range<u64>,
    stop: &AtomicBool,
    finished: impl Fn() + Sync,
) -> Result<Vec<Commissioned>, String> {
    stages
        .into_par_iter()
        .map(|index| {
            let stage = stage(seed, index).map_err(|error| error.to_string())?;
            let done = commission(&stage, seed, index, stop).map_err(|refusal| refusal.to_string());
            finished();
            done
        })
        .collect()
}

/// A line for each stage, and how many succeeded.
pub fn text(all: &[Commissioned]) -> String {
    let error = |found: Option<f64>, truth: f64| found.map_or(f64::NAN, |value| 100.0 * (value / truth - 1.0));
    let mut table = Table::new(
        "Commissioning of stages drawn at random, simulated; errors against the truth".to_owned(),
        &[
            "stage",
            "model",
            "mass / kg",
            "σ / N/µm",
            "F_C / N",
            "mass / %",
            "σ / %",
            "F_C / %",
            "NIASA faster by / %",
            "ended",
        ],
    );
    for c in all {
        let found = &c.found;
        table = table.row([
            c.stage.to_string(),
            c.model.clone(),
            number(c.true_mass_kg, 2),
            number(c.true_sigma_n_per_m * 1e-6, 2),
            number(c.true_coulomb_n, 2),
            number(error(found.mass_kg, c.true_mass_kg), 2),
            number(error(found.sigma_n_per_m, c.true_sigma_n_per_m), 2),
            number(error(found.coulomb_n, c.true_coulomb_n), 2),
            number(100.0 * found.gain().unwrap_or(f64::NAN), 0),
            c.ended.as_ref().map_or_else(String::new, |(step, why)| format!("{step:?}: {why}")),
        ]);
    }
    let good = all.iter().filter(|c| c.ended.is_none()).count();
    let unsafe_ends = all.iter().filter(|c| !c.bridge_off).count();
    format!("{}{good} of {} stages commissioned; {unsafe_ends} ended with the bridge on\n", table.to_text(), all.len())
}
