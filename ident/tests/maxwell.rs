//! Maxwell slip is found again: not its elements, which many others can stand for, but its loops.

mod common;

use common::{Columns, Profile, USUAL, dahl};
use servo_ident::choice::{self, Model};
use servo_ident::{DataError, Record, maxwell};
use servo_sim::friction::{Element, Elements, Friction, GMS_TABLE_4, Gms, MaxwellSlip, gms};

fn elements(list: &[Element]) -> Friction {
    let level = servo_sim::friction::Level {
        coulomb_n: list.iter().map(|e| e.saturation_n).sum(),
        static_n: list.iter().map(|e| e.saturation_n).sum(),
        stribeck_m_per_s: 1.0,
        stribeck_shape: 1.0,
    };
    Friction::Gms(Gms::new(gms::Parameters {
        elements: Elements::new(list).unwrap(),
        level,
        damping_n_s_per_m: 0.0,
        viscous_n_s_per_m: 0.0,
        law: gms::Law::Attraction { attraction_n_per_s: f64::INFINITY },
    }))
}

fn record(columns: &Columns) -> Record {
    Record::from_force(&columns.time_s, &columns.position_m, &columns.friction_n).unwrap()
}

/// Rms of modelled minus true friction over what is compared, N.
fn loop_error_n(fit: &maxwell::MaxwellFit, record: &Record, truth: &Columns) -> f64 {
    let model_n = fit.force_n(record);
    let of = fit.first_sample..model_n.len();
    let square: f64 = of.clone().map(|i| (model_n[i] - fit.offset_n - truth.true_n[i]).powi(2)).sum();
    (square / of.len() as f64).sqrt()
}

#[test]
fn loops_are_within_a_hundredth_of_the_force_with_noise_and_few_elements() {
    for (name, mut friction, coulomb_n) in [
        ("like Dahl", Friction::MaxwellSlip(MaxwellSlip::new(12, 8.66e6, 0.64)), 0.64),
        ("table 4", elements(&GMS_TABLE_4), 0.43),
        ("one element", elements(&[Element { stiffness_n_per_m: 5e6, saturation_n: 0.5 }]), 0.5),
    ] {
        let columns = USUAL.measure(&mut friction, 0);
        let record = record(&columns);
        for (count, share) in [(4, 0.02), (8, 0.01), (12, 0.01)] {
            let fit = maxwell::fit(&record, count).unwrap();
            let error_n = loop_error_n(&fit, &record, &columns);
            assert!(fit.elements.len() <= count + 1, "{name}: {:?}", fit.elements);
            assert!(error_n < share * coulomb_n, "{name}, {count} elements: {error_n} N");
        }
    }
}

/// The loop that the simulated contact closes, on a motion that lets most of the elements slide and some not.
#[test]
fn a_steady_loop_is_that_of_the_simulated_contact() {
    const POINTS: usize = 50;
    let mut contact = MaxwellSlip::new(12, 8.66e6, 0.64);
    let list: Vec<maxwell::Element> = contact
        .elements()
        .map(|e| maxwell::Element { stiffness_n_per_m: e.stiffness_n_per_m, saturation_n: e.saturation_n })
        .collect();
    for half_span_m in [20e-9, 100e-9, 2e-6] {
        contact = MaxwellSlip::new(12, 8.66e6, 0.64);
        contact.advance(half_span_m);
        contact.advance(-2.0 * half_span_m);
        let steps = [1.0, -1.0].into_iter().flat_map(|sign| std::iter::repeat_n(sign, POINTS));
        let expected: Vec<f64> = steps.map(|sign| contact.advance(sign * 2.0 * half_span_m / POINTS as f64)).collect();
        let found = maxwell::steady_loop_n(&list, half_span_m, POINTS);
        assert_eq!(found.len(), expected.len());
        for (found_n, expected_n) in found.iter().zip(&expected) {
            assert!((found_n - expected_n).abs() < 1e-12, "{half_span_m} m: {found_n} N, {expected_n} N");
        }
    }
}

#[test]
fn few_elements_far_apart_are_found_one_by_one() {
    let list = [
        Element { stiffness_n_per_m: 6e6, saturation_n: 0.12 },
        Element { stiffness_n_per_m: 2e6, saturation_n: 0.20 },
        Element { stiffness_n_per_m: 0.8e6, saturation_n: 0.30 },
    ];
    let quiet = Profile { force_noise_n: 1e-3, position_noise_m: 0.05e-9, ..USUAL };
    let fit = maxwell::fit(&record(&quiet.measure(&mut elements(&list), 0)), 3).unwrap();
    assert_eq!(fit.elements.len(), 3, "{fit:?}");
    for (found, truth) in fit.elements.iter().zip(&list) {
        assert!((found.stiffness_n_per_m / truth.stiffness_n_per_m - 1.0).abs() < 0.03, "{found:?} {truth:?}");
        assert!((found.saturation_n / truth.saturation_n - 1.0).abs() < 0.03, "{found:?} {truth:?}");
    }
    assert!((fit.coulomb_n() / 0.62 - 1.0).abs() < 0.01);
    assert_eq!(fit.unsaturated_n_per_m, 0.0);
}

#[test]
fn what_does_not_slide_is_a_spring_with_the_least_saturation_it_can_have() {
    // The second element would slide after 20 µm.
    let list = [
        Element { stiffness_n_per_m: 5e6, saturation_n: 0.4 },
        Element { stiffness_n_per_m: 0.1e6, saturation_n: 2.0 },
    ];
    let fit = maxwell::fit(&record(&USUAL.measure(&mut elements(&list), 0)), 4).unwrap();
    assert!((fit.unsaturated_n_per_m / 0.1e6 - 1.0).abs() < 0.1, "{fit:?}");
    let last = fit.elements.last().unwrap();
    assert_eq!(last.stiffness_n_per_m, fit.unsaturated_n_per_m);
    assert!(last.saturation_n < 0.11, "{last:?}");
}

#[test]
fn the_simpler_model_is_chosen_where_it_does() {
    // Small loops tell them apart: Dahl's do not close.
    let profile = Profile { decay: 0.02, ..USUAL };
    for (mut friction, expected) in [
        (dahl(8.66e6, 0.64), Model::Dahl),
        (Friction::MaxwellSlip(MaxwellSlip::new(12, 8.66e6, 0.64)), Model::MaxwellSlip),
        (elements(&GMS_TABLE_4), Model::MaxwellSlip),
    ] {
        let choice = choice::fit(&record(&profile.measure(&mut friction, 0)), maxwell::USUAL_ELEMENTS).unwrap();
        assert_eq!(choice.model, expected, "{} N against {} N", choice.dahl_rms_n, choice.maxwell.rms_n);
    }
}

#[test]
fn the_number_of_elements_has_a_range() {
    let record = record(&USUAL.measure(&mut dahl(8.66e6, 0.64), 0));
    for count in [0, 13] {
        let refused = maxwell::fit(&record, count);
        let named = DataError::OutOfRange { field: "elements", value: count as f64, min: 1.0, max: 12.0 };
        assert_eq!(refused, Err(named));
    }
}
