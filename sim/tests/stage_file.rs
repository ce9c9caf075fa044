//! Stage files: the two that come with the crate, and every way to get one wrong.

use servo_sim::stage::{BUILT_IN_TOML, FrictionModel};
use servo_sim::{Stage, StageError};

#[test]
fn the_built_in_stage_is_the_published_one() {
    let stage = Stage::default();
    assert_eq!((stage.mechanics.mass_kg, stage.mechanics.travel_m), (1.8, 0.1));
    assert_eq!((stage.friction.model, stage.friction.elements), (FrictionModel::MaxwellSlip, 12));
    assert_eq!((stage.friction.stiffness_n_per_m, stage.friction.coulomb_n), (8.66e6, 0.64));
    assert_eq!(stage.encoder.count_m, 4e-6 / 65_536.0);
    assert_eq!((stage.encoder.noise_m_rms, stage.adc.noise_lsb_rms), (0.44e-9, 1.0));
}

#[test]
fn the_second_stage_is_lighter_stiffer_and_constant() {
    let stage = Stage::from_toml(include_str!("../stages/light-stiff.toml")).unwrap();
    assert_eq!(stage.mechanics.mass_kg, 1.2);
    assert_eq!((stage.friction.stiffness_n_per_m, stage.friction.coulomb_n), (14e6, 0.9));
    assert_eq!(stage.friction.spread, None);
}

/// The built-in file with the line that starts with `key` replaced, and the number of that line.
fn edited(key: &str, replacement: &str) -> (String, usize) {
    let number = 1 + BUILT_IN_TOML.lines().position(|line| line.starts_with(key)).unwrap();
    let lines = BUILT_IN_TOML.lines().map(|line| if line.starts_with(key) { replacement } else { line });
    (lines.collect::<Vec<_>>().join("\n"), number)
}

#[test]
fn a_value_out_of_range_is_refused_with_line_key_value_and_range() {
    for (key, replacement, expected_key, expected_value, expected_range) in [
        ("mass_kg", "mass_kg = -1.8 # light", "mechanics.mass_kg", "-1.8", "0.01 to 1000.0"),
        ("mass_kg", "mass_kg = nan", "mechanics.mass_kg", "nan", "0.01 to 1000.0"),
        ("travel_m", "travel_m = inf", "mechanics.travel_m", "inf", "1e-6 to 10.0"),
        ("viscous", "viscous_n_s_per_m = -0.1", "mechanics.viscous_n_s_per_m", "-0.1", "0.0 to 10000.0"),
        ("elements", "elements = 33", "friction.elements", "33", "1.0 to 32.0"),
        ("elements", "elements = 0", "friction.elements", "0", "1.0 to 32.0"),
        // Half of 1.8 kg at a tenth of a radian per 6.25 µs.
        ("stiffness_n", "stiffness_n_per_m = 3e8", "friction.stiffness_n_per_m", "3e8", "1.0 to 230400000.0"),
        ("coulomb_n", "coulomb_n = 0", "friction.coulomb_n", "0", "1e-6 to 10000.0"),
        (
            "stiffness_min",
            "stiffness_min_n_per_m = 9.0e6",
            "friction.spread.stiffness_min_n_per_m",
            "9.0e6",
            "1.0 to 8660000.0",
        ),
        ("coulomb_max", "coulomb_max_n = 0.5", "friction.spread.coulomb_max_n", "0.5", "0.64 to 10000.0"),
        ("force_constant", "force_constant_n_per_a = 0.0", "motor.force_constant_n_per_a", "0.0", "0.01 to 1000.0"),
        ("inductance", "inductance_h = 0", "motor.inductance_h", "0", "1e-5 to 1.0"),
        ("bus_v", "bus_v = 48000", "amplifier.bus_v", "48000", "1.0 to 1000.0"),
        ("dead_time_s", "dead_time_s = 20e-6", "amplifier.dead_time_s", "20e-6", "0.0 to 1.25e-5"),
        (
            "temperature_full",
            "temperature_full_scale_c = -60",
            "adc.temperature_full_scale_c",
            "-60",
            "-49.0 to 1000.0",
        ),
        ("acknowledge", "acknowledge_bits = 21", "encoder.acknowledge_bits", "21", "1.0 to 20.0"),
    ] {
        let (text, line) = edited(key, replacement);
        let expected = StageError::OutOfRange {
            line,
            key: expected_key,
            value: expected_value.to_string(),
            range: expected_range.to_string(),
        };
        assert_eq!(Stage::from_toml(&text), Err(expected));
    }
}

#[test]
fn counts_too_fine_for_the_travel_are_refused() {
    let (text, line) = edited("count_m", "count_m = 1e-12");
    let message = Stage::from_toml(&text).unwrap_err().to_string();
    assert!(message.starts_with(&format!("line {line}: encoder.count_m = 1e-12 is outside 2.328")), "{message}");
}

#[test]
fn what_does_not_fit_the_format_is_refused_with_its_line() {
    for (key, replacement, expected) in [
        ("mass_kg", "mass_kg = \"heavy\"", "mechanics.mass_kg: invalid type: string \"heavy\", expected f64"),
        ("elements", "elements = 12.5", "friction.elements: invalid type: floating point `12.5`, expected usize"),
        ("elements", "elements = -1", "friction.elements: invalid value: integer `-1`, expected usize"),
        ("model", "model = \"lugre\"", "friction.model: unknown variant `lugre`, expected `maxwell-slip` or `dahl`"),
        ("resistance", "resistance = 3.0", "unknown field `resistance`, expected one of"),
        ("coulomb_std", "coulomb_sd_n = 0.18", "unknown field `coulomb_sd_n`"),
        ("bus_v", "bus_v = 48 V", "string values must be quoted"),
        ("dead_time_s", "pwm_hz = 1e4", "duplicate key"),
    ] {
        let (text, line) = edited(key, replacement);
        let message = Stage::from_toml(&text).unwrap_err().to_string();
        assert!(
            message.starts_with(&format!("line {line}: ")) && message.contains(expected),
            "{replacement}: {message}"
        );
    }
}

#[test]
fn what_is_missing_is_named() {
    let (text, _) = edited("inductance", "");
    let message = Stage::from_toml(&text).unwrap_err().to_string();
    let table = 1 + BUILT_IN_TOML.lines().position(|line| line == "[motor]").unwrap();
    assert_eq!(message, format!("line {table}: missing field `inductance_h`"));
    assert_eq!(Stage::from_toml("").unwrap_err().to_string(), "line 1: missing field `mechanics`");
}

#[test]
fn integers_are_numbers_and_the_number_of_elements_has_a_default() {
    let (text, _) = edited("mass_kg", "mass_kg = 2");
    assert_eq!(Stage::from_toml(&text).unwrap().mechanics.mass_kg, 2.0);
    let (text, _) = edited("elements", "");
    assert_eq!(Stage::from_toml(&text), Ok(Stage::default()));
}
