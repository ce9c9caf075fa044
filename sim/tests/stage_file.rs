//! Stage files: those that come with the crate, and every way to get one wrong.

use servo_sim::friction::{Element, Elements, Level};
use servo_sim::stage::encoder::Kind;
use servo_sim::stage::{BUILT_IN_TOML, FrictionModel};
use servo_sim::{Carriage, Stage, StageError};

const SIN_COS: &str = include_str!("../stages/sin-cos.toml");

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

#[test]
fn the_third_stage_is_the_built_in_one_on_the_friction_of_table_4() {
    let stage = Stage::from_toml(include_str!("../stages/gms-table-4.toml")).unwrap();
    let friction = &stage.friction;
    assert_eq!((friction.model, friction.scaled_elements()), (FrictionModel::Gms, Elements::table_4()));
    assert_eq!(Stage { friction: Stage::default().friction, ..stage }, Stage::default());
}

#[test]
fn the_fourth_stage_is_the_built_in_one_with_sine_and_cosine() {
    let stage = Stage::from_toml(SIN_COS).unwrap();
    let Kind::SinCos(signals) = stage.encoder.kind else { panic!("{:?}", stage.encoder) };
    assert_eq!((signals.cos_offset, signals.sin_offset, signals.gain), (0.02, -0.02, 1.02));
    assert!((signals.phase_rad.to_degrees() - 2.0).abs() < 1e-3);
    assert_eq!(Stage { encoder: Stage::default().encoder, ..stage }, Stage::default());
}

/// Whatever lies there: a file that is added is read as well.
#[test]
fn every_stage_file_of_the_crate_is_valid_and_none_is_another() {
    let directory = concat!(env!("CARGO_MANIFEST_DIR"), "/stages");
    let files = std::fs::read_dir(directory).unwrap().map(|entry| entry.unwrap().path());
    let stages: Vec<(String, Stage)> = files
        .map(|path| {
            let stage = Stage::from_toml(&std::fs::read_to_string(&path).unwrap());
            let name = path.display().to_string();
            (name.clone(), stage.unwrap_or_else(|error| panic!("{name}: {error}")))
        })
        .collect();
    assert!(stages.len() >= 7, "{}", stages.len());
    for (i, (name, stage)) in stages.iter().enumerate() {
        let same = stages[..i].iter().find(|(_, other)| other == stage);
        assert!(same.is_none(), "{name} and {:?}", same.map(|(other, _)| other));
    }
}

#[test]
fn an_encoder_table_that_does_not_fit_its_kind_is_refused_with_its_line() {
    let edited = |text: &str, key: &str, replacement: &str| {
        let number = 1 + text.lines().position(|line| line.starts_with(key)).unwrap();
        let lines = text.lines().map(|line| if line.starts_with(key) { replacement } else { line });
        (lines.collect::<Vec<_>>().join("\n"), number)
    };
    for (text, key, replacement, at, expected) in [
        (BUILT_IN_TOML, "acknowledge", "", "[encoder]", "missing field `acknowledge_bits` of kind \"biss-c\""),
        (BUILT_IN_TOML, "acknowledge", "acknowledge_bits = 12\ngain = 1.0", "gain", "only with kind = \"sin-cos\""),
        (SIN_COS, "amplitude", "", "[encoder]", "missing field `amplitude` of kind \"sin-cos\""),
        (SIN_COS, "gain", "acknowledge_bits = 12", "acknowledge_bits", "only with kind = \"biss-c\""),
        (SIN_COS, "kind", "kind = \"endat\"", "kind", "unknown variant `endat`, expected `biss-c` or `sin-cos`"),
        (SIN_COS, "amplitude", "amplitude = 1.5", "amplitude", "encoder.amplitude = 1.5 is outside 0.01 to 1.0"),
        (SIN_COS, "phase", "phase_rad = 2.0", "phase", "encoder.phase_rad = 2.0 is outside -0.5 to 0.5"),
        (
            SIN_COS,
            "counter",
            "counter_late_s = 1.0",
            "counter",
            "encoder.counter_late_s = 1.0 is outside -1e-5 to 1e-5",
        ),
    ] {
        let (text, _) = edited(text, key, replacement);
        let line = 1 + text.lines().position(|line| line.starts_with(at)).unwrap();
        let message = Stage::from_toml(&text).unwrap_err().to_string();
        assert!(
            message.starts_with(&format!("line {line}: ")) && message.contains(expected),
            "{replacement}: {message}"
        );
    }
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
        ("latency", "latency_s = 251e-6", "encoder.latency_s", "251e-6", "0.0 to 0.00025"),
        ("latency", "latency_s = -1e-6", "encoder.latency_s", "-1e-6", "0.0 to 0.00025"),
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
fn a_reading_without_a_latency_is_of_now() {
    let (text, _) = edited("latency", "");
    assert_eq!(Stage::from_toml(&text).unwrap().encoder.latency_s, 0.0);
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
        ("mass_kg", "mass_kg = \"heavy\"", "mechanics.mass_kg: invalid type: string \"heavy\", expected a number"),
        (
            "elements",
            "elements = 12.5",
            "friction.elements: invalid type: floating point `12.5`, expected a whole number",
        ),
        ("elements", "elements = -1", "friction.elements: invalid value: integer `-1`, expected a whole number"),
        (
            "model",
            "model = \"ligre\"",
            "friction.model: unknown variant `ligre`, expected one of `maxwell-slip`, `dahl`, `gms`, `lugre`, `stribeck`, `coulomb`",
        ),
        ("resistance", "resistance = 3.0", "motor.resistance = 3.0: unknown field `resistance`, expected one of"),
        ("coulomb_std", "coulomb_sd_n = 0.18", "friction.spread.coulomb_sd_n = 0.18: unknown field `coulomb_sd_n`"),
        ("[motor]", "[moto]", "moto: unknown field `moto`, expected one of `mechanics`"),
        ("bus_v", "bus_v = 48 V", "string values must be quoted"),
        ("dead_time_s", "pwm_hz = 1e4", "pwm_hz: duplicate key"),
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
    assert_eq!(message, format!("line {table}: motor: missing field `inductance_h`"));
    assert_eq!(Stage::from_toml("").unwrap_err().to_string(), "line 1: missing field `mechanics`");
}

#[test]
fn integers_are_numbers_and_the_number_of_elements_has_a_default() {
    let (text, _) = edited("mass_kg", "mass_kg = 2");
    assert_eq!(Stage::from_toml(&text).unwrap().mechanics.mass_kg, 2.0);
    let (text, _) = edited("elements", "");
    assert_eq!(Stage::from_toml(&text), Ok(Stage::default()));
}

/// The built-in file with another `[friction]` table, and the line of its header.
fn with_friction(table: &str) -> (String, usize) {
    let from = BUILT_IN_TOML.find("[friction]").unwrap();
    let to = BUILT_IN_TOML.find("[motor]").unwrap();
    let line = 1 + BUILT_IN_TOML[..from].matches('\n').count();
    (format!("{}[friction]\n{table}\n{}", &BUILT_IN_TOML[..from], &BUILT_IN_TOML[to..]), line)
}

fn friction(table: &str) -> servo_sim::stage::Friction {
    Stage::from_toml(&with_friction(table).0).unwrap_or_else(|error| panic!("{table}: {error}")).friction
}

#[test]
fn every_model_can_be_the_stages() {
    for (table, model, stiffness_n_per_m, coulomb_n) in [
        ("model = 'coulomb'\ncoulomb_n = 0.6", FrictionModel::Coulomb, 0.0, 0.6),
        (
            "model = 'stribeck'\ncoulomb_n = 0.6\nstatic_n = 0.9\nstribeck_m_per_s = 1e-3",
            FrictionModel::Stribeck,
            0.0,
            0.6,
        ),
        ("model = 'dahl'\nstiffness_n_per_m = 9e6\ncoulomb_n = 0.6\nshape = 1.5", FrictionModel::Dahl, 9e6, 0.6),
        (
            "model = 'lugre'\nstiffness_n_per_m = 9e6\ncoulomb_n = 0.6\ndamping_n_s_per_m = 400",
            FrictionModel::LuGre,
            9e6,
            0.6,
        ),
        ("model = 'maxwell-slip'\nstiffness_n_per_m = 9e6\ncoulomb_n = 0.6", FrictionModel::MaxwellSlip, 9e6, 0.6),
        ("model = 'gms'\npreset = 'table-4'\ncoulomb_n = 0.6", FrictionModel::Gms, 5.94825e6, 0.6),
        (
            "model = 'gms'\nelement_stiffness_n_per_m = [4e6, 2e6]\nelement_saturation_n = [0.1, 0.3]",
            FrictionModel::Gms,
            3e6,
            0.4,
        ),
    ] {
        let friction = friction(table);
        assert_eq!(friction.model, model);
        assert!((friction.stiffness_n_per_m - stiffness_n_per_m).abs() < 1e-3, "{table}");
        assert!((friction.coulomb_n - coulomb_n).abs() < 1e-12, "{table}");
    }
}

#[test]
fn the_stribeck_curve_is_constant_unless_it_is_described() {
    let lugre = "model = 'lugre'\nstiffness_n_per_m = 9e6\ncoulomb_n = 0.6";
    assert_eq!(friction(lugre).level(), Level::constant(0.6));
    let described = friction(&format!("{lugre}\nstatic_n = 0.9\nstribeck_m_per_s = 2e-3\nstribeck_shape = 2")).level();
    assert_eq!(described, Level { coulomb_n: 0.6, static_n: 0.9, stribeck_m_per_s: 2e-3, stribeck_shape: 2.0 });
}

#[test]
fn sigma_and_coulomb_scale_listed_elements() {
    let elements = friction("model = 'gms'\npreset = 'table-4'").scaled_elements();
    assert_eq!(elements, Elements::table_4());
    let table = "model = 'gms'\nelement_stiffness_n_per_m = [4e6, 2e6]\nelement_saturation_n = [0.1, 0.3]";
    let scaled = friction(&format!("{table}\nstiffness_n_per_m = 6e6\ncoulomb_n = 0.2")).scaled_elements();
    let expected = [(8e6, 0.05), (4e6, 0.15)];
    for (Element { stiffness_n_per_m, saturation_n }, (k, f)) in scaled.as_slice().iter().zip(expected) {
        assert!((stiffness_n_per_m - k).abs() < 1e-6 && (saturation_n - f).abs() < 1e-12);
    }
}

#[test]
fn a_spread_is_drawn_for_every_model_with_a_spring() {
    let spread = "[friction.spread]\nstiffness_std_n_per_m = 1e6\nstiffness_min_n_per_m = 1e6\n\
                  stiffness_max_n_per_m = 2e7\ncoulomb_std_n = 0.1\ncoulomb_min_n = 0.2\ncoulomb_max_n = 1.0";
    for table in [
        "model = 'dahl'\nstiffness_n_per_m = 9e6\ncoulomb_n = 0.6",
        "model = 'lugre'\nstiffness_n_per_m = 9e6\ncoulomb_n = 0.6",
        "model = 'maxwell-slip'\nstiffness_n_per_m = 9e6\ncoulomb_n = 0.6",
        "model = 'gms'\npreset = 'table-4'",
    ] {
        let stage = Stage::from_toml(&with_friction(&format!("{table}\n{spread}")).0).unwrap();
        let step = servo_sim::carriage::Step::new(&stage, 6.25e-6);
        let sliding_n = |move_index| {
            let mut carriage = Carriage::new(&stage, 1);
            carriage.redraw_friction(move_index);
            carriage.advance(&step, 4_000, 5.0, 5.0);
            carriage.friction_n()
        };
        assert_eq!(sliding_n(1), sliding_n(1), "{table}");
        assert!((sliding_n(1) - sliding_n(2)).abs() > 1e-3, "{table}: every move has its own level");
    }
}

#[test]
fn a_friction_table_that_does_not_fit_its_model_is_refused_with_its_line() {
    let dahl = "model = 'dahl'\nstiffness_n_per_m = 9e6\ncoulomb_n = 0.6";
    let lists = |stiffness: &str, saturation: &str| {
        format!("model = 'gms'\nelement_stiffness_n_per_m = {stiffness}\nelement_saturation_n = {saturation}")
    };
    for (table, line_in_table, expected) in [
        (
            "model = 'coulomb'\ncoulomb_n = 0.6\nstiffness_n_per_m = 9e6".to_string(),
            3,
            "friction.stiffness_n_per_m: no parameter of model \"coulomb\", which has `coulomb_n`",
        ),
        (format!("{dahl}\nstatic_n = 0.9"), 4, "friction.static_n: no parameter of model \"dahl\""),
        (format!("{dahl}\nwobble = 1"), 4, "friction.wobble = 1: unknown field `wobble`"),
        (format!("{dahl}\nelements = 12"), 4, "friction.elements: no parameter of model \"dahl\""),
        (
            "model = 'stribeck'\ncoulomb_n = 0.6".to_string(),
            0,
            "friction: missing field `static_n` of model \"stribeck\"",
        ),
        (
            "model = 'lugre'\ncoulomb_n = 0.6".to_string(),
            0,
            "friction: missing field `stiffness_n_per_m` of model \"lugre\"",
        ),
        ("model = 'gms'".to_string(), 0, "friction: model \"gms\" needs `preset`, or `element_stiffness_n_per_m` and"),
        (
            "model = 'gms'\npreset = 'table-5'".to_string(),
            2,
            "friction.preset: unknown variant `table-5`, expected `table-4`",
        ),
        (
            format!("{}\npreset = 'table-4'", lists("[1e6]", "[0.1]")),
            4,
            "friction.preset: either a preset or lists of elements",
        ),
        (lists("[1e6, 2e6]", "[0.1]"), 3, "friction.element_saturation_n: 1 values for 2 stiffnesses"),
        (lists("[]", "[]"), 2, "friction.element_stiffness_n_per_m: 0 values are outside 1 to 12"),
        (
            lists("[1e6,\n -2e6]", "[0.1, 0.2]"),
            3,
            "friction.element_stiffness_n_per_m[1]: -2000000.0 is outside 1e-6 to 1000000000.0",
        ),
        (lists("[1e6]", "[nan]"), 3, "friction.element_saturation_n[0]: NaN is outside 1e-6 to 10000.0"),
        (lists("[9e8]", "[0.1]"), 0, "friction.stiffness_n_per_m = 450000000 is outside 1.0 to 230400000.0"),
        (
            "model = 'gms'\npreset = 'table-4'\nshape = 2\nattraction_n_per_s = 1".to_string(),
            4,
            "friction.attraction_n_per_s: either this or `shape`",
        ),
        (
            "model = 'gms'\npreset = 'table-4'\nshape = 0.5".to_string(),
            3,
            "friction.shape = 0.5 is outside 1.0 to 10.0",
        ),
        (format!("{dahl}\nshape = -1"), 4, "friction.shape = -1 is outside 0.0 to 10.0"),
        (
            "model = 'lugre'\nstiffness_n_per_m = 9e6\ncoulomb_n = 0.6\nstatic_n = 0.5".to_string(),
            4,
            "friction.static_n = 0.5 is outside 0.6 to 10000.0",
        ),
        (
            "model = 'lugre'\nstiffness_n_per_m = 9e6\ncoulomb_n = 0.6\ndamping_n_s_per_m = 1e6".to_string(),
            4,
            "friction.damping_n_s_per_m = 1e6 is outside 0.0 to 28800.0",
        ),
    ] {
        let (text, header) = with_friction(&table);
        let message = Stage::from_toml(&text).unwrap_err().to_string();
        let start = format!("line {}: {expected}", header + line_in_table);
        assert!(message.starts_with(&start), "{table}:\n  {message}\n  {start}");
    }
}

#[test]
fn a_friction_model_without_a_spring_holds_the_carriage_until_static_friction_is_passed() {
    let (text, _) = with_friction("model = 'stribeck'\ncoulomb_n = 0.6\nstatic_n = 0.9\nstribeck_m_per_s = 1e-4");
    let stage = Stage::from_toml(&text).unwrap();
    let step = servo_sim::carriage::Step::new(&stage, 6.25e-6);
    let mut carriage = Carriage::new(&stage, 1);
    carriage.advance(&step, 100_000, 0.89, 0.89);
    assert_eq!((carriage.position_m(), carriage.velocity_m_per_s(), carriage.friction_n()), (0.0, 0.0, 0.89));
    carriage.advance(&step, 1_000, 0.91, 0.91);
    assert!(carriage.velocity_m_per_s() > 5e-4, "and then slips: {} m/s", carriage.velocity_m_per_s());
    // Pushed and let go, it stops: v²/2 = F_C/m · x, and the last micrometre under a little more than F_C.
    carriage.set_velocity(0.1);
    let from_m = carriage.position_m();
    carriage.advance(&step, 100_000, 0.0, 0.0);
    assert_eq!((carriage.velocity_m_per_s(), carriage.friction_n()), (0.0, 0.0));
    let way_m = carriage.position_m() - from_m;
    assert!((way_m / (0.5 * 0.1 * 0.1 * 1.8 / 0.6) - 1.0).abs() < 1e-3, "{way_m} m");
}
