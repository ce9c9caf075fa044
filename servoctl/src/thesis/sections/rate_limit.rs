//! The limit on the rate of the nonlinear integrator (8.1, fig. 56).

use libm::exp;
use servo_core::SERVO_HZ;
use servo_core::parameters::Settings;

use crate::plot::{Axis, Band, Plot, Series};
use crate::table::number;
use crate::thesis::section::Section;
use crate::thesis::targets::Target;
use crate::thesis::verdict::Check;

/// Amplifier counts per newton in appendix E, and its limit in counts.
const COUNTS_PER_N: f64 = 1674.0;
/// See [`COUNTS_PER_N`].
const LIMIT_COUNTS: f64 = 25.0;

/// The section, for the drive's default parameters: τ_d 10 ms, F̂_C 0.6 N.
pub fn section(settings: &Settings) -> Section {
    let (coulomb_n, tau_s) = (settings.niasa_coulomb_n, settings.niasa_time_constant_s);
    let dt_s = 1.0 / f64::from(SERVO_HZ);
    let limit_n = 2.0 * coulomb_n * dt_s / tau_s;
    let range = (LIMIT_COUNTS - 0.5, LIMIT_COUNTS + 0.5);
    let checks = [
        Check::within("2 F̂_C Δt/τ_d in counts of appendix E", Some(limit_n * COUNTS_PER_N), range, 1, ""),
        Check::within(
            "the drive's limit in mN",
            Some(1e3 * settings.niasa_rate_limit_n),
            (1e3 * limit_n - 0.1, 1e3 * limit_n + 0.1),
            1,
            "",
        ),
    ];
    let force = |t_s: f64| coulomb_n * (1.0 - 2.0 * exp(-t_s / tau_s));
    let ms = |s: f64| 1e3 * s;
    let span_s = 5.0 * tau_s;
    let smooth = (0..=200).map(|i| span_s * f64::from(i) / 200.0).map(|t| (ms(t), force(t)));
    let steepest = [0.0, tau_s].map(|t| (ms(t), -coulomb_n + limit_n * t / dt_s));
    let plot = Plot::new(
        "Force of the integrator as a first-order process",
        Axis::linear("time / ms"),
        Axis::linear("force / N"),
    )
    .band(Band::y("±F_C", -coulomb_n, coulomb_n))
    .series(Series::new("first order with τ_d", 0).line(smooth))
    .series(Series::new("rate limit", 1).line(steepest));
    Section::new("8.1 The rate limit")
        .finding(
            Target::RateLimit,
            format!("{} N = {} counts", number(limit_n, 4), number(limit_n * COUNTS_PER_N, 1)),
            &checks,
        )
        .figure(
            &[56],
            [plot],
            format!(
                "from −F_C to F_C as a first-order process (F̂_C {coulomb_n} N, τ_d {} ms, {SERVO_HZ} Hz): its steepest sample is the \
                 limit. Computed.",
                ms(tau_s)
            ),
        )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::thesis::verdict::Outcome;

    #[test]
    fn the_drives_default_is_the_literal_of_appendix_e() {
        assert_eq!(section(&Settings::default()).findings[0].verdict.outcome, Outcome::Reproduced);
        let shorter = Settings { niasa_time_constant_s: 0.001, ..Settings::default() };
        assert_eq!(section(&shorter).findings[0].verdict.outcome, Outcome::NotReproduced);
    }
}
