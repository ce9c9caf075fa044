//! Point-to-point profiles, with or without a limit of jerk, that end on the exact integer target.

use crate::SERVO_DT_S;
use crate::position::Position;

/// The reference at one tick.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Setpoint {
    /// Reference position, rounded to a count.
    pub position: Position,
    /// Reference speed, m/s.
    pub velocity_m_per_s: f32,
    /// Reference acceleration, m/s².
    pub acceleration_m_per_s2: f32,
    /// The profile has ended: this and every later set-point is the target.
    pub done: bool,
}

/// Limits of a motion.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Limits {
    /// Highest speed, m/s, above 0.
    pub velocity_m_per_s: f32,
    /// Acceleration and deceleration, m/s², above 0.
    pub acceleration_m_per_s2: f32,
    /// Jerk, m/s³, above 0: an S-curve; `None`: acceleration steps, a trapezoid or triangle of speed.
    pub jerk_m_per_s3: Option<f32>,
}

/// A stretch of constant jerk, as it begins.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Leg {
    /// Since the start of the motion.
    from_s: f64,
    /// Distance covered.
    from_m: f64,
    velocity_m_per_s: f64,
    acceleration_m_per_s2: f64,
    jerk_m_per_s3: f64,
}

impl Leg {
    /// Distance covered (m), speed and acceleration, `s` seconds after the beginning.
    #[inline]
    fn after(&self, s: f64) -> (f64, f64, f64) {
        let (v, a, js) = (self.velocity_m_per_s, self.acceleration_m_per_s2, self.jerk_m_per_s3 * s);
        (self.from_m + s * (v + s * (0.5 * a + js * (1.0 / 6.0))), v + s * (a + 0.5 * js), a + js)
    }
}

/// A rest-to-rest motion, time-optimal for its limits; or a stop with constant deceleration.
///
/// Up to seven legs of constant jerk. Within a leg the distance covered is a polynomial of the time since its beginning (`f64`,
/// hardware on the target), so that no error accumulates from tick to tick; the last set-point *is* the target.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Profile {
    start: Position,
    target: Position,
    tick: u32,
    end_tick: u32,
    end_s: f64,
    counts_per_m: f64,
    /// The legs there are; those that are not begin at the end.
    legs: [Leg; 7],
    /// Index of the leg that runs.
    leg: usize,
}

impl Profile {
    /// Standing still at `position`.
    pub fn at_rest(position: Position) -> Self {
        Self::of_legs(position, position, 1.0, 0.0, &[])
    }

    /// From rest at `start` to rest at `target`, as fast as `limits` allow: speed is a trapezoid or a triangle, its corners rounded
    /// where jerk is limited.
    ///
    /// # Range
    /// Limits are finite and above 0 (the caller's check); the distance is below 2³² counts. `count_m` is metres per count.
    pub fn between(start: Position, target: Position, limits: Limits, count_m: f64) -> Self {
        let distance_m = (target.0.wrapping_sub(start.0)).unsigned_abs() as f64 * count_m;
        let (velocity, acceleration) = (f64::from(limits.velocity_m_per_s), f64::from(limits.acceleration_m_per_s2));
        let jerk = limits.jerk_m_per_s3.map(f64::from);
        let [ease_s, ramp_s] = ramp(distance_m, velocity, acceleration, jerk);
        if ramp_s == 0.0 {
            return Self::at_rest(target);
        }
        let (jerk, acceleration) = match jerk {
            Some(jerk) => (jerk, jerk * ease_s),
            None => (0.0, acceleration),
        };
        let peak = acceleration * (ramp_s - ease_s);
        // A ramp covers what half its time at full speed would.
        let cruise_s = (distance_m / peak - ramp_s).max(0.0);
        let hold_s = ramp_s - 2.0 * ease_s;
        let legs = [
            (ease_s, 0.0, jerk),
            (hold_s, acceleration, 0.0),
            (ease_s, acceleration, -jerk),
            (cruise_s, 0.0, 0.0),
            (ease_s, 0.0, -jerk),
            (hold_s, -acceleration, 0.0),
            (ease_s, -acceleration, jerk),
        ];
        Self::of_legs(start, target, count_m, 0.0, &legs)
    }

    /// From `start`, moving at `velocity_m_per_s` (signed), to rest with constant `deceleration_m_per_s2`.
    ///
    /// The target is the count nearest to where that ends. Ranges as in [`Profile::between`].
    pub fn stopping(start: Position, velocity_m_per_s: f32, deceleration_m_per_s2: f32, count_m: f64) -> Self {
        let (speed, deceleration) = (f64::from(velocity_m_per_s).abs(), f64::from(deceleration_m_per_s2));
        let counts = (speed * speed / (2.0 * deceleration) / count_m + 0.5) as i64;
        let target = start.plus(if velocity_m_per_s < 0.0 { -counts } else { counts });
        Self::of_legs(start, target, count_m, speed, &[(speed / deceleration, -deceleration, 0.0)])
    }

    /// One leg after the other: length (s), acceleration at its beginning, jerk. Legs of no length are left out.
    fn of_legs(
        start: Position,
        target: Position,
        count_m: f64,
        velocity_m_per_s: f64,
        lengths: &[(f64, f64, f64)],
    ) -> Self {
        let mut next = Leg { velocity_m_per_s, ..Leg::default() };
        let mut legs = [next; 7];
        let mut count = 0;
        for &(length_s, acceleration_m_per_s2, jerk_m_per_s3) in lengths.iter().filter(|(length_s, ..)| *length_s > 0.0)
        {
            let leg = Leg { acceleration_m_per_s2, jerk_m_per_s3, ..next };
            legs[count] = leg;
            count += 1;
            let (from_m, velocity_m_per_s, _) = leg.after(length_s);
            next = Leg { from_s: leg.from_s + length_s, from_m, velocity_m_per_s, ..Leg::default() };
        }
        legs[count..].fill(next);
        Profile {
            start,
            target,
            tick: 0,
            end_tick: libm::ceil(next.from_s / f64::from(SERVO_DT_S)) as u32,
            end_s: next.from_s,
            counts_per_m: 1.0 / count_m,
            legs,
            leg: 0,
        }
    }

    /// Where the motion ends.
    pub fn target(&self) -> Position {
        self.target
    }

    /// Time from start to end, s. The reference is on target from the first tick at or after it.
    pub fn duration_s(&self) -> f64 {
        self.end_s
    }

    /// The last set-point given was the target.
    #[inline]
    pub fn is_done(&self) -> bool {
        self.tick >= self.end_tick
    }

    /// Moves on by one tick and gives the set-point there.
    #[inline]
    pub fn advance(&mut self) -> Setpoint {
        if self.tick < self.end_tick {
            self.tick += 1;
        }
        if self.is_done() {
            return Setpoint { position: self.target, velocity_m_per_s: 0.0, acceleration_m_per_s2: 0.0, done: true };
        }
        let t = f64::from(self.tick) * f64::from(SERVO_DT_S);
        while let Some(next) = self.legs.get(self.leg + 1)
            && t >= next.from_s
        {
            self.leg += 1;
        }
        let leg = &self.legs[self.leg];
        let (covered_m, speed, acceleration) = leg.after(t - leg.from_s);
        // Counts covered fit u32 (range above), which converts in one instruction where i64 takes a library call.
        let counts = i64::from((covered_m * self.counts_per_m + 0.5) as u32);
        let forward = self.target >= self.start;
        let sign = if forward { 1.0 } else { -1.0 };
        Setpoint {
            position: self.start.plus(if forward { counts } else { -counts }),
            velocity_m_per_s: sign * speed as f32,
            acceleration_m_per_s2: sign * acceleration as f32,
            done: false,
        }
    }
}

/// Lengths of the shortest ramp from rest to the highest speed that `distance_m` allows: of its part in which acceleration grows
/// (and of the equal one in which it falls), and of the whole, s.
///
/// With speed limit V, acceleration limit A and jerk limit J a ramp to V has the constant part only if V J > A². Where the distance is
/// shorter than two ramps, they meet: A may then be reached (distance ≥ 2 A³/J²) or not.
fn ramp(distance_m: f64, velocity: f64, acceleration: f64, jerk: Option<f64>) -> [f64; 2] {
    let Some(jerk) = jerk else {
        return [0.0, (velocity / acceleration).min(libm::sqrt(distance_m / acceleration))];
    };
    let full_ease_s = acceleration / jerk;
    let ease_to_speed_s = full_ease_s.min(libm::sqrt(velocity / jerk));
    let to_speed_s = ease_to_speed_s + velocity / (jerk * ease_to_speed_s);
    if velocity * to_speed_s <= distance_m {
        return [ease_to_speed_s, to_speed_s];
    }
    let ease_s = full_ease_s.min(libm::cbrt(0.5 * distance_m / jerk));
    if ease_s < full_ease_s {
        return [ease_s, 2.0 * ease_s];
    }
    // distance = acceleration · (ramp − ease) · ramp
    let half_s = 0.5 * ease_s;
    [ease_s, half_s + libm::sqrt(half_s * half_s + distance_m / acceleration)]
}

#[cfg(test)]
mod tests {
    extern crate std;
    use super::*;
    use proptest::prelude::*;
    use std::vec::Vec;

    const COUNT_M: f64 = 4e-6 / 65536.0;

    fn limits(velocity_m_per_s: f32, acceleration_m_per_s2: f32) -> Limits {
        Limits { velocity_m_per_s, acceleration_m_per_s2, jerk_m_per_s3: None }
    }

    fn run(mut profile: Profile) -> Vec<Setpoint> {
        let mut points = Vec::new();
        while !profile.is_done() {
            points.push(profile.advance());
        }
        points
    }

    #[test]
    fn the_moves_of_the_experiments_are_triangles_of_the_stated_length_and_peak() {
        // 9.1, 9.2, 9.4 (5 µm), 9.4 (50 nm): distance, acceleration, duration, peak speed
        for (distance_m, a, duration_ms, peak) in [
            (5e-3, 1.0, 141.42, 70.7e-3),
            (5e-3, 10.0, 44.72, 223.6e-3),
            (5e-6, 0.1, 14.142, 707e-6),
            (50e-9, 1e-3, 14.142, 7.07e-6),
        ] {
            let target = Position((distance_m / COUNT_M) as i64);
            let profile = Profile::between(Position(0), target, limits(1.0, a), COUNT_M);
            assert!((profile.duration_s() * 1e3 / duration_ms - 1.0).abs() < 1e-3);
            let fastest = run(profile).iter().map(|p| f64::from(p.velocity_m_per_s)).fold(0.0, f64::max);
            assert!((fastest / peak - 1.0).abs() < 0.02, "{fastest} {peak}");
        }
    }

    #[test]
    fn a_move_of_nothing_is_done_at_once() {
        let mut profile = Profile::between(Position(7), Position(7), limits(0.1, 1.0), COUNT_M);
        assert!(profile.is_done());
        assert_eq!(
            profile.advance(),
            Setpoint { position: Position(7), velocity_m_per_s: 0.0, acceleration_m_per_s2: 0.0, done: true }
        );
    }

    #[test]
    fn a_stop_goes_on_from_the_speed_it_had() {
        let stop = Profile::stopping(Position(1000), -0.05, 2.0, COUNT_M);
        assert!((stop.duration_s() - 0.025).abs() < 1e-9);
        let points = run(stop);
        assert!((f64::from(points[0].velocity_m_per_s) + 0.05 - 2.0 / 8000.0).abs() < 1e-6);
        let stopped_after_m = 1000f64.mul_add(1.0, -(stop.target().0 as f64)) * COUNT_M;
        assert!((stopped_after_m - 0.05 * 0.05 / 4.0).abs() < COUNT_M);
        assert_eq!(points.last().unwrap().position, stop.target());
    }

    proptest! {
        #[test]
        fn every_profile_arrives_exactly_and_keeps_its_limits(
            start in -1_000_000_000i64..1_000_000_000, distance in -1_600_000_000i64..1_600_000_000,
            velocity in 1e-3f32..1.0, acceleration in 1e-2f32..50.0, jerk in proptest::option::of(1f32..1e5),
        ) {
            let target = Position(start + distance);
            let limits = Limits { jerk_m_per_s3: jerk, ..limits(velocity, acceleration) };
            let points = run(Profile::between(Position(start), target, limits, COUNT_M));
            if let Some(last) = points.last() {
                prop_assert_eq!(last.position, target);
                prop_assert!(last.done);
            }
            let dt = f64::from(SERVO_DT_S);
            let (mut before, mut acceleration_before) = (start, 0.0);
            for p in &points {
                let step_m = (p.position.0 - before) as f64 * COUNT_M;
                let (v, a) = (f64::from(velocity), f64::from(acceleration));
                prop_assert!(step_m.abs() <= v * dt + 1.01 * COUNT_M, "speed {step_m} at {p:?}");
                prop_assert!(step_m * distance as f64 >= 0.0, "never backwards");
                prop_assert!(f64::from(p.velocity_m_per_s).abs() <= v * 1.000_001);
                prop_assert!(f64::from(p.acceleration_m_per_s2).abs() <= a * 1.000_001);
                if let (Some(jerk), false) = (jerk, p.done) {
                    let change = f64::from(p.acceleration_m_per_s2) - acceleration_before;
                    prop_assert!(change.abs() <= f64::from(jerk) * dt + 1e-6 * a, "jerk at {p:?}");
                }
                (before, acceleration_before) = (p.position.0, f64::from(p.acceleration_m_per_s2));
            }
        }

        #[test]
        fn the_stated_speed_is_the_slope_of_the_position(distance in 1_000_000i64..100_000_000, acceleration in 0.1f32..10.0,
            jerk in proptest::option::of(1f32..1e5),
        ) {
            let limits = Limits { jerk_m_per_s3: jerk, ..limits(0.05, acceleration) };
            let mut profile = Profile::between(Position(0), Position(distance), limits, COUNT_M);
            let mut before = profile.advance();
            while !profile.is_done() {
                let now = profile.advance();
                let slope = f64::from(now.position.minus(before.position)) * COUNT_M / f64::from(SERVO_DT_S);
                let mean = f64::from(now.velocity_m_per_s + before.velocity_m_per_s) / 2.0;
                let rounding = 2.0 * COUNT_M / f64::from(SERVO_DT_S);
                prop_assert!((slope - mean).abs() <= rounding + f64::from(acceleration) * f64::from(SERVO_DT_S));
                before = now;
            }
        }
    }
}
