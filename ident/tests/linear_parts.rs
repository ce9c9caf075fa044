//! Margins, second-order loop, plant, length scale and move: each on a case whose answer is known.

mod common;

use std::f64::consts::TAU;

use servo_ident::frf::{self, Complex64, Point};
use servo_ident::length_scale::{End, Extreme, Swing};
use servo_ident::{DataError, length_scale, move_check};
use servo_sim::random::{Noise, Purpose};

fn response(of: impl Fn(Complex64) -> Complex64) -> Vec<Point> {
    let frequencies = (0..200).map(|i| 2.0 * libm::pow(1_000.0, f64::from(i) / 199.0));
    frequencies.map(|hz| Point { frequency_hz: hz, value: of(Complex64::new(0.0, TAU * hz)) }).collect()
}

/// PD on a mass with delay: crossover and margins from the formulas, not from the code.
fn loop_transmission(s: Complex64) -> Complex64 {
    let (mass, kp, kd, delay) = (1.8, 4.31e5, 912.0, 150e-6);
    (kp + kd * s) / (mass * s * s) * (-delay * s).exp()
}

#[test]
fn margins_of_a_mass_with_pd_and_delay() {
    let margins = frf::margins(&response(loop_transmission)).unwrap();
    let at = |hz: f64| loop_transmission(Complex64::new(0.0, TAU * hz));
    assert!((at(margins.crossover_hz).norm() - 1.0).abs() < 1e-3);
    assert!((margins.phase_margin_deg - 180.0 - at(margins.crossover_hz).arg().to_degrees()).abs() < 0.05);
    // The phase is −180° where tan(ω k_D/k_P…) equals the delay's: found by bisection.
    let (mut low, mut high) = (200.0, 1900.0);
    for _ in 0..60 {
        let middle = 0.5 * (low + high);
        if at(middle).im < 0.0 { low = middle } else { high = middle }
    }
    let expected_db = -20.0 * at(low).norm().log10();
    assert!((margins.gain_margin_db.unwrap() - expected_db).abs() < 0.05, "{margins:?} {expected_db}");
    let peak = (20..20_000).map(|i| 1.0 / (at(f64::from(i) / 10.0) + 1.0).norm()).fold(0.0, f64::max);
    assert!((margins.sensitivity_peak / peak - 1.0).abs() < 0.01, "{margins:?} {peak}");
}

/// A stage that its friction holds like a spring: near its resonance the gain reaches 1, far from −180° on the side of lead.
#[test]
fn lead_at_the_crossover_is_no_lag_of_almost_a_turn() {
    let point = |frequency_hz: f64, gain: f64, phase_deg: f64| Point {
        frequency_hz,
        value: Complex64::from_polar(gain, phase_deg.to_radians()),
    };
    for (phase_deg, margin_deg) in [(32.0, 148.0), (-110.0, 70.0), (80.0, 100.0), (-190.0, -10.0), (150.0, -30.0)] {
        let loop_transmission =
            [point(200.0, 1.3, phase_deg), point(300.0, 1.0, phase_deg), point(400.0, 0.7, phase_deg)];
        let margins = frf::margins(&loop_transmission).unwrap();
        assert!((margins.phase_margin_deg - margin_deg).abs() < 1e-6, "{phase_deg}°: {margins:?}");
    }
}

#[test]
fn a_loop_that_never_crosses_has_no_margins() {
    let quiet = response(|s| 1e-5 * loop_transmission(s));
    assert!(matches!(frf::margins(&quiet), Err(DataError::Undetermined { what: "crossover_hz", .. })));
    let mut disordered = response(loop_transmission);
    disordered.swap(3, 4);
    assert!(matches!(frf::margins(&disordered), Err(DataError::OutOfRange { field: "frequency_hz", .. })));
    disordered[7].value = Complex64::new(f64::NAN, 0.0);
    assert!(matches!(frf::margins(&disordered), Err(DataError::NotFinite { field: "re", sample: 7, .. })));
}

#[test]
fn a_loop_of_second_order_is_itself() {
    for (natural_hz, damping) in [(62.0, 0.15), (100.0, 0.5), (300.0, 1.2)] {
        let exact = frf::SecondOrder { natural_hz, damping, rms: 0.0 };
        let fit = frf::second_order(&response(|s| exact.at(s.im / TAU))).unwrap();
        assert!((fit.natural_hz / natural_hz - 1.0).abs() < 1e-6, "{fit:?}");
        assert!((fit.damping / damping - 1.0).abs() < 1e-6, "{fit:?}");
        assert!(fit.rms < 1e-6);
    }
}

#[test]
fn mass_and_resonance_of_a_plant() {
    // Two masses on a spring: resonance at 600 Hz, damping 2 %, 1.8 kg in all below.
    let (total, mode_hz, share) = (1.8, 600.0, 0.2);
    let plant = response(|s| {
        let w = TAU * mode_hz;
        1.0 / (total * s * s) + share / total / (s * s + 2.0 * 0.02 * w * s + w * w)
    });
    let mass = frf::mass_kg(&plant, [5.0, 100.0]).unwrap();
    assert!((mass / total - 1.0).abs() < 0.01, "{mass}");
    let found = frf::resonances(&plant, 6.0).unwrap();
    assert_eq!(found.len(), 1, "{found:?}");
    assert!((found[0].frequency_hz / mode_hz - 1.0).abs() < 0.04, "{found:?}");
    // Small motions: friction's spring, no mass.
    let spring = response(|s| 1.0 / (total * s * s + 17.3e6));
    assert!(matches!(frf::mass_kg(&spring, [5.0, 100.0]), Err(DataError::Undetermined { what: "mass_kg", .. })));
    let friction = frf::resonances(&spring, 6.0).unwrap();
    assert!((friction[0].frequency_hz / ((17.3e6f64 / total).sqrt() / TAU) - 1.0).abs() < 0.04, "{friction:?}");
}

/// The worked example of section 5.3: extremes every 8 ms until −637 nm, then 23 and 67 ms.
#[test]
fn the_length_scale_of_the_worked_example_is_637_nanometres() {
    let extremes = [
        (0.0, -100_000.0),
        (8.0, 45_000.0),
        (16.0, -14_000.0),
        (24.0, 3_810.0),
        (32.0, -637.0),
        (55.0, 115.0),
        (122.0, 19.0),
    ];
    let mut noise = Noise::new(1, Purpose::Encoder, 0);
    let (time_s, position_m): (Vec<f64>, Vec<f64>) = (0..1_000)
        .map(|i| {
            let ms = f64::from(i) / 8.0;
            let (a, b) =
                extremes.windows(2).map(|w| (w[0], w[1])).find(|(_, b)| ms < b.0).unwrap_or((extremes[5], extremes[6]));
            let way = ((ms - a.0) / (b.0 - a.0)).min(1.0);
            let nm = a.1 + (b.1 - a.1) * 0.5 * (1.0 - libm::cos(std::f64::consts::PI * way));
            (ms * 1e-3, 100e-6 + (nm + 0.44 * noise.normal()) * 1e-9)
        })
        .unzip();
    let swing = Swing::of(&time_s, &position_m, 100e-6).unwrap();
    let found = length_scale::find(&swing, 8e-3, length_scale::USUAL_FACTOR).unwrap();
    assert_eq!((found.end, found.at), (End::Untimely, 3));
    assert!((found.length_m - 637e-9).abs() < 5e-9, "{found:?}");
    assert!((found.linear_from_m - 3.81e-6).abs() < 20e-9, "{found:?}");
    // The top of an extreme is flat: with noise its time is known to a millisecond or two.
    assert!((found.leg_s - 23e-3).abs() < 2e-3, "{found:?}");
    let patient = length_scale::find(&swing, 60e-3, length_scale::USUAL_FACTOR);
    assert!(matches!(patient, Err(DataError::Undetermined { what: "length_m", .. })), "{patient:?}");
}

/// Where friction is stronger than the proportional force the swing ends early, and the integral creeps the rest.
#[test]
fn a_stage_that_creeps_from_its_last_extreme_shows_its_length_scale_there() {
    let extreme = |time_s: f64, nm: f64| Extreme { time_s, error_m: nm * 1e-9 };
    let swing = Swing { extremes: vec![extreme(8e-3, 20_000.0), extreme(16e-3, -4_760.0)], settled_s: 0.4 };
    let found = length_scale::find(&swing, 8e-3, length_scale::USUAL_FACTOR).unwrap();
    assert!(found.end == End::Creeps && found.length_m == 4_760e-9 && (found.leg_s - 0.384).abs() < 1e-9, "{found:?}");
    // Whether it rings where friction has stopped it makes no difference, and neither does when it gets there.
    for stopped_s in [17e-3, 24e-3] {
        let rings =
            [extreme(stopped_s, -1_216.0), extreme(stopped_s + 1e-3, -1_230.0), extreme(stopped_s + 2e-3, -1_217.0)];
        let rings = Swing { extremes: [&swing.extremes[..], &rings].concat(), settled_s: 0.4 };
        let found = length_scale::find(&rings, 8e-3, length_scale::USUAL_FACTOR).unwrap();
        assert!(found.end == End::Short && found.length_m == 4_760e-9, "{found:?}");
        assert!((found.leg_s - (stopped_s - 16e-3)).abs() < 1e-9, "{found:?}");
    }
    // Thrown back across the target after a millisecond: friction's spring.
    let thrown = Swing { extremes: [&swing.extremes[..], &[extreme(17e-3, 200.0)]].concat(), settled_s: 0.4 };
    let found = length_scale::find(&thrown, 8e-3, length_scale::USUAL_FACTOR).unwrap();
    assert!(found.end == End::Untimely && found.length_m == 4_760e-9 && (found.leg_s - 1e-3).abs() < 1e-9, "{found:?}");
    // With its first extreme already there is nothing linear to compare with; without one there is no swing.
    for (extremes, settled_s) in [(vec![extreme(8e-3, 900.0)], 0.4), (Vec::new(), 0.0)] {
        let refused = length_scale::find(&Swing { extremes, settled_s }, 8e-3, length_scale::USUAL_FACTOR);
        assert!(matches!(refused, Err(DataError::Undetermined { what: "length_m", .. })), "{refused:?}");
    }
}

/// 5 mm forth and back at 5 m/s² with viscous and Coulomb friction and noise.
fn shuttle(force_constant_n_per_a: f64) -> [Vec<f64>; 3] {
    let (mass, viscous, coulomb, acceleration) = (1.8, 3.0, 0.64, 5.0);
    let mut noise = Noise::new(2, Purpose::Encoder, 0);
    let (mut time_s, mut position_m, mut current_a) = (vec![], vec![], vec![]);
    let (mut x, mut v) = (0.0, 0.0);
    let dt = 125e-6;
    for i in 0..4_000 {
        // Four quarters, with rests between the two moves.
        let a = match i % 2_000 {
            0..500 => acceleration,
            500..1000 => -acceleration,
            _ => 0.0,
        } * if i < 2_000 { 1.0 } else { -1.0 };
        let friction = if v == 0.0 { 0.0 } else { coulomb * f64::signum(v) };
        time_s.push(f64::from(i) * dt);
        position_m.push(x + 0.44e-9 * noise.normal());
        current_a.push((mass * a + viscous * v + friction + 0.1 + 5e-3 * noise.normal()) / force_constant_n_per_a);
        x += (v + 0.5 * a * dt) * dt;
        v += a * dt;
        if v.abs() < 1e-9 {
            v = 0.0;
        }
    }
    [time_s, position_m, current_a]
}

#[test]
fn a_move_tells_mass_friction_and_force_constant() {
    let [time_s, position_m, current_a] = shuttle(7.8);
    let fit = move_check::fit(&time_s, &position_m, &current_a, 7.8).unwrap();
    assert!((fit.mass_kg / 1.8 - 1.0).abs() < 5e-3, "{fit:?}");
    assert!((fit.viscous_n_s_per_m / 3.0 - 1.0).abs() < 0.05, "{fit:?}");
    assert!((fit.coulomb_n / 0.64 - 1.0).abs() < 0.02, "{fit:?}");
    assert!((fit.offset_n - 0.1).abs() < 0.01, "{fit:?}");
    // With a force constant that is 5 % wrong the mass is, too; the known mass tells.
    let wrong = move_check::fit(&time_s, &position_m, &current_a, 7.8 * 1.05).unwrap();
    assert!((wrong.force_constant_n_per_a(7.8 * 1.05, 1.8) / 7.8 - 1.0).abs() < 5e-3);
    let error = move_check::fit(&time_s, &position_m, &current_a, -7.8).unwrap_err();
    assert!(matches!(error, DataError::WrongSign { field: "force-constant", .. }), "{error}");
}

#[test]
fn a_move_in_one_direction_does_not_tell_friction_from_an_offset() {
    let [time_s, position_m, current_a] = shuttle(7.8).map(|column| column[..1_900].to_vec());
    assert_eq!(move_check::fit(&time_s, &position_m, &current_a, 7.8).unwrap_err(), DataError::NoReversal);
}
