//! The stage file: everything about the simulated hardware in one TOML text.

use std::ops::Range;

use serde::{Deserialize, Serialize};
use toml::de::{DeTable, DeValue};

pub mod encoder;
mod friction;

pub use encoder::Encoder;
pub use friction::{Friction, FrictionModel, Spread};

/// The built-in stage file, `sim/stages/als130h.toml`: a worked example of the format.
pub const BUILT_IN_TOML: &str = include_str!("../stages/als130h.toml");

/// The simulated hardware. Plain data; [`Stage::from_toml`] is where it is checked.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Stage {
    /// The moving mass and its travel.
    pub mechanics: Mechanics,
    /// The rolling friction of its guides.
    pub friction: Friction,
    /// The three-phase linear motor.
    pub motor: Motor,
    /// The bridge and its current sensors.
    pub amplifier: Amplifier,
    /// The converters.
    pub adc: Adc,
    /// The position encoder.
    pub encoder: Encoder,
}

/// The moving mass and its travel.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Mechanics {
    /// Moving mass, kg, 0.01 to 1000.
    pub mass_kg: f64,
    /// Distance between the hard stops, m, 1e-6 to 10; position 0 is in the middle.
    pub travel_m: f64,
    /// Viscous friction, N s/m, 0 to 1e4.
    pub viscous_n_s_per_m: f64,
}

/// The three-phase linear motor, star point floating.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Motor {
    /// Force per q current (amplitude-invariant: per peak phase ampere), N/A, 0.01 to 1000.
    pub force_constant_n_per_a: f64,
    /// Resistance of a phase, Ω, 0.001 to 1000.
    pub resistance_ohm: f64,
    /// Inductance of a phase, H, 1e-5 to 1.
    pub inductance_h: f64,
    /// Length of one electrical period, m, 1e-3 to 1.
    pub magnet_pitch_m: f64,
    /// Position of electrical angle 0, with the opposite sign, m, −1 to 1.
    pub commutation_offset_m: f64,
}

/// The bridge and its current sensors.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Amplifier {
    /// Bus voltage, V, 1 to 1000.
    pub bus_v: f64,
    /// Phase current at the ends of the converter's range, A, 0.01 to 1000.
    pub full_scale_a: f64,
    /// Frequency of the bridge, Hz, 1e3 to 1e6; the dead time costs its voltage once a period.
    pub pwm_hz: f64,
    /// Dead time of the bridge as built, s, 0 to half a period. The plant uses that in [`crate::BridgeState`].
    pub dead_time_s: f64,
    /// Phase current below which the dead time's voltage error fades, A, 0.01 to 100.
    pub dead_time_band_a: f64,
    /// Temperature of the heat sink, °C, −50 to 200; constant.
    pub temperature_c: f64,
}

/// The converters, 16 bit.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Adc {
    /// White noise of a conversion, LSB rms, 0 to 1000.
    pub noise_lsb_rms: f64,
    /// Bus voltage at full scale, V, 1 to 1000.
    pub bus_full_scale_v: f64,
    /// Temperature at code 0, °C, −300 to 1000.
    pub temperature_zero_c: f64,
    /// Temperature at full scale, °C, above that at code 0, to 1000.
    pub temperature_full_scale_c: f64,
}

/// The file as it is written.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct File {
    mechanics: Mechanics,
    friction: friction::File,
    motor: Motor,
    amplifier: Amplifier,
    adc: Adc,
    encoder: encoder::File,
}

/// What is wrong with a stage file, and in which line (from 1).
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum StageError {
    /// Not TOML, or a key is missing, unknown, of the wrong type or at odds with another one.
    #[error("line {line}: {message}")]
    Format {
        /// Line of the value or, of what is missing, of its table.
        line: usize,
        /// What was found and expected, with the key.
        message: String,
    },
    /// A value that this hardware cannot have.
    #[error("line {line}: {key} = {value} is outside {range}")]
    OutOfRange {
        /// Line of the value.
        line: usize,
        /// Full key, such as `motor.inductance_h`.
        key: &'static str,
        /// The value as it is written.
        value: String,
        /// What is allowed.
        range: String,
    },
}

impl Stage {
    /// Reads and checks a stage file.
    ///
    /// # Errors
    /// The first wrong thing found, with its line, key, value and range.
    pub fn from_toml(text: &str) -> Result<Stage, StageError> {
        let File { mechanics, friction, motor, amplifier, adc, encoder } =
            toml::from_str(text).map_err(|error| format_error(text, &error))?;
        let friction = friction.resolve().map_err(|misfit| misfit.error(text))?;
        let encoder = encoder.resolve().map_err(|misfit| misfit.error(text))?;
        let stage = Stage { mechanics, friction, motor, amplifier, adc, encoder };
        let wrong = stage.limits().into_iter().find(|limit| !(limit.from..=limit.to).contains(&limit.value));
        wrong.map_or(Ok(stage), |limit| Err(limit.error(text)))
    }

    /// What to say of a value in a stage file that is out of a narrower range, which follows from what the stage is used for.
    pub fn out_of_range(text: &str, key: &'static str, value: f64, from: f64, to: f64) -> StageError {
        Limit { key, value, from, to }.error(text)
    }

    /// Every value with its range; NaN is in none of them.
    fn limits(&self) -> Vec<Limit> {
        let Stage { mechanics, friction, motor, amplifier, adc, encoder } = self;
        let limit = |key, value, from, to| Limit { key, value, from, to };
        let mut limits = vec![
            limit("mechanics.mass_kg", mechanics.mass_kg, 0.01, 1e3),
            limit("mechanics.travel_m", mechanics.travel_m, 1e-6, 10.0),
            limit("mechanics.viscous_n_s_per_m", mechanics.viscous_n_s_per_m, 0.0, 1e4),
            limit("motor.force_constant_n_per_a", motor.force_constant_n_per_a, 0.01, 1e3),
            limit("motor.resistance_ohm", motor.resistance_ohm, 1e-3, 1e3),
            limit("motor.inductance_h", motor.inductance_h, 1e-5, 1.0),
            limit("motor.magnet_pitch_m", motor.magnet_pitch_m, 1e-3, 1.0),
            limit("motor.commutation_offset_m", motor.commutation_offset_m, -1.0, 1.0),
            limit("amplifier.bus_v", amplifier.bus_v, 1.0, 1e3),
            limit("amplifier.full_scale_a", amplifier.full_scale_a, 0.01, 1e3),
            limit("amplifier.pwm_hz", amplifier.pwm_hz, 1e3, 1e6),
            limit("amplifier.dead_time_s", amplifier.dead_time_s, 0.0, 0.5 / amplifier.pwm_hz),
            limit("amplifier.dead_time_band_a", amplifier.dead_time_band_a, 0.01, 100.0),
            limit("amplifier.temperature_c", amplifier.temperature_c, -50.0, 200.0),
            limit("adc.noise_lsb_rms", adc.noise_lsb_rms, 0.0, 1e3),
            limit("adc.bus_full_scale_v", adc.bus_full_scale_v, 1.0, 1e3),
            limit("adc.temperature_zero_c", adc.temperature_zero_c, -300.0, 1e3),
            limit("adc.temperature_full_scale_c", adc.temperature_full_scale_c, adc.temperature_zero_c + 1.0, 1e3),
        ];
        limits.extend(encoder.limits(mechanics));
        limits.extend(friction.limits(mechanics));
        limits
    }
}

impl Default for Stage {
    /// The built-in stage.
    fn default() -> Stage {
        // A test reads the built-in text; there is no run-time input that could make this fail.
        Stage::from_toml(BUILT_IN_TOML).expect("the built-in stage file is valid")
    }
}

/// A value and the closed range it must lie in.
struct Limit {
    key: &'static str,
    value: f64,
    from: f64,
    to: f64,
}

impl Limit {
    fn error(&self, text: &str) -> StageError {
        let span = span_of(text, self.key);
        let table = self.key.rsplit_once('.').map_or(self.key, |(table, _)| table);
        let written_at = if span.is_empty() { span_of(text, table).start } else { span.start };
        StageError::OutOfRange {
            line: line_of(text, written_at),
            key: self.key,
            // What is not written follows from other keys of its table.
            value: text.get(span).filter(|written| !written.is_empty()).map_or(self.value.to_string(), str::to_string),
            range: format!("{:?} to {:?}", self.from, self.to),
        }
    }
}

/// A key that does not go with the others.
struct Misfit {
    key: String,
    message: String,
}

impl Misfit {
    fn new(key: impl Into<String>, message: String) -> Misfit {
        Misfit { key: key.into(), message }
    }

    fn error(&self, text: &str) -> StageError {
        let message = format!("{}: {}", self.key, self.message);
        StageError::Format { line: line_of(text, span_of(text, &self.key).start), message }
    }
}

fn format_error(text: &str, error: &toml::de::Error) -> StageError {
    let span = error.span().unwrap_or(0..0);
    let at = span.start;
    let found = DeTable::parse(text).ok().and_then(|table| written_at(table.get_ref(), at));
    // What is missing is told at the head of its table; in a text that is no TOML, such as one with a key twice, nothing is found.
    let head = || text.get(at..)?.strip_prefix('[')?.split_once(']').map(|(table, _)| format!("{table}: "));
    let twice = || text.get(span.clone()).filter(|_| error.message() == "duplicate key").map(|key| format!("{key}: "));
    let place = found.map_or_else(
        || head().or_else(twice).unwrap_or_default(),
        |(key, value)| {
            // Of a wrong value the message says what it is; of a wrong name it says only the name.
            let unknown = value.start > at;
            let value = text.get(value).filter(|value| unknown && !value.contains('\n'));
            value.map_or(format!("{key}: "), |value| format!("{key} = {value}: "))
        },
    );
    let message = in_words(error.message().trim_end());
    StageError::Format { line: line_of(text, at), message: format!("{place}{message}") }
}

/// The parser's message without names of Rust types.
fn in_words(message: &str) -> String {
    message.replace("expected f64", "expected a number").replace("expected usize", "expected a whole number, 0 or more")
}

/// Line number, from 1, of a byte of the text.
fn line_of(text: &str, byte: usize) -> usize {
    1 + text.bytes().take(byte).filter(|b| *b == b'\n').count()
}

/// Where the value of a full key, such as `motor.inductance_h` or `friction.element_saturation_n[2]`, is written; an empty range at
/// the start if it is not.
fn span_of(text: &str, key: &str) -> Range<usize> {
    let Ok(table) = DeTable::parse(text) else { return 0..0 };
    let (mut table, mut span) = (table.get_ref(), 0..0);
    for part in key.split('.') {
        let (part, index) = part.split_once('[').unwrap_or((part, ""));
        let Some(value) = table.get(part) else { return 0..0 };
        span = value.span();
        match value.get_ref() {
            DeValue::Table(inner) => table = inner,
            DeValue::Array(list) => {
                let index: Option<usize> = index.trim_end_matches(']').parse().ok();
                return index.and_then(|index| list.get(index)).map_or(span, |element| element.span());
            }
            _ => break,
        }
    }
    span
}

/// The full key whose value, or whose name, is written at a byte of the text, and where its value is.
fn written_at(table: &DeTable<'_>, byte: usize) -> Option<(String, Range<usize>)> {
    table.iter().find_map(|(key, value)| {
        let name = key.get_ref();
        match value.get_ref() {
            DeValue::Table(inner) if !key.span().contains(&byte) => {
                written_at(inner, byte).map(|(rest, value)| (format!("{name}.{rest}"), value))
            }
            _ => (key.span().contains(&byte) || value.span().contains(&byte)).then(|| (name.to_string(), value.span())),
        }
    })
}
