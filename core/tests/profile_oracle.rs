//! The profiles against an established planner: as fast as Ruckig's, which is time-optimal.

use proptest::prelude::*;
use rsruckig::prelude::*;
use servo_core::position::Position;
use servo_core::profile::{Limits, Profile};

const COUNT_M: f64 = 4e-6 / 65536.0;

/// Duration of the time-optimal motion from rest to rest, s.
fn oracle_s(distance_m: f64, limits: &Limits) -> f64 {
    let mut input = InputParameter::<1>::new(None);
    input.target_position[0] = distance_m;
    input.max_velocity[0] = f64::from(limits.velocity_m_per_s);
    input.max_acceleration[0] = f64::from(limits.acceleration_m_per_s2);
    input.max_jerk[0] = limits.jerk_m_per_s3.map_or(f64::INFINITY, f64::from);
    let mut trajectory = Trajectory::<1>::new(None);
    let mut planner = Ruckig::<1, ThrowErrorHandler>::new(None, 125e-6);
    planner.calculate(&input, &mut trajectory).unwrap();
    trajectory.get_duration()
}

fn ours_s(distance_ct: i64, limits: Limits) -> f64 {
    Profile::between(Position(-7), Position(distance_ct - 7), limits, COUNT_M).duration_s()
}

proptest! {
    #[test]
    fn no_planner_is_faster(
        distance_ct in 100_000i64..1_600_000_000, forward in any::<bool>(), velocity in 1e-3f32..1.0,
        acceleration in 1e-1f32..50.0, jerk in proptest::option::of(1f32..1e5),
    ) {
        let limits = Limits { velocity_m_per_s: velocity, acceleration_m_per_s2: acceleration, jerk_m_per_s3: jerk };
        let ours = ours_s(if forward { distance_ct } else { -distance_ct }, limits);
        let oracle = oracle_s(distance_ct as f64 * COUNT_M, &limits);
        prop_assert!((ours / oracle - 1.0).abs() < 1e-6, "{ours} s, the oracle {oracle} s");
    }
}

#[test]
fn every_shape_is_as_fast_as_the_oracles() {
    // Distance in counts, speed, acceleration, jerk, what is reached on the way.
    let cases = [
        (80_000_000, 1.0, 1.0, None, "triangle of speed"),
        (80_000_000, 0.05, 1.0, None, "trapezoid of speed"),
        (80_000_000, 0.05, 1.0, Some(100.0), "jerk, acceleration and speed"),
        (80_000_000, 0.05, 50.0, Some(100.0), "jerk and speed, not acceleration"),
        (80_000_000, 1.0, 1.0, Some(100.0), "jerk and acceleration, not speed"),
        (800_000, 1.0, 10.0, Some(100.0), "jerk only"),
    ];
    for (distance_ct, velocity_m_per_s, acceleration_m_per_s2, jerk_m_per_s3, shape) in cases {
        let limits = Limits { velocity_m_per_s, acceleration_m_per_s2, jerk_m_per_s3 };
        let (ours, oracle) = (ours_s(distance_ct, limits), oracle_s(distance_ct as f64 * COUNT_M, &limits));
        assert!((ours / oracle - 1.0).abs() < 1e-9, "{shape}: {ours} s, the oracle {oracle} s");
    }
}
