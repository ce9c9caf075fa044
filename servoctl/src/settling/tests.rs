use super::*;
use proptest::prelude::*;

const RATE_HZ: f64 = 1000.0;

/// 500 ms inside ±1 nm with the given samples (ms, nm) put in.
fn trace(outside: &[(usize, f64)]) -> Vec<f64> {
    let mut error_nm = vec![1.0; 500];
    for &(at_ms, nm) in outside {
        error_nm[at_ms] = nm;
    }
    error_nm
}

#[test]
fn settling_ends_with_the_last_sample_outside_the_tolerance() {
    let cases = [
        ("never outside", trace(&[]), Some(0.0)),
        ("exactly at the tolerance is inside", trace(&[(70, 10.0), (80, -10.0)]), Some(0.0)),
        ("outside once, below", trace(&[(70, -10.1)]), Some(70.0)),
        ("returns and leaves again", trace(&[(20, 50.0), (150, 11.0)]), Some(150.0)),
        ("just before the guard of 100 ms", trace(&[(399, 11.0)]), Some(399.0)),
        ("in the guard", trace(&[(400, 11.0)]), None),
        ("at the very end", trace(&[(499, 11.0)]), None),
        ("not a number is outside", trace(&[(70, f64::NAN)]), Some(70.0)),
        ("empty", vec![], None),
        ("no longer than the guard", vec![0.0; 100], None),
        ("one sample longer than the guard", vec![0.0; 101], Some(0.0)),
    ];
    for (case, error_nm, expected) in cases {
        assert_eq!(settling_time_ms(&error_nm, RATE_HZ, 10.0, GUARD_S), expected, "{case}");
    }
}

#[test]
fn a_rate_that_is_not_positive_and_finite_settles_nothing() {
    for rate_hz in [0.0, -8000.0, f64::NAN, f64::INFINITY] {
        assert_eq!(settling_time_ms(&trace(&[]), rate_hz, 10.0, GUARD_S), None, "{rate_hz}");
    }
}

#[test]
fn time_is_counted_in_samples_of_the_given_rate() {
    let error_nm: Vec<f64> = (0..8000).map(|i| if i <= 3 { 20.0 } else { 0.0 }).collect();
    assert_eq!(settling_time_ms(&error_nm, 8000.0, 10.0, GUARD_S), Some(0.375));
}

#[test]
fn unsettled_moves_are_counted_and_enter_no_mean() {
    // Tolerance 3: 10, 20 and one unsettled; tolerance 5: 4, 7, 10; tolerance 10: one settled; tolerance 20: none.
    let rows = [
        vec![Some(10.0), Some(4.0), None, None],
        vec![None, Some(7.0), Some(2.0), None],
        vec![Some(20.0), Some(10.0), None, None],
    ];
    let config = Config::new("pid", &[3, 5, 10, 20], &rows, Some(0.48123));
    assert_eq!(config.mean_ms, [Some(15.0), Some(7.0), Some(2.0), None]);
    // Sample deviations: √(2·5²/1) = 7.071, √((3² + 0 + 3²)/2) = 3.
    assert_eq!(config.std_ms, [Some(7.071), Some(3.0), None, None]);
    assert_eq!(config.unsettled, [1, 0, 2, 3]);
    assert_eq!(config.in_position_rms_nm, Some(0.481));
}

#[test]
fn ragged_and_senseless_times_are_unsettled() {
    let config = Config::new("pid", &[3, 5], &[vec![Some(1.0)], vec![Some(f64::NAN), Some(2.0), Some(9.0)]], None);
    assert_eq!(config.settling_ms, [[Some(1.0), None], [None, Some(2.0)]]);
    assert_eq!(config.unsettled, [1, 1]);
}

#[test]
fn reduction_compares_the_second_configuration_with_the_first() {
    let config = |name, times: &[Option<f64>]| Config::new(name, &[3, 5, 10, 20], &[times.to_vec()], None);
    let pid = config("pid", &[Some(400.0), Some(300.0), Some(0.0), None]);
    let niasa = config("pid+niasa", &[Some(100.0), Some(399.0), Some(0.0), Some(1.0)]);
    let experiment = SettlingExperiment::new(&[3, 5, 10, 20], vec![pid.clone(), niasa]);
    assert_eq!(experiment.reduction_percent, [Some(75.0), Some(-33.0), None, None]);
    assert_eq!(experiment.moves, 1);
    assert_eq!(SettlingExperiment::new(&[3, 5, 10, 20], vec![pid]).reduction_percent, [None; 4]);
}

#[test]
fn in_position_is_the_half_second_after_settling_to_the_finest_tolerance() {
    // 0.1 s far outside, 0.5 s at 2 nm, then 0.4 s at 1 nm which the window does not reach.
    let error_nm: Vec<f64> = (0..1000)
        .map(|i| {
            if i < 100 {
                1e3
            } else if i < 600 {
                -2.0
            } else {
                1.0
            }
        })
        .collect();
    let settled = Config::from_errors("pid", &[10, 3], std::slice::from_ref(&error_nm), RATE_HZ);
    assert_eq!(settled.settling_ms, [[Some(99.0), Some(99.0)]]);
    assert_eq!(settled.in_position_rms_nm, Some(2.0));

    // A second move that never settles to ±3 nm adds nothing; a third at 1 nm all through: √((4 + 1) / 2).
    let moves = [error_nm, vec![5.0; 1000], vec![1.0; 1000]];
    let config = Config::from_errors("pid", &[10, 3], &moves, RATE_HZ);
    assert_eq!(config.in_position_rms_nm, Some(1.581));
    assert_eq!(config.unsettled, [0, 1]);
}

#[test]
fn json_is_reproduced_to_the_byte_and_read_back() {
    let tolerances_nm = [3, 5];
    let pid =
        Config::new("pid", &tolerances_nm, &[vec![None, Some(412.375)], vec![None, Some(100.0)]], Some(0.5304999));
    let niasa =
        Config::new("pid+niasa", &tolerances_nm, &[vec![Some(70.125), Some(60.0)], vec![Some(80.0), None]], None);
    let run = BoardRun {
        target: "stm32h743zi".into(),
        elf_sha256: "00ff".into(),
        settling: SettlingExperiment::new(&tolerances_nm, vec![pid, niasa]),
        servo_tick: ServoTick::new(8000, 96_000, 0, 12.34567),
        told: vec!["RCC: \"explained\"".into()],
    };
    let expected = concat!(
        r#"{"target":"stm32h743zi","elf_sha256":"00ff","moves":2,"tolerances_nm":[3,5],"configs":["#,
        r#"{"name":"pid","settling_ms":[[null,412.375],[null,100.0]],"mean_ms":[null,256.188],"std_ms":[null,220.882],"#,
        r#""unsettled":[2,0],"in_position_rms_nm":0.53},"#,
        r#"{"name":"pid+niasa","settling_ms":[[70.125,60.0],[80.0,null]],"mean_ms":[75.063,60.0],"std_ms":[6.983,null],"#,
        r#""unsettled":[0,1],"in_position_rms_nm":null}],"#,
        r#""reduction_percent":[null,76.58],"#,
        r#""servo_tick":{"rate_hz":8000,"count":96000,"overruns":0,"max_us":12.346},"told":["RCC: \"explained\""]}"#
    );
    let json = run.to_json().unwrap();
    assert_eq!(json, expected);
    assert_eq!(serde_json::from_str::<BoardRun>(&json).unwrap(), run);
}

#[test]
fn rounding_never_leaves_a_negative_zero() {
    assert_eq!(round_to(-0.0004, 3).to_bits(), 0.0f64.to_bits());
    assert_eq!(round_to(-0.0005, 3), -0.001);
    assert_eq!(round_to(2.34567, 2), 2.35);
}

proptest! {
    #[test]
    fn a_wider_tolerance_never_takes_longer(error_nm in prop::collection::vec(-200.0..200.0f64, 1..2000)) {
        let decaying: Vec<f64> = error_nm.iter().enumerate().map(|(i, e)| e * (-(i as f64) / 300.0).exp()).collect();
        let times: Vec<f64> = TOLERANCES_NM
            .iter()
            .map(|&tol| settling_time_ms(&decaying, RATE_HZ, f64::from(tol), GUARD_S).unwrap_or(f64::INFINITY))
            .collect();
        prop_assert!(times.windows(2).all(|w| w[0] >= w[1]), "{times:?}");
    }

    #[test]
    fn after_the_settling_time_every_sample_is_inside(error_nm in prop::collection::vec(-12.0..12.0f64, 101..400)) {
        if let Some(ms) = settling_time_ms(&error_nm, RATE_HZ, 10.0, GUARD_S) {
            let last = ms.round() as usize;
            prop_assert!(error_nm[last + 1..].iter().all(|e| e.abs() <= 10.0));
            prop_assert!(last == 0 || error_nm[last].abs() > 10.0);
        }
    }
}
