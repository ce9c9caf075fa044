//! What the thesis says of its measurements, held against their simulation.

use std::sync::atomic::{AtomicBool, Ordering};

use servo_ident::length_scale::End;
use servo_sim::Stage;
use servoctl::reproduce::campaign::{Shard, Watch};
use servoctl::reproduce::experiments::{Experiment, Request};
use servoctl::reproduce::loop_transmission::{self, Curve};
use servoctl::reproduce::outcome::Outcome;
use servoctl::reproduce::{models, step_100um};

fn outcome(experiment: Experiment, moves: u64, mass_errors_percent: &[f64], stage: Stage) -> Outcome {
    let mass_errors_percent = mass_errors_percent.to_vec();
    let plan = Request { experiment, moves, seed: 1, mass_errors_percent, stage }.plan().unwrap();
    Outcome::new(&plan, &plan.campaign.run(Shard::ALL, Watch::NOBODY).unwrap())
}

/// As many moves as the thesis made: the mean of fewer depends on the seed. Five seeds gave 77.2 to 88.6 %, each mean within 2 %.
#[test]
fn the_first_experiment_settles_75_to_92_percent_faster_at_every_tolerance() {
    let (mass_errors_percent, stage) = (Vec::new(), Stage::default());
    let request = Request { experiment: Experiment::Exp1, moves: 250, seed: 1, mass_errors_percent, stage };
    let plan = request.plan().unwrap().only(&["pid+niasa".into()]).unwrap();
    let outcome = Outcome::new(&plan, &plan.campaign.run(Shard::ALL, Watch::NOBODY).unwrap());
    let reduction = &outcome.only.as_ref().unwrap().settling.reduction_percent;
    assert!(reduction.iter().all(|r| r.is_some_and(|r| (75.0..92.0).contains(&r))), "{reduction:?}");
}

/// 500 moves, as many as the thesis made, with a feedforward mass that is 2 % wrong; 40 small steps in both tunings.
#[test]
fn niasa_settles_faster_at_every_tolerance_where_the_thesis_says_so() {
    for (experiment, moves, mass_errors_percent) in [
        (Experiment::Exp2, 500, vec![-2.0, 2.0]),
        (Experiment::Step5Um, 40, vec![]),
        (Experiment::Step50Nm, 40, vec![]),
    ] {
        let request = Request { experiment, moves, seed: 1, mass_errors_percent, stage: Stage::default() };
        let plan = request.plan().unwrap().only(&["pid+niasa".into()]).unwrap();
        let outcome = Outcome::new(&plan, &plan.campaign.run(Shard::ALL, Watch::NOBODY).unwrap());
        assert_eq!(outcome.runs.len(), 2, "{experiment:?}");
        for run in &outcome.runs {
            let reduction = &run.settling.reduction_percent;
            // The smallest steps have no band as wide as themselves.
            let all = run.settling.moves as u64 == moves && reduction.len() >= 4;
            assert!(all, "{experiment:?} {}: {reduction:?}", run.name);
            assert!(reduction.iter().all(|r| r.is_some_and(|r| r > 0.0)), "{experiment:?} {}: {reduction:?}", run.name);
        }
    }
}

#[test]
fn the_noise_in_position_is_that_of_table_3() {
    let outcome = outcome(Experiment::InPosition, 20, &[], Stage::default());
    // Table 3 has PID and NIASA in the form of appendix E; the third is (7.55), which it does not have.
    assert_eq!(outcome.runs.iter().map(|run| run.configs.len()).collect::<Vec<_>>(), [3, 3]);
    for (run, table_3) in outcome.runs.iter().zip([[0.48, 0.50], [0.49, 0.48]]) {
        for (config, expected_nm) in run.configs.iter().zip(table_3) {
            let nm = config.settling.in_position_rms_nm.unwrap();
            assert!((nm - expected_nm).abs() < 0.2, "{} {}: {nm} nm", run.name, config.settling.name);
        }
    }
}

#[test]
fn every_compensator_does_what_chapter_4_says_of_it() {
    let outcome = outcome(Experiment::Compensators, 10, &[], Stage::default());
    let claims = &outcome.claims;
    assert_eq!(claims.len(), 10);
    // Chapter 4 did not know of this one: half the model behind a dead band, driven hard, is faster than NIASA.
    let (exception, rest): (Vec<_>, Vec<_>) =
        claims.iter().partition(|claim| claim.found.starts_with("lugre-observer-scaled"));
    assert!(exception.len() == 1 && exception[0].holds == Some(false), "{exception:#?}");
    assert!(rest.iter().all(|claim| claim.holds != Some(false)), "{rest:#?}");
    // Tuned at equal margins and noise, those that have no limit cycle.
    let search = outcome.search.unwrap();
    for tuned in search.tuned.iter().filter(|tuned| tuned.is_admissible) {
        // More k_I than three times the PID's is not to be had: its cascade has no real zeros any more.
        assert!(!tuned.is_at_an_end || tuned.name == "pid-ki-tuned", "{}: {}", tuned.name, tuned.chosen);
        assert!((tuned.crossover_hz - 100.0).abs() < 4.0, "{}: {} Hz", tuned.name, tuned.crossover_hz);
        assert!((tuned.phase_margin_deg - search.tuned[0].phase_margin_deg).abs() <= 3.0, "{}", tuned.name);
    }
}

/// 5.3, as far as it is reproduced: a linear swing, then a leg that takes much longer.
#[test]
fn a_step_of_100_um_swings_linearly_until_friction_takes_over() {
    let found = step_100um::run(&Stage::default(), 4, 1, Watch::NOBODY).unwrap();
    // 7.25 ms, which is 58 ticks: the thesis has 8 ms, and 8.0 to 8.6 are wanted. Found here once, and held to that.
    assert!(found.linear_leg_ms.is_some_and(|ms| (7.25..=7.5).contains(&ms)), "{:?} ms", found.linear_leg_ms);
    let finding = found.finding.unwrap();
    // 166.25 ms, where the thesis has 23 and 12 to 36 are wanted: not reproduced, the stage creeps to the target (the report says so).
    assert!(finding.end == End::Creeps && (150.0..=180.0).contains(&finding.leg_ms), "{finding:?}");
    assert!(finding.linear_down_to_nm > finding.length_scale_nm, "{finding:?}");
    assert!(found.redrawn.len() == 4 && found.redrawn.iter().all(Option::is_some));
}

#[test]
fn the_models_come_nearer_in_the_order_of_their_figures() {
    let models = models::run(Watch::NOBODY);
    assert_eq!(models.fits.len() as u64, models::FITS);
    assert!(models.fits.windows(2).all(|pair| pair[1].rms_n <= pair[0].rms_n), "{:?}", models.table());
    assert!(models.fits.iter().all(|fit| fit.force_n.len() == models.motion.position_m.len()));
}

#[test]
fn a_stage_of_ones_own_goes_through() {
    for file in [
        include_str!("../../sim/stages/gms-table-4.toml"),
        include_str!("../../sim/stages/light-stiff.toml"),
        include_str!("../../sim/stages/sin-cos.toml"),
    ] {
        let stage = Stage::from_toml(file).unwrap();
        let outcome = outcome(Experiment::Exp1, 2, &[], stage);
        let configs = outcome.only.unwrap().configs;
        assert!(outcome.complete && configs.len() >= 2 && configs.iter().all(|config| config.faults == 0));
    }
}

/// On one thread, ended after the first piece.
fn ended_after_one<T: Send>(run: impl FnOnce(Watch) -> T + Send) -> T {
    let stop = AtomicBool::new(false);
    let finished = |_| stop.store(true, Ordering::Relaxed);
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    pool.install(|| run(Watch { stop: &stop, finished: &finished }))
}

#[test]
fn measurements_that_are_ended_early_keep_what_is_finished() {
    let models = ended_after_one(models::run);
    assert!(!models.complete && models.fits.len() == 1);
    assert!(models.to_text().contains("Not complete: 1 of 6 fits"), "{}", models.to_text());

    let stage = Stage::default();
    let swept = ended_after_one(|watch| loop_transmission::run(&stage, 1, watch)).unwrap().unwrap();
    assert!(!swept.complete && swept.figure_15.len() == 1 && swept.section_8_2.is_empty());
    assert!(swept.to_text().contains("Not complete: 1 of 38 sweeps"), "{}", swept.to_text());

    let stepped = ended_after_one(|watch| step_100um::run(&stage, 3, 1, watch)).unwrap();
    assert!(!stepped.complete && stepped.redrawn.len() == 1 && stepped.finding.is_some());
    assert!(stepped.to_text().contains("Not complete: 1 of 3 steps"), "{}", stepped.to_text());

    let request =
        Request { experiment: Experiment::Compensators, moves: 1, seed: 1, mass_errors_percent: vec![], stage };
    let tuned = ended_after_one(|watch| {
        let plan = request.plan_watched(watch).unwrap();
        Outcome::new(&plan, &plan.campaign.run(Shard::ALL, watch).unwrap())
    });
    let search = tuned.search.as_ref().unwrap();
    assert!(!tuned.complete && !search.complete && search.tuned.len() == 2 && tuned.claims.is_empty());
    assert!(tuned.to_text().ends_with("Not complete: ended before the first moves were finished.\n"));
}

#[test]
fn the_loop_transmission_depends_on_the_amplitude_as_in_5_1_and_8_2() {
    let found = loop_transmission::run(&Stage::default(), 1, Watch::NOBODY).unwrap().unwrap();

    // Figure 15: a mass above 1 % of full current, a spring with a resonance below: of 250 to 420 Hz, the thesis' range, at the
    // two larger amplitudes; 424.74 and 442.83 Hz at the two smallest, which the report calls not reproduced.
    assert_eq!(found.figure_15.len(), 8);
    for curve in &found.figure_15 {
        let expected = if curve.amplitude_percent > 1.0 { "mass" } else { "spring" };
        assert_eq!(curve.behaves_like, expected, "{} %", curve.amplitude_percent);
        if expected == "spring" {
            let range = if curve.amplitude_percent > 0.2 { 250.0..=420.0 } else { 420.0..=445.0 };
            assert!(curve.resonance_hz.is_some_and(|hz| range.contains(&hz)), "{:?}", curve.resonance_hz);
        }
    }
    // Section 8.2: NIASA leaves the large-amplitude loop alone and lifts the first crossover of the small-amplitude one.
    let of =
        |percent: f64| found.section_8_2.iter().filter(move |c| c.amplitude_percent == percent).collect::<Vec<_>>();
    let first = |curve: &Curve| curve.crossover_hz.first().copied().unwrap();
    let large = of(10.0);
    assert!(large.iter().all(|curve| (first(curve) / first(large[0]) - 1.0).abs() < 0.01));
    assert!((first(large[0]) / 315.0 - 1.0).abs() < 0.03);
    let small = of(0.313);
    // Without NIASA there is none above 3 Hz: what is left is the contact's resonance.
    assert!(first(small[0]) > 500.0);
    let [by_4, by_8, by_4_fast, by_8_fast] = [1, 2, 3, 4].map(|i| first(small[i]));
    assert!(4.0 < by_4 && 1.4 * by_4 < by_8 && 1.4 * by_8 < by_4_fast && 1.4 * by_4_fast < by_8_fast);
    // And what the rate limit is for: only without it, with the fast schedule and more delay, does the loop not come to rest.
    assert!(found.stability.iter().any(|case| !case.stable) && found.stability.iter().any(|case| case.stable));
    for case in &found.stability {
        let harsh = !case.rate_limited && case.a_tick_late && case.rate_per_s > 600.0 && case.stiffness_n_per_m > 6e6;
        assert_eq!(case.stable, !harsh, "{case:?}");
    }
}
