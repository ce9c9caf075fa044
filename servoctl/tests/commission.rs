//! Commissioning of simulated stages, unattended.

use std::sync::atomic::AtomicBool;

use servo_sim::Stage;
use servoctl::commission::{Failure, Found, Simulated, Step, run, stages};

static NEVER: AtomicBool = AtomicBool::new(false);

/// The stage of table 4, one with Dahl's friction and two with Maxwell slip; `servoctl commission --simulated --random 50` does more.
#[test]
fn stages_drawn_at_random_are_commissioned_and_left_with_the_bridge_off() {
    let all = stages::commission_all(1, 0..4, &NEVER, || ()).unwrap();
    println!("{}", stages::text(&all));
    for c in &all {
        assert_eq!(c.ended, None, "stage {}", c.stage);
        assert!(c.bridge_off);
        assert!((c.found.mass_kg.unwrap() / c.true_mass_kg - 1.0).abs() < 0.03);
        // Table 4 is no curve with a σ.
        if c.stage > 0 {
            assert!((c.found.sigma_n_per_m.unwrap() / c.true_sigma_n_per_m - 1.0).abs() < 0.10, "stage {}", c.stage);
            assert!((c.found.coulomb_n.unwrap() / c.true_coulomb_n - 1.0).abs() < 0.10, "stage {}", c.stage);
        }
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
