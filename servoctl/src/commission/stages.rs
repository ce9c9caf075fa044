//! Stages to commission: named ones and any number drawn at random.

use std::f64::consts::FRAC_1_SQRT_2;
use std::sync::atomic::{AtomicBool, Ordering};

use rayon::prelude::*;
use serde::Serialize;
use servo_core::parameters::Settings;
use servo_core::profile::Limits;
use servo_core::refusal::Refusal;
use servo_ident::maxwell::Element;
use servo_ident::tuning::Wish;
use servo_sim::friction::{self, MaxwellSlip};
use servo_sim::random::{Noise, Purpose};
use servo_sim::stage::FrictionModel;
use servo_sim::{Stage, StageError};

use super::{Failure, Found, Plan, Session, Simulated, Step, run};

/// Ranges that mass (kg), σ (N/µm) and F_C (N) are drawn from, evenly.
pub const RANGES: [[f64; 2]; 3] = [[0.8, 3.0], [4.0, 17.0], [0.3, 1.1]];
/// The stage with the friction of table 4 (generalised Maxwell slip); it comes first of those drawn.
const GMS_TOML: &str = include_str!("../../../sim/stages/gms-table-4.toml");

/// Time in which a drive that starts with what was saved comes to rest, s, and its largest error then, m: several times the noise.
const REST_S: f64 = 0.5;
const MOVE_M: f64 = 5e-3;
const REST_MAX_M: f64 = 20e-9;

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
    /// What is not safe about how it ended; nothing if all is well.
    pub unsafe_end: Option<String>,
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
pub fn commission(
    name: String,
    stage: &Stage,
    wish: Wish,
    seed: u64,
    stop: &AtomicBool,
) -> Result<Commissioned, Refusal> {
    let mut link = Simulated::new(stage, seed)?;
    let (settings, mut found) = (*link.settings(), Found::default());
    let ended = run(&mut link, &Plan { wish, ..Plan::new(settings) }, &mut found, stop, &mut |_| ()).err();
    Ok(Commissioned {
        unsafe_end: unsafe_end(&mut link, stage, &found, ended.is_some(), seed),
        name,
        model: format!("{:?}", stage.friction.model),
        true_mass_kg: stage.mechanics.mass_kg,
        true_sigma_n_per_m: stage.friction.stiffness_n_per_m,
        true_coulomb_n: stage.friction.coulomb_n,
        true_elements: elements(stage),
        ended: ended.map(|(step, failure)| (step, failure.to_string())),
        found,
    })
}

/// What is not safe about how a commissioning ended: the bridge is on, the stage moves, steps are missing without a refusal, or a drive that
/// starts with what was saved does not come to rest.
pub fn unsafe_end(link: &mut Simulated, stage: &Stage, found: &Found, refused: bool, seed: u64) -> Option<String> {
    if link.bridge_is_on() {
        return Some("the bridge is on".to_owned());
    }
    if !link.is_at_rest() {
        return Some("the stage moves".to_owned());
    }
    if refused {
        return None;
    }
    if !found.done.iter().map(|(step, _)| *step).eq(Step::ALL) {
        return Some("steps are missing without a refusal".to_owned());
    }
    let Some(saved) = link.saved else { return Some("nothing was saved".to_owned()) };
    match error_at_rest_m(stage, &saved, seed) {
        Ok(error_m) if error_m <= REST_MAX_M => None,
        Ok(error_m) => Some(format!("oscillates: {:.0} nm after a restart", error_m * 1e9)),
        Err(failure) => Some(format!("after a restart: {failure}")),
    }
}

/// Largest error of a drive that starts with these parameters, in half a second that begins half a second after a move, m.
fn error_at_rest_m(stage: &Stage, saved: &Settings, seed: u64) -> Result<f64, Failure> {
    let mut link = Simulated::with_parameters(stage, saved, seed)?;
    let stop = AtomicBool::new(false);
    let silence_s = saved.command_timeout_s;
    let mut session = Session { link: &mut link, stop: &stop, settings: *saved, silence_s, said: &mut |_| () };
    session.enable()?;
    let limits = Limits { velocity_m_per_s: 0.2, acceleration_m_per_s2: 1.0, jerk_m_per_s3: None };
    let from_m = session.look()?.position_m;
    session.move_to(from_m + MOVE_M, limits)?;
    session.wait(REST_S)?;
    let errors_ct = session.signal("error_ct", REST_S)?;
    Ok(errors_ct.iter().fold(0.0, |far: f64, ct| far.max(ct.abs())) * saved.encoder_count_m)
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

/// Commissions stages drawn at random, several at a time; `finished` is called after each. Those that were finished before `stop`.
///
/// # Errors
/// As for [`commission`], in words.
pub fn commission_all(
    seed: u64,
    stages: std::ops::Range<u64>,
    wish: Wish,
    stop: &AtomicBool,
    finished: impl Fn() + Sync,
) -> Result<Vec<Commissioned>, String> {
    stages
        .into_par_iter()
        .filter_map(|index| {
            let one = || {
                let stage = stage(seed, index).map_err(|error| error.to_string())?;
                commission(index.to_string(), &stage, wish, seed.wrapping_add(index), stop)
                    .map_err(|refusal| refusal.to_string())
            };
            let done = if stop.load(Ordering::Relaxed) { return None } else { one() };
            // Of one that was under way nothing can be said.
            if stop.load(Ordering::Relaxed) {
                return None;
            }
            finished();
            Some(done)
        })
        .collect()
}
