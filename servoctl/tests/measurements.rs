//! What the thesis says of its measurements, held against their simulation.

use servo_sim::Stage;
use servoctl::reproduce::campaign::Watch;
use servoctl::reproduce::loop_transmission::{self, Curve};

#[test]
fn the_loop_transmission_depends_on_the_amplitude_as_in_5_1_and_8_2() {
    let found = loop_transmission::run(&Stage::default(), 1, Watch::NOBODY).unwrap().unwrap();

    // Figure 15: a mass above 1 % of full current, a spring with a resonance below.
    for curve in &found.figure_15 {
        let expected = if curve.amplitude_percent > 1.0 { "mass" } else { "spring" };
        assert_eq!(curve.behaves_like, expected, "{} %", curve.amplitude_percent);
        if expected == "spring" {
            assert!(curve.resonance_hz.is_some_and(|hz| (250.0..450.0).contains(&hz)), "{:?}", curve.resonance_hz);
        }
    }
    // Section 8.2: NIASA leaves the large-amplitude loop alone and lifts the first crossover of the small-amplitude one.
    let of =
        |percent: f64| found.section_8_2.iter().filter(move |c| c.amplitude_percent == percent).collect::<Vec<_>>();
    let first = |curve: &Curve| curve.crossover_hz.first().copied().unwrap();
    let large = of(10.0);
    assert!(large.iter().all(|curve| (first(curve) / first(large[0]) - 1.0).abs() < 0.01));
    assert!((first(large[0]) / 315.0 - 1.0).abs() < 0.03);
    let small = of(0.313);
    // Without NIASA there is none above 3 Hz: what is left is the contact's resonance.
    assert!(first(small[0]) > 500.0);
    let [by_4, by_8, by_4_fast, by_8_fast] = [1, 2, 3, 4].map(|i| first(small[i]));
    assert!(4.0 < by_4 && 1.4 * by_4 < by_8 && 1.4 * by_8 < by_4_fast && 1.4 * by_4_fast < by_8_fast);
    // And what the rate limit is for: only without it, with the fast schedule and more delay, does the loop not come to rest.
    for case in &found.stability {
        let harsh = !case.rate_limited && case.a_tick_late && case.rate_per_s > 600.0 && case.stiffness_n_per_m > 6e6;
        assert_eq!(case.stable, !harsh, "{case:?}");
    }
}
