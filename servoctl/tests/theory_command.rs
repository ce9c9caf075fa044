//! `servoctl theory` as a person or a program calls it.

use serde_json::Value;
use std::process::{Command, Output};

fn theory(arguments: &str) -> Output {
    let servoctl = env!("CARGO_BIN_EXE_servoctl");
    Command::new(servoctl).arg("theory").args(arguments.split_whitespace()).output().unwrap()
}

#[track_caller]
fn json(arguments: &str) -> Value {
    let output = theory(arguments);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    serde_json::from_slice(&output.stdout).unwrap()
}

fn keys(value: &Value) -> Vec<&str> {
    let mut keys: Vec<&str> = value.as_object().unwrap().keys().map(String::as_str).collect();
    keys.sort_unstable();
    keys
}

const THESIS: &str = "--mass 1.5 --kp 900000 --kd 850 --sigma 8.46e6 --coulomb 0.6 --inv-tau-d 240 --r 35.461e-9";

#[test]
fn massless_json_has_exactly_three_fields() {
    let stable = json("massless --method niasa --kp-ratio 0.05 --e0 0.5 --delta 1 --json -");
    assert_eq!(keys(&stable), ["change_percent", "settling_time_tau", "stable"]);
    assert_eq!(stable["stable"], true);
    assert!(stable["settling_time_tau"].as_f64().unwrap() > 3.912);
    let unstable = json("massless --method observer --kp-ratio 0.05 --e0 0.5 --delta -0.1 --json -");
    assert_eq!(unstable, serde_json::json!({"stable": false, "settling_time_tau": null, "change_percent": null}));
}

#[test]
fn mass_json_has_verdict_times_and_a_trace_that_shows_them() {
    let settled = json(&format!("mass --method niasa {THESIS} --delta -0.5 --json -"));
    assert_eq!(keys(&settled), ["error_m", "peak_after_crossing", "settling_time_ms", "time_ms", "verdict"]);
    assert_eq!(settled["verdict"], "settles");
    let numbers =
        |name: &str| -> Vec<f64> { settled[name].as_array().unwrap().iter().map(|v| v.as_f64().unwrap()).collect() };
    let (time_ms, error_m) = (numbers("time_ms"), numbers("error_m"));
    assert_eq!((time_ms.len(), time_ms[0], error_m[0]), (error_m.len(), 0.0, 35.461e-9));
    let last_outside = error_m.iter().rposition(|e| e.abs() > 0.02 * 35.461e-9).unwrap();
    let settling_ms = settled["settling_time_ms"].as_f64().unwrap();
    assert!(time_ms[last_outside] <= settling_ms && settling_ms <= time_ms[last_outside + 1]);
    let crossing = error_m.iter().position(|&e| e <= 0.0).unwrap();
    let peak = error_m[crossing..].iter().fold(0.0f64, |peak, e| peak.max(e.abs())) / 35.461e-9;
    assert!((peak / settled["peak_after_crossing"].as_f64().unwrap() - 1.0).abs() < 0.01);

    let swinging = json(&format!("mass --method observer {THESIS} --delta -0.1 --json -"));
    assert_eq!(swinging["verdict"], "limit_cycle");
    assert_eq!(swinging["settling_time_ms"], Value::Null);
}

#[test]
fn the_defaults_are_the_thesis_system() {
    let arguments = "mass --method niasa --delta 0.25 --json -";
    assert_eq!(json(arguments), json(&format!("{arguments} {THESIS}")));
}

#[test]
fn without_json_there_is_a_short_table() {
    let output = theory("massless --method observer --kp-ratio 0.05 --e0 0.05 --delta 1");
    let text = String::from_utf8(output.stdout).unwrap();
    assert!(text.contains("settling time to 2 % of e0") && text.contains("1785.8 %"), "{text}");
    let text = String::from_utf8(theory("mass --method observer --delta -0.1").stdout).unwrap();
    assert!(text.contains("limit cycle") && text.lines().all(|line| line.chars().count() <= 100), "{text}");
}

#[test]
fn json_can_go_to_a_file_beside_the_table() {
    let file = std::path::Path::new(env!("CARGO_TARGET_TMPDIR")).join("theory.json");
    let output = theory(&format!("massless --method niasa --kp-ratio 1 --e0 1 --delta 0 --json {}", file.display()));
    assert!(String::from_utf8(output.stdout).unwrap().contains("3.912 τ_d"));
    let written: Value = serde_json::from_str(&std::fs::read_to_string(file).unwrap()).unwrap();
    assert_eq!(written["stable"], true);
}

#[test]
fn a_refusal_names_option_value_and_range() {
    for (arguments, expected) in [
        ("massless --method niasa --kp-ratio 0 --e0 1", "kp-ratio = 0 is outside 0.001 to 1000"),
        ("massless --method niasa --kp-ratio 1 --e0 nan", "e0 = NaN is outside 1e-6 to 10 x_c"),
        ("mass --method niasa --delta -1", "delta = -1 is outside -0.99 to 10"),
        ("mass --method niasa --r 1", "r = 1 is outside 1e-12 to 0.01 m"),
        ("mass --method niasa --duration-ms -3", "duration-ms = -3 is outside 0.001 to 1000000 ms"),
        ("massless --method niasa --kp-ratio one --e0 1", "'one' for '--kp-ratio <K>'"),
        ("massless --method pid --kp-ratio 1 --e0 1", "[possible values: observer, niasa]"),
        ("massless --method niasa --kp-ratio 1 --e0 1 --json no/such/folder/x.json", "no/such/folder/x.json"),
    ] {
        let output = theory(arguments);
        let error = String::from_utf8(output.stderr).unwrap();
        assert!(!output.status.success() && output.stdout.is_empty(), "{arguments}");
        assert!(error.contains(expected), "{arguments}: {error}");
    }
}
