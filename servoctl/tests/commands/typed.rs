//! Commands that need no story of their own, on the same drive.

use std::io::{BufRead, Read};
use std::os::unix::fs::PermissionsExt;
use std::path::Path;
use std::process::{Command, Stdio};
use std::thread;
use std::time::{Duration, Instant};

use object::{Object, ObjectSection};
use serde_json::{Value, json};
use servo_protocol::message::{PROTOCOL, VIRTUAL_SERIAL};
use servoctl::link::virtual_drive;
use servoctl::program;

use crate::{
    at, command, done, done_by, head, interrupt, json, program as typed, refused, refused_by, status_once, under_way,
};

/// Where this process has the firmware.
fn elf() -> String {
    std::env::var(virtual_drive::ELF).unwrap()
}

pub fn the_drive_says_who_it_is() {
    let info = json("info");
    assert_eq!(
        (&info["board"], &info["simulated"], &info["protocol"]),
        (&json!("NUCLEO-H743ZI2"), &json!(true), &PROTOCOL.into())
    );
    assert_eq!(info["serial"], VIRTUAL_SERIAL.map(|word| format!("{word:08x}")).concat());
    let text = done("info");
    for part in ["NUCLEO-H743ZI2, virtual: motor and stage are simulated", "protocol ", "parameters  save "] {
        assert!(text.contains(part), "{part} in\n{text}");
    }
}

pub fn the_log_is_read_with_the_elf_that_is_on_the_drive(directory: &Path) {
    let log = done("log");
    assert!(log.contains("servo-firmware") && log.contains("OperationEnabled"), "{log}");
    let runs = json("info")["program"].as_str().unwrap().to_owned();
    assert_eq!(format!("{:016x}", program::fingerprint(elf().as_ref()).unwrap().0), runs);
    assert!(done(&format!("log --elf {}", elf())).contains("servo-firmware"));
    // Another program: one bit of a vector.
    let mut bytes = std::fs::read(elf()).unwrap();
    let file = object::File::parse(&bytes[..]).unwrap();
    let (vectors, _) = file.section_by_name(".vector_table").unwrap().file_range().unwrap();
    bytes[vectors as usize + 4] ^= 0x40;
    let other = directory.join("other.elf");
    std::fs::write(&other, bytes).unwrap();
    let named = format!("{:016x}", program::fingerprint(&other).unwrap().0);
    assert_ne!(named, runs);
    refused(&format!("log --elf {}", other.display()), &[&named, &runs, "cargo xtask flash"]);
}

/// A board's log comes by its probe, which probe-rs reads: here a program of that name that says what it was asked.
pub fn the_log_of_a_board_is_read_by_probe_rs(directory: &Path) {
    let path = directory.join("path");
    std::fs::create_dir(&path).unwrap();
    let log = || {
        let mut log = at("/dev/no-such-board", &format!("log --elf {} --json -", elf()));
        log.env("PATH", &path);
        log
    };
    refused_by(log(), &["not compared with what is on the drive: /dev/no-such-board", "cargo install probe-rs-tools"]);
    let probe = path.join("probe-rs");
    std::fs::write(&probe, "#!/bin/sh\necho \"$@\"\necho a line of the log\n").unwrap();
    std::fs::set_permissions(&probe, PermissionsExt::from_mode(0o755)).unwrap();
    let said = done_by(log());
    let lines: Vec<Value> = said.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    let asked = format!("attach --chip STM32H743ZITx {}", elf());
    assert_eq!(lines, [json!({ "line": asked }), json!({ "line": "a line of the log" })]);
}

pub fn parameters_go_to_a_file_and_come_back(directory: &Path) {
    let file = directory.join("mine.toml");
    let (mine, rest) = (file.display().to_string(), directory.join("rest.toml"));
    done("params set niasa_time_constant_s 15ms");
    assert!(done(&format!("params dump -o {mine}")).contains("parameters"));
    assert_eq!(done(&format!("params diff {mine}")), "no difference\n");
    // Bridge off: the parameters of a new drive are others that cannot change with torque on.
    json("enable");
    refused("params reset", &["refused ResetParameters", "state: Operation enabled", "`servoctl disable`"]);
    json("disable");
    assert_eq!(json("params reset"), json!({ "loaded": "defaults" }));
    assert_eq!(json("params diff"), json!({}));
    let differ = json(&format!("params diff {mine}"));
    assert_eq!(differ["niasa_time_constant_s"], json!({ "drive": 0.01, "other": 0.015 }));
    assert!(done(&format!("params diff {mine}")).contains("niasa_time_constant_s"));
    let changed = json(&format!("params load {mine}"))["changed"].as_u64().unwrap();
    assert_eq!(changed as usize, differ.as_object().unwrap().len());
    assert_eq!(json("params get niasa_time_constant_s")["niasa_time_constant_s"], 0.015);
    // Nothing of a file with a mistake is taken.
    std::fs::write(&rest, "niasa_time_constant_s = \"20 ms\"\ncompensator = 77\n").unwrap();
    refused(&format!("params load {}", rest.display()), &["rest.toml", "compensator = 77 is outside 0 … "]);
    assert_eq!(json("params get niasa_time_constant_s")["niasa_time_constant_s"], 0.015);
    done("params load");
    assert!(json("params list").as_object().unwrap().len() > 50);
    assert_eq!(json("params get niasa_time_constant_s")["niasa_time_constant_s"], 0.02, "the saved one");
}

pub fn a_stream_is_written_without_a_loss(directory: &Path) {
    let file = directory.join("live.csv");
    let told = json(&format!("stream --length 500ms -o {}", file.display()));
    let samples = told["samples"].as_u64().unwrap();
    assert_eq!((&told["lost_samples"], &told["lost_blocks"]), (&0.into(), &0.into()), "{told}");
    assert!((4000..4100).contains(&samples), "{told}");
    let (text, rows) = head(&file);
    for part in ["NUCLEO-H743ZI2, simulated", "# rate 8000 Hz", "# trigger: none; 0 samples lost"] {
        assert!(text.contains(part), "{part} in\n{text}");
    }
    assert_eq!(rows.len() as u64, samples + 1);
    assert!(rows[1].starts_with("0,") && rows[2].starts_with("0.000125,"), "{} {}", rows[1], rows[2]);
    // Blocks that are further apart than any answer.
    let signals =
        "tick,error_ct,position_low_ct,position_high_ct,force_n,iq_a,bus_v,friction_n,slope_n_per_m,integral_n";
    let told = json(&format!("stream --signals {signals} --every 800 --length 500ms -o {}", file.display()));
    assert_eq!((&told["lost_samples"], told["samples"].as_u64().unwrap() >= 5), (&0.into(), true), "{told}");
    refused("stream --every 0 -o /dev/null", &["--every 0: it must be between 1 and 8000"]);
}

pub fn a_sequence_reports_what_it_has_done_however_it_ends(directory: &Path) {
    let file = directory.join("moves.txt");
    let sequence = |text: &str| {
        std::fs::write(&file, text).unwrap();
        format!("sequence {}", file.display())
    };
    let lines = |text: &str| text.lines().map(|line| serde_json::from_str(line).unwrap()).collect::<Vec<Value>>();
    let whole = sequence("enable\nmove 0mm\nset compensator 1\nwait 20ms\nmove 1mm # settles with NIASA\ndisable\n");
    let moves = lines(&done(&format!("{whole} --json -")));
    let targets: Vec<f64> = moves.iter().map(|moved| moved["target_m"].as_f64().unwrap()).collect();
    assert!(targets.len() == 2 && targets[0] == 0.0 && (targets[1] - 1e-3).abs() < 1e-9, "{moves:?}");
    assert_eq!((&moves[1]["compensator"], &moves[1]["simulated"]), (&1.0.into(), &true.into()));
    assert!(moves[1]["settling"]["in_position_rms_nm"].is_f64());
    json("params set compensator 0");

    let refused_in_line_2 = sequence("move 0mm\nmove 80mm\nmove 1mm\n");
    let says = ["moves.txt, line 2", "target = 0.08", "is outside", "state: Operation enabled"];
    let moves = lines(&refused(&format!("{refused_in_line_2} --json -"), &says));
    assert_eq!((moves.len(), &moves[0]["target_m"]), (1, &0.0.into()));
    assert!(refused(&refused_in_line_2, &says).contains("±3 nm"), "in words as well");

    let interrupted = sequence("move 0mm\nmove 40mm --velocity 2mm/s\nmove 0mm\n");
    let mut slow = command(&interrupted);
    slow.args(["--json", "-"]);
    let (mut child, mut said) = under_way(slow);
    let mut line = String::new();
    while !line.starts_with("moving to 40") {
        line.clear();
        assert!(said.read_line(&mut line).unwrap() > 0, "it ended before the second move");
    }
    interrupt(&child);
    let mut out = String::new();
    child.stdout.take().unwrap().read_to_string(&mut out).unwrap();
    assert_eq!(child.wait().unwrap().code(), Some(130));
    assert_eq!(lines(&out).len(), 1, "{out}");
    let status = json("status");
    assert!(status["moving"] == false && status["position_m"].as_f64().unwrap() < 0.03, "{status}");
}

/// Whoever began the move has gone, the drive goes on.
pub fn what_moves_is_stopped() {
    let (mut child, _said) = under_way(command("move 45mm --velocity 2mm/s"));
    child.kill().unwrap();
    child.wait().unwrap();
    status_once(|status| status["moving"] == true);
    let stopped = json("stop");
    assert_eq!((&stopped["moving"], &stopped["state"]), (&false.into(), &"Operation enabled".into()));
    assert!(json("status")["position_m"].as_f64().unwrap() < 0.044);
}

/// As a master of CiA 402 does, and what the drive tells it.
pub fn a_master_walks_through_the_states_and_halts() {
    done("disable");
    for (word, state) in [
        ("0x06", "Ready to switch on"),
        ("0x07", "Switched on"),
        ("0x0f", "Operation enabled"),
        ("0x07", "Switched on"),
        ("0x0f", "Operation enabled"),
    ] {
        done(&format!("control {word}"));
        status_once(|status| status["state"] == state);
    }
    let word = json("status")["status_word"].as_u64().unwrap();
    assert_eq!(word & 0b0110_1111, 0b0010_0111, "{word:#06x}");
    let (mut child, _said) = under_way(command("move 5mm --velocity 1mm/s"));
    child.kill().unwrap();
    child.wait().unwrap();
    status_once(|status| status["moving"] == true);
    json("control 0x10f");
    status_once(|status| status["moving"] == false);
    refused("move 1mm", &["refused Move", "halt bit", "Operation enabled", "`servoctl control 0x0f`"]);
    assert!(done("control 0x0f").contains("statusword  0x"));
    done("move 1mm");
    // Quick stop brakes and ends with the bridge off.
    done("control 0x02");
    status_once(|status| status["state"] == "Switch on disabled");
    done("enable");
}

/// A drive that was killed cannot take its state file away: the next program does.
pub fn a_killed_drive_is_not_in_the_way(directory: &Path) {
    let state = directory.join("state");
    let mut drive = Command::new(std::env::var(virtual_drive::PROGRAM).unwrap());
    drive.arg("--state").arg(&state).stdout(Stdio::null());
    let mut drive = drive.spawn().unwrap();
    let mine = |link: &[&str], words: &str| {
        let mut command = typed(link, words);
        command.env(virtual_drive::STATE, &state);
        command
    };
    let begun = Instant::now();
    while !state.exists() {
        assert!(begun.elapsed() < Duration::from_secs(120), "no drive");
        thread::sleep(Duration::from_millis(20));
    }
    assert!(done_by(mine(&[], "info")).contains("virtual"), "a single drive is found");
    drive.kill().unwrap();
    drive.wait().unwrap();
    assert!(state.exists(), "killed: nobody has taken it away");
    refused_by(mine(&[], "info"), &["no drive found", "--virtual"]);
    assert!(!state.exists());
}

#[test]
fn a_virtual_drive_listens_elsewhere_only_if_somebody_says_so() {
    let directory = tempfile::tempdir().unwrap();
    let mut command = typed(&[], "virtual --listen 0.0.0.0:0");
    command.env(virtual_drive::STATE, directory.path().join("state"));
    refused_by(command, &["--listen 0.0.0.0:0: other computers can reach this address", "--any-address"]);
    let help = done_by(typed(&[], "virtual --help"));
    assert!(help.contains("--any-address"), "{help}");
}
