//! Sine and cosine: a drive of its own, after the other.

use serde_json::Value;

use crate::{done, json, refused};

pub fn an_encoder_without_sine_and_cosine_is_not_calibrated() {
    refused("calibrate-encoder", &["refused CollectSignals", "no sine and cosine", "encoder_kind"]);
    assert_eq!(json("status")["subdivisional_error_m"], Value::Null);
}

/// Another drive, from its data sheets to stored corrections.
pub fn sine_and_cosine_are_calibrated() {
    let stage = concat!(env!("CARGO_MANIFEST_DIR"), "/../sim/stages/sin-cos.toml");
    done(&format!("virtual --stage {stage}"));
    for (name, of_a_data_sheet) in
        [("sincos_cos_offset", 0), ("sincos_sin_offset", 0), ("sincos_gain", 1), ("sincos_phase_rad", 0)]
    {
        done(&format!("params set {name} {of_a_data_sheet}"));
    }
    refused("calibrate-encoder", &["refused Enable", "not aligned", "`servoctl align`"]);
    done("align");
    let found = json("calibrate-encoder");
    let off = |name: &str, value: f64| (found[name].as_f64().unwrap() - value).abs();
    for (name, value) in
        [("sincos_cos_offset", 0.02), ("sincos_sin_offset", -0.02), ("sincos_gain", 1.02), ("sincos_phase_rad", 0.0349)]
    {
        assert!(off(name, value) < 1e-3, "{found}");
    }
    assert!(found["error_after_m"].as_f64().unwrap() < 0.3e-9, "{found}");
    let text = done("status");
    assert!(text.contains("sub-divisional error") && text.contains(" pm"), "{text}");
    done("disable");
    done("params save");
    json("restart");
    assert_eq!(json("params get sincos_gain")["sincos_gain"], found["sincos_gain"]);
}
