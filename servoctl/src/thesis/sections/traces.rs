//! Time series of single moves: the first moves of a campaign, with every sample.

use servo_core::SERVO_HZ;
use servo_core::record::flags;
use servo_core::refusal::Refusal;
use servo_host_tests::experiment::Steps;

use crate::plot::{Axis, Band, Plot, Series};
use crate::reproduce::pass::{self, Case};

/// Moves that are shown, as many as the thesis shows.
pub const MOVES: u64 = 6;

/// Tolerance drawn into the error plots (±, nm).
const SHOWN_NM: f64 = 10.0;

/// The moves of one configuration.
#[derive(Debug, Clone, PartialEq)]
pub struct Traces {
    /// What they are of, for captions.
    pub name: String,
    /// What acts, for legends.
    pub config: String,
    /// The moves.
    pub moves: Vec<Vec<Sample>>,
}

/// One servo period. Every move counts upwards from where its set-point began.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sample {
    /// Time after the end of the profile (s), negative during it.
    pub time_s: f64,
    /// Set-point − position (nm).
    pub error_nm: f64,
    /// Set-point (nm).
    pub setpoint_nm: f64,
}

/// Makes the first [`MOVES`] moves (at most `moves`) of a case and keeps every sample up to `until_s` after the profile.
///
/// # Errors
/// Settings or moves that the drive refuses.
pub fn record(case: &Case, name: &str, seed: u64, moves: u64, until_s: f64) -> Result<Traces, Refusal> {
    let count_nm = case.settings.encoder_count_m * 1e9;
    let mut recorded: Vec<Vec<(bool, i64, i32)>> = Vec::new();
    pass::run_observed(case, seed, 0, moves.min(MOVES), |index, record, _| {
        recorded.resize(index as usize + 1, Vec::new());
        let moving = record.flags & flags::MOVING != 0;
        recorded[index as usize].push((moving, record.position.0, record.error_ct));
    })?;
    let samples = |(index, ticks): (usize, &Vec<(bool, i64, i32)>)| {
        let sign = if Steps::is_forward(index as u64) { 1.0 } else { -1.0 };
        let profile = ticks.iter().filter(|tick| tick.0).count();
        let start_ct = ticks.first().map_or(0, |tick| tick.1 + i64::from(tick.2));
        let sample = |(tick, (_, position_ct, error_ct)): (usize, &(bool, i64, i32))| Sample {
            time_s: (tick as f64 - profile as f64) / f64::from(SERVO_HZ),
            error_nm: sign * f64::from(*error_ct) * count_nm,
            setpoint_nm: sign * (position_ct + i64::from(*error_ct) - start_ct) as f64 * count_nm,
        };
        ticks.iter().enumerate().map(sample).filter(|s| s.time_s <= until_s).collect()
    };
    let config = super::settling::display_name(&case.name);
    Ok(Traces { name: name.to_owned(), config, moves: recorded.iter().enumerate().map(samples).collect() })
}

/// Error over time after the profile, up to `end_ms`, within ± `height_nm`.
pub fn error_plot(traces: &Traces, end_ms: f64, height_nm: f64) -> Plot {
    let x = Axis::linear("time after the profile / ms").range(-0.02 * end_ms, end_ms);
    let y = Axis::linear("position error / nm").range(-height_nm, height_nm);
    let plot = Plot::new(format!("Position error, {}", traces.config), x, y).band(Band::y(
        format!("±{SHOWN_NM} nm"),
        -SHOWN_NM,
        SHOWN_NM,
    ));
    plot.series(traces.moves.iter().fold(Series::new(&traces.config, colour(traces)), |series, samples| {
        series.line(samples.iter().map(|s| (1e3 * s.time_s, s.error_nm)))
    }))
}

/// Position and set-point over time, from the beginning of the profile to 60 ms after it.
pub fn position_plot(traces: &Traces) -> Plot {
    let from_ms = 1e3 * traces.moves.iter().flatten().fold(0.0f64, |least, s| least.min(s.time_s));
    let goal_nm = traces.moves.iter().flatten().fold(0.0f64, |most, s| most.max(s.setpoint_nm));
    let x = Axis::linear("time after the profile / ms").range(from_ms, 60.0);
    let y = Axis::linear("position / nm").range(-0.5 * goal_nm, 2.0 * goal_nm);
    let plot = Plot::new(format!("Position, {}", traces.config), x, y);
    let moved = traces.moves.iter().fold(Series::new(&traces.config, colour(traces)), |series, samples| {
        series.line(samples.iter().map(|s| (1e3 * s.time_s, s.setpoint_nm - s.error_nm)))
    });
    let asked = traces.moves.iter().take(1).flatten().map(|s| (1e3 * s.time_s, s.setpoint_nm));
    plot.series(moved).series(Series::new("set-point", 5).line(asked))
}

/// The colour of a configuration, the same in all pictures of the page.
fn colour(traces: &Traces) -> usize {
    match traces.config.as_str() {
        "PID" => 0,
        "PID + NIASA (App. E)" => 1,
        _ => 2,
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use crate::reproduce::outcome::{ConfigOutcome, Run, StepOutcome, TuningOutcome};
    use crate::settling::{Config, SettlingExperiment, reduction_percent};
    use servo_core::parameters::Settings;
    use servo_sim::Stage;

    /// A run of ten moves with given mean settling times at ±3 and ±10 nm (ms) per configuration, their standard
    /// deviation a tenth of the mean.
    pub fn tiny_run(means_ms: &[(f64, f64)]) -> Run {
        let off = 0.1 * 0.9f64.sqrt();
        let scattered = |(a, b): &(f64, f64)| -> Vec<Vec<Option<f64>>> {
            (0..10)
                .map(|i| if i % 2 == 0 { 1.0 - off } else { 1.0 + off })
                .map(|f| vec![Some(a * f), Some(b * f)])
                .collect()
        };
        let names = ["pid", "pid+niasa", "pid+niasa-7.55", "fourth", "fifth", "sixth"];
        let tolerances_nm = [3, 10];
        let configs: Vec<Config> = means_ms
            .iter()
            .zip(names)
            .map(|(m, name)| Config::new(name, &tolerances_nm, &scattered(m), None))
            .collect();
        let settling = SettlingExperiment::new(&tolerances_nm, configs.clone());
        let reductions = |config: &Config| {
            let means = configs[0].mean_ms.iter().zip(&config.mean_ms);
            means.map(|(before, after)| reduction_percent((*before)?, (*after)?)).collect()
        };
        let outcome = |config: &Config| ConfigOutcome {
            settling: config.clone(),
            reduction_percent: reductions(config),
            compensator: String::new(),
            faults: 0,
            first_fault: None,
            tracking_rms_nm: None,
            end_error_rms_nm: Some(31.0),
            after_settling_rms_nm: None,
            steady_error_nm: None,
            restless_nm: None,
            parameters: Settings::default(),
        };
        Run {
            name: String::new(),
            configs: configs.iter().map(outcome).collect(),
            settling,
            tuning: TuningOutcome {
                name: String::new(),
                crossover_hz: 100.0,
                phase_margin_deg: 45.0,
                kp_n_per_m: 1.0,
                ki_n_per_m_s: 1.0,
                kd_n_s_per_m: 1.0,
                feedforward_mass_error_percent: None,
                terminal_force_n: 0.0,
                terminal_force_per_coulomb: 0.0,
            },
            step: StepOutcome { length_m: 5e-8, acceleration_m_per_s2: 1e-3, profile_ms: 14.142, dwell_s: 2.0 },
            plant: Stage::default(),
        }
    }

    #[test]
    fn a_recorded_move_ends_at_its_length_whichever_way_it_goes() {
        use crate::reproduce::experiments::{Experiment, Request};
        let request = Request {
            experiment: Experiment::Step50Nm,
            moves: 6,
            seed: 1,
            mass_errors_percent: vec![],
            stage: Stage::default(),
        };
        let plan = request.plan().unwrap();
        let traces = record(&plan.campaign.cases[1], "standard", 1, 6, 0.05).unwrap();
        assert_eq!((traces.moves.len(), traces.config.as_str()), (6, "PID + NIASA (App. E)"));
        for samples in &traces.moves {
            assert_eq!(samples.first().unwrap().setpoint_nm, 0.0);
            let last = samples.last().unwrap();
            assert!((last.setpoint_nm - 50.0).abs() < 0.1 && (last.time_s - 0.05).abs() < 1e-9, "{last:?}");
            // 14.142 ms of profile.
            assert!((samples[0].time_s + 0.01414).abs() < 3e-4, "{}", samples[0].time_s);
        }
    }
}
