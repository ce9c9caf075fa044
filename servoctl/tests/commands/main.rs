//! The program as a person types it, in front of the firmware's ELF on the virtual board: one drive, one story.
//!
//! Needs the virtual drive: `cargo xtask test --only commands` builds it and says where it is.
#![cfg(unix)]

mod cable;
mod typed;

use std::io::{BufRead, BufReader, Read};
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
    ctrl_c_stops_the_motion_first();
    a_second_client_is_told_why();
    cable::a_second_client_of_a_serial_port_is_told_why(&drive);
    a_fault_is_explained_and_its_ticks_computed_again(&directory.path().join("black-box.csv"));
    a_host_that_dies_in_mid_move_ends_it();
    cable::a_pulled_cable_is_reported_within_a_second_and_ends_the_move(&drive);
    typed::a_killed_drive_is_not_in_the_way(directory.path());
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
