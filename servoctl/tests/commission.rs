//! Commissioning of simulated stages, unattended.

use std::sync::atomic::AtomicBool;

use servo_sim::Stage;
use servoctl::commission::{Failure, Found, Many, Simulated, Step, run, stages};

static NEVER: AtomicBool = AtomicBool::new(false);

/// The stage of table 4, one with Dahl's friction and two with Maxwell slip; `servoctl commission --simulated --random 50` does more.
#[test]
fn stages_drawn_at_random_are_commissioned_and_left_with_the_bridge_off() {
    let many = Many::new(1, stages::commission_all(1, 0..4, &NEVER, || ()).unwrap());
    println!("{}", many.to_text());
    let summary = &many.summary;
    assert_eq!((summary.tried, summary.succeeded, summary.unsafe_ends), (4, 4, 0));
    assert!(summary.least_gain_percent.unwrap() >= 60.0);
    for worst in [summary.sigma_error_percent, summary.coulomb_error_percent].map(|error| error.unwrap()[1]) {
        assert!(worst < 10.0, "{worst} %");
    }
    assert!(summary.loop_error_percent.unwrap()[1] < 3.0, "{:?}", summary.loop_error_percent);
    for c in &many.stages {
        assert!((c.found.mass_kg.unwrap() / c.true_mass_kg - 1.0).abs() < 0.03, "stage {}", c.name);
    }
}

#[test]
fn a_stop_ends_it_with_the_bridge_off_and_the_name_of_the_step() {
    let mut link = Simulated::new(&Stage::default(), 1).unwrap();
    let settings = *link.settings();
    let ended = run(&mut link, &settings, &mut Found::default(), Step::Offsets, &AtomicBool::new(true), |_, _| ());
    assert_eq!(ended, Err((Step::Offsets, Failure::Stopped)));
    assert!(!link.bridge_is_on());
}

#[test]
fn a_step_without_what_it_needs_refuses_by_name() {
    let mut link = Simulated::new(&Stage::default(), 1).unwrap();
    let settings = *link.settings();
    let ended = run(&mut link, &settings, &mut Found::default(), Step::Tuning, &NEVER, |_, _| ());
    assert_eq!(ended, Err((Step::Tuning, Failure::Missing("the plant"))));
}

/// What a run has found is enough to go on with, on a drive that knows nothing.
#[test]
fn it_goes_on_from_what_was_written_down() {
    let mut stage = Stage::default();
    stage.friction.spread = None;
    let mut link = Simulated::new(&stage, 1).unwrap();
    let settings = *link.settings();
    let mut found = Found::default();
    let stop = AtomicBool::new(false);
    let ended = run(&mut link, &settings, &mut found, Step::Offsets, &stop, |step, _| {
        stop.store(step == Step::Tuning, std::sync::atomic::Ordering::Relaxed);
    });
    assert_eq!(ended, Err((Step::LengthScale, Failure::Stopped)));
    let mut again: Found = serde_json::from_str(&serde_json::to_string(&found).unwrap()).unwrap();
    let mut link = Simulated::new(&stage, 2).unwrap();
    run(&mut link, &settings, &mut again, Step::LengthScale, &NEVER, |_, _| ()).unwrap();
    assert!(link.saved.is_some_and(|saved| saved.compensator == 1.0));
}
