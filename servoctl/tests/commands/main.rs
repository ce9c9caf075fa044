//! The program as a person types it, in front of the firmware's ELF on the virtual board: one drive, one story.
//!
//! Needs the virtual drive: `cargo xtask test --only commands` builds it and says where it is.
#![cfg(unix)]

mod cable;
mod sine_cosine;
mod typed;

use std::io::{BufRead, BufReader, Lines, Read};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::thread;
use std::time::Duration;

use serde_json::Value;
use servo_core::settling::TOLERANCES_NM;
use servo_sim::Stage;
use servoctl::link::virtual_drive;

/// `servoctl --virtual …`
fn command(words: &str) -> Command {
    program(&["--virtual"], words)
}

/// `servoctl --port …`
fn at(port: &str, words: &str) -> Command {
    program(&["--port", port], words)
}

fn program(link: &[&str], words: &str) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_servoctl"));
    command.args(link).args(words.split_whitespace()).stdin(Stdio::null());
    command
}

/// It must succeed; its standard output.
fn done(words: &str) -> String {
    done_by(command(words))
}

fn done_by(mut command: Command) -> String {
    let output = command.output().unwrap();
    assert!(output.status.success(), "{command:?}: {}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8(output.stdout).unwrap()
}

/// It must succeed; what it says to a program.
fn json(words: &str) -> Value {
    json_by(command(words))
}

fn json_by(mut command: Command) -> Value {
    command.args(["--json", "-"]);
    serde_json::from_str(&done_by(command)).unwrap()
}

/// It must fail and say all of `parts`; its standard output.
fn refused(words: &str, parts: &[&str]) -> String {
    refused_by(command(words), parts)
}

fn refused_by(mut command: Command, parts: &[&str]) -> String {
    let output = command.output().unwrap();
    let said = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{command:?}: {said}");
    assert!(parts.iter().all(|part| said.contains(part)), "{command:?}: {said}");
    String::from_utf8(output.stdout).unwrap()
}

/// A long move, once it has begun, and what it says after that.
fn under_way(mut command: Command) -> (Child, BufReader<impl Read>) {
    let mut child = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    let mut said = BufReader::new(child.stderr.take().unwrap());
    let mut line = String::new();
    while !line.starts_with("moving to") {
        line.clear();
        assert!(said.read_line(&mut line).unwrap() > 0, "{command:?} ended before it moved");
    }
    (child, said)
}

/// What prints line by line, once it has printed the first.
fn first_line(mut command: Command) -> (Child, String) {
    let mut child = command.stdout(Stdio::piped()).stderr(Stdio::null()).spawn().unwrap();
    let mut lines = BufReader::new(child.stdout.take().unwrap()).lines();
    let line = lines.next().unwrap().unwrap();
    // It goes on printing.
    thread::spawn(move || lines.for_each(drop));
    (child, line)
}

/// The drive goes into this fault by itself, in silence. The emulated board may be slower than the clock on the wall, and whoever asks
/// keeps it from timing out.
fn fault_within(number: u64) {
    let silences_s = [1, 2, 4, 8, 16, 32];
    let ended = silences_s.into_iter().any(|silence_s| {
        thread::sleep(Duration::from_secs(silence_s));
        json("faults")["fault"] == number
    });
    assert!(ended, "{}", done("status"));
}

/// The drive's state once `what` is so. A status may be of 10 ms ago, and a program that has ordered nothing itself cannot tell.
fn status_once(what: impl Fn(&Value) -> bool) -> Value {
    let look = |_| {
        thread::sleep(Duration::from_millis(50));
        json("status")
    };
    (0..40).map(look).find(what).unwrap_or_else(|| panic!("{}", done("status")))
}

fn interrupt(child: &Child) {
    let killed = Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap();
    assert!(killed.success());
}

fn head(file: &Path) -> (String, Vec<String>) {
    let text = std::fs::read_to_string(file).unwrap();
    let (head, rows): (Vec<&str>, Vec<&str>) = text.lines().partition(|line| line.starts_with('#'));
    (head.join("\n"), rows.into_iter().map(str::to_owned).collect())
}

/// Started for this test, ended with it.
struct Background;

impl Drop for Background {
    fn drop(&mut self) {
        let _ = virtual_drive::stop();
    }
}

#[test]
#[ignore = "needs the virtual drive: cargo xtask test --only commands"]
fn from_the_first_move_to_a_pulled_cable() {
    let _background = Background;
    let directory = tempfile::tempdir().unwrap();
    // Time passes while nobody is connected, as on a board.
    let drive = done("virtual --runs-on").trim().to_owned();
    assert!(drive.starts_with("tcp://127.0.0.1:"), "{drive}");

    every_move_ends_with_how_it_settled();
    a_parameter_survives_a_reset();
    the_motor_is_aligned();
    a_move_is_captured(&directory.path().join("move.csv"));
    typed::the_drive_says_who_it_is();
    cable::a_virtual_drive_says_so_whatever_leads_to_it(&drive);
    typed::the_log_is_read_with_the_elf_that_is_on_the_drive(directory.path());
    typed::the_log_of_a_board_is_read_by_probe_rs(directory.path());
    typed::parameters_go_to_a_file_and_come_back(directory.path());
    typed::a_stream_is_written_without_a_loss(directory.path());
    typed::a_sequence_reports_what_it_has_done_however_it_ends(directory.path());
    typed::what_moves_is_stopped();
    typed::a_master_walks_through_the_states_and_halts();
    the_loop_is_measured();
    a_profile_is_recorded_and_fitted(&directory.path().join("profile.csv"));
    ctrl_c_ends_a_commissioning_which_goes_on_from_any_step(&directory.path().join("commissioning.html"));
    ctrl_c_stops_the_motion_first();
    a_second_client_is_told_why();
    cable::a_second_client_of_a_serial_port_is_told_why(&drive);
    a_fault_is_explained_and_its_ticks_computed_again(&directory.path().join("black-box.csv"));
    a_host_that_dies_in_mid_move_ends_it();
    cable::a_pulled_cable_is_reported_within_a_second_and_ends_the_move(&drive);
    cable::a_pulled_cable_ends_a_commissioning_on_the_drive_too(&drive, &directory.path().join("pulled.html"));
    typed::a_killed_drive_is_not_in_the_way(directory.path());
    sine_cosine::an_encoder_without_sine_and_cosine_is_not_calibrated();
    done("virtual --stop");
    sine_cosine::sine_and_cosine_are_calibrated();
}

fn every_move_ends_with_how_it_settled() {
    let text = done("move 5mm");
    for nm in TOLERANCES_NM {
        assert!(text.contains(&format!("±{nm} nm")), "{text}");
    }
    for part in ["simulated", "settled after", "overshoot", "nm rms", "nm peak to peak"] {
        assert!(text.contains(part), "{part} in\n{text}");
    }
    let moved = json("move -1mm --relative --velocity 50mm/s --acceleration 2m/s2 --jerk 200m/s3");
    let near = |name: &str, value: f64| assert!((moved[name].as_f64().unwrap() - value).abs() < 1e-6, "{moved}");
    [("from_m", 5e-3), ("target_m", 4e-3), ("velocity_m_per_s", 0.05), ("jerk_m_per_s3", 200.0)]
        .into_iter()
        .for_each(|(name, value)| near(name, value));
    assert_eq!(moved["settling"]["settled_after_ms"].as_array().unwrap().len(), TOLERANCES_NM.len());
    assert!(moved["settling"]["in_position_rms_nm"].as_f64().unwrap() < 2.0, "{moved}");
}

fn a_parameter_survives_a_reset() {
    assert_eq!(done("params set niasa_time_constant_s 20ms"), "niasa_time_constant_s = 0.02 s\n");
    refused("params save", &["refused SaveParameters", "state: Operation enabled", "`servoctl disable`"]);
    done("disable");
    assert_eq!(json("params save"), serde_json::json!({ "saved": 2 }));
    assert_eq!(json("restart")["state"], "Switch on disabled");
    assert_eq!(json("params get niasa_time_constant_s"), serde_json::json!({ "niasa_time_constant_s": 0.02 }));
    refused(
        "params set niasa_time_constant_s 20s",
        &["niasa_time_constant_s = 20", "outside", "`servoctl params list`"],
    );
}

fn the_motor_is_aligned() {
    let motor = Stage::default().motor;
    let found_m = json("align")["commutation_offset_m"].as_f64().unwrap();
    let off_turns = (found_m - motor.commutation_offset_m) / motor.magnet_pitch_m;
    assert!((off_turns - off_turns.round()).abs() < 0.1 / 360.0, "{found_m} m");
    assert_eq!(json("status")["state"], "Switch on disabled");
    done("enable");
    refused("align", &["refused Align", "state: Operation enabled", "`servoctl disable`"]);
    done("disable");
}

fn a_move_is_captured(file: &Path) {
    let told = json(&format!("capture 5mm --length 200ms --before 10ms -o {}", file.display()));
    assert_eq!(told["samples"], 1600);
    let (head, rows) = head(file);
    for part in ["servoctl ", "firmware ", "# parameters ", "# rate 8000 Hz", "# trigger: move-end at tick", "# units"]
    {
        assert!(head.contains(part), "{part} in\n{head}");
    }
    assert_eq!((rows[0].as_str(), rows.len()), ("time_s,position_low_ct,error_ct,force_n,position_m,error_m", 1601));
    assert!(rows[1].starts_with("-0.01,") && rows[81].starts_with("0,"), "{} {}", rows[1], rows[81]);
}

fn the_loop_is_measured() {
    let told = json("measure loop --amplitude 8 --frequency 60,85,120,170,1500 --speed 200mm/s");
    let (found, near) = (&told[0], |value: &Value, low: f64, high: f64| {
        assert!((low..high).contains(&value.as_f64().unwrap_or(f64::NAN)), "{value} in {told}");
    });
    near(&found["margins"]["crossover_hz"], 95.0, 108.0);
    near(&found["margins"]["phase_margin_deg"], 40.0, 60.0);
    // Above its friction the plant is a mass of 1.8 kg.
    let [re, im] = [0, 1].map(|part| found["plant_m_per_n"][2]["value"][part].as_f64().unwrap());
    let mass_kg = 1.0 / (re.hypot(im) * (std::f64::consts::TAU * 120.0f64).powi(2));
    assert!((1.5..2.1).contains(&mass_kg), "{mass_kg} kg");
    let by_velocity = json("measure loop --node velocity --amplitude 0.008 --frequency 60,85,120,170");
    near(&by_velocity[0]["margins"]["crossover_hz"], 90.0, 115.0);
    let carried = done("measure loop --amplitude 2 --frequency 85,120 --carrier 10mm/s");
    assert!(carried.contains("Loop at 2 N") && carried.contains("plant / nm/N"), "{carried}");
    refused("measure loop --amplitude 8 --frequency 60 --travel 1µm", &["met its limit of travel"]);
    refused("measure loop --amplitude 8 --frequency 60 --speed 1µm/s", &["met its limit of speed"]);
    refused("measure loop --amplitude 8 --frequency 60 --current 0.01", &["met its limit of current"]);
    refused("measure loop --amplitude 8 --frequency 5000", &["frequency = 5000 Hz", "outside"]);
    refused("measure loop --amplitude 8 --frequency 60,50", &["60, 50 is not in rising order"]);
    assert_eq!(json("status")["state"], "Operation enabled");
}

fn a_profile_is_recorded_and_fitted(file: &Path) {
    let name = file.display();
    for frequency in [8, 16, 32] {
        let told =
            json(&format!("measure profile --amplitude 1.5 --frequency {frequency} --periods 4 --output {name}"));
        assert_eq!(told["samples"], 4 * 8_000 / frequency);
        assert!((0.3e-6..20e-6).contains(&told["moved_m"].as_f64().unwrap()), "{told}");
        let fit = json(&format!("fit dahl {name} --mass 1.8 --force-constant 7.8"));
        assert!((2e6..25e6).contains(&fit["sigma_n_per_m"].as_f64().unwrap()), "{fit}");
        assert!((0.2..1.3).contains(&fit["coulomb_n"].as_f64().unwrap()), "{fit}");
    }
    let told = json(&format!("measure pulse --amplitude 3 --length 20ms --output {name}"));
    assert!(told["samples"] == 160 && told["moved_m"].as_f64().unwrap() > 1e-6, "{told}");
}

/// What says on standard error how far it is, up to the line that begins with `until`; what it will say, and what it has said.
fn spoken_up_to(until: &str, mut command: Command) -> (Child, Lines<BufReader<impl Read>>, String) {
    let mut child = command.stdout(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap();
    let mut lines = BufReader::new(child.stderr.take().unwrap()).lines();
    let mut said = String::new();
    let begun = lines.by_ref().map_while(Result::ok).any(|line| {
        said += &format!("{line}\n");
        line.starts_with(until)
    });
    assert!(begun, "{command:?} ended before {until}: {said}");
    (child, lines, said)
}

fn ctrl_c_ends_a_commissioning_which_goes_on_from_any_step(report: &Path) {
    for (words, step, not) in [("", "plant: 20 %", "refused"), ("--from plant", "plant: 10 %", "safety:")] {
        let words = format!("commission --output {} {words}", report.display());
        let (mut child, lines, mut said) = spoken_up_to(step, command(&words));
        interrupt(&child);
        lines.for_each(|line| said += &format!("{}\n", line.unwrap()));
        assert_eq!(child.wait().unwrap().code(), Some(130), "{said}");
        assert!(said.contains("ended by the user; the bridge is off. `--from plant` goes on"), "{said}");
        assert!(!said.contains(not), "{said}");
        status_once(|status| status["state"] == "Switch on disabled" && status["moving"] == false);
        assert!(std::fs::read_to_string(report).unwrap().contains("Ended at plant: ended by the user"));
        assert_eq!(json("params get command_timeout_s")["command_timeout_s"], 0.0);
    }
    let noise_m = std::fs::read_to_string(report.with_extension("json")).unwrap();
    assert!(serde_json::from_str::<Value>(&noise_m).unwrap()["noise_m"].is_f64(), "kept from the first run: {noise_m}");
    refused(
        &format!("commission --output {} --from niasa", report.display()),
        &["sigma is not known: begin with the step that finds it"],
    );
    done("params load");
}

fn ctrl_c_stops_the_motion_first() {
    let (mut child, mut said) = under_way(command("move 45mm --velocity 2mm/s"));
    interrupt(&child);
    let mut rest = String::new();
    said.read_to_string(&mut rest).unwrap();
    assert_eq!(child.wait().unwrap().code(), Some(130), "{rest}");
    assert!(rest.contains("braking") && rest.contains("stopped at"), "{rest}");
    let status = json("status");
    assert_eq!((&status["moving"], &status["state"]), (&Value::from(false), &Value::from("Operation enabled")));
    assert!(status["position_m"].as_f64().unwrap() < 0.044, "{status}");
}

fn a_second_client_is_told_why() {
    let (mut first, line) = first_line(command("watch position --json -"));
    let line: Value = serde_json::from_str(&line).unwrap();
    assert!(line["position_mm"].is_f64(), "{line}");
    refused("status", &["serves another client (one at a time)"]);
    interrupt(&first);
    first.wait().unwrap();
    json("status");
}

fn a_fault_is_explained_and_its_ticks_computed_again(file: &Path) {
    done("params set following_error_max_m 2um");
    refused("move 0mm --acceleration 10m/s2", &["fault 7: following error", "`servoctl faults`"]);
    refused("enable", &["state: Fault", "`servoctl faults clear`"]);
    assert_eq!(json("faults")["fault"], 7);
    let text = done(&format!("faults blackbox -o {}", file.display()));
    assert!(text.starts_with("fault 7: following error") && text.contains("bridge off, fault 7"), "{text}");
    let told = json("faults blackbox");
    let ticks = told["ticks_before"].as_u64().unwrap() + told["ticks_from_it_on"].as_u64().unwrap();
    assert!(told["replayed_ticks"].as_u64().unwrap() > 500, "{told}");
    let (head, rows) = head(file);
    assert!(head.contains("# trigger: fault 7 at tick"), "{head}");
    assert_eq!(rows.len() as u64, ticks + 1);
    done("params load");
    assert_eq!(json("faults clear")["fault"], Value::Null);
}

/// A pulled cable as the drive sees it: in mid-move nothing more comes.
fn a_host_that_dies_in_mid_move_ends_it() {
    done("params set command_timeout_s 200ms");
    // A host that only waits for the end of its move is there.
    json("move 1mm --relative --velocity 1mm/s");
    let (mut child, _said) = under_way(command("move -40mm --velocity 1mm/s"));
    child.kill().unwrap();
    child.wait().unwrap();
    fault_within(19);
    assert_eq!(json("status")["moving"], false);
    json("faults clear");
}
