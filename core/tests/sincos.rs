//! The second kind of encoder: signals made here in f64, sample by sample, with everything that real ones have wrong.

use core::f64::consts::TAU;

use proptest::prelude::*;
use servo_core::encoder::sincos::{
    Coefficients, Correction, Fit, FitError, Interpolator, PERIOD_CT, Sample, SampleError, Signals,
};
use servo_core::position::Position;

const PERFECT: Signals = Signals { amplitude: 0.75, cos_offset: 0.0, sin_offset: 0.0, gain: 1.0, phase_rad: 0.0 };
/// 2 % of gain, 2 % of offset and 2° of phase.
const WRONG: Signals =
    Signals { cos_offset: 0.02, sin_offset: -0.02, gain: 1.02, phase_rad: 2.0 * TAU / 360.0, ..PERFECT };
/// Length of a count, nm.
const COUNT_NM: f64 = 4e3 / 65_536.0;

fn coefficients(signals: &Signals) -> Coefficients {
    Coefficients { correction: Correction::new(signals), least2: 0.25, most2: 1.69 }
}

/// What the converters and the counter give at a position in periods.
fn sample(signals: &Signals, periods: f64, noise: &mut impl FnMut() -> f64) -> Sample {
    let angle = TAU * periods;
    let code = |share: f64, noise: f64| {
        (32_768.0 * (1.0 + signals.amplitude * share) + noise).round().clamp(0.0, 65_535.0) as u16
    };
    Sample {
        cos: code(signals.cos_offset + angle.cos(), noise()),
        sin: code(signals.sin_offset + signals.gain * (angle + signals.phase_rad).sin(), noise()),
        edges: (4.0 * periods).floor() as i64 as u16,
    }
}

/// Uniform noise from −3 to 3 LSB.
fn noise(mut state: u64) -> impl FnMut() -> f64 {
    move || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 33) as f64 / f64::from(1u32 << 31) * 6.0 - 3.0
    }
}

/// Moves by `step` periods a tick from `from`; the difference between the positions told and the truth, nm.
fn follow(
    encoder: &mut Interpolator,
    k: &Coefficients,
    signals: &Signals,
    from: f64,
    step: f64,
    ticks: u32,
) -> Vec<f64> {
    let mut noise = noise(1);
    let mut before = None;
    (0..ticks)
        .map(|tick| {
            let periods = from + step * f64::from(tick);
            let position = encoder.update(k, sample(signals, periods, &mut noise), before).unwrap();
            before = Some(position);
            (position.0 as f64 - periods * f64::from(PERIOD_CT)) * COUNT_NM
        })
        .collect()
}

/// Half of peak to peak, with the noise of the converters averaged away: the mean in each 64th of a period.
fn subdivisional_nm(errors_nm: &[f64], from: f64, step: f64) -> f64 {
    let mut bins = [(0.0, 0u32); 64];
    for (tick, error_nm) in errors_nm.iter().enumerate() {
        let bin = &mut bins[((from + step * tick as f64).rem_euclid(1.0) * 64.0) as usize];
        *bin = (bin.0 + error_nm, bin.1 + 1);
    }
    let means = bins.map(|(sum, n)| sum / f64::from(n));
    0.5 * (means.iter().copied().fold(f64::MIN, f64::max) - means.iter().copied().fold(f64::MAX, f64::min))
}

#[test]
fn uncorrected_signals_with_two_percent_and_two_degrees_are_wrong_by_tens_of_nanometres() {
    let errors_nm = follow(&mut Interpolator::default(), &coefficients(&PERFECT), &WRONG, 0.1, 0.0137, 200);
    assert!(subdivisional_nm(&errors_nm, 0.1, 0.0137) > 10.0);
}

#[test]
fn a_correction_that_fits_leaves_less_than_the_converters_resolution() {
    let (from, step) = (-3.0, 0.0137);
    let errors_nm = follow(&mut Interpolator::default(), &coefficients(&WRONG), &WRONG, from, step, 20_000);
    assert!(subdivisional_nm(&errors_nm, from, step) < 0.03);
}

#[test]
fn a_move_calibrates_signals_with_two_percent_and_two_degrees_to_well_below_a_third_of_a_nanometre() {
    for wrong in [
        WRONG,
        Signals { cos_offset: -0.02, gain: 0.98, ..WRONG },
        Signals { amplitude: 0.6, sin_offset: 0.02, phase_rad: -WRONG.phase_rad, ..WRONG },
    ] {
        let mut encoder = Interpolator::default();
        encoder.collect();
        follow(&mut encoder, &coefficients(&PERFECT), &wrong, 0.0, 0.037, 2_000);
        let found = encoder.fit().unwrap().solve().unwrap();
        for (found, wrong, tolerance) in [
            (found.amplitude, wrong.amplitude, 1e-4),
            (found.cos_offset, wrong.cos_offset, 1e-4),
            (found.sin_offset, wrong.sin_offset, 1e-4),
            (found.gain, wrong.gain, 1e-4),
            (found.phase_rad, wrong.phase_rad, 1e-4),
        ] {
            assert!((found - wrong).abs() < tolerance, "{found} instead of {wrong}");
        }
        let (from, step) = (0.2, 0.0137);
        let errors_nm = follow(&mut Interpolator::default(), &coefficients(&found), &wrong, from, step, 20_000);
        let left_nm = subdivisional_nm(&errors_nm, from, step);
        assert!(left_nm < 0.1, "{left_nm} nm of {wrong:?}");
    }
}

#[test]
fn what_drifts_is_followed_and_the_health_figure_says_what_is_left() {
    let (k, step) = (coefficients(&PERFECT), 0.0313);
    let mut encoder = Interpolator::default();
    assert_eq!(encoder.error_periods(), None);
    let errors_nm = follow(&mut encoder, &k, &WRONG, 0.0, step, 400);
    let health_nm = |encoder: &Interpolator| f64::from(encoder.error_periods().unwrap()) * 4e3;
    // Before it has learnt: the amplitudes of both harmonics add up at their worst, as in the signal itself or a little less.
    let found_nm = subdivisional_nm(&errors_nm, 0.0, step);
    assert!((0.6..1.4).contains(&(health_nm(&encoder) / found_nm)), "{} {found_nm}", health_nm(&encoder));
    // Five seconds of slow motion later.
    follow(&mut encoder, &k, &WRONG, 0.0, step, 40_000);
    let errors_nm = follow(&mut encoder, &k, &WRONG, 0.0, step, 20_000);
    assert!(subdivisional_nm(&errors_nm, 0.0, step) < 0.1);
    assert!(health_nm(&encoder) < 0.1, "{}", health_nm(&encoder));
}

#[test]
fn at_rest_nothing_is_learnt() {
    let (k, mut encoder) = (coefficients(&PERFECT), Interpolator::default());
    let first_nm = follow(&mut encoder, &k, &WRONG, 0.3, 0.0, 8_000);
    let mean_nm = |errors: &[f64]| errors.iter().sum::<f64>() / errors.len() as f64;
    assert_eq!(encoder.error_periods(), None);
    assert!((mean_nm(&first_nm[..4_000]) - mean_nm(&first_nm[4_000..])).abs() < 0.01);
}

#[test]
fn amplitudes_outside_the_window_are_refused_and_the_position_goes_on_afterwards() {
    let (k, mut encoder, mut quiet) = (coefficients(&PERFECT), Interpolator::default(), || 0.0);
    let before = encoder.update(&k, sample(&PERFECT, 0.2, &mut quiet), None).unwrap();
    for (amplitude, error) in
        [(0.0, SampleError::TooSmall), (0.37, SampleError::TooSmall), (0.99, SampleError::TooLarge)]
    {
        let wrong = sample(&Signals { amplitude, ..PERFECT }, 0.3, &mut quiet);
        assert_eq!(encoder.update(&k, wrong, Some(before)), Err(error), "{amplitude}");
    }
    let after = encoder.update(&k, sample(&PERFECT, 7.3, &mut quiet), Some(before)).unwrap();
    assert!((after.0 as f64 / f64::from(PERIOD_CT) - 7.3).abs() < 1e-4);
}

#[test]
fn a_broken_wire_or_a_converter_at_its_end_is_refused_wherever_the_stage_is() {
    let (k, mut quiet) = (coefficients(&PERFECT), || 0.0);
    for step in 0..1_000 {
        let good = sample(&PERFECT, f64::from(step) * 0.001, &mut quiet);
        for (sin, cos, error) in [
            (32_768, 32_768, SampleError::TooSmall),
            (0, 0, SampleError::TooLarge),
            (u16::MAX, 0, SampleError::TooLarge),
            (u16::MAX, good.cos, SampleError::TooLarge),
        ] {
            let refused = Interpolator::default().update(&k, Sample { sin, cos, ..good }, None);
            // With one channel at its end, the other one can make up a plausible amplitude: 1.33 is the least.
            assert_eq!(refused, Err(error), "{sin} {cos}");
        }
    }
}

#[test]
fn a_move_too_short_to_see_the_whole_ellipse_gives_no_correction_and_says_what_is_missing() {
    let mut encoder = Interpolator::default();
    encoder.collect();
    follow(&mut encoder, &coefficients(&PERFECT), &WRONG, 0.02, 0.016, 40);
    let error = encoder.fit().unwrap().solve().unwrap_err();
    assert!(matches!(error, FitError::TooFewSamples { samples: 0, .. }), "{error:?}");
    assert!(error.to_string().ends_with("has 0 samples, 32 are needed: move further"), "{error}");
}

#[test]
fn channels_that_are_not_sine_and_cosine_of_one_period_are_no_ellipse() {
    let sawtooth = |tick: u32, period: u32| f64::from(tick % period) / f64::from(period) * 2.0 - 1.0;
    type Channels = fn(f64, f64) -> [f64; 2];
    let cases: [(&str, Channels); 4] = [
        ("a square instead of the cosine", |a, _| [(TAU * a).sin(), 0.6 * (TAU * a).cos().signum()]),
        ("one channel far smaller", |a, _| [0.3 * (TAU * a).sin(), (TAU * a).cos()]),
        ("both channels the same, but for a little", |a, _| [(TAU * a).cos() + 0.2 * (TAU * a).sin(), (TAU * a).cos()]),
        ("two signals that have nothing to do with each other", |a, b| [a, b]),
    ];
    for (what, shares) in cases {
        let mut fit = Fit::default();
        for tick in 0..4_000 {
            let [sin, cos] =
                shares(sawtooth(tick, 400), sawtooth(tick, 331)).map(|share| (32_768.0 + 20_000.0 * share) as u16);
            fit.take(Sample { sin, cos, edges: 0 });
        }
        assert_eq!(fit.solve(), Err(FitError::NoEllipse), "{what}");
    }
}

proptest! {
    /// Up to 10 m/s with 4 µm, back and forth, with the counter read up to 20 ns early or late: two of them together are an eighth of a
    /// period at most, which is what the fusion can take.
    #[test]
    fn no_period_is_ever_lost(from in -1e3..1e3f64, speeds in prop::collection::vec((-312.0..312.0f64, -1.0..1.0f64), 1..200)) {
        let (k, mut encoder, mut noise) = (coefficients(&WRONG), Interpolator::default(), noise(7));
        let mut periods = from;
        let first = encoder.update(&k, sample(&WRONG, from, &mut noise), None).unwrap();
        prop_assert!(first.0.abs() <= i64::from(PERIOD_CT / 2));
        let origin = from - first.0 as f64 / f64::from(PERIOD_CT);
        let mut before = first;
        for (step, late) in speeds {
            periods += step;
            let skew = late * 20e-9 * step * 8_000.0;
            let seen = sample(&WRONG, periods, &mut noise);
            let counted = sample(&WRONG, periods + skew, &mut noise);
            before = encoder.update(&k, Sample { edges: counted.edges, ..seen }, Some(before)).unwrap();
            let off = before.0 as f64 / f64::from(PERIOD_CT) + origin - periods;
            prop_assert!(off.abs() < 0.01, "{off} periods after a step of {step}");
        }
    }

    /// One edge too few or too many in a tick never makes the position jump by a period: either it is right, or the sample is refused.
    #[test]
    fn a_lost_edge_is_refused_or_does_no_harm(from in -1e3..1e3f64, step in -100.0..100.0f64, lost in prop::sample::select(vec![-1i16, 1])) {
        let (k, mut encoder, mut quiet) = (coefficients(&PERFECT), Interpolator::default(), || 0.0);
        let before = encoder.update(&k, sample(&PERFECT, from, &mut quiet), None).unwrap();
        let next = sample(&PERFECT, from + step, &mut quiet);
        let told = encoder.update(&k, Sample { edges: next.edges.wrapping_add_signed(lost), ..next }, Some(before));
        match told {
            Ok(position) => prop_assert!(((position.0 - before.0) as f64 / f64::from(PERIOD_CT) - step).abs() < 0.01),
            Err(error) => prop_assert_eq!(error, SampleError::Counter),
        }
    }

    #[test]
    fn any_sample_is_taken_or_refused_without_panic(bits: u64, before: Option<i64>) {
        let _ = Interpolator::default().update(&coefficients(&WRONG), Sample::from_bits(bits), before.map(Position));
        let masked = bits & 0xffff_ffff_0000_ffff;
        prop_assert_eq!(Sample::from_bits(masked).to_bits(), masked);
    }
}
