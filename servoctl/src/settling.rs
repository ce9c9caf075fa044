//! Settling experiments: what a move's error trace says about settling, and the statistics over many moves.
//!
//! Everything here is plain data and pure functions. The types serialise to the JSON that `cargo xtask demo --json` and
//! the experiments write; the order of the fields is the order in that file, and every float is rounded when it enters
//! a type, so that the file is reproducible to the byte and the tables print the same numbers.

use serde::{Deserialize, Serialize};

/// Settling tolerances of the thesis' chapter 9 (±, nm), finest first.
pub const TOLERANCES_NM: [u32; 6] = [3, 5, 10, 20, 50, 100];

/// How long an error must stay inside its tolerance at the end of the dwell before the move counts as settled (s).
pub const GUARD_S: f64 = 0.1;

/// Length of the in-position window that follows settling to the finest tolerance (s); thesis section 9.3.
pub const IN_POSITION_WINDOW_S: f64 = 0.5;

/// Decimals kept of every float (ms, µs, nm, %).
const DECIMALS: i32 = 3;

/// Settling of several configurations of one drive over the same kind of move.
///
/// `reduction_percent` compares the second configuration with the first; with one configuration it holds only `None`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SettlingExperiment {
    /// Moves per configuration.
    pub moves: usize,
    /// Tolerances (±, nm) that every per-tolerance array in this experiment refers to.
    pub tolerances_nm: Vec<u32>,
    /// Results, baseline first.
    pub configs: Vec<Config>,
    /// Reduction of the mean settling time of `configs[1]` against `configs[0]`, per tolerance (%, positive = faster,
    /// three decimals); `None` where a mean is missing or the baseline's mean is zero.
    pub reduction_percent: Vec<Option<f64>>,
}

impl SettlingExperiment {
    /// Puts configurations side by side; `moves` is the number of moves of the first one.
    pub fn new(tolerances_nm: &[u32], configs: Vec<Config>) -> Self {
        let mean = |config: usize, tolerance: usize| configs.get(config)?.mean_ms.get(tolerance).copied().flatten();
        let reduction_percent = (0..tolerances_nm.len()).map(|t| reduction_percent(mean(0, t)?, mean(1, t)?)).collect();
        Self {
            moves: configs.first().map_or(0, |c| c.settling_ms.len()),
            tolerances_nm: tolerances_nm.to_vec(),
            configs,
            reduction_percent,
        }
    }
}

/// Settling of one configuration (one controller with one tuning).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Config {
    /// Name of the configuration, for example `pid+niasa`.
    pub name: String,
    /// Settling time of each move at each tolerance (ms, three decimals): outer index the move, inner the tolerance.
    /// `None` where the move had not settled by the end of its dwell.
    pub settling_ms: Vec<Vec<Option<f64>>>,
    /// Mean over the settled moves, per tolerance (ms); `None` if none settled.
    pub mean_ms: Vec<Option<f64>>,
    /// Sample standard deviation (n − 1) over the settled moves, per tolerance (ms); `None` for fewer than two.
    pub std_ms: Vec<Option<f64>>,
    /// Number of moves that had not settled, per tolerance. They count here and in no mean.
    pub unsettled: Vec<usize>,
    /// Root mean square of the error in position, all moves together (nm); `None` if no move settled.
    pub in_position_rms_nm: Option<f64>,
}

impl Config {
    /// Computes the statistics of given settling times (ms; one row per move, one entry per tolerance).
    ///
    /// A missing or non-finite entry counts as unsettled; entries beyond the number of tolerances are dropped.
    pub fn new(
        name: &str,
        tolerances_nm: &[u32],
        settling_ms: &[Vec<Option<f64>>],
        in_position_rms_nm: Option<f64>,
    ) -> Self {
        let time_ms = |row: &[Option<f64>], t: usize| row.get(t).copied().flatten().filter(|ms| ms.is_finite());
        let tolerances = 0..tolerances_nm.len();
        let settled_ms: Vec<Vec<f64>> =
            tolerances.clone().map(|t| settling_ms.iter().filter_map(|row| time_ms(row, t)).collect()).collect();
        let rounded = |value: Option<f64>| value.map(|v| round_to(v, DECIMALS));
        Self {
            name: name.to_owned(),
            settling_ms: settling_ms
                .iter()
                .map(|row| tolerances.clone().map(|t| rounded(time_ms(row, t))).collect())
                .collect(),
            mean_ms: settled_ms.iter().map(|times| rounded(mean(times))).collect(),
            std_ms: settled_ms.iter().map(|times| rounded(sample_std(times))).collect(),
            unsettled: settled_ms.iter().map(|times| settling_ms.len() - times.len()).collect(),
            in_position_rms_nm: rounded(in_position_rms_nm.filter(|rms| rms.is_finite())),
        }
    }

    /// Computes everything from the error traces of the moves (nm), each starting at the end of its motion profile and
    /// sampled at `sample_rate_hz`, with [`GUARD_S`] and [`IN_POSITION_WINDOW_S`].
    ///
    /// In position means: up to [`IN_POSITION_WINDOW_S`] from the moment the move has settled to the finest tolerance.
    pub fn from_errors(name: &str, tolerances_nm: &[u32], errors_nm: &[Vec<f64>], sample_rate_hz: f64) -> Self {
        let settling_ms: Vec<Vec<Option<f64>>> = errors_nm
            .iter()
            .map(|error_nm| {
                let time = |&tol: &u32| settling_time_ms(error_nm, sample_rate_hz, f64::from(tol), GUARD_S);
                tolerances_nm.iter().map(time).collect()
            })
            .collect();
        let finest_nm = tolerances_nm.iter().min().map_or(0.0, |&tol| f64::from(tol));
        let in_position: Vec<&[f64]> =
            errors_nm.iter().filter_map(|error_nm| in_position(error_nm, sample_rate_hz, finest_nm)).collect();
        Self::new(name, tolerances_nm, &settling_ms, rms(&in_position))
    }
}

/// One run on a board, virtual or real: the experiment together with the firmware that produced it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct BoardRun {
    /// Part the firmware was built for, for example `stm32h743zi`.
    pub target: String,
    /// SHA-256 of the ELF (hexadecimal).
    pub elf_sha256: String,
    /// The settling results; their fields stand at this level in the JSON.
    #[serde(flatten)]
    pub settling: SettlingExperiment,
    /// Timing of the servo tick over the whole run.
    pub servo_tick: ServoTick,
    /// What the emulator told about the firmware's use of the part; empty if nothing was out of order.
    pub told: Vec<String>,
}

impl BoardRun {
    /// The run as one line of JSON, without a line end.
    ///
    /// # Errors
    /// Those of the serialiser; none is known for this type.
    pub fn to_json(&self) -> serde_json::Result<String> {
        serde_json::to_string(self)
    }
}

/// Timing of the servo tick, measured in the tick.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ServoTick {
    /// Nominal rate (Hz).
    pub rate_hz: u32,
    /// Ticks measured.
    pub count: u64,
    /// Ticks that took longer than their period.
    pub overruns: u64,
    /// Longest tick (µs, three decimals).
    pub max_us: f64,
}

impl ServoTick {
    /// Rounds `max_us` to three decimals and keeps the rest.
    pub fn new(rate_hz: u32, count: u64, overruns: u64, max_us: f64) -> Self {
        Self { rate_hz, count, overruns, max_us: round_to(max_us, DECIMALS) }
    }
}

/// Settling time (ms): from the first sample to the last one with |error| > tolerance; 0 if there is none.
///
/// `error_nm[0]` is the sample at the end of the motion profile. `None` if the error exceeds the tolerance within the last
/// `guard_s` seconds of the trace, if the trace is no longer than that, or if `sample_rate_hz` is not positive. An error
/// that is not a number exceeds every tolerance.
pub fn settling_time_ms(error_nm: &[f64], sample_rate_hz: f64, tolerance_nm: f64, guard_s: f64) -> Option<f64> {
    settled_at(error_nm, sample_rate_hz, tolerance_nm, guard_s).map(|sample| sample as f64 / sample_rate_hz * 1e3)
}

/// Index of the last sample outside the tolerance, 0 if there is none; `None` as for [`settling_time_ms`].
fn settled_at(error_nm: &[f64], sample_rate_hz: f64, tolerance_nm: f64, guard_s: f64) -> Option<usize> {
    if !(sample_rate_hz > 0.0 && sample_rate_hz.is_finite()) {
        return None;
    }
    let guard_samples = (guard_s.max(0.0) * sample_rate_hz).ceil().max(1.0) as usize;
    let guard_start = error_nm.len().checked_sub(guard_samples).filter(|&start| start > 0)?;
    let inside = |e: &f64| e.abs() <= tolerance_nm;
    match error_nm.iter().rposition(|e| !inside(e)) {
        None => Some(0),
        Some(last) if last < guard_start => Some(last),
        Some(_) => None,
    }
}

/// The part of a trace that counts as in position: [`IN_POSITION_WINDOW_S`] from settling, less if the trace ends before.
fn in_position(error_nm: &[f64], sample_rate_hz: f64, tolerance_nm: f64) -> Option<&[f64]> {
    let last_outside = settled_at(error_nm, sample_rate_hz, tolerance_nm, GUARD_S)?;
    let rest = &error_nm[last_outside + 1..];
    let window_samples = (IN_POSITION_WINDOW_S * sample_rate_hz).round() as usize;
    Some(&rest[..window_samples.min(rest.len())])
}

/// Root mean square of all samples of all traces, about zero; `None` without samples.
fn rms(traces: &[&[f64]]) -> Option<f64> {
    let count: usize = traces.iter().map(|t| t.len()).sum();
    let sum_of_squares: f64 = traces.iter().flat_map(|t| t.iter()).map(|e| e * e).sum();
    (count > 0).then(|| (sum_of_squares / count as f64).sqrt())
}

/// Arithmetic mean; `None` of nothing.
pub fn mean(values: &[f64]) -> Option<f64> {
    (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
}

/// Sample standard deviation (n − 1); `None` of fewer than two values.
pub fn sample_std(values: &[f64]) -> Option<f64> {
    let mean = mean(values)?;
    let sum_of_squares: f64 = values.iter().map(|v| (v - mean) * (v - mean)).sum();
    (values.len() >= 2).then(|| (sum_of_squares / (values.len() - 1) as f64).sqrt())
}

/// Reduction of `value` against `baseline` (%, positive = smaller, three decimals); `None` if the baseline is not positive.
pub fn reduction_percent(baseline: f64, value: f64) -> Option<f64> {
    (baseline > 0.0).then(|| round_to((baseline - value) / baseline * 100.0, DECIMALS))
}

/// Rounds to a number of decimals, half away from zero; never returns a negative zero.
pub fn round_to(value: f64, decimals: i32) -> f64 {
    let scale = 10f64.powi(decimals);
    (value * scale).round() / scale + 0.0
}

#[cfg(test)]
mod tests;
