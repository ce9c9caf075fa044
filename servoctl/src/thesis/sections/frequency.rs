//! Loop transmissions: by amplitude (5.1, fig. 15) and with NIASA (8.2, figs 57 to 62 and 68).

use std::f64::consts::{PI, TAU};

use servo_core::PWM_HZ;
use servo_sim::Stage;

use super::small_amplitude::{between, expected_in_words, small_crossovers};
use crate::plot::{Axis, Band, Plot, Series};
use crate::reproduce::loop_transmission::{Curve, LoopTransmission, RATES_PER_S, SECTION_8_2_PERCENT, Stability};
use crate::reproduce::outcome::ORIGIN;
use crate::reproduce::words::plant;
use crate::table::{MISSING, number};
use crate::thesis::section::Section;
use crate::thesis::targets::Target;
use crate::thesis::verdict::{Check, Verdict, judge};

/// Least amplitude that behaves like a mass, and largest that behaves like a spring, in the thesis (% of full current).
const MASS_FROM_PERCENT: f64 = 1.25;
/// Largest amplitude of figure 15 (% of full current).
const LARGE_PERCENT: f64 = 10.0;
/// See [`MASS_FROM_PERCENT`].
const SPRING_TO_PERCENT: f64 = 0.625;
/// Resonance of the small amplitudes in the thesis (Hz).
const RESONANCE_HZ: (f64, f64) = (250.0, 420.0);
/// Crossover of section 8.2 at large amplitude (Hz), and how far it may move (share) where the thesis says "unchanged".
const LARGE_HZ: f64 = 315.0;
/// See [`LARGE_HZ`].
const UNCHANGED: f64 = 0.02;

/// Captions of the tables, whose conditions stand at the head of the section.
const BY_AMPLITUDE: &str = "behaviour by amplitude; like a mass where the gain at low frequency is well above what the contact's spring \
     2σ alone would leave";
/// See [`BY_AMPLITUDE`].
const CROSSOVERS: &str = "crossover frequencies in Hz (phase margin in °) by amplitude, NIASA with its rate limit";
/// See [`BY_AMPLITUDE`].
const LEFT_OVER: &str = "speed left a second after an excitation of 10 % of full scale, with NIASA";

/// Section 5.1.
pub fn by_amplitude(measured: &LoopTransmission) -> Section {
    let curves = &measured.figure_15;
    let like = |what: &str| {
        let percent: Vec<String> =
            curves.iter().filter(|c| c.behaves_like == what).map(|c| c.amplitude_percent.to_string()).collect();
        format!("{} % like a {what}", if percent.is_empty() { MISSING.to_owned() } else { percent.join(", ") })
    };
    let resonances: Vec<String> =
        small(curves).map(|c| c.resonance_hz.map_or(MISSING.to_owned(), |hz| number(hz, 0))).collect();
    Section::new("5.1 Loop transmission by amplitude")
        .finding(Target::LoopByAmplitude, format!("{}; {}", like("mass"), like("spring")), &behaviour_checks(curves))
        .judged(Target::Resonance, format!("{} Hz", resonances.join(", ")), resonance_verdict(measured))
        .conditions(conditions(measured, "PID 100 Hz / 45°"))
        .figure(
            &[15, 62],
            bode(curves.iter().map(|c| (format!("{} %", c.amplitude_percent), c))),
            "loop transmission by stepped sine at eight amplitudes, % of the amplifier's full current; the 10 % curve is that of the \
             first tuning",
        )
        .table(&[], measured.figure_15_table().under(BY_AMPLITUDE))
        .text(friction_turns(&measured.plant, LARGE_PERCENT))
}

/// Section 8.2.
pub fn with_niasa(measured: &LoopTransmission) -> Section {
    let large: Vec<&Curve> = at(measured, SECTION_8_2_PERCENT[0]);
    let (small_percent, small_words, small_verdict) = small_crossovers(measured);
    let both = |pick: fn(&Curve) -> bool| {
        let of = |percent: f64, word: &'static str| {
            at(measured, percent).into_iter().filter(move |c| pick(c)).map(move |c| (format!("{}, {word}", name(c)), c))
        };
        bode(of(SECTION_8_2_PERCENT[0], "large").chain(of(small_percent, "small")))
    };
    let amplitudes = format!("large: {} %, small: {small_percent} % of full current", SECTION_8_2_PERCENT[0]);
    Section::new("8.2 Loop transmission with NIASA")
        .finding(Target::LargeCrossover, first_crossovers(&large), &large_checks(&large))
        .judged(Target::SmallCrossover, small_words, small_verdict)
        .judged(Target::WithoutRateLimit, stability_in_words(&measured.stability), stability_verdict(&measured.stability))
        .conditions(conditions(measured, "PID 315 Hz / 50°, NIASA as in appendix E"))
        .text(format!(
            "The thesis' small amplitude is one that “remains in the pre-rolling regime”; it is not printed. Shown is the largest whose force \
             is below F_C, so that it cannot make the stage roll. Computed as (k_I + σ̂/τ_d)/2πk and measured at the smallest amplitude: {}. {}",
            expected_in_words(measured),
            between(measured)
        ))
        .figure(
            &[57, 68],
            both(|c| c.stiffness_n_per_m.is_none()),
            format!("loop transmission with PID alone, {amplitudes}"),
        )
        .figure(
            &[58, 59, 60, 61],
            both(|c| c.rate_per_s.is_none_or(|rate| rate < 200.0)),
            format!("with NIASA, 1/τ_d = {} 1/s, {amplitudes}", number(RATES_PER_S[0], 0)),
        )
        .figure(
            &[],
            both(|c| c.rate_per_s.is_none_or(|rate| rate > 200.0)),
            format!("with NIASA, 1/τ_d = 2π·100 = {} 1/s, {amplitudes}", number(RATES_PER_S[1], 0)),
        )
        .table(&[], measured.section_8_2_table().under(CROSSOVERS))
        .text(format!(
            "{} The gains are computed with a PWM period of delay besides the current loop's own, too, which is {}° at {LARGE_HZ} Hz.",
            friction_turns(&measured.plant, SECTION_8_2_PERCENT[0]),
            number(360.0 * LARGE_HZ / f64::from(PWM_HZ), 1)
        ))
        .table(&[], measured.stability_table().under(LEFT_OVER))
}

/// Why a phase margin measured with friction is larger than the one that the gains were computed for.
///
/// Coulomb friction is in phase with velocity; of its square wave the fundamental is 4 F_C/π. Beside a force F that turns the phase of
/// the mass by asin(4 F_C/πF).
pub(super) fn friction_turns(plant: &Stage, percent: f64) -> String {
    let amplitude_n = percent / 100.0 * plant.amplifier.full_scale_a * plant.motor.force_constant_n_per_a;
    let share = 4.0 * plant.friction.coulomb_n / (PI * amplitude_n);
    let turned = if share < 1.0 {
        let degrees = number(libm::asin(share).to_degrees(), 0);
        format!(", which is {degrees}° at {percent} % of full current and more at less")
    } else {
        String::new()
    };
    format!(
        "A phase margin measured on the stage is larger than the one that the gains were computed for on the free mass, because friction \
         damps: beside a force F it turns the phase of the mass by asin(4 F_C/πF){turned}."
    )
}

/// What was measured on, by name.
pub(super) fn conditions(measured: &LoopTransmission, tuning: &str) -> [(&'static str, String); 3] {
    [
        ("Origin", ORIGIN.to_owned()),
        ("Tuning", tuning.to_owned()),
        ("Plant", format!("{}, not redrawn", plant(&measured.plant))),
    ]
}

/// Magnitude and phase; the first curves are drawn first.
fn bode<'a>(curves: impl Iterator<Item = (String, &'a Curve)>) -> [Plot; 2] {
    let hz = || Axis::log("frequency / Hz").range(3.0, 1000.0);
    let mut magnitude =
        Plot::new("Magnitude of the loop transmission", hz(), Axis::log("magnitude")).band(Band::y("", 1.0, 1.0));
    let mut phase = Plot::new("Phase of the loop transmission", hz(), Axis::linear("phase / °").range(-270.0, 90.0))
        .band(Band::y("", -180.0, -180.0));
    for (i, (name, curve)) in curves.enumerate() {
        let line =
            |values: &[f64]| Series::new(&name, i).line(curve.frequency_hz.iter().copied().zip(values.iter().copied()));
        magnitude = magnitude.series(line(&curve.magnitude));
        // A loop lags, but with a spring and a lead it may be ahead: the cut is where none of them is.
        let unwrapped: Vec<f64> =
            curve.phase_deg.iter().map(|deg| if *deg < -270.0 { deg + 360.0 } else { *deg }).collect();
        phase = phase.series(line(&unwrapped));
    }
    magnitude.height = 380.0;
    phase.height = 380.0;
    [magnitude, phase]
}

pub(super) fn name(curve: &Curve) -> String {
    match curve.stiffness_n_per_m {
        Some(stiffness) => format!("σ̂ {} N/µm", number(stiffness * 1e-6, 1)),
        None => "PID".to_owned(),
    }
}

fn behaviour_checks(curves: &[Curve]) -> Vec<Check> {
    let expected = |percent: f64| match percent {
        p if p >= MASS_FROM_PERCENT => Some("mass"),
        p if p <= SPRING_TO_PERCENT => Some("spring"),
        _ => None,
    };
    let check = |c: &Curve| {
        let says = format!("{} % like a {}", c.amplitude_percent, c.behaves_like);
        expected(c.amplitude_percent).map(|like| Check::new(c.behaves_like == like, says))
    };
    curves.iter().filter_map(check).collect()
}

fn small(curves: &[Curve]) -> impl Iterator<Item = &Curve> {
    curves.iter().filter(|c| c.amplitude_percent <= SPRING_TO_PERCENT)
}

fn resonance_verdict(measured: &LoopTransmission) -> Verdict {
    let check =
        |c: &Curve| Check::within(&format!("{} %:", c.amplitude_percent), c.resonance_hz, RESONANCE_HZ, 0, "Hz");
    let checks: Vec<Check> = small(&measured.figure_15).map(check).collect();
    let rigid_hz = |stiffness: f64| libm::sqrt(stiffness / measured.plant.mechanics.mass_kg) / TAU;
    let sigma = measured.plant.friction.stiffness_n_per_m;
    judge(&checks).because(format!(
        "The mass on σ swings at {} Hz, on the small-signal stiffness 2σ, which parallel elements have and Dahl's model has not, at {} Hz: \
         the less the stage moves, the nearer it comes to the latter",
        number(rigid_hz(sigma), 0),
        number(rigid_hz(2.0 * sigma), 0)
    ))
}

/// Curves of section 8.2 at an amplitude, PID first.
pub(super) fn at(measured: &LoopTransmission, percent: f64) -> Vec<&Curve> {
    measured.section_8_2.iter().filter(|c| c.amplitude_percent == percent).collect()
}

/// First crossover below [`LARGE_HZ`] and a bit: further ones belong to the contact's resonance.
pub(super) fn first_crossover(curve: &Curve) -> Option<f64> {
    curve.crossover_hz.first().copied().filter(|hz| *hz < 1.2 * LARGE_HZ)
}

pub(super) fn first_crossovers(curves: &[&Curve]) -> String {
    let shown = |c: &&Curve| first_crossover(c).map_or(MISSING.to_owned(), |hz| number(hz, 1));
    format!("{} Hz", curves.iter().map(shown).collect::<Vec<_>>().join(", "))
}

fn large_checks(curves: &[&Curve]) -> Vec<Check> {
    let Some((pid, others)) = curves.split_first() else { return Vec::new() };
    let near = (LARGE_HZ * (1.0 - UNCHANGED), LARGE_HZ * (1.0 + UNCHANGED));
    let mut checks = vec![Check::within("PID", first_crossover(pid), near, 1, "Hz")];
    let moved = others.iter().map(|c| Some(100.0 * (first_crossover(c)? / first_crossover(pid)? - 1.0).abs()));
    let most = moved.collect::<Option<Vec<f64>>>().map(|all| all.into_iter().fold(0.0, f64::max));
    checks.push(Check::within("NIASA moves it by at most", most, (0.0, 100.0 * UNCHANGED), 2, "%"));
    checks
}

fn stability_checks(cases: &[Stability]) -> Vec<Check> {
    let limited = || cases.iter().filter(|case| case.rate_limited);
    let unstable = limited().filter(|case| !case.stable).count();
    let mut checks = vec![Check::new(
        unstable == 0,
        format!("with the rate limit {unstable} of {} cases are unstable", limited().count()),
    )];
    for (late, delay) in [(false, "the drive's delay"), (true, "a servo period more of it")] {
        let without: Vec<&Stability> =
            cases.iter().filter(|case| !case.rate_limited && case.a_tick_late == late).collect();
        let unstable = without.iter().filter(|case| !case.stable).count();
        let says = format!("without it and with {delay} {unstable} of {} are unstable", without.len());
        checks.push(Check::new(unstable > 0, says));
    }
    checks
}

/// Partly, if it takes more delay than the drive here has.
fn stability_verdict(cases: &[Stability]) -> Verdict {
    let left = |late: bool| {
        let left_over = cases.iter().filter(|case| !case.rate_limited && case.a_tick_late == late);
        number(1e6 * left_over.map(|case| case.left_over_m_per_s).fold(0.0, f64::max), 1)
    };
    judge(&stability_checks(cases)).because(format!(
        "It hangs on the delay: a second after the excitation at most {} µm/s are left with the drive's, which has its force within the \
         servo period of the sample, and {} µm/s with a period more, as in a drive that puts its force out in the next one",
        left(false),
        left(true)
    ))
}

fn stability_in_words(cases: &[Stability]) -> String {
    let unstable = cases.iter().filter(|case| !case.stable).map(|case| {
        format!(
            "σ̂ {} N/µm, 1/τ_d {} 1/s, {}",
            number(case.stiffness_n_per_m * 1e-6, 0),
            number(case.rate_per_s, 0),
            if case.a_tick_late { "a servo period of delay more" } else { "the drive's delay" }
        )
    });
    let unstable: Vec<String> = unstable.collect();
    if unstable.is_empty() {
        "stable in all cases".to_owned()
    } else {
        format!("unstable with {}", unstable.join("; "))
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::thesis::verdict::Outcome;

    fn curve(percent: f64, niasa: Option<(f64, f64)>, crossover_hz: &[f64], like: &'static str) -> Curve {
        Curve {
            name: String::new(),
            stiffness_n_per_m: niasa.map(|n| n.0),
            rate_per_s: niasa.map(|n| n.1),
            amplitude_percent: percent,
            amplitude_n: 0.78 * percent,
            crossover_hz: crossover_hz.to_vec(),
            phase_margin_deg: vec![50.0; crossover_hz.len()],
            resonance_hz: (like == "spring").then_some(349.0),
            low_gain_per_spring: 1.0,
            behaves_like: like,
            frequency_hz: vec![10.0, 100.0],
            motion_nm: vec![100.0, 10.0],
            magnitude: vec![2.0, 0.5],
            phase_deg: vec![-90.0, -135.0],
        }
    }

    pub(in crate::thesis::sections) fn measured(small_hz: [f64; 5]) -> LoopTransmission {
        let niasa = |i: usize| (i > 0).then(|| ([4e6, 8e6][(i - 1) % 2], RATES_PER_S[(i - 1) / 2]));
        let section_8_2 = [10.0, 0.8].into_iter().flat_map(|percent| {
            (0..5).map(move |i| curve(percent, niasa(i), &[if percent > 1.0 { 315.0 } else { small_hz[i] }], "mass"))
        });
        let stable = |rate_limited, stable| Stability {
            rate_limited,
            a_tick_late: false,
            stiffness_n_per_m: 8e6,
            rate_per_s: 100.0,
            left_over_m_per_s: 0.0,
            stable,
        };
        LoopTransmission {
            experiment: "",
            thesis_section: "",
            origin: "",
            seed: 1,
            complete: true,
            figure_15: vec![curve(1.25, None, &[100.0], "mass"), curve(0.625, None, &[], "spring")],
            section_8_2: section_8_2.collect(),
            section_8_2_ki_n_per_m_s: 2e8,
            section_8_2_ki_most_n_per_m_s: 2.9e8,
            stability: vec![stable(true, true), stable(false, false)],
            plant: Stage::default(),
        }
    }

    #[test]
    fn a_mass_above_and_a_spring_below_are_what_figure_15_shows() {
        let findings = by_amplitude(&measured([15.0; 5])).findings;
        assert!(findings.iter().all(|f| f.verdict.outcome == Outcome::Reproduced), "{findings:?}");
        let mut wrong = measured([15.0; 5]);
        wrong.figure_15[1].behaves_like = "mass";
        wrong.figure_15[1].resonance_hz = None;
        let outcomes = by_amplitude(&wrong).findings.into_iter().map(|f| f.verdict.outcome);
        assert_eq!(outcomes.collect::<Vec<_>>(), [Outcome::Partly, Outcome::NotReproduced]);
    }

    #[test]
    fn friction_turns_the_mass_by_the_share_of_its_fundamental_in_the_force() {
        // 4 · 0.64 N/π beside 7.8 N.
        assert!(friction_turns(&Stage::default(), 10.0).contains("which is 6° at 10 % of full current"));
        // Beside a force below it there is no such angle.
        assert!(friction_turns(&Stage::default(), 0.1).ends_with("by asin(4 F_C/πF)."));
    }

    #[test]
    fn unchanged_at_large_amplitude_means_within_two_per_cent() {
        let at_large =
            |hz: f64| judge(&large_checks(&[&curve(10.0, None, &[315.0], "mass"), &curve(10.0, None, &[hz], "mass")]));
        assert_eq!(at_large(319.0).outcome, Outcome::Reproduced);
        assert_eq!(at_large(330.0).outcome, Outcome::Partly);
    }
}
