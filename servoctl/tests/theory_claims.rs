//! Chapter 7's statements, one test each, by section and figure. Where the text gives no number, the number here says
//! what the words are taken to mean.

use servoctl::theory::figures::{DELTA, DELTAS, E0_XC, KP_RATIOS, Map, curve_plot, curves};
use servoctl::theory::mass::{Case, Response, Verdict};
use servoctl::theory::{Method, TheoryError, massless};
use std::sync::LazyLock;

/// Both halves of figures 34 to 44: observer and NIASA.
static MAPS: LazyLock<Vec<(f64, Map, Map)>> = LazyLock::new(|| {
    let map = |method, kp_ratio| Map::new(method, kp_ratio, 39, 61).unwrap();
    KP_RATIOS.map(|k| (k, map(Method::Observer, k), map(Method::Niasa, k))).to_vec()
});

fn respond(method: Method, delta: f64) -> Response {
    Case::thesis(method, delta).respond().unwrap()
}

fn settling_ms(method: Method, delta: f64) -> f64 {
    respond(method, delta).settling_time_s.unwrap_or_else(|| panic!("{method:?} {delta}")) * 1e3
}

// Section 7.4

#[test]
fn the_spread_of_measured_stiffness_gives_the_range_of_delta() {
    let (nominal, least, most) = (8.46, 4.17, 16.79);
    assert!((least / nominal - 1.0f64 - DELTA.0).abs() < 0.02);
    assert!((most / nominal - 1.0f64 - DELTA.1).abs() < 0.02);
}

// Section 7.5, figures 34 to 44

#[test]
fn with_a_perfect_model_both_methods_settle_in_ln_50_time_constants() {
    for method in [Method::Observer, Method::Niasa] {
        for kp_ratio in KP_RATIOS {
            let settling = massless::Case { method, kp_ratio, e0_xc: 0.7, delta: 0.0 }.settle().unwrap();
            assert!((settling.settling_time_tau.unwrap() - 50f64.ln()).abs() < 1e-12);
            assert!(settling.change_percent.unwrap().abs() < 1e-10);
        }
    }
}

#[test]
fn the_observer_has_an_unstable_region_up_to_kp_0_407_and_none_from_0_549() {
    for (kp_ratio, observer, _) in &*MAPS {
        assert_eq!(observer.unstable_share() > 0.0, *kp_ratio <= 0.407, "k_P = {kp_ratio} σ");
    }
}

#[test]
fn niasa_is_stable_everywhere() {
    for (kp_ratio, _, niasa) in &*MAPS {
        assert_eq!(niasa.unstable_share(), 0.0, "k_P = {kp_ratio} σ");
    }
}

#[test]
fn niasa_is_less_sensitive_at_every_gain_distance_and_delta() {
    for (kp_ratio, observer, niasa) in &*MAPS {
        for (i, change) in niasa.change_percent.iter().enumerate() {
            let Some(observer_change) = observer.change_percent[i] else { continue };
            assert!(change.unwrap().abs() <= observer_change.abs() + 1e-9, "k_P = {kp_ratio} σ, cell {i}");
        }
    }
}

#[test]
fn more_proportional_gain_means_less_sensitivity() {
    let spans: Vec<[f64; 2]> =
        MAPS.iter().map(|(_, observer, niasa)| [observer, niasa].map(|map| map.extremes_percent().1)).collect();
    assert!(spans.windows(2).all(|w| w[1][0] < w[0][0] && w[1][1] < w[0][1]), "{spans:?}");
}

#[test]
fn the_observer_exceeds_a_thousand_percent_in_the_upper_left_corner_of_the_two_lowest_gains_only() {
    for (kp_ratio, observer, _) in &*MAPS {
        assert_eq!(observer.extremes_percent().1 > 1000.0, *kp_ratio <= 0.0675, "k_P = {kp_ratio} σ");
        let corner = massless::Case { method: Method::Observer, kp_ratio: *kp_ratio, e0_xc: E0_XC.0, delta: DELTA.1 };
        let highest = corner.settle().unwrap().change_percent.unwrap();
        assert!((highest - observer.extremes_percent().1).abs() < 1e-9, "k_P = {kp_ratio} σ");
    }
}

#[test]
fn the_observer_has_a_second_unstable_zone_in_the_upper_right_up_to_kp_0_091() {
    for kp_ratio in KP_RATIOS {
        let corner = massless::Case { method: Method::Observer, kp_ratio, e0_xc: E0_XC.1, delta: DELTA.1 };
        assert_eq!(!corner.settle().unwrap().stable, kp_ratio <= 0.091, "k_P = {kp_ratio} σ");
    }
}

#[test]
fn an_unstable_case_has_no_settling_time() {
    let case = massless::Case { method: Method::Observer, kp_ratio: 0.3, e0_xc: 0.5, delta: -0.3 };
    let settling = case.settle().unwrap();
    assert_eq!((settling.stable, settling.settling_time_tau, settling.change_percent), (false, None, None));
}

// Section 7.6, figures 45 to 54

#[test]
fn figure_45_observer_and_niasa_swing_slightly_and_the_observer_more_slowly() {
    let [observer, niasa] = [Method::Observer, Method::Niasa].map(|method| respond(method, 0.0));
    assert!(observer.peak_after_crossing < 0.05 && niasa.peak_after_crossing < 0.05);
    // Swings about the exponential, from one minimum of the error's velocity to the next.
    let period_s = |response: &Response| {
        let errors: Vec<f64> = response.sampled(0.02, 4000).iter().map(|point| point.1).collect();
        let slope: Vec<f64> = errors.windows(2).map(|w| w[1] - w[0]).collect();
        let minima: Vec<usize> =
            (1..slope.len() - 1).filter(|&i| slope[i] < slope[i - 1] && slope[i] < slope[i + 1]).collect();
        (minima[1] - minima[0]) as f64 * 0.02 / 4000.0
    };
    assert!(period_s(&observer) > 2.0 * period_s(&niasa), "{} {}", period_s(&observer), period_s(&niasa));
}

#[test]
fn figures_46_to_49_niasa_settles_faster_than_the_observer() {
    for delta in [0.1, 0.25, 0.5, 1.0] {
        let (observer_ms, niasa_ms) = (settling_ms(Method::Observer, delta), settling_ms(Method::Niasa, delta));
        assert!(niasa_ms < 0.7 * observer_ms, "δ = {delta}: {niasa_ms} {observer_ms}");
    }
}

#[test]
fn figures_46_to_49_the_massless_curve_is_near_the_one_with_mass() {
    for delta in [0.1, 0.25, 0.5, 1.0] {
        for method in [Method::Observer, Method::Niasa] {
            let case = Case::thesis(method, delta);
            let response = case.respond().unwrap();
            for (time_tau, error_xc) in case.massless().course(20.0).unwrap() {
                let error_m = error_xc * case.coulomb_n / case.sigma_n_per_m;
                let apart = (response.error_at_m(time_tau / case.inv_tau_d_per_s) - error_m).abs() / case.r_m;
                assert!(apart < 0.16, "{method:?} δ = {delta}: {apart} r at {time_tau} τ_d");
            }
        }
    }
}

#[test]
fn niasa_is_less_sensitive_to_a_softer_model_with_mass_too() {
    let growth = |method| settling_ms(method, 1.0) / settling_ms(method, 0.0);
    assert!(growth(Method::Niasa) < 2.0 && growth(Method::Observer) > 2.5);
}

#[test]
fn figure_50_the_observer_rings_where_massless_theory_promises_faster_settling() {
    let case = Case::thesis(Method::Observer, -0.05);
    let response = case.respond().unwrap();
    assert!(case.massless().settle().unwrap().change_percent.unwrap() < 0.0);
    assert_eq!(response.verdict, Verdict::Settles);
    assert!(response.peak_after_crossing > 0.2, "{}", response.peak_after_crossing);
    assert!(response.settling_time_s.unwrap() * 1e3 > 3.0 * settling_ms(Method::Observer, 0.0));
    assert!(settling_ms(Method::Niasa, -0.05) < 1.1 * settling_ms(Method::Niasa, 0.0));
}

#[test]
fn figure_51_the_observer_swings_for_ever_where_massless_theory_promises_faster_settling() {
    let case = Case::thesis(Method::Observer, -0.1);
    let response = case.respond().unwrap();
    assert!(case.massless().settle().unwrap().change_percent.unwrap() < 0.0);
    assert_eq!((response.verdict, response.settling_time_s), (Verdict::LimitCycle, None));
    assert!(response.peak_after_crossing > 1.0, "substantial: {}", response.peak_after_crossing);
    assert_eq!(respond(Method::Niasa, -0.1).verdict, Verdict::Settles);
}

#[test]
fn figures_52_to_54_the_observer_is_unstable_with_and_without_mass() {
    for delta in [-0.3, -0.5, -0.65] {
        let case = Case::thesis(Method::Observer, delta);
        assert!(!case.massless().settle().unwrap().stable);
        assert_eq!(case.respond().unwrap().verdict, Verdict::LimitCycle, "δ = {delta}");
    }
}

#[test]
fn figures_52_and_53_niasa_rings_more_and_more_but_settles() {
    let peaks = [0.0, -0.05, -0.1, -0.3, -0.5].map(|delta| {
        let response = respond(Method::Niasa, delta);
        assert_eq!(response.verdict, Verdict::Settles, "δ = {delta}");
        response.peak_after_crossing
    });
    assert!(peaks.windows(2).all(|w| w[0] < w[1]), "{peaks:?}");
    assert!(peaks[3] < 0.1 && peaks[4] > 0.1, "slight at −0.3, significant at −0.5: {peaks:?}");
}

#[test]
fn figure_54_niasa_is_unstable_with_mass_only() {
    let case = Case::thesis(Method::Niasa, -0.65);
    assert!(case.massless().settle().unwrap().stable);
    assert_eq!(case.respond().unwrap().verdict, Verdict::LimitCycle);
}

#[test]
fn the_verdicts_do_not_hang_on_the_settling_distance_below_half_a_characteristic_length() {
    for share in [0.02, 0.1, 0.25] {
        for (method, delta, verdict) in [
            (Method::Observer, -0.05, Verdict::Settles),
            (Method::Observer, -0.1, Verdict::LimitCycle),
            (Method::Niasa, -0.5, Verdict::Settles),
            (Method::Niasa, -0.65, Verdict::LimitCycle),
        ] {
            let case = Case { r_m: share * 0.6 / 8.46e6, ..Case::thesis(method, delta) };
            assert_eq!(case.respond().unwrap().verdict, verdict, "{method:?} δ = {delta} r = {share} x_c");
        }
    }
}

/// Section 8.1.2 limits the rate of the integral action for large moves. This is why: after a reversal in gross motion the
/// schedule is at its highest while the error is large, and a swing of some 65 x_c keeps itself up, with a perfect model.
#[test]
fn without_a_rate_limit_niasa_swings_for_ever_once_it_starts_far_away() {
    let from = |r_m| Case { r_m, ..Case::thesis(Method::Niasa, 0.0) }.respond().unwrap();
    assert_eq!(from(1e-6).verdict, Verdict::Settles);
    let amplitudes_m = [1e-5, 1e-4, 1e-3].map(|r_m| {
        let response = from(r_m);
        assert_eq!(response.verdict, Verdict::LimitCycle, "r = {r_m} m");
        response.reversals.last().unwrap().error_m.abs()
    });
    assert!(amplitudes_m.iter().all(|a| (a - 4.626e-6).abs() < 0.01e-6), "{amplitudes_m:?}");
    let observer = Case { r_m: 1e-4, ..Case::thesis(Method::Observer, 0.0) };
    assert_eq!(observer.respond().unwrap().verdict, Verdict::Settles);
}

/// Small swings about a rest without friction force see constant slopes, σ(1+δ) and σ. Routh's criterion for the
/// third-order error equation then gives the edge of stability: k_D (slope + k_P) = m k_I.
#[test]
fn the_edge_of_stability_is_rouths_for_small_swings() {
    let respond = |method, delta| Case { r_m: 1e-10, ..Case::thesis(method, delta) }.respond().unwrap();
    let nominal = Case::thesis(Method::Observer, 0.0);
    let needed = |integral: f64| integral * nominal.mass_kg * nominal.inv_tau_d_per_s / nominal.kd_n_s_per_m;
    let (sigma, kp) = (nominal.sigma_n_per_m, nominal.kp_n_per_m);
    let observer = (needed(kp) - kp) / sigma;
    let niasa = (needed(sigma + kp) - kp) / sigma - 1.0;
    for (method, edge) in [(Method::Observer, observer), (Method::Niasa, niasa)] {
        assert_eq!(respond(method, edge + 0.003).verdict, Verdict::Settles, "{method:?} above {edge}");
        assert_eq!(respond(method, edge - 0.003).verdict, Verdict::LimitCycle, "{method:?} below {edge}");
    }
}

// What the functions promise

#[test]
fn plant_and_model_keep_their_own_friction_force_through_a_reversal() {
    let case = Case::thesis(Method::Niasa, -0.5);
    let (mut from_m, mut direction, mut forces_n) = (case.r_m, 1.0, [0.0, 0.0]);
    for reversal in case.respond().unwrap().reversals.iter().take(20) {
        let travel_m = from_m - reversal.error_m;
        assert!(travel_m * direction > 0.0, "each motion goes the other way: {reversal:?}");
        for (force_n, sigma) in forces_n.iter_mut().zip([case.plant_sigma_n_per_m(), case.sigma_n_per_m]) {
            // Dahl's exponential (7.5) from the force before.
            let goal_n = direction * case.coulomb_n;
            *force_n = goal_n - (goal_n - *force_n) * (-sigma * travel_m.abs() / case.coulomb_n).exp();
        }
        assert!(
            (forces_n[0] - reversal.friction_n).abs() < 1e-12
                && (forces_n[1] - reversal.model_friction_n).abs() < 1e-12
        );
        (from_m, direction) = (reversal.error_m, -direction);
    }
}

#[test]
fn the_error_between_steps_is_smooth_and_starts_at_r() {
    let case = Case::thesis(Method::Observer, -0.05);
    let response = case.respond().unwrap();
    let fine = response.sampled(0.02, 200_000);
    assert_eq!(fine[0], (0.0, case.r_m));
    let second: Vec<f64> = fine.windows(3).map(|w| w[2].1 - 2.0 * w[1].1 + w[0].1).collect();
    let largest = second.iter().fold(0.0f64, |l, s| l.max(s.abs()));
    assert!(second.windows(2).all(|w| (w[1] - w[0]).abs() < 0.01 * largest));
}

#[test]
fn a_loop_that_is_unstable_as_a_free_mass_is_said_to_grow_without_bound() {
    let case = Case { inv_tau_d_per_s: 700.0, r_m: 1e-6, ..Case::thesis(Method::Observer, 0.0) };
    assert_eq!(
        case.respond().unwrap_err().to_string(),
        "the error grows without bound: inv-tau-d = 700 is outside 0 to kd/mass = 566.6666666666666 1/s, \
         where the loop is stable as a free mass"
    );
}

#[test]
fn time_scales_too_far_apart_are_said_to_be() {
    let case = Case { mass_kg: 1e-3, inv_tau_d_per_s: 1e-3, ..Case::thesis(Method::Niasa, 0.0) };
    assert!(matches!(case.respond(), Err(TheoryError::TooLong { .. })));
}

#[test]
fn values_out_of_range_are_named() {
    let case = massless::Case { method: Method::Niasa, kp_ratio: 0.1, e0_xc: 0.5, delta: 0.0 };
    for (case, text) in [
        (massless::Case { kp_ratio: 0.0, ..case }, "kp-ratio = 0 is outside 0.001 to 1000"),
        (massless::Case { e0_xc: -1.0, ..case }, "e0 = -1 is outside 1e-6 to 10 x_c"),
        (massless::Case { delta: -1.0, ..case }, "delta = -1 is outside -0.99 to 10"),
        (massless::Case { delta: f64::NAN, ..case }, "delta = NaN is outside -0.99 to 10"),
    ] {
        assert_eq!(case.settle().unwrap_err().to_string(), text);
        assert!(case.course(1.0).is_err());
    }
    let case = Case::thesis(Method::Niasa, 0.0);
    for (case, name) in [
        (Case { mass_kg: 0.0, ..case }, "mass"),
        (Case { kp_n_per_m: -1.0, ..case }, "kp"),
        (Case { kd_n_s_per_m: f64::INFINITY, ..case }, "kd"),
        (Case { sigma_n_per_m: 0.0, ..case }, "sigma"),
        (Case { coulomb_n: f64::NAN, ..case }, "coulomb"),
        (Case { inv_tau_d_per_s: 0.0, ..case }, "inv-tau-d"),
        (Case { r_m: 0.0, ..case }, "r"),
        (Case { delta: 11.0, ..case }, "delta"),
        (Case { f0_n: 0.6, ..case }, "f0"),
        (Case { f0_model_n: -0.6, ..case }, "f0-model"),
    ] {
        match case.respond() {
            Err(TheoryError::OutOfRange { name: named, .. }) => assert_eq!(named, name),
            other => panic!("{name}: {other:?}"),
        }
    }
}

#[test]
fn the_figures_hold_a_line_for_each_case_that_has_one() {
    for delta in DELTAS {
        let curves = curves(delta, 0.05).unwrap();
        // Without mass the observer has no course where it is unstable from the start.
        assert_eq!(curves.len(), if delta < -0.2 { 4 } else { 5 }, "δ = {delta}");
        let bytes = curve_plot(delta, 0.05).unwrap().svg().len();
        assert!(bytes < 20_000, "{bytes}");
    }
}

#[test]
fn a_map_is_a_small_picture() {
    let bytes = Map::new(Method::Observer, 0.05, 96, 96).unwrap().plot().svg().len();
    assert!(bytes < 40_000, "{bytes}");
}
