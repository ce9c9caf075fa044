//! What the friction models have in common, what tells them apart, and which is a special case of which.

use proptest::prelude::*;
use servo_sim::friction::gms::{self, Law};
use servo_sim::friction::lugre;
use servo_sim::friction::{
    Coulomb, Dahl, Element, Elements, Friction, GMS_TABLE_4, Gms, Level, LuGre, MaxwellSlip, Stribeck,
};

const STIFFNESS_N_PER_M: f64 = 8.66e6;
const COULOMB_N: f64 = 0.64;
const DAMPING_N_S_PER_M: f64 = 400.0;
const LEVEL: Level = Level { coulomb_n: COULOMB_N, static_n: 0.8, stribeck_m_per_s: 1e-3, stribeck_shape: 2.0 };
/// As little as keeps the bristles' damping passive: `σ1 (F_s/F_C − 1)`.
const VISCOUS_N_S_PER_M: f64 = DAMPING_N_S_PER_M * 0.25;
const DT_S: f64 = 1e-5;

fn maxwell_slip() -> Friction {
    Friction::MaxwellSlip(MaxwellSlip::new(12, STIFFNESS_N_PER_M, COULOMB_N))
}

fn dahl() -> Friction {
    Friction::Dahl(Dahl::new(STIFFNESS_N_PER_M, COULOMB_N))
}

fn lugre(level: Level, damping_n_s_per_m: f64, viscous_n_s_per_m: f64) -> Friction {
    let stiffness_n_per_m = STIFFNESS_N_PER_M;
    Friction::LuGre(LuGre::new(lugre::Parameters { stiffness_n_per_m, damping_n_s_per_m, viscous_n_s_per_m, level }))
}

/// Table 4, scaled to F_C.
fn gms(law: Law, level: Level, damping_n_s_per_m: f64, viscous_n_s_per_m: f64) -> Friction {
    let elements = Elements::table_4().scaled(1.0, COULOMB_N / Elements::table_4().coulomb_n());
    Friction::Gms(Gms::new(gms::Parameters { elements, level, damping_n_s_per_m, viscous_n_s_per_m, law }))
}

const AT_ONCE: Law = Law::Attraction { attraction_n_per_s: f64::INFINITY };
const SLOWLY: Law = Law::Attraction { attraction_n_per_s: 50.0 };

/// Models that depend on the path only, with and without non-local memory.
fn rate_independent() -> Vec<(&'static str, Friction)> {
    let constant = Level::constant(COULOMB_N);
    let shaped = |shape| Friction::Dahl(Dahl::with_shape(STIFFNESS_N_PER_M, COULOMB_N, shape));
    vec![
        ("coulomb", Friction::Coulomb(Coulomb::new(COULOMB_N, 0.0))),
        ("dahl", dahl()),
        ("dahl, i = 0.5", shaped(0.5)),
        ("dahl, i = 2", shaped(2.0)),
        ("lugre without rate", lugre(constant, 0.0, 0.0)),
        ("maxwell-slip", maxwell_slip()),
        ("gms, table 4", gms(AT_ONCE, constant, 0.0, 0.0)),
        ("gms, hidden state", gms(Law::HiddenState { shape: 1.0 }, constant, 0.0, 0.0)),
        ("gms, hidden state, n = 3", gms(Law::HiddenState { shape: 3.0 }, constant, 0.0, 0.0)),
    ]
}

/// All of the above and those that depend on velocity.
fn all() -> Vec<(&'static str, Friction)> {
    let mut models = rate_independent();
    let (damping, viscous) = (DAMPING_N_S_PER_M, VISCOUS_N_S_PER_M);
    models.extend([
        ("coulomb and viscous", Friction::Coulomb(Coulomb::new(COULOMB_N, 30.0))),
        ("stribeck", Friction::Stribeck(Stribeck::new(LEVEL, 3.0))),
        ("lugre", lugre(LEVEL, damping, viscous)),
        ("gms with stribeck effect", gms(AT_ONCE, LEVEL, damping, 0.0)),
        ("gms with attraction", gms(SLOWLY, LEVEL, damping, 0.0)),
        ("gms with stribeck effect, hidden state", gms(Law::HiddenState { shape: 1.0 }, LEVEL, damping, viscous)),
    ]);
    models
}

/// Moves by `nanometres` in steps of half a nanometre at one velocity; the work done against friction, J, as a mass does it
/// that meets the force at the end of each step.
fn travel(friction: &mut Friction, nanometres: i32, dt_s: f64) -> f64 {
    let dx_m = 0.5e-9 * f64::from(nanometres.signum());
    (0..2 * nanometres.abs()).map(|_| friction.advance(dx_m, dt_s) * dx_m).sum()
}

fn legs() -> impl Strategy<Value = Vec<(i32, f64)>> {
    prop::collection::vec((-300i32..300, (-8.0..-4.0f64).prop_map(|e| libm::pow(10.0, e))), 1..12)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn no_motion_gives_back_more_energy_than_was_stored(legs in legs()) {
        for (name, mut friction) in all() {
            for (nanometres, dt_s) in &legs {
                let before_j = friction.stored_j();
                let work_j = travel(&mut friction, *nanometres, *dt_s);
                // Typical energies are 1e-8 J.
                prop_assert!(work_j - (friction.stored_j() - before_j) >= -1e-20, "{}: {} J", name, work_j);
            }
        }
    }

    #[test]
    fn a_closed_path_costs_energy(mut legs in legs()) {
        legs.push((-legs.iter().map(|(nanometres, _)| nanometres).sum::<i32>(), DT_S));
        for (name, mut friction) in all() {
            let mut round_j = || legs.iter().map(|(nm, dt_s)| travel(&mut friction, *nm, *dt_s)).sum::<f64>();
            // After a few rounds the force is periodic, or wears out towards a periodic one: nothing is left to be given back.
            (0..5).for_each(|_| { round_j(); });
            prop_assert!(round_j() >= -1e-12, "{}", name);
        }
    }

    #[test]
    fn the_force_stays_within_its_level_and_keeps_its_fraction_when_the_level_changes(
        steps_m in prop::collection::vec(-1e-6..1e-6, 1..50), redrawn in (1e6..2e7, 0.1..2.0),
    ) {
        for (name, mut friction) in rate_independent() {
            for dx_m in &steps_m {
                prop_assert!(friction.advance(*dx_m, DT_S).abs() <= COULOMB_N * (1.0 + 1e-12), "{}", name);
            }
            let before_n = friction.force_n();
            friction.set(redrawn.0, redrawn.1);
            prop_assert!((friction.force_n() / redrawn.1 - before_n / COULOMB_N).abs() < 1e-12, "{}", name);
            for dx_m in &steps_m {
                prop_assert!(friction.advance(*dx_m, DT_S).abs() <= redrawn.1 * (1.0 + 1e-12), "{}", name);
            }
        }
    }

    #[test]
    fn a_model_set_to_other_values_is_the_model_made_with_them(
        steps_m in prop::collection::vec(-1e-6..1e-6, 1..50), sigma in 1e6..2e7f64, level_n in 0.1..2.0f64,
    ) {
        let elements = Elements::table_4();
        let of = |law, elements: Elements, level| gms::Parameters { elements, level, law, damping_n_s_per_m: 0.0, viscous_n_s_per_m: 0.0 };
        for law in [AT_ONCE, Law::HiddenState { shape: 1.0 }] {
            let mut set = Gms::new(of(law, elements, LEVEL));
            set.set(3e6, 0.5);
            set.set(sigma, level_n);
            let scaled = elements.scaled(2.0 * sigma / elements.stiffness_n_per_m(), level_n / COULOMB_N);
            let mut made = Gms::new(of(law, scaled, LEVEL.with_coulomb(level_n)));
            for dx_m in &steps_m {
                let (a_n, b_n) = (set.advance(*dx_m, DT_S), made.advance(*dx_m, DT_S));
                prop_assert!((a_n - b_n).abs() < 1e-12, "{} {}", a_n, b_n);
            }
        }
    }

    #[test]
    fn one_endless_element_that_follows_the_hidden_state_is_lugre(
        steps in prop::collection::vec((-3e-6..3e-6, 1e-6..1e-2), 1..60),
    ) {
        let element = Element { stiffness_n_per_m: STIFFNESS_N_PER_M, saturation_n: f64::INFINITY };
        let mut gms = Gms::new(gms::Parameters {
            elements: Elements::new(&[element]).unwrap(),
            level: LEVEL,
            damping_n_s_per_m: DAMPING_N_S_PER_M,
            viscous_n_s_per_m: VISCOUS_N_S_PER_M,
            law: Law::HiddenState { shape: 1.0 },
        });
        let mut lugre = lugre(LEVEL, DAMPING_N_S_PER_M, VISCOUS_N_S_PER_M);
        for (dx_m, dt_s) in steps {
            let (a_n, b_n) = (gms.advance(dx_m, dt_s), lugre.advance(dx_m, dt_s));
            prop_assert!((a_n - b_n).abs() < 1e-9 * (1.0 + b_n.abs()), "{} {}", a_n, b_n);
        }
    }

    #[test]
    fn gms_with_the_elements_of_maxwell_slip_and_a_constant_level_is_maxwell_slip(
        steps_m in prop::collection::vec(-3e-7..3e-7, 1..60), attraction_n_per_s in prop::sample::select(vec![1e-3, 1.0, f64::INFINITY]),
    ) {
        let mut slip = MaxwellSlip::new(12, STIFFNESS_N_PER_M, COULOMB_N);
        let elements = Elements::new(&slip.elements().collect::<Vec<_>>()).unwrap();
        let mut gms = Gms::new(gms::Parameters {
            elements,
            level: Level::constant(elements.coulomb_n()),
            damping_n_s_per_m: 0.0,
            viscous_n_s_per_m: 0.0,
            law: Law::Attraction { attraction_n_per_s },
        });
        for dx_m in steps_m {
            let (a_n, b_n) = (gms.advance(dx_m, DT_S), slip.advance(dx_m));
            prop_assert!((a_n - b_n).abs() < 1e-14, "{} {}", a_n, b_n);
        }
    }
}

/// Force after going to each of the positions in turn, N.
fn forces_n(mut friction: Friction, positions_nm: &[f64]) -> Vec<f64> {
    let mut at_nm = 0.0;
    let go = |to_nm: &f64| {
        let moved_m = (to_nm - std::mem::replace(&mut at_nm, *to_nm)) * 1e-9;
        friction.advance(moved_m, DT_S)
    };
    positions_nm.iter().map(go).collect()
}

#[test]
fn masing_a_reversal_is_the_virgin_curve_at_twice_the_scale_for_parallel_elements_only() {
    for (name, friction, expected) in [
        ("maxwell-slip", maxwell_slip(), true),
        ("gms, table 4", gms(AT_ONCE, Level::constant(COULOMB_N), 0.0, 0.0), true),
        ("dahl", dahl(), false),
        ("lugre", lugre(Level::constant(COULOMB_N), 0.0, 0.0), false),
    ] {
        for (turn_nm, back_nm) in [(1e6, 5.0), (1e6, 100.0), (40.0, 30.0), (40.0, 79.0)] {
            let virgin_n = forces_n(friction.clone(), &[0.5 * back_nm])[0];
            let [turn_n, back_n] = forces_n(friction.clone(), &[turn_nm, turn_nm - back_nm])[..] else {
                unreachable!()
            };
            let off_n = (turn_n - back_n - 2.0 * virgin_n).abs();
            assert!(
                if expected { off_n < 1e-13 } else { off_n > 1e-3 },
                "{name} at {turn_nm} by {back_nm} nm: {off_n} N"
            );
        }
    }
}

#[test]
fn non_local_memory_an_inner_loop_closes_and_is_forgotten_for_parallel_elements_only() {
    for (name, friction, expected) in [
        ("maxwell-slip", maxwell_slip(), true),
        ("gms, table 4", gms(AT_ONCE, Level::constant(COULOMB_N), 0.0, 0.0), true),
        ("dahl", dahl(), false),
        ("lugre", lugre(LEVEL, 0.0, 0.0), false),
    ] {
        // Down the outer branch to −60, up to −30, an inner loop to −45 and back, and on up.
        let looped_n = forces_n(friction.clone(), &[1e6, -60.0, -30.0, -45.0, -30.0, 20.0]);
        let direct_n = forces_n(friction, &[1e6, -60.0, -30.0, 20.0]);
        let closes_n = (looped_n[4] - looped_n[2]).abs();
        let forgets_n = (looped_n[5] - direct_n[3]).abs();
        let wanted = if expected { closes_n < 1e-13 && forgets_n < 1e-13 } else { closes_n > 1e-5 || forgets_n > 1e-5 };
        assert!(wanted, "{name}: {closes_n} N, {forgets_n} N");
    }
}

#[test]
fn presliding_every_spring_starts_at_its_own_stiffness_and_doubles_it_after_saturation_where_it_should() {
    let sum_n_per_m = Elements::table_4().stiffness_n_per_m();
    for (name, mut friction, virgin_n_per_m, reversed_n_per_m) in [
        ("dahl", dahl(), STIFFNESS_N_PER_M, 2.0 * STIFFNESS_N_PER_M),
        ("maxwell-slip", maxwell_slip(), 2.0 * STIFFNESS_N_PER_M, 2.0 * STIFFNESS_N_PER_M),
        ("gms, table 4", gms(AT_ONCE, LEVEL, 0.0, 0.0), sum_n_per_m, sum_n_per_m),
        (
            "gms, hidden state",
            gms(Law::HiddenState { shape: 1.0 }, Level::constant(COULOMB_N), 0.0, 0.0),
            sum_n_per_m,
            2.0 * sum_n_per_m,
        ),
    ] {
        let stiffness_n_per_m = friction.advance(1e-13, DT_S) / 1e-13;
        assert!((stiffness_n_per_m / virgin_n_per_m - 1.0).abs() < 1e-3, "{name}: {stiffness_n_per_m} N/m at first");
        let top_n = friction.advance(1e-2, 1.0);
        let stiffness_n_per_m = (top_n - friction.advance(-1e-13, DT_S)) / 1e-13;
        assert!(
            (stiffness_n_per_m / reversed_n_per_m - 1.0).abs() < 2e-3,
            "{name}: {stiffness_n_per_m} N/m after reversal"
        );
    }
}

#[test]
fn table_4_saturates_element_by_element() {
    let mut friction = gms(AT_ONCE, Level::constant(COULOMB_N), 0.0, 0.0);
    friction.set(0.5 * Elements::table_4().stiffness_n_per_m(), Elements::table_4().coulomb_n());
    let mut at_m = 0.0;
    let mut reaches_m: Vec<f64> = GMS_TABLE_4.iter().map(|e| e.saturation_n / e.stiffness_n_per_m).collect();
    reaches_m.sort_by(f64::total_cmp);
    for to_m in reaches_m.iter().flat_map(|reach_m| [0.99 * reach_m, 1.01 * reach_m]) {
        let force_n = friction.advance(to_m - at_m, DT_S);
        at_m = to_m;
        let expected_n: f64 = GMS_TABLE_4.iter().map(|e| (e.stiffness_n_per_m * to_m).min(e.saturation_n)).sum();
        assert!((force_n - expected_n).abs() < 1e-12, "{to_m} m: {force_n} N, {expected_n} N");
    }
    assert!((friction.force_n() - 0.4301).abs() < 1e-12);
}

#[test]
fn steady_sliding_is_the_stribeck_curve_for_every_model_that_has_one() {
    for velocity_m_per_s in [1e-5, -5e-4, 1e-3, -0.1] {
        let level_n = LEVEL.at(velocity_m_per_s).copysign(velocity_m_per_s);
        for (name, mut friction) in [
            ("stribeck", Friction::Stribeck(Stribeck::new(LEVEL, 0.0))),
            ("lugre", lugre(LEVEL, DAMPING_N_S_PER_M, 0.0)),
            ("gms", gms(AT_ONCE, LEVEL, DAMPING_N_S_PER_M, 0.0)),
            ("gms with attraction", gms(SLOWLY, LEVEL, DAMPING_N_S_PER_M, 0.0)),
        ] {
            for _ in 0..20_000 {
                let dx_m = 20e-9f64.copysign(velocity_m_per_s);
                friction.advance(dx_m, dx_m / velocity_m_per_s);
            }
            assert!(
                (friction.force_n() - level_n).abs() < 1e-9,
                "{name} at {velocity_m_per_s} m/s: {} N",
                friction.force_n()
            );
        }
    }
}

#[test]
fn a_sliding_element_lags_behind_a_change_of_velocity_by_the_attraction() {
    // Saturated at 10 mm/s, then 0.3 mm/s, where s is higher: F → s with the time constant s/C.
    let attraction_n_per_s = 20.0;
    let mut friction = gms(Law::Attraction { attraction_n_per_s }, LEVEL, 0.0, 0.0);
    for _ in 0..10_000 {
        friction.advance(1e-7, 1e-5);
    }
    let (slow_n, fast_n) = (LEVEL.at(3e-4), LEVEL.at(1e-2));
    let (steps, time_constant_s) = (1_000, slow_n / attraction_n_per_s);
    for _ in 0..steps {
        let dt_s = time_constant_s / f64::from(steps);
        friction.advance(3e-4 * dt_s, dt_s);
    }
    let expected_n = slow_n + (fast_n - slow_n) * libm::exp(-1.0);
    assert!((friction.force_n() - expected_n).abs() < 1e-9, "{} N, {expected_n} N", friction.force_n());
    assert!(slow_n - expected_n > 0.05, "the lag is there to be seen");
}

#[test]
fn the_hidden_state_with_any_shape_factor_follows_its_differential_equation() {
    // Levels above, at and below what the elements can hold.
    for (shape, level_n) in [(1.0, 0.5), (1.0, 0.4), (1.5, 0.5), (1.5, 0.4), (3.0, 0.4301), (4.0, 0.4), (8.0, 0.35)] {
        let mut gms = Gms::new(gms::Parameters {
            elements: Elements::table_4(),
            level: Level::constant(level_n),
            damping_n_s_per_m: 0.0,
            viscous_n_s_per_m: 0.0,
            law: Law::HiddenState { shape },
        });
        let mut element_n = [0.0; 8];
        for (path_nm, pieces) in [(30.0, 1), (-200.0, 1), (150.0, 3), (-20.0, 7), (3_000.0, 1), (5_000.0, 1)] {
            for _ in 0..pieces {
                gms.advance(path_nm * 1e-9 / f64::from(pieces), DT_S);
            }
            // Explicit steps of 1 pm, on a long way 5 pm.
            let per_nm: f64 = if path_nm.abs() < 1e3 { 1e3 } else { 200.0 };
            let (dx_m, steps) = ((1e-9 / per_nm).copysign(path_nm), (path_nm.abs() * per_nm) as usize);
            for _ in 0..steps {
                let filled = element_n.iter().sum::<f64>() / level_n * dx_m.signum();
                let dz_m = dx_m * (1.0 - filled.signum() * libm::pow(filled.abs(), shape));
                for (force_n, element) in element_n.iter_mut().zip(&GMS_TABLE_4) {
                    *force_n += element.stiffness_n_per_m * dz_m;
                    *force_n = force_n.clamp(-element.saturation_n, element.saturation_n);
                }
            }
            let expected_n: f64 = element_n.iter().sum();
            let off_n = (gms.force_n() - expected_n).abs();
            // The explicit steps are themselves off by about 1e-5 N.
            assert!(off_n < 2e-5, "n = {shape}, {path_nm} nm: {} N, {expected_n} N", gms.force_n());
        }
    }
}

#[test]
fn no_motion_changes_no_force_of_a_spring() {
    for (name, mut friction) in rate_independent().into_iter().skip(1) {
        let force_n = friction.advance(7e-9, DT_S);
        assert_eq!((friction.advance(0.0, DT_S), friction.force_n()), (force_n, force_n), "{name}");
    }
}

#[test]
fn nanometre_jitter_wears_out_local_memory_but_not_the_other() {
    for (name, mut friction, kept) in [
        ("maxwell-slip", maxwell_slip(), 1.0..=1.0),
        ("gms, table 4", gms(AT_ONCE, Level::constant(COULOMB_N), 0.0, 0.0), 1.0..=1.0),
        ("dahl", dahl(), 0.0..=0.5),
        ("lugre", lugre(LEVEL, 0.0, 0.0), 0.0..=0.5),
    ] {
        let start_n = friction.advance(100e-9, DT_S);
        for _ in 0..1_000 {
            friction.advance(-0.5e-9, DT_S);
            friction.advance(0.5e-9, DT_S);
        }
        let ratio = friction.force_n() / start_n;
        assert!(kept.contains(&((ratio * 1e9).round() * 1e-9)), "{name}: {ratio}");
    }
}
