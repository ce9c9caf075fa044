//! Finding the electrical angle on a carriage whose magnets are anywhere.

use std::f64::consts::TAU;

use servo_core::alignment::{Alignment, Plan, Reason, Step};
use servo_core::encoder::biss;
use servo_core::position::Position;
use servo_core::{SERVO_DT_S, SERVO_HZ};
use servo_sim::{Carriage, Stage};

const COUNT_M: f64 = 4e-6 / 65536.0;
const PITCH_M: f64 = 0.03;
const FORCE_CONSTANT: f64 = 7.8;
const TRAVEL_M: f64 = 200e-6;

fn plan() -> Plan {
    Plan {
        current_a: 5.0,
        newtons_per_amp: FORCE_CONSTANT as f32,
        turns_per_ct: (COUNT_M / PITCH_M) as f32,
        travel_max_ct: (TRAVEL_M / COUNT_M) as i32,
        proportional_n_per_ct: (4.3e5 * COUNT_M) as f32,
        derivative_n_per_ct: (912.0 * COUNT_M / f64::from(SERVO_DT_S)) as f32,
    }
}

/// How the motor is wired and mounted.
#[derive(Clone, Copy)]
struct Motor {
    /// Electrical angle of the magnets at position 0, turns.
    angle: f64,
    /// −1: phases exchanged.
    direction: f64,
    /// −1: the encoder counts backwards.
    encoder: f64,
    /// N/A; 0: blocked.
    force_constant: f64,
}

const GOOD: Motor = Motor { angle: 0.0, direction: 1.0, encoder: 1.0, force_constant: FORCE_CONSTANT };

/// The outcome, and how far the stage was from its beginning at most, m.
fn align(stage: &Stage, seed: u64, motor: Motor) -> (Step, f64) {
    const SUBSTEPS: u32 = 10;
    let mut carriage = Carriage::new(stage, seed);
    carriage.redraw_friction(0);
    let substep = servo_sim::carriage::Step::new(stage, f64::from(SERVO_DT_S) / f64::from(SUBSTEPS));
    let plan = plan();
    let mut alignment: Option<Alignment> = None;
    let (mut furthest_m, mut carried_a) = (0.0_f64, 0.0_f32);
    for _ in 0..20 * SERVO_HZ {
        let count = biss::decode(carriage.encoder_frame()).unwrap().counts;
        let position = Position((motor.encoder as i64) * (i64::from(count) - 0x8000_0000));
        let alignment = alignment.get_or_insert_with(|| Alignment::start(position));
        match alignment.step(&plan, position, carried_a) {
            Step::Hold { turns, amps } => {
                let magnets = motor.angle + carriage.position_m() / PITCH_M;
                let force_n = motor.force_constant
                    * f64::from(amps)
                    * (TAU * (motor.direction * f64::from(turns) - magnets)).sin();
                carriage.advance(&substep, SUBSTEPS, force_n, force_n);
                carried_a = amps;
                furthest_m = furthest_m.max(carriage.position_m().abs());
            }
            end => return (end, furthest_m),
        }
    }
    panic!("no end");
}

/// Difference of two angles in turns, −0.5 … 0.5.
fn difference(a: f64, b: f64) -> f64 {
    (a - b + 0.5).rem_euclid(1.0) - 0.5
}

fn assert_found(stage: &Stage, seed: u64, motor: Motor) {
    let (end, furthest_m) = align(stage, seed, motor);
    let Step::Found { at, turns } = end else { panic!("{end:?} at {} turns", motor.angle) };
    let expected = motor.angle + at.0 as f64 * COUNT_M / PITCH_M;
    let wrong = difference(f64::from(turns), expected);
    assert!(wrong.abs() < 0.01 / 360.0, "found {turns}, expected {expected}");
    assert!(furthest_m <= TRAVEL_M, "{furthest_m} m away from the beginning, magnets at {}", motor.angle);
}

#[test]
fn every_angle_is_found_to_a_hundredth_of_a_degree_within_the_travel_bound() {
    for start in 0..36 {
        assert_found(&Stage::default(), start, Motor { angle: start as f64 / 36.0, ..GOOD });
    }
}

#[test]
fn light_and_heavy_stages_with_little_and_much_friction_are_aligned() {
    for (index, (mass_kg, stiffness_n_per_m, coulomb_n)) in
        [(0.8, 4e6, 0.3), (0.8, 17e6, 1.1), (3.0, 4e6, 1.1), (3.0, 17e6, 0.3)].into_iter().enumerate()
    {
        let mut stage = Stage::default();
        stage.mechanics.mass_kg = mass_kg;
        (stage.friction.stiffness_n_per_m, stage.friction.coulomb_n) = (stiffness_n_per_m, coulomb_n);
        stage.friction.spread = None;
        for start in 0..9 {
            assert_found(&stage, index as u64, Motor { angle: start as f64 / 9.0, ..GOOD });
        }
    }
}

#[test]
fn what_is_wrong_with_motor_or_encoder_is_refused_by_name_at_every_angle() {
    for start in 0..12 {
        let angle = f64::from(start) / 12.0;
        let cases = [
            (Motor { angle, direction: -1.0, ..GOOD }, Reason::Reversed),
            (Motor { angle, encoder: -1.0, ..GOOD }, Reason::Reversed),
            (Motor { angle, force_constant: 0.0, ..GOOD }, Reason::Blocked),
        ];
        for (motor, reason) in cases {
            let (end, furthest_m) = align(&Stage::default(), 1, motor);
            assert_eq!(end, Step::Refused(reason), "magnets at {angle}");
            assert!(furthest_m <= TRAVEL_M, "{furthest_m} m away from the beginning");
        }
    }
}
