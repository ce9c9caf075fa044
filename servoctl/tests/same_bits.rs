//! The results of a small campaign, to the bit: the same on any computer, in debug and release.

use servo_sim::Stage;
use servoctl::reproduce::campaign::{Shard, Watch};
use servoctl::reproduce::experiments::{Experiment, Request};
use servoctl::reproduce::outcome::results_hash;

fn hash(experiment: Experiment, moves: u64) -> String {
    let mass_errors_percent = if experiment == Experiment::Exp2 { vec![1.0] } else { Vec::new() };
    let plan = Request { experiment, moves, seed: 1, mass_errors_percent, stage: Stage::default() }.plan().unwrap();
    results_hash(&plan.campaign.run(Shard::ALL, Watch::NOBODY).unwrap())
}

/// `cargo xtask test` runs this optimised as well. Whoever changes what drive or stage compute changes these numbers, knowingly.
#[test]
fn debug_and_release_give_the_results_that_are_written_here() {
    let found = [Experiment::Exp1, Experiment::Exp2, Experiment::Step50Nm].map(|experiment| hash(experiment, 3));
    assert_eq!(found, ["23586f1bfe865380", "1cb7f27b4152bbd7", "ca645ba6925374de"]);
}
