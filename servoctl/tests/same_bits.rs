//! The results of a small campaign, to the bit: the same on any computer, in debug and release.

use servo_core::compensator::Compensator;
use servo_core::parameters::Settings;
use servo_sim::Stage;
use servo_sim::stage::FrictionModel;
use servoctl::reproduce::campaign::{Campaign, Shard, Watch};
use servoctl::reproduce::experiments::{Experiment, Plan, Request, with};
use servoctl::reproduce::outcome::results_hash;
use servoctl::reproduce::pass::Case;

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
    let found = [Experiment::Exp1, Experiment::Exp2, Experiment::Step50Nm]
        .map(|experiment| hash(&plan(experiment, 3).campaign));
    assert_eq!(found, ["23586f1bfe865380", "d5dd1ba60e49da9e", "ca645ba6925374de"]);
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
