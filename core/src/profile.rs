//! Point-to-point profiles, with or without a limit of jerk, that end on the exact integer target.

use crate::SERVO_DT_S;
use crate::position::Position;

/// The reference at one tick.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
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

/// From rest to a speed: acceleration grows, stays, and falls to nothing again; without a limit of jerk it only stays.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
struct Ramp {
    /// Length of the part in which acceleration grows, and of that in which it falls, s.
    ease_s: f64,
    /// Length of the whole, s.
    length_s: f64,
    /// Largest acceleration.
    acceleration_m_per_s2: f64,
    jerk_m_per_s3: f64,
    /// Speed at the end.
    velocity_m_per_s: f64,
}

impl Ramp {
    /// The shortest ramp from rest to the highest speed that a motion over `distance_m` allows.
    ///
    /// With speed limit V, acceleration limit A and jerk limit J, a ramp to V has a part of constant acceleration only if V J > A².
    /// Where the distance is shorter than two such ramps, they meet, A being reached (distance ≥ 2 A³/J²) or not.
    fn longest(distance_m: f64, limits: &Limits) -> Self {
        let (v, a) = (f64::from(limits.velocity_m_per_s), f64::from(limits.acceleration_m_per_s2));
        let Some(jerk) = limits.jerk_m_per_s3.map(f64::from) else {
            let length_s = (v / a).min(libm::sqrt(distance_m / a));
            return Ramp { length_s, acceleration_m_per_s2: a, velocity_m_per_s: a * length_s, ..Ramp::default() };
        };
        let full_ease_s = a / jerk;
        let mut ease_s = full_ease_s.min(libm::sqrt(v / jerk));
        let mut length_s = ease_s + v / (jerk * ease_s);
        if v * length_s > distance_m {
            ease_s = full_ease_s.min(libm::cbrt(0.5 * distance_m / jerk));
            // distance = acceleration · (length − ease) · length
            let half_s = 0.5 * ease_s;
            let reached_s = half_s + libm::sqrt(half_s * half_s + distance_m / a);
            length_s = if ease_s < full_ease_s { 2.0 * ease_s } else { reached_s };
        }
        let acceleration_m_per_s2 = jerk * ease_s;
        let velocity_m_per_s = acceleration_m_per_s2 * (length_s - ease_s);
        Ramp { ease_s, length_s, acceleration_m_per_s2, jerk_m_per_s3: jerk, velocity_m_per_s }
    }

    /// Distance covered at its end, m: what half its time at full speed would.
    fn distance_m(&self) -> f64 {
        0.5 * self.velocity_m_per_s * self.length_s
    }

    /// Distance covered (m), speed and acceleration `s` seconds after its beginning; beyond its end, at full speed.
    #[inline]
    fn after(&self, s: f64) -> (f64, f64, f64) {
        let (a, j) = (self.acceleration_m_per_s2, self.jerk_m_per_s3);
        let left = self.length_s - s;
        if left < self.ease_s {
            // What full speed would have covered, and a little more: the speed was not full yet.
            let at_speed_m = (s - 0.5 * self.length_s) * self.velocity_m_per_s;
            let left = left.max(0.0);
            let jl = j * left;
            (at_speed_m + jl * left * left * (1.0 / 6.0), self.velocity_m_per_s - 0.5 * jl * left, jl)
        } else if s < self.ease_s {
            let js = j * s;
            (js * s * s * (1.0 / 6.0), 0.5 * js * s, js)
        } else {
            let since = s - 0.5 * self.ease_s;
            (a * (0.5 * since * since + self.ease_s * self.ease_s * (1.0 / 24.0)), a * since, a)
        }
    }
}

/// A rest-to-rest motion, time-optimal for its limits: a ramp, an optional cruise and the same ramp backwards. A stop is its end.
///
/// The distance covered is evaluated in closed form from the tick number (`f64`, hardware on the target), so that no error
/// accumulates: the deceleration counts back from the target and the last set-point *is* the target.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Profile {
    start: Position,
    target: Position,
    tick: u32,
    end_tick: u32,
    counts_per_m: f64,
    ramp: Ramp,
    /// What the time since the start is counted from: 0, or for a stop where the cruise would end.
    from_s: f64,
    /// Distance covered there.
    from_m: f64,
    /// Until here it accelerates or cruises.
    decelerate_from_s: f64,
    distance_m: f64,
    end_s: f64,
}

impl Profile {
    /// Standing still at `position`.
    pub fn at_rest(position: Position) -> Self {
        Self::new(position, position, 1.0, Ramp::default(), 0.0, 0.0)
    }

    /// From rest at `start` to rest at `target`, as fast as `limits` allow: speed is a trapezoid or a triangle, its corners rounded
    /// where jerk is limited.
    ///
    /// # Range
    /// Limits are finite and above 0 (the caller's check); the distance is below 2³² counts. `count_m` is metres per count.
    pub fn between(start: Position, target: Position, limits: Limits, count_m: f64) -> Self {
        let distance_m = (target.0.wrapping_sub(start.0)).unsigned_abs() as f64 * count_m;
        let ramp = Ramp::longest(distance_m, &limits);
        let v = ramp.velocity_m_per_s;
        let cruise_s = if v > 0.0 { (distance_m / v - ramp.length_s).max(0.0) } else { 0.0 };
        Self::new(start, target, count_m, ramp, cruise_s, 0.0)
    }

    /// From `start`, moving at `velocity_m_per_s` (signed), to rest with constant `deceleration_m_per_s2`.
    ///
    /// The target is the count nearest to where that ends. Ranges as in [`Profile::between`].
    pub fn stopping(start: Position, velocity_m_per_s: f32, deceleration_m_per_s2: f32, count_m: f64) -> Self {
        let (speed, deceleration) = (f64::from(velocity_m_per_s).abs(), f64::from(deceleration_m_per_s2));
        let ramp = Ramp {
            length_s: speed / deceleration,
            acceleration_m_per_s2: deceleration,
            velocity_m_per_s: speed,
            ..Ramp::default()
        };
        let counts = (ramp.distance_m() / count_m + 0.5) as i64;
        let target = start.plus(if velocity_m_per_s < 0.0 { -counts } else { counts });
        Self::new(start, target, count_m, ramp, 0.0, ramp.length_s)
    }

    fn new(start: Position, target: Position, count_m: f64, ramp: Ramp, cruise_s: f64, from_s: f64) -> Self {
        let decelerate_from_s = ramp.length_s + cruise_s;
        let end_s = decelerate_from_s + ramp.length_s;
        Profile {
            start,
            target,
            tick: 0,
            end_tick: libm::ceil((end_s - from_s) / f64::from(SERVO_DT_S)) as u32,
            counts_per_m: 1.0 / count_m,
            ramp,
            from_s,
            from_m: if from_s > 0.0 { ramp.distance_m() } else { 0.0 },
            decelerate_from_s,
            distance_m: 2.0 * ramp.distance_m() + cruise_s * ramp.velocity_m_per_s,
            end_s,
        }
    }

    /// Where the motion ends.
    pub fn target(&self) -> Position {
        self.target
    }

    /// Time from start to end, s. The reference is on target from the first tick at or after it.
    pub fn duration_s(&self) -> f64 {
        self.end_s - self.from_s
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
        let t = self.from_s + f64::from(self.tick) * f64::from(SERVO_DT_S);
        let braking = t >= self.decelerate_from_s;
        let (m, speed, acceleration) = self.ramp.after(if braking { self.end_s - t } else { t });
        let (covered_m, acceleration) = if braking { (self.distance_m - m, -acceleration) } else { (m, acceleration) };
        // Counts covered fit u32 (range above), which converts in one instruction where i64 takes a library call.
        let counts = i64::from(((covered_m - self.from_m) * self.counts_per_m + 0.5) as u32);
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
