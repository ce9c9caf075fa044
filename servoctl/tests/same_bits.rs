//! The results of every experiment in a small size, to the bit: the same on any computer, in debug and release.

use std::sync::atomic::{AtomicBool, Ordering};

use servo_core::compensator::Compensator;
use servo_core::fingerprint::Fingerprint;
use servo_core::parameters::Settings;
use servo_sim::Stage;
use servo_sim::stage::FrictionModel;
use servoctl::reproduce::campaign::{Campaign, Shard, Watch};
use servoctl::reproduce::experiments::{Experiment, Plan, Request, with};
use servoctl::reproduce::outcome::results_hash;
use servoctl::reproduce::pass::Case;
use servoctl::reproduce::{identification_study, loop_transmission, models, step_100um};
use servoctl::theory::{Method, mass, massless};

fn plan(experiment: Experiment, moves: u64) -> Plan {
    let mass_errors_percent = if experiment == Experiment::Exp2 { vec![1.0] } else { Vec::new() };
    Request { experiment, moves, seed: 1, mass_errors_percent, stage: Stage::default() }.plan().unwrap()
}

fn hash(campaign: &Campaign) -> String {
    results_hash(&campaign.run(Shard::ALL, Watch::NOBODY).unwrap())
}

/// `cargo xtask test` runs this optimised as well. Whoever changes what drive or stage compute changes these numbers, knowingly.
#[test]
fn debug_and_release_give_the_results_that_are_written_here() {
    let found = [
        (Experiment::Exp1, 3),
        (Experiment::Exp2, 3),
        (Experiment::Step50Nm, 3),
        (Experiment::Step5Um, 3),
        (Experiment::InPosition, 1),
        (Experiment::Sensitivity, 1),
    ]
    .map(|(experiment, moves)| hash(&plan(experiment, moves).campaign));
    assert_eq!(
        found,
        [
            "23586f1bfe865380",
            "d5dd1ba60e49da9e",
            "ca645ba6925374de",
            "2cc9ea646ead145e",
            "6069aea4365a39bb",
            "6d8d0bd484377823"
        ]
    );
}

/// Of everything that is written, numbers with a point included.
fn json_hash(found: &impl serde::Serialize) -> String {
    let words: Vec<u32> = serde_json::to_string(found).unwrap().bytes().map(u32::from).collect();
    format!("{:016x}", Fingerprint::default().with_words(&words).0)
}

/// Sweeps, steps, fits and theory; of the sweeps the first, for time.
#[test]
fn measurements_and_theory_do_so_to_the_last_digit_that_is_written() {
    let stage = Stage::default();
    let stop = AtomicBool::new(false);
    let finished = |_| stop.store(true, Ordering::Relaxed);
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    let watch = Watch { stop: &stop, finished: &finished };
    let swept = pool.install(|| loop_transmission::run(&stage, 1, watch)).unwrap().unwrap();
    let stepped = step_100um::run(&stage, 1, 1, Watch::NOBODY).unwrap();
    let fitted = models::run(Watch::NOBODY);
    let identified = identification_study::run(&stage, 1, 3, 1, Watch::NOBODY).unwrap().unwrap();
    let responses: Vec<(Option<f64>, f64)> = [Method::Observer, Method::Niasa]
        .into_iter()
        .flat_map(|method| [-0.5, -0.05, 0.5].map(|delta| mass::Case::thesis(method, delta)))
        .map(|case| case.respond().unwrap())
        .map(|response| (response.settling_time_s, response.peak_after_crossing))
        .collect();
    let settlings: Vec<_> = [Method::Observer, Method::Niasa]
        .into_iter()
        .flat_map(|method| [-0.2, 0.7].map(|delta| massless::Case { method, kp_ratio: 0.3, e0_xc: 0.5, delta }))
        .map(|case| case.settle().unwrap())
        .collect();
    let found = [
        json_hash(&swept.figure_15),
        json_hash(&(&stepped.stage, &stepped.redrawn)),
        json_hash(&fitted.fits),
        json_hash(&identified.groups),
        json_hash(&responses),
        json_hash(&settlings),
    ];
    assert_eq!(
        found,
        [
            "d59c81ba4f51ff2b",
            "143004b4ac59443b",
            "4500fca5497dd10b",
            "eae4a9100b3b85cf",
            "8a2a9dd447ec12b9",
            "e4c8e111a6d7f98c"
        ]
    );
}

/// A move with every compensator, and one on every model of friction: what the experiments above do not come by.
#[test]
fn every_compensator_and_every_friction_does_as_well() {
    let mut campaign = plan(Experiment::Exp1, 1).campaign;
    let case = campaign.cases.remove(0);
    let compensated = Compensator::ALL.map(|kind| Case { settings: with(case.settings, kind), ..case.clone() });
    let models = [
        FrictionModel::Dahl,
        FrictionModel::Gms,
        FrictionModel::LuGre,
        FrictionModel::Stribeck,
        FrictionModel::Coulomb,
    ];
    let on = models.map(|model| {
        let mut other = case.clone();
        other.stage.friction.model = model;
        other
    });
    let on_table_4 = Settings { niasa_elements: 1.0, ..with(case.settings, Compensator::NiasaMaxwell) };
    let on_table_4 = Case { settings: on_table_4, ..case.clone() };
    campaign.cases = compensated.into_iter().chain(on).chain([on_table_4]).collect();
    assert_eq!(hash(&campaign), "f7557bc2ae604941");
}
