//! Length scale, friction and what NIASA makes of it.

use serde::{Deserialize, Serialize};
use servo_core::measure::Shape;
use servo_core::parameters::Settings;
use servo_core::profile::Limits;
use servo_ident::frf;
use servo_ident::length_scale::{End, Swing};
use servo_ident::{Record, dahl, length_scale as scale, maxwell, tuning};

use super::link::{Order, Sample, Session};
use super::loops::{SAMPLE_S, bounds};
use super::{Failure, Found, fit};

/// The step that shows the length scale, m, and its acceleration, m/s².
const STEP_M: f64 = 100e-6;
const STEP_M_PER_S2: f32 = 20.0;
/// Places of the identification profile, as shares of half the travel.
const PLACES: [f64; 3] = [-0.3, 0.0, 0.3];
/// Frequency of the profile, Hz, its periods, and its amplitude at the end over that at the beginning.
const PROFILE_HZ: f32 = 16.0;
const PERIODS: u32 = 8;
const END_SHARE: f32 = 0.7;
/// Motion of a profile in length scales, well inside of where friction rules, and its limits, m.
const SPAN_SCALES: f64 = 0.5;
const SPAN_M: [f64; 2] = [1.6e-6, 4e-6];
/// The amplitude begins here, N, and is raised by this factor until the stage moves far enough.
const FIRST_N: f32 = 0.2;
const RAISE: f32 = 1.25;
const ATTEMPTS: usize = 20;
/// Elements of the Maxwell-slip model.
const ELEMENTS: usize = 10;
/// Residual of Dahl's model against that of Maxwell slip up to which the simpler one is preferred.
const SIMPLER_UNTIL: f64 = servo_ident::choice::SIMPLER_UNTIL;
/// What is accepted of friction: outside, something else has been measured.
const SIGMA_N_PER_M: [f64; 2] = [1e5, 1e9];
const COULOMB_N: [f64; 2] = [1e-2, 50.0];

/// Friction found at a place.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ProfileFit {
    /// Where (m).
    pub place_m: f64,
    /// Amplitude of the profile (N).
    pub amplitude_n: f64,
    /// σ of Dahl's model (N/m).
    pub sigma_n_per_m: f64,
    /// Its 95 % interval (N/m).
    pub sigma_ci95_n_per_m: [f64; 2],
    /// F_C of Dahl's model (N).
    pub coulomb_n: f64,
    /// Its 95 % interval (N).
    pub coulomb_ci95_n: [f64; 2],
    /// What Dahl's model leaves on the samples that Maxwell slip is compared on (N rms).
    pub dahl_rms_n: f64,
    /// What Maxwell slip leaves (N rms); nothing if it cannot be fitted.
    pub maxwell_rms_n: Option<f64>,
    /// Its elements; none if it cannot be fitted.
    pub elements: Vec<maxwell::Element>,
    /// Motion of the profile (m).
    pub span_m: f64,
    /// Whether Maxwell slip is so much better that its parameters are needed.
    pub needs_maxwell: bool,
    /// Position (nm), measured friction (N) and Dahl's model (N), for a picture.
    pub loop_nm_n: Vec<[f64; 3]>,
}

/// A step, and the times between the extremes of its swing against those of the linear loop.
pub fn length_scale(session: &mut Session, found: &mut Found) -> Result<String, Failure> {
    let Some((_, large)) = found.loops.first() else { return Err(Failure::Missing("the loop transmission")) };
    let gains = found.gains.ok_or(Failure::Missing("the gains"))?;
    let closed_loop = frf::second_order(&tuning::closed_loop_without_zeros(large, &gains, SAMPLE_S))?;
    found.closed_loop = Some(closed_loop);
    session.enable()?;
    let start_m = session.look()?.position_m;
    let limits = Limits { velocity_m_per_s: 0.1, acceleration_m_per_s2: STEP_M_PER_S2, jerk_m_per_s3: None };
    let order = Order::Move { target_m: start_m + STEP_M, limits };
    let samples = session.capture(&order, 0.5, 1)?;
    let time_s: Vec<f64> = (0..samples.len()).map(|i| i as f64 * SAMPLE_S).collect();
    let position_m: Vec<f64> = samples.iter().map(|sample| -sample.error_m).collect();
    let swing = Swing::of(&time_s, &position_m, 0.0)?;
    found.extremes.clone_from(&swing.extremes);
    let linear = format!(
        "closed loop as of second order {:.0} Hz, damping {:.2}, {:.1} ms from extreme to extreme",
        closed_loop.natural_hz,
        closed_loop.damping,
        closed_loop.half_period_s() * 1e3
    );
    // A stage whose friction stops it at once shows no length scale; the profile then has its usual size.
    let result = scale::find(&swing, closed_loop.half_period_s(), scale::USUAL_FACTOR);
    found.length_scale_m = result.as_ref().ok().map(|length| length.length_m);
    Ok(match result {
        Ok(length) => {
            let leg_ms = length.leg_s * 1e3;
            let leg = match length.end {
                End::Untimely => format!("the next extreme comes after {leg_ms:.1} ms"),
                End::Short => format!("the way from there ends short of the target after {leg_ms:.1} ms"),
                End::Creeps => format!("creeping from there takes {leg_ms:.1} ms or more"),
            };
            let [linear_nm, length_nm] = [length.linear_from_m, length.length_m].map(|m| m * 1e9);
            format!("linear down to {linear_nm:.0} nm, friction rules below {length_nm:.0} nm: {leg}; {linear}")
        }
        Err(why) => format!("not seen ({why}); {linear}"),
    })
}

/// The identification profile at several places, Dahl's model and Maxwell slip fitted to each.
pub fn friction(session: &mut Session, found: &mut Found) -> Result<String, Failure> {
    let mass_kg = found.mass_kg.ok_or(Failure::Missing("the mass"))?;
    let span_m = found.length_scale_m.map_or(SPAN_M[0], |m| SPAN_SCALES * m).clamp(SPAN_M[0], SPAN_M[1]);
    let settings = session.settings;
    let half_m = 0.5 * (settings.travel_max_m - settings.travel_min_m);
    let middle_m = 0.5 * (settings.travel_max_m + settings.travel_min_m);
    session.enable()?;
    let mut profiles = Vec::new();
    for (index, place) in PLACES.into_iter().enumerate() {
        session.done(index, PLACES.len());
        let place_m = middle_m + place * half_m;
        session.move_to(place_m, Limits { velocity_m_per_s: 0.1, acceleration_m_per_s2: 1.0, jerk_m_per_s3: None })?;
        session.wait(0.5)?;
        let amplitude = amplitude_for(session, span_m)?;
        let shape = Shape::DecayingSine { amplitude, frequency_hz: PROFILE_HZ, periods: PERIODS, end_share: END_SHARE };
        let length_s = f64::from(PERIODS) / f64::from(PROFILE_HZ);
        let samples = session.capture(&Order::Excite(bounds(&settings).around(shape)), length_s, 1)?;
        profiles.push((place_m, f64::from(amplitude), samples));
        session.wait(0.1)?;
    }
    session.off()?;
    found.profiles = profiles
        .iter()
        .map(|(place_m, amplitude_n, samples)| fit_profile(samples, &settings, mass_kg, *place_m, *amplitude_n))
        .collect::<Result<_, _>>()?;
    let median = |of: fn(&ProfileFit) -> f64| {
        let mut values: Vec<f64> = found.profiles.iter().map(of).collect();
        values.sort_by(f64::total_cmp);
        values[values.len() / 2]
    };
    let (sigma, coulomb) = (median(|fit| fit.sigma_n_per_m), median(|fit| fit.coulomb_n));
    fit("sigma / N/m", sigma, SIGMA_N_PER_M[0], SIGMA_N_PER_M[1], "this is no friction of guides")?;
    fit("F_C / N", coulomb, COULOMB_N[0], COULOMB_N[1], "this is no friction of guides")?;
    (found.sigma_n_per_m, found.coulomb_n) = (Some(sigma), Some(coulomb));
    let votes = found.profiles.iter().filter(|fit| fit.needs_maxwell).count();
    let needs_maxwell = 2 * votes > found.profiles.len();
    found.needs_maxwell = Some(needs_maxwell);
    let model = if needs_maxwell { "Maxwell slip fits better" } else { "Dahl's model will do" };
    Ok(format!("σ {:.2} N/µm, F_C {coulomb:.3} N; {model}", sigma * 1e-6))
}

/// The amplitude that moves the stage by `span_m`, N: single periods at twice the frequency, raised until they do.
fn amplitude_for(session: &mut Session, span_m: f64) -> Result<f32, Failure> {
    let mut amplitude = FIRST_N;
    for _ in 0..ATTEMPTS {
        let frequency_hz = 2.0 * PROFILE_HZ;
        let shape = Shape::DecayingSine { amplitude, frequency_hz, periods: 1, end_share: 1.0 };
        let request = bounds(&session.settings).around(shape);
        let samples = session.capture(&Order::Excite(request), 1.0 / f64::from(frequency_hz), 1)?;
        let positions = || samples.iter().map(|sample| sample.position_m);
        let moved_m = positions().fold(f64::MIN, f64::max) - positions().fold(f64::MAX, f64::min);
        session.wait(0.05)?;
        if moved_m >= span_m {
            return Ok(amplitude);
        }
        amplitude *= RAISE;
    }
    let why = "no amplitude moves the stage far enough";
    Err(fit("amplitude / N", f64::from(amplitude), 0.0, f64::from(amplitude / RAISE), why)
        .err()
        .unwrap_or(Failure::Late(why)))
}

/// Both models fitted to a profile.
///
/// The force that the drive asked for is there one time constant of the current loop later, and then for a tick: its mean time is
/// that much after the tick, and the force at a tick lies between two of them.
fn fit_profile(
    samples: &[Sample],
    settings: &Settings,
    mass_kg: f64,
    place_m: f64,
    amplitude_n: f64,
) -> Result<ProfileFit, Failure> {
    let late = 0.5 + 1.0 / (std::f64::consts::TAU * settings.current_bandwidth_hz * SAMPLE_S);
    let time_s: Vec<f64> = (0..samples.len()).map(|i| i as f64 * SAMPLE_S).collect();
    let position_m: Vec<f64> = samples.iter().map(|sample| sample.position_m).collect();
    let force_n: Vec<f64> = (0..samples.len())
        .map(|i| {
            let (before, now) = (samples[i.saturating_sub(1)].force_n, samples[i].force_n);
            before + (1.0 - late) * (now - before)
        })
        .collect();
    let record = Record::from_current(&time_s, &position_m, &force_n, mass_kg, 1.0)?;
    let found = dahl::fit_any_memory(&record, false)?;
    let maxwell = maxwell::fit(&record, ELEMENTS).ok();
    let maxwell_rms_n = maxwell.as_ref().map(|fit| fit.rms_n);
    let model_n = found.force_n(&record);
    // Both on the same samples: from where the states of all elements are known.
    let compared = maxwell.as_ref().map_or(0, |fit| fit.first_sample);
    let left = record.force_n.iter().zip(&model_n).skip(compared).map(|(f, m)| (f - m) * (f - m));
    let dahl_rms_n = (left.sum::<f64>() / (record.samples() - compared) as f64).sqrt();
    let every = samples.len().div_ceil(800).max(1);
    let points = record.position_m.iter().zip(record.force_n.iter().zip(&model_n)).step_by(every);
    Ok(ProfileFit {
        place_m,
        amplitude_n,
        sigma_n_per_m: found.sigma_n_per_m,
        sigma_ci95_n_per_m: found.ci95.sigma_n_per_m.0,
        coulomb_n: found.coulomb_n,
        coulomb_ci95_n: found.ci95.coulomb_n.0,
        dahl_rms_n,
        maxwell_rms_n,
        elements: maxwell.map_or_else(Vec::new, |fit| fit.elements),
        span_m: record.span_m(),
        needs_maxwell: maxwell_rms_n.is_some_and(|rms_n| dahl_rms_n > SIMPLER_UNTIL * rms_n),
        loop_nm_n: points.map(|(x, (f, m))| [x * 1e9, f - found.offset_n, m - found.offset_n]).collect(),
    })
}

/// NIASA's parameters, for the smallest F_C of the places; in use but not switched on.
pub fn niasa(session: &mut Session, found: &mut Found) -> Result<String, Failure> {
    let sigma_n_per_m = found.sigma_n_per_m.ok_or(Failure::Missing("sigma"))?;
    // The smallest along the travel: with more than a quarter above it the axis may cycle there.
    let places = found.profiles.iter().map(|profile| profile.coulomb_n);
    let coulomb_n = places.reduce(f64::min).ok_or(Failure::Missing("F_C"))?;
    let noise_m = found.noise_m.ok_or(Failure::Missing("the noise"))?;
    let niasa = tuning::niasa(sigma_n_per_m, coulomb_n, noise_m, SAMPLE_S);
    let settings = Settings {
        niasa_stiffness_n_per_m: niasa.stiffness_n_per_m,
        niasa_coulomb_n: niasa.coulomb_n,
        niasa_time_constant_s: niasa.time_constant_s,
        niasa_rate_limit_n: niasa.rate_limit_n,
        niasa_hysteresis_m: niasa.hysteresis_m,
        ..session.settings
    };
    session.configure(settings)?;
    found.niasa = Some(niasa);
    Ok(format!(
        "σ̂ {:.2} N/µm, F̂_C {:.3} N, τ_d {:.0} ms, rate limit {:.1} mN a tick, hysteresis {:.1} nm",
        niasa.stiffness_n_per_m * 1e-6,
        niasa.coulomb_n,
        niasa.time_constant_s * 1e3,
        niasa.rate_limit_n * 1e3,
        niasa.hysteresis_m * 1e9
    ))
}
