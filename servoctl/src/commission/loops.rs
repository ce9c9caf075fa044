//! Offsets, safety, plant and loop.

use servo_core::SERVO_HZ;
use servo_core::cascade::{CascadeGains, ParallelGains};
use servo_core::config::Compensator;
use servo_core::measure::{self, Node, Reading, Request, Shape};
use servo_core::parameters::Settings;
use servo_core::profile::Limits;
use servo_ident::filter;
use servo_ident::frf::{self, Complex64, Point};
use servo_ident::tuning::{self, Pid, STANDARD, Stability};

use super::link::{Order, Session};
use super::{Failure, Found, fit};

/// Gains to begin with: about 50 Hz on 1.5 kg, and stable from half to twice of it.
const CAUTIOUS: Pid = Pid { kp_n_per_m: 1.2e5, ki_n_per_m_s: 1e6, kd_n_s_per_m: 500.0 };
/// How long the current is looked at, s.
const OFFSET_S: f64 = 0.05;
/// Largest offset of the current, as a share of the converter's range.
const OFFSET_SHARE: f64 = 0.01;
/// Largest noise of the position that is accepted, m rms.
const NOISE_MAX_M: f64 = 100e-9;
/// Force of the push, N, and its length, s.
const PUSH_N: f32 = 3.0;
const PUSH_S: f32 = 0.02;
/// Frequencies of the stepped sine, Hz, and their number.
const SWEEP_HZ: [f64; 2] = [20.0, 2_000.0];
const SWEEP_POINTS: usize = 28;
/// Speed of the slow move that carries the sweep, m/s.
const CARRIER_M_PER_S: f32 = 10e-3;
/// Speed of the sweep against that of the carrier, for a stage of [`LIGHTEST_KG`]: friction keeps its direction.
const SWEEP_SHARE: f64 = 0.3;
const LIGHTEST_KG: f64 = 0.8;
/// Largest force of the sweep, N.
const SWEEP_MAX_N: f64 = 4.0;
/// Length of a tone's measured part and of its lead, s.
const TONE_S: [f32; 2] = [0.2, 0.1];
/// Where a free mass is expected to show, Hz.
const MASS_BAND_HZ: [f64; 2] = [60.0, 300.0];
/// Height of a resonance that is told, dB.
const PROMINENCE_DB: f64 = 6.0;
/// Amplitudes over which the loop has to be stable, N.
const FAMILY_N: [f64; 4] = [8.0, 2.0, 0.5, 0.15];
/// Frequencies at each of them.
const FAMILY_POINTS: usize = 18;

/// The time between two ticks, s.
pub const SAMPLE_S: f64 = 1.0 / SERVO_HZ as f64;

/// Limits of every excitation.
pub fn bounded(shape: Shape, settings: &Settings) -> Request {
    Request {
        shape,
        node: Node::Force,
        travel_m: 0.1,
        speed_m_per_s: 0.1,
        current_a: (0.9 * settings.current_limit_a) as f32,
    }
}

/// Bridge off: what the current reads without one.
pub fn offsets(session: &mut Session, found: &mut Found) -> Result<String, Failure> {
    session.link.order(&Order::Disable)?;
    session.wait(OFFSET_S)?;
    let current_a = session.signal("iq_a", OFFSET_S)?;
    let offset_a = current_a.iter().sum::<f64>() / current_a.len() as f64;
    let most_a = OFFSET_SHARE * session.settings.current_full_scale_a;
    fit("offset of the current / A", offset_a, -most_a, most_a, "the converters are not calibrated")?;
    found.current_offset_a = Some(offset_a);
    Ok(format!("offset of the current {:.2} mA", offset_a * 1e3))
}

/// Cautious gains, loops closed: noise at rest, then a push that has to move the stage its way.
pub fn safety(session: &mut Session, found: &mut Found) -> Result<String, Failure> {
    let settings = with_gains(&session.settings, &CAUTIOUS)?;
    session.configure(settings)?;
    session.link.order(&Order::Compensator(Compensator::None))?;
    session.enable()?;
    let rest = bounded(Shape::Pulse { amplitude: 0.0, length_s: 0.25 }, &settings);
    let samples = session.capture(&Order::Excite(rest), 0.2, 1)?;
    let errors_m: Vec<f64> = samples.iter().map(|sample| sample.error_m).collect();
    let noise_m = filter::noise_rms(&errors_m);
    fit("noise / m rms", noise_m, 0.0, NOISE_MAX_M, "the encoder's signal is not good enough")?;
    found.noise_m = Some(noise_m);
    let push = Request { travel_m: 0.5e-3, ..bounded(Shape::Pulse { amplitude: PUSH_N, length_s: PUSH_S }, &settings) };
    let samples = session.capture(&Order::Excite(push), f64::from(PUSH_S), 1)?;
    let way_m = samples
        .iter()
        .map(|sample| sample.position_m)
        .fold(0.0, |far: f64, x| if x.abs() > far.abs() { x } else { far });
    let least_m = 10.0 * noise_m;
    fit("way of a push / m", way_m, least_m, 0.5e-3, "a positive force has to move the stage in positive direction")?;
    session.wait(0.2)?;
    session.look()?;
    Ok(format!("noise {:.2} nm rms; {PUSH_N} N move the stage by {:.1} µm", noise_m * 1e9, way_m * 1e6))
}

/// The plant by stepped sine while a slow move keeps friction sliding.
pub fn plant(session: &mut Session, found: &mut Found) -> Result<String, Failure> {
    let settings = session.settings;
    let limits = Limits { velocity_m_per_s: CARRIER_M_PER_S, acceleration_m_per_s2: 0.5, jerk_m_per_s3: None };
    let middle_m = 0.5 * (settings.travel_max_m + settings.travel_min_m);
    let reach_m = 0.3 * (settings.travel_max_m - settings.travel_min_m);
    let tone_s = f64::from(TONE_S[0] + TONE_S[1]) + 0.1;
    session.move_to(middle_m - reach_m, Limits { velocity_m_per_s: 0.1, ..limits })?;
    let mut target_m = middle_m - reach_m;
    let mut plant = Vec::new();
    for hz in logarithmic(SWEEP_HZ, SWEEP_POINTS) {
        let left_m = (target_m - session.look()?.position_m).abs();
        if left_m < 2.0 * tone_s * f64::from(CARRIER_M_PER_S) {
            // The end of the travel is near: on in the other direction.
            session.rest()?;
            target_m = 2.0 * middle_m - target_m;
            session.link.order(&Order::Move { target_m, limits })?;
            session.wait(0.2)?;
        }
        let speed = SWEEP_SHARE * f64::from(CARRIER_M_PER_S);
        let amplitude_n = (LIGHTEST_KG * std::f64::consts::TAU * hz * speed).min(SWEEP_MAX_N);
        let reading = session.measure(&bounded(tone(amplitude_n, hz), &settings))?;
        plant.push(plant_point(&reading, settings.encoder_count_m));
    }
    session.rest()?;
    let mass_kg = frf::mass_kg(&plant, MASS_BAND_HZ)?;
    found.resonances = frf::resonances(&plant, PROMINENCE_DB)?;
    found.mass_kg = Some(mass_kg);
    found.plant = plant;
    let resonances: Vec<String> = found.resonances.iter().map(|r| format!("{:.0} Hz", r.frequency_hz)).collect();
    let resonances = if resonances.is_empty() { "none".to_owned() } else { resonances.join(", ") };
    Ok(format!("mass {mass_kg:.3} kg, resonances: {resonances}"))
}

/// Gains for the wanted loop, then the loop itself at large and small amplitudes.
pub fn tuning(session: &mut Session, found: &mut Found) -> Result<String, Failure> {
    if found.plant.is_empty() {
        return Err(Failure::Missing("the plant"));
    }
    let pid = tuning::pid(&found.plant, &STANDARD, SAMPLE_S)?;
    Stability::of(0.0, &tuning::loop_transmission(&found.plant, &pid, SAMPLE_S)).check()?;
    let settings = with_gains(&session.settings, &pid)?;
    session.configure(settings)?;
    session.enable()?;
    (found.loops, found.family) = (Vec::new(), Vec::new());
    for amplitude_n in FAMILY_N {
        let mut points = Vec::new();
        for hz in logarithmic(SWEEP_HZ, FAMILY_POINTS) {
            let reading = session.measure(&bounded(tone(amplitude_n, hz), &settings))?;
            let value = -complex(reading.before) / complex(reading.after);
            points.push(Point { frequency_hz: reading.frequency_hz, value });
        }
        let stability = Stability::of(amplitude_n, &points);
        found.loops.push((amplitude_n, points));
        found.family.push(stability);
        stability.check()?;
    }
    found.gains = Some(pid);
    let margins = found.family[0].margins.ok_or(Failure::Missing("the crossover at the largest amplitude"))?;
    Ok(format!(
        "k_P {:.3e} N/m, k_I {:.3e} N/(m s), k_D {:.0} N s/m; measured {:.1} Hz, {:.1}°; stable from {} to {} N",
        pid.kp_n_per_m,
        pid.ki_n_per_m_s,
        pid.kd_n_s_per_m,
        margins.crossover_hz,
        margins.phase_margin_deg,
        FAMILY_N[3],
        FAMILY_N[0]
    ))
}

fn with_gains(settings: &Settings, pid: &Pid) -> Result<Settings, Failure> {
    let parallel =
        ParallelGains { kp_n_per_m: pid.kp_n_per_m, ki_n_per_m_s: pid.ki_n_per_m_s, kd_n_s_per_m: pid.kd_n_s_per_m };
    let cascade = CascadeGains::from_parallel(parallel)?;
    Ok(Settings {
        position_gain_per_s: cascade.position_per_s,
        velocity_gain_n_s_per_m: cascade.velocity_n_s_per_m,
        velocity_integral_per_s: cascade.integral_per_s,
        ..*settings
    })
}

fn tone(amplitude_n: f64, hz: f64) -> Shape {
    Shape::Tone { amplitude: amplitude_n as f32, frequency_hz: hz as f32, measure_s: TONE_S[0], lead_s: TONE_S[1] }
}

fn plant_point(reading: &Reading, count_m: f64) -> Point {
    let value = complex(reading.position_ct) / complex(reading.after) * count_m;
    Point { frequency_hz: reading.frequency_hz, value }
}

fn complex(value: measure::Complex) -> Complex64 {
    Complex64::new(value.re, value.im)
}

/// `count` frequencies from the first to the last, in equal ratios.
fn logarithmic([first, last]: [f64; 2], count: usize) -> impl Iterator<Item = f64> {
    (0..count).map(move |i| first * libm::pow(last / first, i as f64 / (count - 1) as f64))
}
