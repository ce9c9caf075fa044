//! Loop transmissions by stepped sine (5.1, 8.2): how the loop changes with the amplitude, without and with NIASA.

use std::sync::atomic::Ordering;

use rayon::prelude::*;
use serde::Serialize;
use servo_core::SERVO_HZ;
use servo_core::compensator::Compensator;
use servo_core::parameters::Settings;
use servo_core::refusal::Refusal;
use servo_host_tests::FastBench;
use servo_host_tests::frequency_response::{Complex, Tone, play};
use servo_host_tests::tuning::{self, HIGH_PERFORMANCE, STANDARD};
use servo_sim::Stage;

use super::campaign::Watch;
use super::experiments::{appendix_e, gains, with};
use super::outcome::ORIGIN;
use super::words::plant;
use crate::settling::round_to;
use crate::table::{MISSING, Table, number};

/// Amplitudes of figure 15, % of the amplifier's full scale.
pub const FIGURE_15_PERCENT: [f64; 8] = [10.0, 5.0, 2.5, 1.25, 0.625, 0.313, 0.156, 0.078];
/// Amplitudes at which section 8.2 is looked at, %: the first is the large one.
pub const SECTION_8_2_PERCENT: [f64; 6] = [10.0, 1.25, 0.8, 0.625, 0.313, 0.078];
/// Design rates 1/τ_d of section 8.2: as written, and 2π of it, 1/s.
pub const RATES_PER_S: [f64; 2] = [100.0, 628.318_530_717_958_6];

/// Lowest and highest frequency, Hz, and how many of them, evenly on a logarithmic scale.
const SWEEP: (f64, f64, usize) = (3.0, 1000.0, 49);
/// Least time that each tone is measured, s, after it has been on for [`LEAD_TICKS`].
const SHORTEST_S: f64 = 0.5;
const LEAD_TICKS: u32 = 4_000;
/// Where it is looked whether the contact holds, Hz.
const LOW_HZ: f64 = 20.0;
/// A loop whose low-frequency gain exceeds that on the contact's spring by this factor has broken away.
const BROKEN_AWAY: f64 = 10.0;

/// Everything measured.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct LoopTransmission {
    /// Name as typed.
    pub experiment: &'static str,
    /// Section of the thesis.
    pub thesis_section: &'static str,
    /// Where the numbers come from.
    pub origin: &'static str,
    /// Seed of the noise.
    pub seed: u64,
    /// Whether everything was measured.
    pub complete: bool,
    /// Figure 15: PID of the first tuning at eight amplitudes.
    pub figure_15: Vec<Curve>,
    /// Section 8.2: PID of the second tuning, and NIASA with two stiffnesses and two rates, at several amplitudes.
    pub section_8_2: Vec<Curve>,
    /// k_I of section 8.2's tuning (N/(m s)).
    pub section_8_2_ki_n_per_m_s: f64,
    /// The most that its cascade could have: k_P²/4k_D, both zeros real (N/(m s)).
    pub section_8_2_ki_most_n_per_m_s: f64,
    /// Section 8.2: what the rate limit is for; measured when the sweeps are finished.
    pub stability: Vec<Stability>,
    /// The simulated hardware; friction as it stands here, without spread.
    pub plant: Stage,
}

/// One sweep.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Curve {
    /// Configuration, for example `niasa 4 N/µm`.
    pub name: String,
    /// σ̂ of NIASA (N/m); `None` without.
    pub stiffness_n_per_m: Option<f64>,
    /// 1/τ_d of NIASA (1/s); `None` without.
    pub rate_per_s: Option<f64>,
    /// Amplitude (% of full scale).
    pub amplitude_percent: f64,
    /// Amplitude as a force (N).
    pub amplitude_n: f64,
    /// Frequencies where |L| falls through 1, lowest first (Hz).
    pub crossover_hz: Vec<f64>,
    /// Phase margin at each of them (°).
    pub phase_margin_deg: Vec<f64>,
    /// Where |L| has its highest maximum above 100 Hz (Hz), interpolated; `None` if there is none.
    pub resonance_hz: Option<f64>,
    /// |L| at 20 Hz over that of the controller on the contact's small-signal stiffness alone.
    pub low_gain_per_spring: f64,
    /// `mass` or `spring`: what the stage behaves like at low frequency.
    pub behaves_like: &'static str,
    /// Frequencies (Hz).
    pub frequency_hz: Vec<f64>,
    /// Amplitude of the stage's motion (nm).
    pub motion_nm: Vec<f64>,
    /// |L|.
    pub magnitude: Vec<f64>,
    /// Phase of L, −360 to 0 (°).
    pub phase_deg: Vec<f64>,
}

/// Whether the stage comes to rest after a large excitation.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Stability {
    /// Whether the rate limit (8.1) acts.
    pub rate_limited: bool,
    /// Whether the delay is a whole servo period more than the drive's.
    pub a_tick_late: bool,
    /// σ̂ (N/m).
    pub stiffness_n_per_m: f64,
    /// 1/τ_d (1/s).
    pub rate_per_s: f64,
    /// Speed that is left a second after the excitation (m/s rms).
    pub left_over_m_per_s: f64,
    /// `true` if that is the noise of the loop at rest.
    pub stable: bool,
}

/// What a sweep is made of.
struct Sweep {
    name: String,
    settings: Settings,
    niasa: Option<(f64, f64)>,
    amplitude_percent: f64,
}

/// Number of sweeps, for progress.
pub const SWEEPS: u64 = (FIGURE_15_PERCENT.len() + SECTION_8_2_PERCENT.len() * (1 + 2 * RATES_PER_S.len())) as u64;

/// Measures everything. Ended from outside, it gives the sweeps that are finished; nothing if there are none.
///
/// # Errors
/// A stage that the drive's parameters cannot describe.
pub fn run(stage: &Stage, seed: u64, watch: Watch) -> Result<Option<LoopTransmission>, Refusal> {
    let mut stage = *stage;
    stage.friction.spread = None;
    let standard = tuning::settings(&stage, &STANDARD)?;
    let performance = tuning::settings(&stage, &HIGH_PERFORMANCE)?;
    let pid = |settings: Settings, amplitude_percent: f64| Sweep {
        name: "pid".to_owned(),
        settings,
        niasa: None,
        amplitude_percent,
    };
    let niasa = |(stiffness_n_per_m, rate_per_s): (f64, f64), amplitude_percent: f64| Sweep {
        name: format!("niasa σ̂ {} N/µm", stiffness_n_per_m * 1e-6),
        settings: with_niasa(performance, stiffness_n_per_m, rate_per_s),
        niasa: Some((stiffness_n_per_m, rate_per_s)),
        amplitude_percent,
    };
    let variants: Vec<(f64, f64)> =
        RATES_PER_S.iter().flat_map(|rate| stiffnesses(&stage).map(|stiffness| (stiffness, *rate))).collect();
    let figure_15 = FIGURE_15_PERCENT.map(|percent| pid(standard, percent));
    let section_8_2 = SECTION_8_2_PERCENT.into_iter().flat_map(|percent| {
        std::iter::once(pid(performance, percent)).chain(variants.iter().map(move |v| niasa(*v, percent)))
    });
    let sweeps: Vec<Sweep> = figure_15.into_iter().chain(section_8_2).collect();
    let mut figure_15: Vec<Option<Curve>> = sweeps
        .par_iter()
        .with_max_len(1)
        .map(|sweep| {
            if watch.stop.load(Ordering::Relaxed) {
                return Ok(None);
            }
            let curve = measure(&stage, seed, sweep)?;
            (watch.finished)(1);
            Ok(Some(curve))
        })
        .collect::<Result<_, Refusal>>()?;
    let parallel = gains(&performance);
    let most = parallel.kp_n_per_m * parallel.kp_n_per_m / (4.0 * parallel.kd_n_s_per_m);
    let section_8_2 = figure_15.split_off(FIGURE_15_PERCENT.len());
    let [figure_15, section_8_2] =
        [figure_15, section_8_2].map(|curves| curves.into_iter().flatten().collect::<Vec<_>>());
    let made = figure_15.len() + section_8_2.len();
    if made == 0 {
        return Ok(None);
    }
    let complete = made == sweeps.len() && !watch.stop.load(Ordering::Relaxed);
    Ok(Some(LoopTransmission {
        experiment: "loop-transmission",
        thesis_section: "5.1, 8.2",
        origin: ORIGIN,
        seed,
        complete,
        figure_15,
        section_8_2,
        section_8_2_ki_n_per_m_s: round_to(parallel.ki_n_per_m_s, 0),
        section_8_2_ki_most_n_per_m_s: round_to(most, 0),
        stability: if complete { stability(&stage, seed, &performance)? } else { Vec::new() },
        plant: stage,
    }))
}

/// The thesis' σ̂ of 4 and 8 N/µm for a stage of 8.66 N/µm, scaled to this one.
fn stiffnesses(stage: &Stage) -> [f64; 2] {
    [4.0, 8.0].map(|percent| round_to(stage.friction.stiffness_n_per_m * percent / 8.66, 0))
}

/// Settings with NIASA as in appendix E.
fn with_niasa(settings: Settings, stiffness_n_per_m: f64, rate_per_s: f64) -> Settings {
    let niasa = with(appendix_e(settings), Compensator::Niasa);
    Settings { niasa_stiffness_n_per_m: stiffness_n_per_m, niasa_time_constant_s: 1.0 / rate_per_s, ..niasa }
}

fn enabled(stage: &Stage, settings: &Settings, seed: u64) -> Result<FastBench, Refusal> {
    let mut bench = FastBench::new(stage, settings, seed)?;
    bench.enable()?;
    Ok(bench)
}

fn measure(stage: &Stage, seed: u64, sweep: &Sweep) -> Result<Curve, Refusal> {
    let amplitude_a = sweep.amplitude_percent / 100.0 * stage.amplifier.full_scale_a;
    let (low_hz, high_hz, count) = SWEEP;
    let mut points: Vec<(f64, Complex)> = Vec::with_capacity(count);
    let mut motion_nm = Vec::with_capacity(count);
    for i in 0..count {
        let hz = low_hz * libm::pow(high_hz / low_hz, i as f64 / (count - 1) as f64);
        let mut bench = enabled(stage, &sweep.settings, seed)?;
        // A tone that the drive refuses to follow leaves a gap.
        if let Ok(response) = play(&mut bench, &Tone::near(hz, amplitude_a, SHORTEST_S), LEAD_TICKS) {
            points.push((response.frequency_hz, response.loop_transmission));
            motion_nm.push(round_to(response.position_m * 1e9, 2));
        }
    }
    let crossings = crossings(&points);
    let spring_n_per_m = 2.0 * stage.friction.stiffness_n_per_m;
    let on_spring = gains(&sweep.settings).kp_n_per_m / spring_n_per_m;
    let low = points.iter().min_by(|a, b| (a.0 - LOW_HZ).abs().total_cmp(&(b.0 - LOW_HZ).abs()));
    let low_gain_per_spring = low.map_or(0.0, |(_, l)| l.abs() / on_spring);
    Ok(Curve {
        name: sweep.name.clone(),
        stiffness_n_per_m: sweep.niasa.map(|n| n.0),
        rate_per_s: sweep.niasa.map(|n| round_to(n.1, 3)),
        amplitude_percent: sweep.amplitude_percent,
        amplitude_n: round_to(amplitude_a * stage.motor.force_constant_n_per_a, 4),
        crossover_hz: crossings.iter().map(|c| round_to(c.0, 2)).collect(),
        phase_margin_deg: crossings.iter().map(|c| round_to(c.1, 2)).collect(),
        resonance_hz: resonance_hz(&points).map(|hz| round_to(hz, 2)),
        low_gain_per_spring: round_to(low_gain_per_spring, 3),
        behaves_like: if low_gain_per_spring > BROKEN_AWAY { "mass" } else { "spring" },
        frequency_hz: points.iter().map(|p| round_to(p.0, 4)).collect(),
        motion_nm,
        magnitude: points.iter().map(|p| round_to(p.1.abs(), 6)).collect(),
        phase_deg: points.iter().map(|p| round_to(lag_deg(p.1), 3)).collect(),
    })
}

/// Frequency (Hz) of the highest maximum of |L| above 100 Hz: the top of the parabola through three points on logarithmic scales.
fn resonance_hz(points: &[(f64, Complex)]) -> Option<f64> {
    let logarithms: Vec<(f64, f64)> = points.iter().map(|(hz, l)| (libm::log(*hz), libm::log(l.abs()))).collect();
    let [a, b, c] = logarithms
        .array_windows()
        .filter(|[a, b, c]| b.0 > libm::log(100.0) && b.1 > a.1 && b.1 >= c.1)
        .max_by(|x, y| x[1].1.total_cmp(&y[1].1))?;
    let (before, after) = ((b.1 - a.1) / (b.0 - a.0), (c.1 - b.1) / (c.0 - b.0));
    // The slope goes in a straight line from one middle to the next.
    let (from, to) = (0.5 * (a.0 + b.0), 0.5 * (b.0 + c.0));
    Some(libm::exp(from + (to - from) * before / (before - after)))
}

/// Phase, −360 to 0 degrees: a loop lags.
fn lag_deg(l: Complex) -> f64 {
    let degrees = l.degrees();
    if degrees > 0.0 { degrees - 360.0 } else { degrees }
}

/// Frequency (Hz) and phase margin (°) wherever |L| falls through 1, between two points on logarithmic scales.
pub(super) fn crossings(points: &[(f64, Complex)]) -> Vec<(f64, f64)> {
    let falls = points.windows(2).filter(|w| w[0].1.abs() >= 1.0 && w[1].1.abs() < 1.0);
    falls
        .map(|w| {
            let share = libm::log(w[0].1.abs()) / libm::log(w[0].1.abs() / w[1].1.abs());
            let hz = w[0].0 * libm::pow(w[1].0 / w[0].0, share);
            let margins = [w[0], w[1]].map(|p| 180.0 + lag_deg(p.1));
            (hz, margins[0] + share * (margins[1] - margins[0]))
        })
        .collect()
}

/// A large excitation and a second of rest, with and without rate limit, with the drive's delay and with a whole period more.
fn stability(stage: &Stage, seed: u64, pid: &Settings) -> Result<Vec<Stability>, Refusal> {
    const TONE_HZ: f64 = 30.0;
    const REST_TICKS: u32 = 8_000;
    const LISTEN_TICKS: u32 = 800;
    let amplitude_a = SECTION_8_2_PERCENT[0] / 100.0 * stage.amplifier.full_scale_a;
    let left_over = |settings: &Settings, late: bool, excite: bool| -> Result<f64, Refusal> {
        let mut stage = *stage;
        stage.encoder.latency_s += if late { 1.0 / f64::from(SERVO_HZ) } else { 0.0 };
        let mut bench = enabled(&stage, settings, seed)?;
        if excite && play(&mut bench, &Tone::near(TONE_HZ, amplitude_a, SHORTEST_S), LEAD_TICKS).is_err() {
            return Ok(f64::INFINITY);
        }
        for _ in 0..REST_TICKS {
            bench.tick(None);
        }
        let squares = (0..LISTEN_TICKS).map(|_| {
            bench.tick(None);
            bench.carriage.velocity_m_per_s() * bench.carriage.velocity_m_per_s()
        });
        Ok(libm::sqrt(squares.sum::<f64>() / f64::from(LISTEN_TICKS)))
    };
    let mut found = Vec::new();
    for a_tick_late in [false, true] {
        for rate_per_s in RATES_PER_S {
            for stiffness_n_per_m in stiffnesses(stage) {
                for rate_limited in [true, false] {
                    let limited = with_niasa(*pid, stiffness_n_per_m, rate_per_s);
                    let unlimited = Settings { niasa_rate_limit_n: 1e3, ..limited };
                    let settings = if rate_limited { limited } else { unlimited };
                    let left_over_m_per_s = left_over(&settings, a_tick_late, true)?;
                    let noise_m_per_s = left_over(pid, a_tick_late, false)?;
                    found.push(Stability {
                        rate_limited,
                        a_tick_late,
                        stiffness_n_per_m,
                        rate_per_s: round_to(rate_per_s, 3),
                        left_over_m_per_s: round_to(left_over_m_per_s, 9),
                        stable: left_over_m_per_s < 10.0 * noise_m_per_s,
                    });
                }
            }
        }
    }
    Ok(found)
}

impl LoopTransmission {
    /// The tables for a terminal.
    pub fn to_text(&self) -> String {
        let tables = [self.figure_15_table(), self.section_8_2_table(), self.stability_table()];
        let made = self.figure_15.len() + self.section_8_2.len();
        let unfinished = (!self.complete).then(|| format!("Not complete: {made} of {SWEEPS} sweeps.\n"));
        tables.iter().map(Table::to_text).chain(unfinished).collect::<Vec<_>>().join("\n")
    }

    /// Figure 15 in numbers.
    pub fn figure_15_table(&self) -> Table {
        let caption = format!(
            "Loop transmission of PID 100 Hz / 45° by amplitude (figure 15): {ORIGIN}, {}; mass: more than {BROKEN_AWAY} times the \
             gain at {LOW_HZ} Hz that the contact's spring 2σ alone would leave",
            plant(&self.plant)
        );
        let header = [
            "amplitude",
            "force / N",
            "behaves like",
            "gain over spring",
            "resonance / Hz",
            "crossover / Hz",
            "phase margin / °",
        ];
        self.figure_15.iter().fold(Table::new(caption, &header), |table, curve| {
            table.row([
                format!("{} %", curve.amplitude_percent),
                number(curve.amplitude_n, 3),
                curve.behaves_like.to_owned(),
                number(curve.low_gain_per_spring, 1),
                curve.resonance_hz.map_or(MISSING.to_owned(), |hz| number(hz, 0)),
                list(&curve.crossover_hz, 1),
                list(&curve.phase_margin_deg, 0),
            ])
        })
    }

    /// Crossovers of section 8.2 by amplitude: a row per amplitude, a column per configuration.
    pub fn section_8_2_table(&self) -> Table {
        let caption = format!(
            "Crossover frequencies in Hz (phase margin in °) by amplitude, 315 Hz / 50° (8.2): {ORIGIN}, {}; NIASA as in \
             appendix E, with its rate limit",
            plant(&self.plant)
        );
        let column = |curve: &Curve| match curve.rate_per_s {
            Some(rate) => format!("{}, {rate:.0} 1/s", curve.name),
            None => curve.name.clone(),
        };
        let mut columns: Vec<String> = Vec::new();
        for name in self.section_8_2.iter().map(column) {
            if !columns.contains(&name) {
                columns.push(name);
            }
        }
        let cell = |curve: &Curve| {
            let pairs = curve.crossover_hz.iter().zip(&curve.phase_margin_deg);
            let text: Vec<String> =
                pairs.map(|(hz, deg)| format!("{} ({})", number(*hz, 1), number(*deg, 0))).collect();
            if text.is_empty() { MISSING.to_owned() } else { text.join(", ") }
        };
        let header: Vec<&str> = std::iter::once("amplitude").chain(columns.iter().map(String::as_str)).collect();
        let rows = self.section_8_2.chunk_by(|a, b| a.amplitude_percent == b.amplitude_percent);
        rows.fold(Table::new(caption, &header), |table, curves| {
            let cells = columns
                .iter()
                .map(|name| curves.iter().find(|curve| column(curve) == *name).map_or(MISSING.to_owned(), &cell));
            table.row(std::iter::once(format!("{} %", curves[0].amplitude_percent)).chain(cells))
        })
    }

    /// What is left after a large excitation.
    pub fn stability_table(&self) -> Table {
        let caption = format!(
            "Speed left a second after an excitation of 10 % of full scale, 315 Hz / 50° with NIASA as in appendix E (8.1.2, 8.2): \
             {ORIGIN}, {}",
            plant(&self.plant)
        );
        let header = ["1/τ_d", "σ̂ / N/µm", "delay", "rate limit", "left over / µm/s", "verdict"];
        self.stability.iter().fold(Table::new(caption, &header), |table, s| {
            table.row([
                format!("{:.0} 1/s", s.rate_per_s),
                number(s.stiffness_n_per_m * 1e-6, 2),
                if s.a_tick_late { "a servo period more" } else { "the drive's" }.to_owned(),
                if s.rate_limited { "2 F̂_C dt/τ_d" } else { "none" }.to_owned(),
                number(s.left_over_m_per_s * 1e6, 1),
                if s.stable { "stable" } else { "unstable" }.to_owned(),
            ])
        })
    }
}

/// Numbers with a comma between.
fn list(values: &[f64], decimals: usize) -> String {
    let text: Vec<String> = values.iter().map(|v| number(*v, decimals)).collect();
    if text.is_empty() { MISSING.to_owned() } else { text.join(", ") }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_resonance_between_two_tones_is_found() {
        let at = |hz: f64| {
            let off = libm::log(hz / 400.0);
            (hz, Complex { re: libm::exp(-3.0 * off * off), im: 0.0 })
        };
        let found = resonance_hz(&[120.0, 250.0, 330.0, 430.0, 560.0].map(at)).unwrap();
        assert!((found - 400.0).abs() < 0.5, "{found} Hz");
        assert_eq!(resonance_hz(&[30.0, 40.0, 50.0].map(at)), None);
    }
}
