//! The friction models of the drive (`f32`, one step a tick) against those of the simulation (`f64`), which share no code, on random
//! paths: same parameters, same force.

use proptest::prelude::*;
use servo_core::friction as drive;
use servo_core::position::Position;
use servo_sim::friction as truth;

const DT_S: f32 = servo_core::SERVO_DT_S;
const COUNT_M: f64 = 4e-6 / 65_536.0;

const STIFFNESS_N_PER_M: f32 = 8.66e6;
const COULOMB_N: f32 = 0.64;
const DAMPING_N_S_PER_M: f32 = 400.0;
const VISCOUS_N_S_PER_M: f32 = 3.0;

/// Velocities of either sign from 100 nm/s (12 pm a tick) to 0.3 m/s (38 µm a tick), for a few ticks each.
fn path() -> impl Strategy<Value = Vec<f32>> {
    let leg = (-7.0..-0.5f32, any::<bool>(), 1usize..8);
    prop::collection::vec(leg, 1..60).prop_map(|legs| {
        let velocity = |(exponent, forward, _): &(f32, bool, usize)| {
            libm::powf(10.0, *exponent) * if *forward { 1.0 } else { -1.0 }
        };
        legs.iter().flat_map(|leg| std::iter::repeat_n(velocity(leg), leg.2)).collect()
    })
}

/// A curve with and one without Stribeck effect, on both sides.
fn level(falls: bool, stribeck_shape: f32) -> (drive::stribeck::Level, truth::Level) {
    let static_n = if falls { 1.25 * COULOMB_N } else { COULOMB_N };
    let drives = drive::stribeck::Level { coulomb_n: COULOMB_N, static_n, stribeck_m_per_s: 1e-3, stribeck_shape };
    let simulated = truth::Level {
        coulomb_n: f64::from(COULOMB_N),
        static_n: f64::from(static_n),
        stribeck_m_per_s: f64::from(1e-3f32),
        stribeck_shape: f64::from(stribeck_shape),
    };
    (drives, simulated)
}

/// The elements of the drive, widened.
fn elements(of: &drive::maxwell_slip::Elements) -> truth::Elements {
    let list = of.stiffness_n_per_m.iter().zip(&of.saturation_n).filter(|(k, _)| **k > 0.0);
    let list: Vec<_> =
        list.map(|(k, f)| truth::Element { stiffness_n_per_m: f64::from(*k), saturation_n: f64::from(*f) }).collect();
    truth::Elements::new(&list).unwrap()
}

/// Runs both along the path; forces must agree within `tolerance` of the level and of the force itself.
fn compare(
    path: &[f32],
    tolerance: f64,
    mut drives: impl FnMut(f32) -> f32,
    mut simulated: impl FnMut(f64, f64) -> f64,
) -> Result<(), TestCaseError> {
    for (tick, velocity) in path.iter().enumerate() {
        let ours_n = f64::from(drives(*velocity));
        let theirs_n = simulated(f64::from(*velocity) * f64::from(DT_S), f64::from(DT_S));
        let within_n = tolerance * (f64::from(COULOMB_N) + theirs_n.abs());
        prop_assert!(
            (ours_n - theirs_n).abs() <= within_n,
            "tick {} at {} m/s: drive {} N, simulation {} N",
            tick,
            velocity,
            ours_n,
            theirs_n
        );
    }
    Ok(())
}

proptest! {
    #[test]
    fn coulomb(path in path()) {
        let k = drive::coulomb::Coefficients { coulomb_n: COULOMB_N, viscous_n_s_per_m: VISCOUS_N_S_PER_M };
        let mut simulated = truth::Coulomb::new(f64::from(COULOMB_N), f64::from(VISCOUS_N_S_PER_M));
        compare(&path, 1e-6, |v| drive::coulomb::step(&k, v), |dx_m, dt_s| simulated.advance(dx_m, dt_s))?;
    }

    #[test]
    fn stribeck(path in path(), shape in prop::sample::select(vec![0.5, 1.0, 2.0])) {
        let (level, simulated_level) = level(true, shape);
        let k = drive::stribeck::Coefficients { level, viscous_n_s_per_m: VISCOUS_N_S_PER_M };
        let mut simulated = truth::Stribeck::new(simulated_level, f64::from(VISCOUS_N_S_PER_M));
        compare(&path, 1e-6, |v| drive::stribeck::step(&k, v), |dx_m, dt_s| simulated.advance(dx_m, dt_s))?;
    }

    #[test]
    fn dahl_of_any_shape(path in path(), shape in prop::sample::select(vec![0.0, 0.5, 1.0, 1.25, 2.0, 4.0])) {
        let k = drive::shaped_dahl::Coefficients { stiffness_n_per_m: STIFFNESS_N_PER_M, coulomb_n: COULOMB_N, shape };
        let mut simulated = truth::Dahl::with_shape(f64::from(STIFFNESS_N_PER_M), f64::from(COULOMB_N), f64::from(shape));
        let mut drives = drive::shaped_dahl::ShapedDahl::RELAXED;
        compare(&path, 1e-5, |v| drives.step(&k, v, DT_S), |dx_m, _| simulated.advance(dx_m))?;
    }

    #[test]
    fn lugre(path in path(), falls: bool) {
        let (level, simulated_level) = level(falls, 2.0);
        let k = drive::lugre::Coefficients {
            stiffness_n_per_m: STIFFNESS_N_PER_M,
            damping_n_s_per_m: DAMPING_N_S_PER_M,
            viscous_n_s_per_m: VISCOUS_N_S_PER_M,
            level,
        };
        let mut simulated = truth::LuGre::new(truth::lugre::Parameters {
            stiffness_n_per_m: f64::from(STIFFNESS_N_PER_M),
            damping_n_s_per_m: f64::from(DAMPING_N_S_PER_M),
            viscous_n_s_per_m: f64::from(VISCOUS_N_S_PER_M),
            level: simulated_level,
        });
        let mut drives = drive::lugre::LuGre::RELAXED;
        compare(&path, 1e-5, |v| drives.step(&k, v, DT_S), |dx_m, dt_s| simulated.advance(dx_m, dt_s))?;
    }

    #[test]
    fn gms(
        path in path(), falls: bool, damped: bool, (law, tolerance) in prop::sample::select(vec![
            (drive::gms::Law::Attraction { attraction_n_per_s: f32::INFINITY }, 1e-5),
            (drive::gms::Law::Attraction { attraction_n_per_s: 50.0 }, 1e-5),
            (drive::gms::Law::HiddenState { shape: 1.0 }, 1e-5),
            // In pieces.
            (drive::gms::Law::HiddenState { shape: 1.5 }, 3e-4),
            (drive::gms::Law::HiddenState { shape: 2.0 }, 3e-4),
            (drive::gms::Law::HiddenState { shape: 4.0 }, 3e-4),
        ]),
    ) {
        let (level, simulated_level) = level(falls, 2.0);
        let mut listed = drive::maxwell_slip::GMS_TABLE_4;
        for saturation_n in &mut listed.saturation_n {
            *saturation_n *= COULOMB_N / 0.4301;
        }
        let k = drive::gms::Coefficients {
            elements: listed,
            level,
            damping_n_s_per_m: if damped { DAMPING_N_S_PER_M } else { 0.0 },
            viscous_n_s_per_m: VISCOUS_N_S_PER_M,
            law,
        };
        // σ1/dt is two hundred times the stiffness of the softest element, and turns its rounding into force.
        let tolerance = if damped { f64::max(tolerance, 2e-4) } else { tolerance };
        let mut simulated = truth::Gms::new(truth::gms::Parameters {
            elements: elements(&listed),
            level: simulated_level,
            damping_n_s_per_m: f64::from(k.damping_n_s_per_m),
            viscous_n_s_per_m: f64::from(VISCOUS_N_S_PER_M),
            law: match law {
                drive::gms::Law::HiddenState { shape } => truth::gms::Law::HiddenState { shape: f64::from(shape) },
                drive::gms::Law::Attraction { attraction_n_per_s } => {
                    truth::gms::Law::Attraction { attraction_n_per_s: f64::from(attraction_n_per_s) }
                }
            },
        });
        let mut drives = drive::gms::Gms::RELAXED;
        compare(&path, tolerance, |v| drives.step(&k, v, DT_S), |dx_m, dt_s| simulated.advance(dx_m, dt_s))?;
    }

    #[test]
    fn the_models_that_follow_the_measured_position(legs_ct in prop::collection::vec(-40_000i64..40_000, 1..60), steps in 1i64..20) {
        let dahl_k = drive::dahl::Coefficients {
            stiffness_n_per_m: STIFFNESS_N_PER_M,
            coulomb_n: COULOMB_N,
            exponent_per_ct: (f64::from(STIFFNESS_N_PER_M) / f64::from(COULOMB_N) * COUNT_M) as f32,
            hysteresis_ct: 0,
        };
        let listed = drive::maxwell_slip::Elements::like_dahl(12, STIFFNESS_N_PER_M, COULOMB_N);
        let slip_k = drive::maxwell_slip::Coefficients { elements: listed, count_m: COUNT_M as f32, hysteresis_ct: 0 };
        let (mut dahl, mut slip) =
            (drive::dahl::Dahl::relaxed(Position(0)), drive::maxwell_slip::MaxwellSlip::relaxed(Position(0)));
        let mut true_dahl = truth::Dahl::new(f64::from(STIFFNESS_N_PER_M), f64::from(COULOMB_N));
        let mut true_slip = truth::MaxwellSlip::new(12, f64::from(STIFFNESS_N_PER_M), f64::from(COULOMB_N));
        let mut at_ct = 0;
        for leg_ct in legs_ct {
            for _ in 0..steps {
                at_ct += leg_ct / steps;
                dahl.update(&dahl_k, Position(at_ct));
                slip.update(&slip_k, Position(at_ct));
                let dx_m = (leg_ct / steps) as f64 * COUNT_M;
                let (a_n, b_n) = (true_dahl.advance(dx_m), true_slip.advance(dx_m));
                prop_assert!((f64::from(dahl.force_n()) - a_n).abs() < 1e-5, "{} {}", dahl.force_n(), a_n);
                prop_assert!((f64::from(slip.force_n()) - b_n).abs() < 1e-5, "{} {}", slip.force_n(), b_n);
            }
            if leg_ct / steps != 0 {
                let ahead_m = 1e-14f64.copysign(leg_ct as f64);
                let slope_n_per_m = (true_dahl.clone().advance(ahead_m) - true_dahl.force_n()) / ahead_m;
                prop_assert!((f64::from(dahl.slope_n_per_m()) - slope_n_per_m).abs() < 2e4, "{}", slope_n_per_m);
            }
        }
    }
}

#[test]
fn the_slope_of_maxwell_slip_is_that_of_the_simulated_one_between_its_corners() {
    let listed = drive::maxwell_slip::Elements::like_dahl(12, STIFFNESS_N_PER_M, COULOMB_N);
    let k = drive::maxwell_slip::Coefficients { elements: listed, count_m: COUNT_M as f32, hysteresis_ct: 16 };
    let mut slip = drive::maxwell_slip::MaxwellSlip::relaxed(Position(0));
    let mut simulated = truth::MaxwellSlip::new(12, f64::from(STIFFNESS_N_PER_M), f64::from(COULOMB_N));
    let (mut at_ct, mut agree, mut differ) = (0i64, 0, 0);
    // Falling amplitudes: reversals within reversals.
    for turn_ct in [9_000i64, -6_000, 4_000, -2_500, 1_500, -800, 400] {
        let way = (turn_ct - at_ct).signum();
        while at_ct != turn_ct {
            at_ct += way;
            slip.update(&k, Position(at_ct));
            simulated.advance(way as f64 * COUNT_M);
            // Until it has come back by the hysteresis the drive does not know of the reversal.
            if (turn_ct - at_ct).abs() % 100 == 50 {
                let ahead_m = way as f64 * 1e-3 * COUNT_M;
                let slope_n_per_m = (simulated.clone().advance(ahead_m) - simulated.force_n()) / ahead_m;
                let same =
                    (f64::from(slip.slope_n_per_m()) - slope_n_per_m).abs() < 1e-5 * f64::from(STIFFNESS_N_PER_M);
                if same { agree += 1 } else { differ += 1 }
            }
        }
    }
    assert!(agree > 400 && differ <= 3, "{agree} places agree, {differ} (next to a corner) do not");
}

#[test]
fn both_sides_choose_the_same_elements_for_dahls_curve_and_know_the_same_table_4() {
    for count in [1, 2, 7, 12] {
        let ours = elements(&drive::maxwell_slip::Elements::like_dahl(count, STIFFNESS_N_PER_M, COULOMB_N));
        let theirs = truth::MaxwellSlip::new(count, f64::from(STIFFNESS_N_PER_M), f64::from(COULOMB_N));
        assert_eq!(ours.as_slice().len(), count);
        for (a, b) in ours.as_slice().iter().zip(theirs.elements()) {
            assert!((a.stiffness_n_per_m / b.stiffness_n_per_m - 1.0).abs() < 1e-5, "{count}: {a:?} {b:?}");
            assert!((a.saturation_n / b.saturation_n - 1.0).abs() < 1e-5, "{count}: {a:?} {b:?}");
        }
    }
    for (a, b) in elements(&drive::maxwell_slip::GMS_TABLE_4).as_slice().iter().zip(truth::GMS_TABLE_4) {
        assert!((a.stiffness_n_per_m / b.stiffness_n_per_m - 1.0).abs() < 1e-7);
        assert!((a.saturation_n / b.saturation_n - 1.0).abs() < 1e-7);
    }
}
