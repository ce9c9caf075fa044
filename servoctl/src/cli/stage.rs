//! The stage file of `--stage`: read, and checked for what the experiments ask of a stage.

use std::path::Path;

use anyhow::{Result, anyhow};
use servo_core::parameters::{Parameter, Settings};
use servo_core::refusal::{Field, Refusal};
use servo_host_tests::tuning::{self, STANDARD};
use servo_sim::Stage;
use servo_sim::stage::StageError;

use crate::reproduce::experiments::FIVE_MM_SLOW;

/// The stage file, or the built-in one; `least_travel_m` is what will be done with it.
///
/// # Errors
/// A file that cannot be read, or is wrong: with line, key, value and range; a stage that the drive's parameters cannot describe, too
/// short for the motion or too heavy for its motor.
pub fn read_stage(file: Option<&Path>, least_travel_m: f64) -> Result<Stage> {
    let Some(file) = file else { return Ok(Stage::default()) };
    let read = || checked(&std::fs::read_to_string(file)?, least_travel_m);
    read().map_err(|error: anyhow::Error| error.context(format!("--stage {}", file.display())))
}

fn checked(text: &str, least_travel_m: f64) -> Result<Stage> {
    let stage = Stage::from_toml(text)?;
    if stage.friction.stiffness_n_per_m == 0.0 {
        return Err(without_stiffness(text).into());
    }
    let settings = tuning::uncalibrated(&stage, &STANDARD).map_err(|refusal| of_the_file(&stage, text, refusal))?;
    let travel_m = stage.mechanics.travel_m;
    if travel_m < least_travel_m {
        return Err(Stage::out_of_range(text, "mechanics.travel_m", travel_m, least_travel_m, 10.0).into());
    }
    check_force(&stage, text, &settings)?;
    Ok(stage)
}

/// Neither tuning nor NIASA know what to do with a contact that is no spring.
fn without_stiffness(text: &str) -> StageError {
    match Stage::out_of_range(text, "friction.model", 0.0, 0.0, 0.0) {
        StageError::OutOfRange { line, key, value, .. } => {
            let range = "the models with a stiffness: maxwell-slip, gms, dahl, lugre".to_owned();
            StageError::OutOfRange { line, key, value, range }
        }
        other => other,
    }
}

/// What the drive refuses, said of the key that its parameter is set from, in a constant proportion.
fn of_the_file(stage: &Stage, text: &str, refusal: Refusal) -> anyhow::Error {
    let Refusal::OutOfRange { field: Field::Parameter(id), value, min, max } = refusal else { return refusal.into() };
    let Some((key, given)) = Parameter::by_id(id).and_then(|parameter| origin(stage, parameter.name)) else {
        return refusal.into();
    };
    let of_key = |limit: f64| if given == value { limit } else { shortened(limit / value * given) };
    let (from, to) = if value * given < 0.0 { (max, min) } else { (min, max) };
    let (from, to) = (of_key(from), of_key(to));
    // What is a size has no negative part of its range.
    let from = if given == value { from } else { from.max(0.0) };
    anyhow!(refusal).context(Stage::out_of_range(text, key, given, from, to))
}

/// Key and value of the stage file that a parameter of [`tuning::uncalibrated`] is proportional to.
fn origin(stage: &Stage, parameter: &str) -> Option<(&'static str, f64)> {
    let Stage { mechanics, friction, motor, amplifier, adc, encoder } = stage;
    Some(match parameter {
        "travel_min_m" | "travel_max_m" => ("mechanics.travel_m", mechanics.travel_m),
        "friction_viscous_n_s_per_m" => ("mechanics.viscous_n_s_per_m", mechanics.viscous_n_s_per_m),
        "disturbance_mass_kg" => ("mechanics.mass_kg", mechanics.mass_kg),
        "niasa_stiffness_n_per_m" | "friction_stiffness_n_per_m" => {
            ("friction.stiffness_n_per_m", friction.stiffness_n_per_m)
        }
        "niasa_coulomb_n" | "niasa_rate_limit_n" | "friction_coulomb_n" => ("friction.coulomb_n", friction.coulomb_n),
        "friction_damping_n_s_per_m" => ("friction.damping_n_s_per_m", friction.damping_n_s_per_m),
        "friction_static_n" => ("friction.static_n", friction.static_n?),
        "friction_stribeck_m_per_s" => ("friction.stribeck_m_per_s", friction.stribeck_m_per_s?),
        "force_constant_n_per_a" => ("motor.force_constant_n_per_a", motor.force_constant_n_per_a),
        "phase_resistance_ohm" => ("motor.resistance_ohm", motor.resistance_ohm),
        "phase_inductance_h" => ("motor.inductance_h", motor.inductance_h),
        "magnet_pitch_m" => ("motor.magnet_pitch_m", motor.magnet_pitch_m),
        "commutation_offset_m" => ("motor.commutation_offset_m", motor.commutation_offset_m),
        "bus_min_v" | "bus_max_v" => ("amplifier.bus_v", amplifier.bus_v),
        "current_full_scale_a" | "current_limit_a" | "over_current_a" | "continuous_current_a" => {
            ("amplifier.full_scale_a", amplifier.full_scale_a)
        }
        "dead_time_s" => ("amplifier.dead_time_s", amplifier.dead_time_s),
        "dead_time_band_a" => ("amplifier.dead_time_band_a", amplifier.dead_time_band_a),
        "bus_full_scale_v" => ("adc.bus_full_scale_v", adc.bus_full_scale_v),
        "temperature_zero_c" => ("adc.temperature_zero_c", adc.temperature_zero_c),
        "temperature_full_scale_c" => ("adc.temperature_full_scale_c", adc.temperature_full_scale_c),
        "encoder_count_m" => ("encoder.count_m", encoder.count_m),
        _ => return None,
    })
}

/// Six significant digits.
fn shortened(value: f64) -> f64 {
    format!("{value:.5e}").parse().unwrap_or(value)
}

/// Every experiment moves at 1 m/s², or begins with such a move. A drive that cannot ends with a following error, which tells a person
/// less than this. The mass is what is too large, unless friction alone takes more than the motor has: then that is too weak.
fn check_force(stage: &Stage, text: &str, settings: &Settings) -> Result<()> {
    const LEAST_KG: f64 = 0.01;
    const MOST_N_PER_A: f64 = 1000.0;
    let (mechanics, friction) = (&stage.mechanics, &stage.friction);
    let acceleration_m_per_s2 = FIVE_MM_SLOW.acceleration_m_per_s2;
    let peak_m_per_s = libm::sqrt(acceleration_m_per_s2 * FIVE_MM_SLOW.step_m);
    let friction_n = mechanics.viscous_n_s_per_m * peak_m_per_s + friction.static_n.unwrap_or(friction.coulomb_n);
    let needed_n = mechanics.mass_kg * acceleration_m_per_s2 + friction_n;
    let force_constant_n_per_a = settings.force_constant_n_per_a;
    let given_n = settings.current_limit_a * force_constant_n_per_a;
    if needed_n <= given_n {
        return Ok(());
    }
    let most_kg = libm::floor((given_n - friction_n) / acceleration_m_per_s2 * 1e3) * 1e-3;
    let least_n_per_a = libm::ceil(needed_n / settings.current_limit_a * 1e3) * 1e-3;
    let refused = if most_kg >= LEAST_KG {
        Stage::out_of_range(text, "mechanics.mass_kg", mechanics.mass_kg, LEAST_KG, most_kg)
    } else {
        Stage::out_of_range(text, "motor.force_constant_n_per_a", force_constant_n_per_a, least_n_per_a, MOST_N_PER_A)
    };
    Err(anyhow!(
        "{} kg with {friction_n:.1} N of friction take {needed_n:.1} N at {acceleration_m_per_s2} m/s²; motor.force_constant_n_per_a and \
         amplifier.full_scale_a give {given_n:.1} N",
        mechanics.mass_kg
    )
    .context(refused))
}

#[cfg(test)]
mod tests {
    use servo_sim::stage::BUILT_IN_TOML;

    use super::checked;

    /// What is said of the built-in file with one line of it changed, and how what is said must begin.
    fn refused(from: &str, to: &str) -> (String, String) {
        let text = BUILT_IN_TOML.replace(from, to);
        assert_ne!(text, BUILT_IN_TOML, "{from}");
        let line = 1 + text.lines().position(|line| line.starts_with(to)).unwrap();
        (format!("{:#}", checked(&text, 0.025).unwrap_err()), format!("line {line}: "))
    }

    #[test]
    fn a_stage_too_heavy_for_its_motor_is_refused_with_line_key_value_range_and_both_forces() {
        assert!(checked(BUILT_IN_TOML, 0.025).is_ok());
        let (heavy, line) = refused("mass_kg = 1.8", "mass_kg = 100");
        assert!(heavy.starts_with(&(line + "mechanics.mass_kg = 100 is outside 0.01 to 61.7")), "{heavy}");
        assert!(heavy.contains("take 100.6 N at 1 m/s²") && heavy.ends_with("give 62.4 N"), "{heavy}");
        // 1.8 kg and 0.6 N are nothing beside a drag of 1,000 N·s/m at 0.07 m/s.
        let (dragged, _) = refused("viscous_n_s_per_m = 0.0", "viscous_n_s_per_m = 1000.0");
        assert!(dragged.contains("motor.force_constant_n_per_a = 7.8 is outside 9.1"), "{dragged}");
    }

    #[test]
    fn what_the_drive_cannot_be_set_to_is_refused_with_line_key_value_and_range_of_the_file() {
        for (from, to, expected) in [
            (
                "resistance_ohm = 3.0",
                "resistance_ohm = 1000.0",
                "motor.resistance_ohm = 1000.0 is outside 0.01 to 100.0",
            ),
            ("bus_v = 48.0", "bus_v = 1000.0", "amplifier.bus_v = 1000.0 is outside 0.8 to 800.0"),
            ("count_m = 61.03515625e-12", "count_m = 1e-3", "encoder.count_m = 1e-3 is outside 1e-12 to 1e-6"),
            ("travel_m = 0.1 ", "travel_m = 0.02 ", "mechanics.travel_m = 0.02 is outside 0.025 to 10.0"),
        ] {
            let (refused, line) = refused(from, to);
            assert!(refused.starts_with(&(line + expected)), "{refused}");
        }
    }

    #[test]
    fn a_contact_that_is_no_spring_is_refused_by_its_model() {
        let friction = BUILT_IN_TOML.find("[friction]").unwrap()..BUILT_IN_TOML.find("[motor]").unwrap();
        let mut text = BUILT_IN_TOML.to_owned();
        text.replace_range(friction, "[friction]\nmodel = \"coulomb\"\ncoulomb_n = 0.64\n\n");
        let refused = checked(&text, 0.025).unwrap_err().to_string();
        assert!(
            refused.starts_with("line 10: friction.model = \"coulomb\" is outside the models with a stiffness"),
            "{refused}"
        );
    }
}
