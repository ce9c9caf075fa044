//! Bad data are refused by name.

mod common;

use common::{Profile, USUAL, dahl};
use proptest::prelude::*;
use servo_ident::{DataError, Record};

const FORCE_CONSTANT_N_PER_A: f64 = 7.8;

struct Measured {
    time_s: Vec<f64>,
    position_m: Vec<f64>,
    current_a: Vec<f64>,
}

fn measured(profile: &Profile) -> Measured {
    let columns = profile.measure(&mut dahl(8.66e6, 0.64), 0);
    let current_a = columns.current_a(FORCE_CONSTANT_N_PER_A);
    Measured { time_s: columns.time_s, position_m: columns.position_m, current_a }
}

impl Measured {
    fn record(&self) -> Result<Record, DataError> {
        Record::from_current(&self.time_s, &self.position_m, &self.current_a, 1.8, FORCE_CONSTANT_N_PER_A)
    }

    fn without(mut self, samples: std::ops::Range<usize>) -> Measured {
        for column in [&mut self.time_s, &mut self.position_m, &mut self.current_a] {
            column.drain(samples.clone());
        }
        self
    }
}

/// The message and the sample.
fn refusal(data: &Measured) -> (String, Option<usize>) {
    let error = data.record().unwrap_err();
    (error.to_string(), error.sample())
}

#[test]
fn good_data_are_accepted_with_and_without_noise() {
    for profile in [USUAL, Profile { position_noise_m: 0.0, force_noise_n: 0.0, ..USUAL }] {
        assert!(measured(&profile).record().is_ok(), "{:?}", measured(&profile).record().err());
    }
}

#[test]
fn too_few_samples() {
    let few = measured(&USUAL).without(99..8_000);
    assert_eq!(few.record().unwrap_err(), DataError::TooFewSamples { found: 99, least: 100 });
    assert_eq!(refusal(&few), ("samples = 99 is too few: 100 or more are needed".to_owned(), None));
}

#[test]
fn columns_of_different_length() {
    let mut data = measured(&USUAL);
    data.current_a.pop();
    assert_eq!(refusal(&data), ("current_a has 7999 samples, time_s has 8000".to_owned(), None));
}

#[test]
fn not_a_number() {
    for (column, name) in [(0, "time_s"), (1, "position_m"), (2, "current_a")] {
        for value in [f64::NAN, f64::INFINITY] {
            let mut data = measured(&USUAL);
            [&mut data.time_s, &mut data.position_m, &mut data.current_a][column][1234] = value;
            assert_eq!(refusal(&data), (format!("{name} = {value} is not a finite number"), Some(1234)));
        }
    }
}

#[test]
fn time_that_goes_backwards_or_stands_still() {
    let mut data = measured(&USUAL);
    data.time_s[4000] = data.time_s[3990];
    assert_eq!(
        refusal(&data),
        ("time_s = 0.49875 goes backwards: the sample before has 0.499875".to_owned(), Some(4000))
    );
    data.time_s[4000] = data.time_s[3999];
    assert!(matches!(data.record(), Err(DataError::TimeBackwards { sample: 4000, .. })));
}

#[test]
fn dropped_samples() {
    let (message, sample) = refusal(&measured(&USUAL).without(1000..1001));
    assert_eq!(sample, Some(1000));
    assert_eq!(
        message,
        "time_s = 0.125125: a gap of 0.000250000 s before it, dropped samples; the others are 0.000125000 s apart"
    );
}

#[test]
fn no_motion_beyond_noise() {
    for (amplitude_m, position_noise_m) in [(0.0, 0.44e-9), (0.5e-9, 0.44e-9), (0.0, 0.0)] {
        let data = measured(&Profile { amplitude_m, position_noise_m, ..USUAL });
        assert!(matches!(data.record(), Err(DataError::NoMotion { .. })), "{amplitude_m} m, {position_noise_m} m");
    }
    // An encoder that flickers between two counts.
    let mut data = measured(&USUAL);
    for (i, x) in data.position_m.iter_mut().enumerate() {
        *x = if i % 700 == 0 { 61e-12 } else { 0.0 };
    }
    assert!(matches!(data.record(), Err(DataError::NoMotion { .. })), "{:?}", data.record().err());
}

#[test]
fn no_reversal() {
    let mut data = measured(&USUAL);
    for (x, t) in data.position_m.iter_mut().zip(&data.time_s) {
        *x = 1e-6 * t;
    }
    assert_eq!(data.record().unwrap_err(), DataError::NoReversal);
}

#[test]
fn saturated_current() {
    for noise in [0.0, 1.0] {
        let noisy = Profile { force_noise_n: noise * 2.8e-3, position_noise_m: noise * 0.44e-9, ..USUAL };
        for (low_a, high_a) in [(-0.06, 0.06), (-1.0, 0.05), (-0.07, 1.0)] {
            let mut data = measured(&noisy);
            data.current_a.iter_mut().for_each(|i| *i = i.max(low_a).min(high_a));
            let error = data.record().unwrap_err();
            let DataError::Saturated { value_a, sample, .. } = error else { panic!("{error}") };
            assert!(value_a == low_a || value_a == high_a, "{value_a}");
            assert_eq!(data.current_a[sample], value_a);
        }
    }
}

#[test]
fn a_coarse_converter_is_not_a_saturated_one() {
    for step_a in [1e-6, 3e-4, 2e-3] {
        let mut data = measured(&Profile { force_noise_n: 0.0, ..USUAL });
        data.current_a.iter_mut().for_each(|i| *i = (*i / step_a).round() * step_a);
        assert!(data.record().is_ok(), "{step_a} A: {:?}", data.record().err());
    }
}

#[test]
fn a_force_constant_of_the_wrong_sign() {
    let data = measured(&USUAL);
    let error = Record::from_current(&data.time_s, &data.position_m, &data.current_a, 1.8, -7.8).unwrap_err();
    assert!(matches!(error, DataError::WrongSign { field: "force-constant", value: -7.8, .. }), "{error}");
    let reversed: Vec<f64> = data.current_a.iter().map(|i| -i).collect();
    let error = Record::from_current(&data.time_s, &data.position_m, &reversed, 1.8, 7.8).unwrap_err();
    assert!(matches!(error, DataError::WrongSign { field: "force-constant", value: 7.8, .. }), "{error}");
}

#[test]
fn mass_and_force_constant_out_of_range() {
    let data = measured(&USUAL);
    for (mass_kg, force_constant, message) in [
        (0.0, 7.8, "mass = 0 is outside 0.001 to 10000.0"),
        (f64::NAN, 7.8, "mass = NaN is outside 0.001 to 10000.0"),
        (1.8, 0.0, "force-constant = 0 is outside 0.001 to 10000.0"),
    ] {
        let error = Record::from_current(&data.time_s, &data.position_m, &data.current_a, mass_kg, force_constant);
        assert_eq!(error.unwrap_err().to_string(), message);
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]
    /// Whatever the columns hold: an answer, no panic.
    #[test]
    fn any_columns_get_an_answer(
        values in prop::collection::vec((any::<f64>(), any::<f64>(), any::<f64>()), 0..300), ordered: bool,
    ) {
        let mut time_s: Vec<f64> = values.iter().map(|v| v.0).collect();
        if ordered {
            time_s = (0..values.len()).map(|i| i as f64 * 1e-3).collect();
        }
        let position_m: Vec<f64> = values.iter().map(|v| v.1 % 1.0).collect();
        let force_n: Vec<f64> = values.iter().map(|v| v.2 % 1e3).collect();
        if let Ok(record) = Record::from_force(&time_s, &position_m, &force_n) {
            let _ = servo_ident::choice::fit(&record, 4);
        }
        let _ = Record::from_current(&time_s, &position_m, &force_n, 1.0, 1.0);
    }
}
