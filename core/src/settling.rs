//! How a move settled, measured by the drive itself while it happens.

use crate::SERVO_HZ;

/// Number of tolerances.
pub const TOLERANCES: usize = 6;
/// Half-widths of the tolerance bands, nm.
pub const TOLERANCES_NM: [u32; TOLERANCES] = [3, 5, 10, 20, 50, 100];
/// Ticks over which in-position noise is taken: 0.5 s.
pub const NOISE_TICKS: u32 = SERVO_HZ / 2;
/// A tolerance counts as settled once the error has stayed inside for this many ticks: 0.1 s.
pub const HOLD_TICKS: u32 = SERVO_HZ / 10;

/// What is known about the settling of the last move.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Settling {
    /// Ticks since the profile ended; 0 while it moves.
    pub ticks: u32,
    /// For each tolerance, ticks from the end of the profile to the last one with a larger error (0: never outside).
    pub settled_after_ticks: [u32; TOLERANCES],
    /// Furthest the stage went past the target after the profile ended, counts.
    pub overshoot_ct: i32,
    /// Mean square of the error over the last complete [`NOISE_TICKS`], counts²; `None` before there is one.
    pub noise_ct2: Option<f32>,
    /// Largest minus smallest error over the same ticks, counts.
    pub noise_peak_to_peak_ct: i32,
}

impl Settling {
    /// Time from the end of the profile to the last error beyond tolerance `index`, s; `None` if it has not stayed inside for
    /// [`HOLD_TICKS`] yet.
    pub fn settled_after_s(&self, index: usize) -> Option<f64> {
        let after = *self.settled_after_ticks.get(index)?;
        (self.ticks >= after + HOLD_TICKS).then(|| f64::from(after) / f64::from(SERVO_HZ))
    }
}

/// Follows the error from the end of each profile on.
#[derive(Clone, Copy, Debug)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Monitor {
    settling: Settling,
    forward: bool,
    sum_ct2: u64,
    low_ct: i32,
    high_ct: i32,
    block_ticks: u32,
    /// Tick of the last error beyond the position window.
    outside_ticks: u32,
}

impl Default for Monitor {
    fn default() -> Self {
        Monitor {
            settling: Settling::default(),
            forward: true,
            sum_ct2: 0,
            low_ct: i32::MAX,
            high_ct: i32::MIN,
            block_ticks: 0,
            outside_ticks: 0,
        }
    }
}

impl Monitor {
    /// What is known now.
    pub fn settling(&self) -> Settling {
        self.settling
    }

    /// Ticks in a row without an error beyond the position window.
    pub fn inside_ticks(&self) -> u32 {
        self.settling.ticks - self.outside_ticks
    }

    /// A move towards larger (`forward`) or smaller positions begins.
    pub fn restart(&mut self, forward: bool) {
        *self = Monitor { forward, ..Monitor::default() };
    }

    /// One tick after the end of the profile, the first of them being the one on which the reference reached the target.
    /// `limits_ct` are the tolerances in counts, narrowest first; `window_ct` is the position window.
    #[inline]
    pub fn update(&mut self, error_ct: i32, limits_ct: &[i32; TOLERANCES], window_ct: i32) {
        let s = &mut self.settling;
        s.ticks = s.ticks.saturating_add(1);
        let size_ct = error_ct.saturating_abs();
        for (after, limit) in s.settled_after_ticks.iter_mut().zip(limits_ct) {
            if size_ct <= *limit {
                break; // inside this band and all wider ones
            }
            *after = s.ticks;
        }
        if size_ct > window_ct {
            self.outside_ticks = s.ticks;
        }
        // Past the target means beyond it in the direction of the move: error = target − position.
        s.overshoot_ct = s.overshoot_ct.max(if self.forward { error_ct.saturating_neg() } else { error_ct });

        let bounded = u64::from(size_ct.unsigned_abs().min(1 << 24));
        self.sum_ct2 += bounded * bounded;
        self.low_ct = self.low_ct.min(error_ct);
        self.high_ct = self.high_ct.max(error_ct);
        self.block_ticks += 1;
        if self.block_ticks == NOISE_TICKS {
            // Below 2⁶⁰; halves convert to f32 in hardware where u64 takes a library call.
            let sum = (self.sum_ct2 >> 32) as u32 as f32 * 4_294_967_296.0 + self.sum_ct2 as u32 as f32;
            s.noise_ct2 = Some(sum / NOISE_TICKS as f32);
            s.noise_peak_to_peak_ct = self.high_ct.saturating_sub(self.low_ct);
            (self.sum_ct2, self.low_ct, self.high_ct, self.block_ticks) = (0, i32::MAX, i32::MIN, 0);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const LIMITS_CT: [i32; TOLERANCES] = [49, 81, 163, 327, 819, 1638];

    fn after(errors_ct: impl IntoIterator<Item = i32>) -> Settling {
        let mut monitor = Monitor::default();
        for e in errors_ct {
            monitor.update(e, &LIMITS_CT, 60);
        }
        monitor.settling()
    }

    #[test]
    fn settling_time_is_the_last_tick_outside_each_band() {
        // 900 for ten ticks, 200 for ten, 60 once after five quiet ones, then quiet.
        let quiet = HOLD_TICKS as usize;
        let errors = [vec(900, 10), vec(-200, 10), vec(10, 5), vec(60, 1), vec(0, quiet)].into_iter().flatten();
        let s = after(errors);
        assert_eq!(s.settled_after_ticks, [26, 20, 20, 10, 10, 0]);
        assert_eq!(s.settled_after_s(0), Some(26.0 / 8000.0));
        assert_eq!(s.settled_after_s(5), Some(0.0));
    }

    #[test]
    fn a_band_left_just_now_is_not_settled() {
        let s = after([vec(0, 5000), vec(60, 1), vec(0, 10)].into_iter().flatten());
        assert_eq!(s.settled_after_s(0), None);
        assert_eq!(s.settled_after_s(1), Some(0.0));
    }

    #[test]
    fn overshoot_is_what_went_past_the_target() {
        let mut monitor = Monitor::default();
        for (forward, expected) in [(true, 70), (false, 300)] {
            monitor.restart(forward);
            for e in [300, 100, -70, -20] {
                monitor.update(e, &LIMITS_CT, 60);
            }
            assert_eq!(monitor.settling().overshoot_ct, expected);
        }
    }

    #[test]
    fn the_time_inside_the_window_begins_after_the_last_error_beyond_it() {
        let mut monitor = Monitor::default();
        for (error_ct, inside) in [(0, 1), (61, 0), (60, 1), (-60, 2), (-61, 0), (5, 1)] {
            monitor.update(error_ct, &LIMITS_CT, 60);
            assert_eq!(monitor.inside_ticks(), inside);
        }
    }

    #[test]
    fn noise_is_the_mean_square_of_the_last_half_second() {
        let s = after((0..2 * NOISE_TICKS as i32).map(|i| if i < NOISE_TICKS as i32 { 500 } else { 8 - 16 * (i % 2) }));
        assert_eq!((s.noise_ct2, s.noise_peak_to_peak_ct), (Some(64.0), 16));
        assert_eq!(after(vec(5, 100)).noise_ct2, None);
    }

    fn vec(value: i32, n: usize) -> impl Iterator<Item = i32> {
        core::iter::repeat_n(value, n)
    }
}
