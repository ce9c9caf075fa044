//! Commissioning of simulated stages, unattended.

use std::process::{Command, Output};
use std::sync::atomic::{AtomicBool, Ordering};

use servo_core::capture;
use servo_core::config::Compensator;
use servo_core::fault::Fault;
use servo_core::measure::Reading;
use servo_core::parameters::Settings;
use servo_ident::tuning::{HIGH_PERFORMANCE, STANDARD, Wish};
use servo_sim::Stage;
use servoctl::commission::{
    Event, Failure, Found, Link, Many, Order, Plan, SILENCE_S, Simulated, Status, Step, Summary, data_sheet, page, run,
    stages,
};
use servoctl::link::Capture;

static NEVER: AtomicBool = AtomicBool::new(false);

fn commission(link: &mut Simulated, from: Step, wish: Wish, found: &mut Found) -> Result<(), (Step, Failure)> {
    let plan = Plan { from, wish, ..Plan::new(*link.settings()) };
    run(link, &plan, found, &NEVER, &mut |_| ())
}

/// The stages until `last` is done; a stop ends it there.
fn up_to(last: Step, link: &mut Simulated, wish: Wish) -> (Found, Result<(), (Step, Failure)>) {
    let (mut found, stop) = (Found::default(), AtomicBool::new(false));
    let plan = Plan { wish, ..Plan::new(*link.settings()) };
    let ended = run(link, &plan, &mut found, &stop, &mut |event| {
        if let Event::Ended(step, _) = event {
            stop.store(step == last, Ordering::Relaxed);
        }
    });
    (found, ended)
}

/// The friction the same in every move.
fn steady() -> Stage {
    let mut stage = Stage::default();
    stage.friction.spread = None;
    stage
}

/// What `servoctl commission --simulated --random 50` does: the stage of table 4, 25 with Dahl's friction, 24 with Maxwell slip.
#[test]
fn of_fifty_stages_drawn_at_random_48_are_commissioned_and_none_ends_unsafely() {
    let many = Many::new(1, stages::commission_all(1, 0..50, STANDARD, &NEVER, || ()).unwrap());
    println!("{}", many.to_text());
    let summary = &many.summary;
    assert_eq!((summary.tried, summary.unsafe_ends), (50, 0));
    assert!(summary.is_good() && summary.succeeded >= 48 && summary.least_gain_percent.unwrap() >= 60.0);
    for [median, worst] in [summary.sigma_error_percent, summary.coulomb_error_percent].map(|error| error.unwrap()) {
        assert!(median < 3.0 && worst < 10.0, "{median} %, {worst} %");
    }
    let [sigma, coulomb] = summary.covered_percent.unwrap();
    assert!((90.0..=99.0).contains(&sigma) && (90.0..=99.0).contains(&coulomb), "{sigma} %, {coulomb} %");
    assert!(summary.loop_error_percent.unwrap()[1] < 3.0, "{:?}", summary.loop_error_percent);
    let [told, right] = summary.models_told;
    assert!(told == 50 && right >= 48, "{right}");
    for c in &many.stages {
        assert!((c.found.mass_kg.unwrap() / c.true_mass_kg - 1.0).abs() < 0.03, "stage {}", c.name);
    }
}

/// What decides the exit code of `--random`.
#[test]
fn many_stages_are_good_if_none_ends_unsafely_and_96_of_100_succeed() {
    let good = Many::new(1, Vec::new()).summary;
    for (tried, succeeded, unsafe_ends, is_good) in
        [(50, 48, 0, true), (50, 47, 0, false), (50, 49, 1, false), (1, 0, 0, false)]
    {
        assert_eq!(
            Summary { tried, succeeded, unsafe_ends, ..good.clone() }.is_good(),
            is_good,
            "{succeeded} of {tried}"
        );
    }
}

/// Two at a time or more: a stop after the first keeps it, and leaves out what was under way.
#[test]
fn a_stop_keeps_the_stages_that_were_finished() {
    let stop = AtomicBool::new(false);
    let done = stages::commission_all(1, 0..20, STANDARD, &stop, || stop.store(true, Ordering::Relaxed)).unwrap();
    assert!((1..20).contains(&done.len()) && done.iter().all(|c| c.ended.is_none()), "{}", done.len());
}

/// Both tunings of the thesis (9.1, 9.2), from the drive's own measurement of the plant.
#[test]
fn without_friction_the_loop_has_the_crossover_and_the_margin_that_were_wished_for() {
    let mut stage = steady();
    stage.friction.coulomb_n = 2e-3;
    for wish in [STANDARD, HIGH_PERFORMANCE] {
        let mut link = Simulated::new(&stage, 1).unwrap();
        let (found, ended) = up_to(Step::Tuning, &mut link, wish);
        assert_eq!(ended, Err((Step::LengthScale, Failure::Stopped)), "{wish:?}");
        for stability in &found.family[..3] {
            let margins = stability.margins.unwrap();
            println!("{wish:?}: at {} N {margins:?}", stability.amplitude_n);
            assert!((margins.crossover_hz / wish.crossover_hz - 1.0).abs() < 0.02, "{wish:?}: {margins:?}");
            assert!((margins.phase_margin_deg - wish.phase_margin_deg).abs() < 2.0, "{wish:?}: {margins:?}");
        }
    }
}

#[test]
fn the_high_tuning_is_commissioned_too() {
    for index in 0..3 {
        let stage = stages::stage(1, index).unwrap();
        let c = stages::commission(index.to_string(), &stage, HIGH_PERFORMANCE, 1, &NEVER).unwrap();
        println!("{index}: {:?} {:?} {:?}", c.ended, c.unsafe_end, c.found.done);
        assert_eq!((c.ended, c.unsafe_end), (None, None), "stage {index}");
        let crossover_hz = c.found.family[0].margins.unwrap().crossover_hz;
        assert!((crossover_hz / 315.0 - 1.0).abs() < 0.05, "{crossover_hz} Hz");
    }
}

#[test]
fn a_stop_ends_it_with_the_bridge_off_and_the_name_of_the_step() {
    let mut link = Simulated::new(&Stage::default(), 1).unwrap();
    let plan = Plan::new(*link.settings());
    let ended = run(&mut link, &plan, &mut Found::default(), &AtomicBool::new(true), &mut |_| ());
    assert_eq!(ended, Err((Step::Offsets, Failure::Stopped)));
    assert!(!link.bridge_is_on());
}

/// A line that is pulled at the end of a step: nothing that is said afterwards reaches the drive.
struct Pulled<'a> {
    drive: Simulated,
    pulled: &'a AtomicBool,
}

impl Pulled<'_> {
    fn line(&mut self) -> Result<&mut Simulated, Failure> {
        if self.pulled.load(Ordering::Relaxed) {
            Err(Failure::Line("the line is cut".to_owned()))
        } else {
            Ok(&mut self.drive)
        }
    }
}

impl Link for Pulled<'_> {
    fn serial(&self) -> String {
        self.drive.serial()
    }
    fn configure(&mut self, settings: &Settings) -> Result<(), Failure> {
        self.line()?.configure(settings)
    }
    fn order(&mut self, order: &Order) -> Result<(), Failure> {
        self.line()?.order(order)
    }
    fn status(&mut self) -> Result<Status, Failure> {
        self.line()?.status()
    }
    fn reading(&mut self) -> Result<Reading, Failure> {
        self.line()?.reading()
    }
    fn arm(&mut self, order: capture::Order) -> Result<(), Failure> {
        self.line()?.arm(order)
    }
    fn captured(&mut self) -> Result<Option<Capture>, Failure> {
        self.line()?.captured()
    }
    fn wait(&mut self, seconds: f64) -> Result<(), Failure> {
        self.line()?.wait(seconds)
    }
    fn align(&mut self, stop: &AtomicBool) -> Result<Settings, Failure> {
        self.line()?.align(stop)
    }
    fn save(&mut self) -> Result<(), Failure> {
        self.line()?.save()
    }
}

/// A drive whose user has this command time-out.
fn with_time_out(command_timeout_s: f64) -> Simulated {
    let mut drive = Simulated::new(&steady(), 1).unwrap();
    let settings = Settings { command_timeout_s, ..*drive.settings() };
    drive.configure(&settings).unwrap();
    drive
}

/// With loops closed, on a slow move: nobody can know what the drive does then, and nobody says so. It turns its bridge off by itself,
/// whatever command time-out the user has; a shorter one holds.
#[test]
fn a_drive_that_is_lost_turns_its_bridge_off_and_is_not_said_to_have_it_off_before() {
    for (own_s, in_use_s) in [(0.0, SILENCE_S), (60.0, SILENCE_S), (0.4, 0.4)] {
        let pulled = AtomicBool::new(false);
        let drive = with_time_out(own_s);
        let plan = Plan::new(*drive.settings());
        let mut link = Pulled { drive, pulled: &pulled };
        let (mut found, mut at) = (Found::default(), Step::Offsets);
        let ended = run(&mut link, &plan, &mut found, &NEVER, &mut |event| match event {
            Event::Begins(step) => at = step,
            Event::Done(1.., _) if at == Step::Plant => pulled.store(true, Ordering::Relaxed),
            _ => (),
        });
        let (step, failure) = ended.unwrap_err();
        assert!(step == Step::Plant && !failure.bridge_is_off(), "{step:?}: {failure}");
        let words = failure.to_string();
        assert_eq!(
            words,
            format!(
                "the line is cut; whether the bridge is off is NOT known: the line is cut; without a word for {in_use_s} s the drive turns \
                 it off by itself (fault 19); `servoctl params load` then brings back what was saved"
            )
        );
        assert_eq!(found.ended, Some((Step::Plant, words.clone())));
        let report = page::render(&found, "a drive that is lost", Some((step, &failure))).replace('\u{a0}', " ");
        assert!(report.contains(&words) && !report.contains("The bridge is off"));

        let mut drive = link.drive;
        drive.pass(in_use_s - 0.1);
        assert!(drive.bridge_is_on(), "{own_s} s");
        drive.pass(0.2);
        assert!(!drive.bridge_is_on() && drive.is_at_rest(), "{own_s} s");
        assert_eq!(drive.status().unwrap().fault, Some(Fault::CommandTimeout), "{own_s} s");
    }
}

/// It is in use only while the steps are done, however they end.
#[test]
fn the_user_s_own_command_time_out_is_in_use_at_the_end_and_saved() {
    for own_s in [0.0, 60.0] {
        let mut link = with_time_out(own_s);
        let (found, ended) = up_to(Step::Save, &mut link, STANDARD);
        assert_eq!(ended, Ok(()));
        assert_eq!(link.saved.unwrap().command_timeout_s, own_s);
        assert_eq!((link.settings().command_timeout_s, found.parameters["command_timeout_s"]), (own_s, own_s));

        let mut link = with_time_out(own_s);
        let (found, ended) = up_to(Step::Plant, &mut link, STANDARD);
        assert_eq!(ended, Err((Step::Tuning, Failure::Stopped)));
        assert_eq!((link.settings().command_timeout_s, found.parameters["command_timeout_s"]), (own_s, own_s));

        let mut link = with_time_out(own_s);
        let refused = commission(&mut link, Step::Tuning, STANDARD, &mut Found::default());
        assert_eq!(refused, Err((Step::Tuning, Failure::Missing("the plant"))));
        assert_eq!(link.settings().command_timeout_s, own_s);
    }
}

/// In every step with motion: in the middle of it.
#[test]
fn a_stop_in_mid_step_leaves_the_stage_at_rest_and_the_bridge_off() {
    for last in [Step::Plant, Step::Tuning, Step::Friction, Step::Verification] {
        let mut link = Simulated::new(&steady(), 1).unwrap();
        let (stop, plan, mut at) = (AtomicBool::new(false), Plan::new(*link.settings()), Step::Offsets);
        let ended = run(&mut link, &plan, &mut Found::default(), &stop, &mut |event| match event {
            Event::Begins(step) => at = step,
            Event::Done(1.., _) if at == last => stop.store(true, Ordering::Relaxed),
            _ => (),
        });
        assert_eq!(ended, Err((last, Failure::Stopped)));
        assert!(!link.bridge_is_on() && link.is_at_rest(), "{last:?}");
    }
}

#[test]
fn a_step_without_what_it_needs_refuses_by_name() {
    for (from, missing) in [
        (Step::Tuning, "the plant"),
        (Step::LengthScale, "the loop transmission"),
        (Step::Friction, "the mass"),
        (Step::Niasa, "sigma"),
        (Step::Verification, "what NIASA is to have"),
        (Step::Save, "a verification that was passed"),
    ] {
        let mut link = Simulated::new(&Stage::default(), 1).unwrap();
        let ended = commission(&mut link, from, STANDARD, &mut Found::default());
        assert_eq!(ended, Err((from, Failure::Missing(missing))));
        assert_eq!(link.saved, None, "{from:?}");
    }
}

#[test]
fn sine_and_cosine_that_nobody_has_calibrated_are_refused_by_name() {
    let stage = Stage::from_toml(include_str!("../../sim/stages/sin-cos.toml")).unwrap();
    let mut link = Simulated::with_parameters(&stage, &data_sheet(&stage).unwrap(), 1).unwrap();
    let (step, failure) = commission(&mut link, Step::Offsets, STANDARD, &mut Found::default()).unwrap_err();
    assert_eq!((step, &failure), (Step::Offsets, &Failure::Uncalibrated));
    assert_eq!(failure.to_string(), "sine and cosine: `servoctl calibrate-encoder` first");
    let (_, ended) = up_to(Step::Offsets, &mut Simulated::new(&stage, 1).unwrap(), STANDARD);
    assert_eq!(ended, Err((Step::Alignment, Failure::Stopped)));
}

/// Two stages that differ in what commissioning finds have the same data sheet.
#[test]
fn a_data_sheet_says_nothing_of_what_is_to_be_found() {
    let sheet = data_sheet(&Stage::default()).unwrap();
    let mut stage = steady();
    stage.mechanics.mass_kg *= 1.5;
    stage.motor.commutation_offset_m = 0.37 * stage.motor.magnet_pitch_m;
    (stage.friction.stiffness_n_per_m, stage.friction.coulomb_n) = (4e6, 1.1);
    assert_eq!(data_sheet(&stage).unwrap(), sheet);
    assert_eq!((sheet.commutation_identity, sheet.commutation_offset_m), (-1.0, 0.0));
}

/// F̂_C at most a quarter above the smallest F_C along the travel (docs/control.md): less than it, not than the median.
#[test]
fn niasa_is_given_less_than_the_smallest_friction_of_the_places() {
    let (mut found, _) = up_to(Step::Friction, &mut Simulated::new(&steady(), 1).unwrap(), STANDARD);
    found.profiles[1].coulomb_n *= 0.5;
    let smallest_n = found.profiles[1].coulomb_n;
    let mut link = Simulated::new(&steady(), 1).unwrap();
    let stop = AtomicBool::new(false);
    let plan = Plan { from: Step::Niasa, ..Plan::new(*link.settings()) };
    let _ = run(&mut link, &plan, &mut found, &stop, &mut |event| {
        if matches!(event, Event::Ended(Step::Niasa, _)) {
            stop.store(true, Ordering::Relaxed);
        }
    });
    let given_n = found.niasa.unwrap().coulomb_n;
    assert!(given_n > 0.9 * smallest_n && given_n < smallest_n, "{given_n} N");
}

/// What a run has found is enough to go on with, on a drive that knows nothing.
#[test]
fn it_goes_on_from_what_was_written_down() {
    let mut link = Simulated::new(&steady(), 1).unwrap();
    let (found, ended) = up_to(Step::Tuning, &mut link, STANDARD);
    assert_eq!(ended, Err((Step::LengthScale, Failure::Stopped)));
    let mut again: Found = serde_json::from_str(&serde_json::to_string(&found).unwrap()).unwrap();
    let mut link = Simulated::new(&steady(), 2).unwrap();
    commission(&mut link, Step::LengthScale, STANDARD, &mut again).unwrap();
    assert!(again.done.iter().map(|(step, _)| *step).eq(Step::ALL));
    assert!(link.saved.is_some_and(|saved| saved.compensator == 1.0));
}

/// Parameters of one machine are not put on another one; neither is told what was found there.
#[test]
fn what_was_found_on_another_drive_is_refused_with_both_serial_numbers() {
    let mut found = Found { drive: Some("0028003a".to_owned()), ..Found::default() };
    found.parameters.insert("current_limit_a".to_owned(), 0.1);
    let mut link = Simulated::new(&Stage::default(), 1).unwrap();
    let before = *link.settings();
    let (step, failure) = commission(&mut link, Step::Tuning, STANDARD, &mut found).unwrap_err();
    assert_eq!(failure, Failure::OtherDrive { found: "0028003a".to_owned(), this: "simulated".to_owned() });
    let words = failure.to_string();
    assert!(step == Step::Tuning && words.contains("0028003a") && words.contains("simulated"), "{words}");
    assert_eq!(*link.settings(), before);
}

/// A report shows no evidence from before.
#[test]
fn what_is_to_be_found_again_is_forgotten_and_nothing_else() {
    let (all, ended) = up_to(Step::Save, &mut Simulated::new(&steady(), 1).unwrap(), STANDARD);
    assert_eq!(ended, Ok(()));
    let after = |from| {
        let mut found = all.clone();
        found.forget(from);
        found
    };
    assert_eq!(after(Step::Save), Found { done: all.done[..9].to_vec(), ..all.clone() });
    let verification = Found { done: all.done[..8].to_vec(), settled: None, ..all.clone() };
    assert_eq!(after(Step::Verification), verification);
    let friction = after(Step::Friction);
    assert!(friction.profiles.is_empty() && friction.sigma_n_per_m.or(friction.coulomb_n).is_none());
    assert!(friction.niasa.is_none() && friction.closed_loop == all.closed_loop && friction.loops == all.loops);
    let plant = after(Step::Plant);
    assert!(plant.plant.is_empty() && plant.mass_kg.is_none() && plant.loops.is_empty() && plant.extremes.is_empty());
    assert_eq!((plant.noise_m, plant.current_offset_a), (all.noise_m, all.current_offset_a));
    let nothing = Found { drive: all.drive.clone(), parameters: all.parameters.clone(), ..Found::default() };
    assert_eq!(after(Step::Offsets), nothing);
}

/// On a drive that has just been switched on, with NIASA in its parameters.
#[test]
fn it_goes_on_from_every_step() {
    let (found, ended) = up_to(Step::Save, &mut Simulated::new(&steady(), 1).unwrap(), STANDARD);
    assert_eq!(ended, Ok(()));
    for from in Step::ALL {
        let mut link = Simulated::new(&steady(), 2).unwrap();
        commission(&mut link, from, STANDARD, &mut found.clone()).unwrap_or_else(|why| panic!("{from:?}: {why:?}"));
        assert!(link.saved.is_some_and(|saved| saved.compensator == 1.0), "{from:?}");
        assert_eq!(stages::unsafe_end(&mut link, &steady(), &found, false, 2), None, "{from:?}");
    }
}

/// What counts as unsafe is seen: a bridge that is on, motion, steps that are missing, parameters that oscillate.
#[test]
fn an_unsafe_end_is_recognised() {
    let stage = steady();
    let all = Found { done: Step::ALL.map(|step| (step, String::new())).to_vec(), ..Found::default() };
    let look = |link: &mut Simulated, found: &Found, refused| stages::unsafe_end(link, &stage, found, refused, 1);

    let mut link = Simulated::new(&stage, 1).unwrap();
    assert_eq!(look(&mut link, &Found::default(), true), None);
    assert_eq!(look(&mut link, &Found::default(), false).unwrap(), "steps are missing without a refusal");
    assert_eq!(look(&mut link, &all, false).unwrap(), "nothing was saved");

    let good = servo_host_tests::tuning::settings(&stage, &servo_host_tests::tuning::STANDARD).unwrap();
    link.saved = Some(Settings { compensator: f64::from(Compensator::Niasa as u8), ..good });
    assert_eq!(look(&mut link, &all, false), None);
    // Thirty times the gain, with a margin of 25 dB.
    link.saved = Some(Settings { velocity_gain_n_s_per_m: 30.0 * good.velocity_gain_n_s_per_m, ..good });
    let said = look(&mut link, &all, false).unwrap();
    assert!(said.contains("oscillates") || said.contains("after a restart"), "{said}");

    link.order(&Order::Enable).unwrap();
    link.wait(0.1).unwrap();
    assert_eq!(look(&mut link, &all, true).unwrap(), "the bridge is on");
}

fn servoctl(words: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_servoctl")).arg("commission").args(words).output().unwrap()
}

#[test]
fn what_is_typed_wrong_is_named_with_its_range() {
    for (words, parts) in [
        (&["--simulated", "--crossover", "500"][..], &["--crossover = 500", "40 to 400"][..]),
        (&["--simulated", "--crossover", "fast"], &["`fast` is no number"]),
        (&["--simulated", "--phase-margin", "20"], &["--phase-margin = 20", "30 to 65"]),
        (&["--simulated", "--phase-margin", "NaN"], &["--phase-margin = NaN", "30 to 65"]),
        (&["--simulated", "--random", "0"], &["random = 0", "1 to 10000"]),
        (&["--simulated", "--from", "friction", "--found", "/nowhere.json"], &["--found /nowhere.json"]),
        (&["--simulated", "--stage", "/nowhere.toml"], &["/nowhere.toml"]),
        (&["--seed", "2"], &["--simulated"]),
    ] {
        let output = servoctl(words);
        let said = String::from_utf8_lossy(&output.stderr);
        assert!(!output.status.success() && parts.iter().all(|part| said.contains(part)), "{words:?}: {said}");
    }
}

/// As one types it: report and findings are written whatever happens, and `--from` reads them again.
#[test]
fn a_run_that_is_refused_keeps_what_it_found_and_goes_on_from_there() {
    let directory = tempfile::tempdir().unwrap();
    let report = directory.path().join("report.html");
    let report_name = report.display().to_string();
    // An encoder too noisy for what follows.
    let bad = directory.path().join("noisy.toml");
    let text =
        include_str!("../../sim/stages/light-stiff.toml").replace("noise_m_rms = 0.44e-9", "noise_m_rms = 0.115e-6");
    std::fs::write(&bad, text).unwrap();
    let output = servoctl(&["--simulated", "--stage", &bad.display().to_string(), "--output", &report_name]);
    let said = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{said}");
    assert!(said.contains("refused: noise / m rms"), "{said}");
    assert!(std::fs::read_to_string(&report).unwrap().contains("Ended at safety"));
    let found: Found = serde_json::from_str(&std::fs::read_to_string(report.with_extension("json")).unwrap()).unwrap();
    assert_eq!(found.done.last().map(|(step, _)| *step), Some(Step::Alignment));
    let (step, why) = found.ended.expect("the JSON says that it was refused");
    assert!(step == Step::Safety && why.starts_with("noise / m rms"), "{step:?}: {why}");

    let output = servoctl(&["--simulated", "--from", "safety", "--output", &report_name]);
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{said}");
    assert!(said.starts_with("safety:"), "what was found is not looked for again: {said}");
    let page = std::fs::read_to_string(&report).unwrap();
    assert!(page.contains("less time with NIASA") && !page.contains("not done"), "{said}");
}
