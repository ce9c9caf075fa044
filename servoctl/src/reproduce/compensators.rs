//! Chapter 4 on the drive: every compensator on the moves of the first experiment, each tuned by the same procedure.

use std::sync::atomic::Ordering;

use rayon::prelude::*;
use serde::Serialize;
use servo_core::SERVO_HZ;
use servo_core::compensator::Compensator;
use servo_core::parameters::Settings;
use servo_core::refusal::Refusal;
use servo_host_tests::FastBench;
use servo_host_tests::frequency_response::{Tone, play};
use servo_host_tests::tuning::{self, STANDARD, Tuning};
use servo_sim::Stage;

use super::campaign::Watch;
use super::experiments::{FIVE_MM_SLOW, Request, appendix_e, gains, with};
use super::loop_transmission::crossings;
use super::pass::{self, Case};
use crate::settling::round_to;
use crate::table::{Table, number};

/// How each compensator is tuned, in words.
pub const PROCEDURE: &str = "for every candidate of a coarse grid the PD gains are adjusted until the loop transmission, measured at \
     10 % of full current on the nominal stage, has the crossover frequency and phase margin of the PID 100 Hz / 45° (to 3 Hz and \
     3°); candidates whose unrest in position, in the same last 500 ms of the same dwell as in the results, exceeds the PID's by more \
     than a tenth are dropped; of the rest the one with the least cost is taken: mean settling time to ±10 nm plus that to ±100 nm \
     over ten moves of another seed (fewer if fewer are compared), a move that does not settle counting as its whole dwell; for \
     feedforward, which is there for the motion, the rms error while moving; between equals the least error that stays decides";

/// Added to the seed for the moves that the tuning sees.
const TRAINING: u64 = 1_000;
/// Amplitude at which margins are measured, % of full scale.
pub const AMPLITUDE_PERCENT: f64 = 10.0;
/// Where the loop transmission is measured, as a share of the crossover frequency wanted.
const AROUND: [f64; 5] = [0.7, 0.85, 1.0, 1.2, 1.45];
/// Least time of a tone, s, and the ticks before it.
const TONE_S: f64 = 0.15;
const LEAD_TICKS: u32 = 1_600;
/// Rounds of adjusting the gains.
const ROUNDS: usize = 4;
/// How near margins must come: Hz and °.
const NEAR: (f64, f64) = (3.0, 3.0);
/// Noise in position that is still equal, as a share of the PID's.
const NOISIER: f64 = 1.1;
/// Time constants of the observers' error terms, s.
const OBSERVER_TAU_S: [f64; 10] = [2e-5, 5e-5, 1e-4, 2e-4, 5e-4, 1e-3, 3e-3, 6e-3, 0.01, 0.03];
/// What has nothing but more k_I, as far as the cascade has it: two real zeros, k_I ≤ k_P²/4k_D.
const INTEGRAL: &str = "pid-ki-tuned";
/// The LuGre observer with as much of its model as settles best.
pub const OBSERVER_SCALED: &str = "lugre-observer-scaled";
/// The same without its dead band against the encoder's noise: not tuned, but there to show what the band is for.
pub const WITHOUT_DEAD_BAND: &str = "lugre-observer-no-band";
/// What is tuned for the error while moving.
const FEEDFORWARD: &str = "feedforward";

/// What was tried, and what came of it.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Search {
    /// The procedure in words.
    pub procedure: &'static str,
    /// Whether every candidate was tried.
    pub complete: bool,
    /// One entry for each compensator.
    pub tuned: Vec<Tuned>,
}

/// A tuned compensator.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Tuned {
    /// Name of the configuration.
    pub name: &'static str,
    /// The chosen parameters in words.
    pub chosen: String,
    /// How many candidates there were.
    pub candidates: usize,
    /// How many of them had the margins and the noise of the PID.
    pub admissible: usize,
    /// Whether the chosen one is at an end of its row of the grid: a wider grid might have a better one.
    pub is_at_an_end: bool,
    /// Whether the chosen one has.
    pub is_admissible: bool,
    /// Its crossover frequency (Hz).
    pub crossover_hz: f64,
    /// Its phase margin (°).
    pub phase_margin_deg: f64,
    /// Its noise in position: standard deviation in the last 500 ms of the dwell (nm).
    pub noise_nm: f64,
    /// Its mean settling time to ±10 nm plus that to ±100 nm, whole dwells where a move did not settle (ms).
    pub cost_ms: f64,
    /// Its rms error while the profile moves (nm).
    pub tracking_nm: f64,
    /// All parameters.
    #[serde(skip)]
    pub settings: Settings,
}

type Change = Box<dyn Fn(Settings) -> Settings + Send + Sync>;

/// One point of a grid.
struct Candidate {
    name: &'static str,
    words: String,
    /// Factor on k_I.
    integral: f64,
    change: Change,
}

/// Whether one of the numbers in a candidate's words is the first or the last of those that were tried.
fn is_at_an_end(words: &str, all: &[&str]) -> bool {
    words.split(", ").enumerate().any(|(part, text)| {
        let mut tried: Vec<&str> = all.iter().filter_map(|words| words.split(", ").nth(part)).collect();
        tried.dedup();
        let ends = [tried.first(), tried.last()];
        text.contains(char::is_numeric) && ends[0] != ends[1] && ends.contains(&Some(&text))
    })
}

/// A candidate measured.
struct Trial {
    margins: (f64, f64),
    noise_nm: f64,
    cost_ms: f64,
    tracking_nm: f64,
    stays_nm: f64,
    settings: Settings,
}

/// Number of candidates, for progress.
pub fn candidates() -> u64 {
    grid().len() as u64
}

/// Wide enough that the best of a row lies inside of it, unless margins or noise end it first.
fn grid() -> Vec<Candidate> {
    let mut grid = Vec::new();
    let mut add = |name, words: String, integral, change: Change| {
        grid.push(Candidate { name, words, integral, change });
    };
    for factor in [1.0, 1.7, 3.0, 5.0, 8.0, 12.0, 18.0, 27.0] {
        add(INTEGRAL, format!("k_I × {factor}"), factor, Box::new(|s| s));
    }
    for (model, name) in ["Coulomb", "Stribeck", "Dahl", "LuGre", "GMS"].into_iter().enumerate() {
        for share in [0.5, 1.0, 1.5, 2.0, 3.0, 4.0] {
            let change = move |s| {
                let scaled = friction(s, 1.0, share);
                with(Settings { feedforward_model: model as f64, ..scaled }, Compensator::Feedforward)
            };
            add(FEEDFORWARD, format!("{name}, F_C × {share}"), 1.0, Box::new(change));
        }
    }
    // With friction as it was identified, which is what chapter 4 is about, and with as much of it as settles best.
    for (name, scaled, kind) in [
        ("lugre-observer", OBSERVER_SCALED, Compensator::LugreObserver),
        ("dahl-observer", "dahl-observer-scaled", Compensator::DahlObserver),
    ] {
        for (name, shares) in [(name, &[1.0][..]), (scaled, &[0.05, 0.1, 0.2, 0.35, 0.5, 0.65][..])] {
            for (share, tau_s) in shares.iter().flat_map(|share| OBSERVER_TAU_S.map(|tau_s| (*share, tau_s))) {
                let change = move |s| {
                    let scaled = friction(s, share, share);
                    with(Settings { observer_time_constant_s: tau_s, ..scaled }, kind)
                };
                add(name, format!("σ, F_C × {share}, τ_d {} ms", round_to(tau_s * 1e3, 3)), 1.0, Box::new(change));
            }
        }
    }
    for share in [0.01, 0.03, 0.1, 0.2, 0.3, 0.5, 1.0, 2.0] {
        let change = move |s| with(Settings { schedule_share: share, ..s }, Compensator::ScheduledPd);
        add("scheduled-pd", format!("share {share}"), 1.0, Box::new(change));
    }
    for hz in [3.0, 6.0, 10.0, 15.0, 20.0, 30.0, 50.0] {
        let change = move |s| with(Settings { disturbance_bandwidth_hz: hz, ..s }, Compensator::DisturbanceObserver);
        add("disturbance-observer", format!("{hz} Hz"), 1.0, Box::new(change));
    }
    for (name, kind, linear_too) in [
        ("niasa", Compensator::Niasa, true),
        ("niasa-7.55", Compensator::Niasa, false),
        ("niasa-maxwell", Compensator::NiasaMaxwell, true),
        ("niasa-maxwell-7.55", Compensator::NiasaMaxwell, false),
    ] {
        for factor in [0.12, 0.25, 0.5, 1.0, 2.0, 4.0, 8.0] {
            for tau_s in [0.001, 0.002, 0.003, 0.006, 0.01, 0.02] {
                let change = move |s: Settings| {
                    let niasa = Settings {
                        niasa_stiffness_n_per_m: factor * s.niasa_stiffness_n_per_m,
                        niasa_time_constant_s: tau_s,
                        ..with(s, kind)
                    };
                    if linear_too { appendix_e(niasa) } else { niasa }
                };
                add(name, format!("σ̂ × {factor}, τ_d {} ms", tau_s * 1e3), 1.0, Box::new(change));
            }
        }
    }
    grid
}

/// Settings with the friction model of feedforward, observers and scheduled PD scaled.
fn friction(s: Settings, stiffness: f64, coulomb: f64) -> Settings {
    Settings {
        friction_stiffness_n_per_m: stiffness * s.friction_stiffness_n_per_m,
        friction_coulomb_n: coulomb * s.friction_coulomb_n,
        friction_static_n: coulomb * s.friction_static_n,
        ..s
    }
}

/// Tunes every compensator for the stage of a request. `watch` hears of each candidate; ended from outside, the search tries no more.
///
/// # Errors
/// A stage that the drive's parameters cannot describe, or on which the PID itself does not work.
pub fn search(request: &Request, watch: Watch) -> Result<Search, Refusal> {
    let stage = &request.stage;
    let pid_settings = tuning::settings(stage, &STANDARD)?;
    let wanted = margins(stage, &pid_settings, STANDARD.crossover_hz, request.seed)
        .unwrap_or((STANDARD.crossover_hz, STANDARD.phase_margin_deg));
    let pid = judged(request, wanted, pid_settings)?;
    let grid = grid();
    let trials: Vec<Option<Trial>> = grid
        .par_iter()
        .with_max_len(1)
        .map(|candidate| {
            if watch.stop.load(Ordering::Relaxed) {
                return Ok(None);
            }
            let trial = match equalised(stage, candidate, wanted, request.seed) {
                Some((settings, margins)) => Some(judged(request, margins, settings)?),
                None => None,
            };
            (watch.finished)(1);
            Ok(trial)
        })
        .collect::<Result<_, Refusal>>()?;
    let complete = !watch.stop.load(Ordering::Relaxed);
    let is_admissible = |trial: &Trial| {
        let (hz, deg) = trial.margins;
        let near = (hz - wanted.0).abs() <= NEAR.0 && (deg - wanted.1).abs() <= NEAR.1;
        near && trial.noise_nm <= NOISIER * pid.noise_nm
    };
    let mut tuned: Vec<Tuned> = vec![Tuned::new("pid", "100 Hz / 45°", 1, &[&pid], is_admissible, &pid)];
    let mut names: Vec<&'static str> = grid.iter().map(|c| c.name).collect();
    names.dedup();
    for name in names {
        let known: Vec<(&Candidate, &Trial)> = grid
            .iter()
            .zip(&trials)
            .filter(|(c, _)| c.name == name)
            .filter_map(|(c, t)| Some((c, t.as_ref()?)))
            .collect();
        let best = known.iter().min_by(|a, b| {
            let cost = |t: &Trial| if name == FEEDFORWARD { t.tracking_nm } else { t.cost_ms };
            let (a, b) = (a.1, b.1);
            let admissible_first = is_admissible(b).cmp(&is_admissible(a));
            admissible_first.then(cost(a).total_cmp(&cost(b))).then(a.stays_nm.total_cmp(&b.stays_nm))
        });
        if let Some((candidate, trial)) = best {
            let of_name: Vec<&str> = grid.iter().filter(|c| c.name == name).map(|c| c.words.as_str()).collect();
            let all: Vec<&Trial> = known.iter().map(|(_, t)| *t).collect();
            let ki = |trial: &Trial| gains(&trial.settings).ki_n_per_m_s;
            // What is asked for is not what the cascade and the margins leave of it.
            let words = match name {
                INTEGRAL => format!("k_I × {}", number(ki(trial) / ki(&pid), 1)),
                _ => candidate.words.clone(),
            };
            let is_at_an_end = is_at_an_end(&candidate.words, &of_name);
            let tuned_so = Tuned::new(name, &words, of_name.len(), &all, is_admissible, trial);
            tuned.push(Tuned { is_at_an_end, ..tuned_so });
        }
    }
    Ok(Search { procedure: PROCEDURE, complete, tuned })
}

impl Tuned {
    fn new(
        name: &'static str,
        words: &str,
        candidates: usize,
        known: &[&Trial],
        is_admissible: impl Fn(&Trial) -> bool,
        trial: &Trial,
    ) -> Tuned {
        Tuned {
            name,
            chosen: words.to_owned(),
            candidates,
            admissible: known.iter().filter(|trial| is_admissible(trial)).count(),
            is_at_an_end: false,
            is_admissible: is_admissible(trial),
            crossover_hz: round_to(trial.margins.0, 2),
            phase_margin_deg: round_to(trial.margins.1, 2),
            noise_nm: round_to(trial.noise_nm, 3),
            cost_ms: round_to(trial.cost_ms, 1),
            tracking_nm: round_to(trial.tracking_nm, 1),
            settings: trial.settings,
        }
    }
}

/// [`WITHOUT_DEAD_BAND`], if the observer was tuned.
pub fn without_dead_band(search: &Search) -> Option<(&'static str, Settings)> {
    let tuned = search.tuned.iter().find(|tuned| tuned.name == OBSERVER_SCALED)?;
    Some((WITHOUT_DEAD_BAND, Settings { niasa_hysteresis_m: 0.0, ..tuned.settings }))
}

/// Gains with which the candidate has the margins wanted, and what it has; nothing if the loop cannot be measured.
fn equalised(stage: &Stage, candidate: &Candidate, wanted: (f64, f64), seed: u64) -> Option<(Settings, (f64, f64))> {
    let mut design = Tuning { creep_per_s: candidate.integral * STANDARD.creep_per_s, ..STANDARD };
    let mut found = None;
    for _ in 0..ROUNDS {
        let settings = (candidate.change)(tuning::settings(stage, &design).ok()?);
        let measured = margins(stage, &settings, wanted.0, seed)?;
        let miss = (wanted.0 - measured.0, wanted.1 - measured.1);
        found = Some((settings, measured));
        if miss.0.abs() < 0.2 * NEAR.0 && miss.1.abs() < 0.2 * NEAR.1 {
            break;
        }
        design.crossover_hz = (design.crossover_hz + miss.0).clamp(0.3 * wanted.0, 3.0 * wanted.0);
        design.phase_margin_deg = (design.phase_margin_deg + miss.1).clamp(20.0, 85.0);
    }
    found
}

/// Crossover frequency (Hz) and phase margin (°) near `around_hz`, by stepped sine on the stage without spread.
fn margins(stage: &Stage, settings: &Settings, around_hz: f64, seed: u64) -> Option<(f64, f64)> {
    let mut stage = *stage;
    stage.friction.spread = None;
    let amplitude_a = AMPLITUDE_PERCENT / 100.0 * stage.amplifier.full_scale_a;
    let mut points = Vec::with_capacity(AROUND.len());
    for share in AROUND {
        let mut bench = FastBench::new(&stage, settings, seed).ok()?;
        bench.enable().ok()?;
        let response = play(&mut bench, &Tone::near(share * around_hz, amplitude_a, TONE_S), LEAD_TICKS).ok()?;
        points.push((response.frequency_hz, response.loop_transmission));
    }
    crossings(&points).last().copied()
}

/// Noise and cost on the moves of the tuning.
fn judged(request: &Request, margins: (f64, f64), settings: Settings) -> Result<Trial, Refusal> {
    let (stage, steps) = (request.stage, FIVE_MM_SLOW);
    let case = Case { name: String::new(), stage, settings, steps, tolerances_nm: vec![10, 100] };
    let moves = pass::run(&case, request.seed.wrapping_add(TRAINING), 0, pass::MOVES.min(request.moves))?;
    let count = moves.len() as f64;
    let variance_ct2 = moves.iter().map(|m| m.rest.variance_ct2()).sum::<f64>() / count;
    let ms = |ticks: &Option<u32>| ticks.map_or(steps.dwell_s, |t| f64::from(t) / f64::from(SERVO_HZ)) * 1e3;
    let cost_ms = moves.iter().flat_map(|m| &m.settled_ticks).map(ms).sum::<f64>() / count;
    let (moving_ct2, samples) =
        moves.iter().fold((0.0, 0.0), |(ct2, n), m| (ct2 + m.tracking.ct2 as f64, n + f64::from(m.tracking.samples)));
    let count_nm = settings.encoder_count_m * 1e9;
    let faulty = moves.iter().any(|m| m.fault.is_some());
    Ok(Trial {
        margins,
        noise_nm: if faulty { f64::INFINITY } else { libm::sqrt(variance_ct2) * count_nm },
        cost_ms,
        stays_nm: libm::sqrt(moves.iter().map(|m| m.rest.mean_ct() * m.rest.mean_ct()).sum::<f64>() / count) * count_nm,
        tracking_nm: if faulty { f64::INFINITY } else { libm::sqrt(moving_ct2 / samples) * count_nm },
        settings,
    })
}

impl Search {
    /// How each was tuned, for a terminal.
    pub fn table(&self) -> Table {
        let header = [
            "compensator",
            "chosen",
            "candidates",
            "admissible",
            "crossover / Hz",
            "phase margin / °",
            "noise / nm",
            "cost / ms",
            "moving / nm",
        ];
        let table = Table { text_columns: 2, ..Table::new(format!("Tuning: {}", self.procedure), &header) };
        self.tuned.iter().fold(table, |table, tuned| {
            let admissible = if tuned.is_admissible { "" } else { ", taken anyway" };
            table.row([
                tuned.name.to_owned(),
                tuned.chosen.clone(),
                tuned.candidates.to_string(),
                format!("{}{admissible}", tuned.admissible),
                number(tuned.crossover_hz, 1),
                number(tuned.phase_margin_deg, 1),
                number(tuned.noise_nm, 2),
                number(tuned.cost_ms, 0),
                number(tuned.tracking_nm, 0),
            ])
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_candidate_at_an_end_of_the_grid_is_seen_whichever_of_its_numbers_it_is() {
        let all = [
            "Dahl, × 1, 2 ms",
            "Dahl, × 1, 4 ms",
            "Dahl, × 1, 8 ms",
            "LuGre, × 2, 2 ms",
            "LuGre, × 2, 4 ms",
            "LuGre, × 3, 8 ms",
        ];
        for (words, expected) in [("LuGre, × 2, 4 ms", false), ("Dahl, × 1, 4 ms", true), ("LuGre, × 2, 8 ms", true)]
        {
            assert_eq!(is_at_an_end(words, &all), expected, "{words}");
        }
        assert!(!is_at_an_end("30 Hz", &["30 Hz"]), "what was not varied has no end");
    }

    #[test]
    fn every_candidate_has_words_of_its_own() {
        let mut words: Vec<(&str, String)> = grid().into_iter().map(|c| (c.name, c.words)).collect();
        words.sort();
        words.dedup();
        assert_eq!(words.len() as u64, candidates());
    }
}
