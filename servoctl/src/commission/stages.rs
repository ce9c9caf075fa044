//! Stages to commission: named ones and any number drawn at random.

use std::f64::consts::FRAC_1_SQRT_2;
use std::sync::atomic::AtomicBool;

use rayon::prelude::*;
use serde::Serialize;
use servo_core::refusal::Refusal;
use servo_ident::maxwell::Element;
use servo_sim::friction::{self, MaxwellSlip};
use servo_sim::random::{Noise, Purpose};
use servo_sim::stage::FrictionModel;
use servo_sim::{Stage, StageError};

use super::{Found, Simulated, Step, run};

/// Ranges that mass (kg), σ (N/µm) and F_C (N) are drawn from, evenly.
pub const RANGES: [[f64; 2]; 3] = [[0.8, 3.0], [4.0, 17.0], [0.3, 1.1]];
/// The stage with the friction of table 4 (generalised Maxwell slip); it comes first of those drawn.
const GMS_TOML: &str = include_str!("../../../sim/stages/gms-table-4.toml");

/// How a stage was commissioned.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Commissioned {
    /// Name, or the number of a stage drawn at random; 0 is that of table 4.
    pub name: String,
    /// Model of its friction.
    pub model: String,
    /// Its mass (kg).
    pub true_mass_kg: f64,
    /// Its σ (N/m).
    pub true_sigma_n_per_m: f64,
    /// Its F_C (N).
    pub true_coulomb_n: f64,
    /// Its parallel elements; none with Dahl's model.
    pub true_elements: Vec<Element>,
    /// The step that ended it, and why; nothing if all were done.
    pub ended: Option<(Step, String)>,
    /// Whether the bridge was off afterwards, and the stage at rest.
    pub safe: bool,
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
        stage.friction.model = FrictionModel::Dahl;
    }
    Ok(stage)
}

/// Commissions a stage, unattended.
///
/// # Errors
/// A stage that the drive's parameters cannot describe.
pub fn commission(name: String, stage: &Stage, seed: u64, stop: &AtomicBool) -> Result<Commissioned, Refusal> {
    let mut link = Simulated::new(stage, seed)?;
    let (settings, mut found) = (*link.settings(), Found::default());
    let ended = run(&mut link, &settings, &mut found, Step::Offsets, stop, |_, _| ()).err();
    Ok(Commissioned {
        name,
        model: format!("{:?}", stage.friction.model),
        true_mass_kg: stage.mechanics.mass_kg,
        true_sigma_n_per_m: stage.friction.stiffness_n_per_m,
        true_coulomb_n: stage.friction.coulomb_n,
        true_elements: elements(stage),
        ended: ended.map(|(step, failure)| (step, failure.to_string())),
        safe: !link.bridge_is_on() && link.is_at_rest(),
        found,
    })
}

/// The parallel elements of a stage's friction.
fn elements(stage: &Stage) -> Vec<Element> {
    let friction = &stage.friction;
    let element =
        |e: friction::Element| Element { stiffness_n_per_m: e.stiffness_n_per_m, saturation_n: e.saturation_n };
    match friction.model {
        FrictionModel::MaxwellSlip => {
            let count = friction.elements;
            MaxwellSlip::new(count, friction.stiffness_n_per_m, friction.coulomb_n).elements().map(element).collect()
        }
        FrictionModel::Gms => friction.scaled_elements().as_slice().iter().map(|e| element(*e)).collect(),
        _ => Vec::new(),
    }
}

/// Commissions stages drawn at random, several at a time; `finished` is called after each.
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
            let done = commission(index.to_string(), &stage, seed.wrapping_add(index), stop);
            finished();
            done.map_err(|refusal| refusal.to_string())
        })
        .collect()
}
