//! The closed loop as a second-order system (5.2, fig. 16), from the loop transmission at large amplitude.

use servo_host_tests::frequency_response::Complex;

use crate::plot::{Axis, Plot, Series};
use crate::reproduce::loop_transmission::{Curve, LoopTransmission};
use crate::table::number;
use crate::thesis::section::Section;
use crate::thesis::targets::Target;
use crate::thesis::verdict::Check;

/// Share of the closed loop's size that a good approximation explains: 1 − Σ|T − T₂|²/Σ|T|².
const GOOD: f64 = 0.9;

/// ω_n²/(s² + 2ζω_n s + ω_n²).
#[derive(Debug, Clone, Copy, PartialEq)]
struct SecondOrder {
    natural_hz: f64,
    damping: f64,
}

impl SecondOrder {
    fn at(self, hz: f64) -> Complex {
        let ratio = hz / self.natural_hz;
        Complex { re: 1.0, im: 0.0 } / Complex { re: 1.0 - ratio * ratio, im: 2.0 * self.damping * ratio }
    }
}

/// The section, from the curve of the largest amplitude.
pub fn section(measured: &LoopTransmission) -> Option<Section> {
    let curve = measured.figure_15.first()?;
    let points = closed(curve);
    let fit = fit(&points);
    let explained = explained(&points, fit);
    let shown = format!("ω_n = 2π·{} Hz, ζ = {}", number(fit.natural_hz, 1), number(fit.damping, 2));
    Some(
        Section::new("5.2 The closed loop as a second-order system")
            .finding(
                Target::SecondOrder,
                format!("{shown}; explains {} % of it", number(100.0 * explained, 1)),
                &[Check::within("share of the closed loop explained", Some(100.0 * explained), (100.0 * GOOD, 100.0), 1, "%")],
            )
            .conditions(super::frequency::conditions(measured, "PID 100 Hz / 45°"))
            .figure(
                &[16],
                panels(&points, fit),
                format!(
                    "closed loop L/(1 + L) from the loop transmission at {} % of full current, and {shown}, fitted by least squares",
                    curve.amplitude_percent
                ),
            )
            .text(differences(&points, fit)),
    )
}

/// Where the two differ: at the resonance, and far above it, where k_D makes the loop fall by one order only.
fn differences(points: &[(f64, Complex)], model: SecondOrder) -> String {
    let largest = |of: &dyn Fn(f64, Complex) -> f64| points.iter().map(|(hz, t)| of(*hz, *t)).fold(0.0, f64::max);
    let last = points.last().map_or((0.0, 0.0, 0.0), |(hz, t)| (*hz, t.abs(), model.at(*hz).abs()));
    format!(
        "Explained is the share of the sum of squares over all frequencies shown, evenly spread over their logarithm. It is not the whole of \
         the closed loop: its largest magnitude is {}, that of the second order {}; and k_D makes it fall by one order only, so that at {} Hz \
         {} are left of it, {} of the second order.",
        number(largest(&|_, t| t.abs()), 2),
        number(largest(&|hz, _| model.at(hz).abs()), 2),
        number(last.0, 0),
        number(last.1, 3),
        number(last.2, 3)
    )
}

/// Frequency (Hz) and closed loop.
fn closed(curve: &Curve) -> Vec<(f64, Complex)> {
    let loop_transmission = curve.magnitude.iter().zip(&curve.phase_deg).map(|(size, deg)| {
        let phase = deg.to_radians();
        Complex { re: size * libm::cos(phase), im: size * libm::sin(phase) }
    });
    let closed = loop_transmission.map(|l| l / Complex { re: 1.0 + l.re, im: l.im });
    curve.frequency_hz.iter().copied().zip(closed).collect()
}

/// Sum of the squared distances, on points that are evenly spread over the logarithm of frequency.
fn misfit(points: &[(f64, Complex)], model: SecondOrder) -> f64 {
    let distance2 = |(hz, closed): &(f64, Complex)| {
        let model = model.at(*hz);
        (closed.re - model.re).powi(2) + (closed.im - model.im).powi(2)
    };
    points.iter().map(distance2).sum()
}

fn explained(points: &[(f64, Complex)], model: SecondOrder) -> f64 {
    let size: f64 = points.iter().map(|(_, closed)| closed.re.powi(2) + closed.im.powi(2)).sum();
    1.0 - misfit(points, model) / size
}

/// Least squares: a grid over both parameters, refined about the best point until it does not move.
fn fit(points: &[(f64, Complex)]) -> SecondOrder {
    let mut best = SecondOrder { natural_hz: 100.0, damping: 0.5 };
    let mut span = (10.0f64, 20.0f64);
    for _ in 0..40 {
        let around = best;
        for i in -4i32..=4 {
            for j in -4i32..=4 {
                let step = |span: f64, k: i32| libm::pow(span, f64::from(k) / 4.0);
                let tried = SecondOrder {
                    natural_hz: around.natural_hz * step(span.0, i),
                    damping: around.damping * step(span.1, j),
                };
                if misfit(points, tried) < misfit(points, best) {
                    best = tried;
                }
            }
        }
        span = (libm::sqrt(span.0), libm::sqrt(span.1));
    }
    best
}

fn panels(points: &[(f64, Complex)], model: SecondOrder) -> [Plot; 2] {
    let modelled = || points.iter().map(|(hz, _)| (*hz, model.at(*hz)));
    let panel = |title: &str, of: fn(Complex) -> f64, y: Axis| {
        let hz = Axis::log("frequency / Hz");
        Plot::new(format!("Closed loop: {title}"), hz, y)
            .series(Series::new("closed loop", 0).line(points.iter().map(|(hz, t)| (*hz, of(*t)))))
            .series(Series::new("second order", 1).line(modelled().map(|(hz, t)| (hz, of(t)))))
    };
    let lag = |t: Complex| if t.degrees() > 0.0 { t.degrees() - 360.0 } else { t.degrees() };
    [
        panel("magnitude", |t| t.abs(), Axis::log("magnitude")),
        panel("phase", lag, Axis::linear("phase / °").range(-360.0, 10.0)),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_second_order_system_is_found_again() {
        let truth = SecondOrder { natural_hz: 137.0, damping: 0.31 };
        let points: Vec<(f64, Complex)> = (0..50).map(|i| 3.0 * 1.12f64.powi(i)).map(|hz| (hz, truth.at(hz))).collect();
        let found = fit(&points);
        assert!((found.natural_hz - 137.0).abs() < 1e-3 && (found.damping - 0.31).abs() < 1e-5, "{found:?}");
        assert!(explained(&points, found) > 1.0 - 1e-9);
    }

    #[test]
    fn the_closed_loop_of_a_large_gain_is_one() {
        let curve_like = |magnitude: f64| closed_point(magnitude, -90.0);
        assert!((curve_like(1e6).abs() - 1.0).abs() < 1e-6);
        assert!((curve_like(1e-6).abs() - 1e-6).abs() < 1e-9);
    }

    fn closed_point(magnitude: f64, deg: f64) -> Complex {
        let curve = Curve {
            name: String::new(),
            stiffness_n_per_m: None,
            rate_per_s: None,
            amplitude_percent: 10.0,
            amplitude_n: 1.0,
            crossover_hz: vec![],
            phase_margin_deg: vec![],
            resonance_hz: None,
            low_gain_per_spring: 1.0,
            behaves_like: "mass",
            frequency_hz: vec![10.0],
            motion_nm: vec![],
            magnitude: vec![magnitude],
            phase_deg: vec![deg],
        };
        closed(&curve)[0].1
    }
}
