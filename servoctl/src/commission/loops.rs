//! Offsets, safety, plant and loop.

use servo_core::SERVO_HZ;
use servo_core::cascade::{CascadeGains, ParallelGains};
use servo_core::measure::{Node, Shape};
use servo_core::parameters::Settings;
use servo_core::refusal::Refusal;
use servo_ident::filter;
use servo_ident::frf::{self, Point};
use servo_ident::tuning::{self, Pid, Stability, Wish};

use super::link::{Order, Session};
use super::sweep::{self, Bounds, Carrier, Tone, logarithmic, sweep};
use super::{Failure, Found, fit};

/// Crossover frequencies that can be wished for, Hz: inside the sweep, with a factor of five to its upper end.
pub const CROSSOVER_HZ: [f64; 2] = [40.0, 400.0];
/// Phase margins that can be wished for, degrees: from the least that is accepted on.
pub const PHASE_MARGIN_DEG: [f64; 2] = [tuning::PHASE_MARGIN_DEG, 65.0];
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
/// Travel that ends every excitation, m: a tone on the slow move takes 2.6 mm at most.
const TRAVEL_M: f32 = 5e-3;
/// Frequencies of the stepped sine, Hz, and their number.
const SWEEP_HZ: [f64; 2] = [20.0, 2_000.0];
const SWEEP_POINTS: usize = 28;
/// Speed of the slow move that carries the sweep, m/s.
const CARRIER_M_PER_S: f64 = 10e-3;
/// Speed of the sweep against that of the carrier, for a stage of [`LIGHTEST_KG`]: friction keeps its direction.
const SWEEP_SHARE: f64 = 0.3;
pub const LIGHTEST_KG: f64 = 0.8;
/// Largest force of the sweep, N.
const SWEEP_MAX_N: f64 = 4.0;
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
pub fn bounds(settings: &Settings) -> Bounds {
    Bounds {
        node: Node::Force,
        travel_m: TRAVEL_M,
        speed_m_per_s: 0.1,
        current_a: (0.9 * settings.current_limit_a) as f32,
    }
}

/// Bridge off: what the current reads without one. Sine and cosine have to be calibrated.
pub fn offsets(session: &mut Session, found: &mut Found) -> Result<String, Failure> {
    if !signals_are_calibrated(&session.settings) {
        return Err(Failure::Uncalibrated);
    }
    session.link.order(&Order::Disable)?;
    session.wait(OFFSET_S)?;
    let current_a = session.signal("iq_a", OFFSET_S)?;
    let offset_a = current_a.iter().sum::<f64>() / current_a.len() as f64;
    let most_a = OFFSET_SHARE * session.settings.current_full_scale_a;
    fit("offset of the current / A", offset_a, -most_a, most_a, "the converters are not calibrated")?;
    found.current_offset_a = Some(offset_a);
    Ok(format!("offset of the current {:.2} mA", offset_a * 1e3))
}

/// Whether anything but the values of a new drive says how sine and cosine are; an encoder without them needs nothing.
fn signals_are_calibrated(settings: &Settings) -> bool {
    let of = |s: &Settings| [s.sincos_cos_offset, s.sincos_sin_offset, s.sincos_gain, s.sincos_phase_rad];
    settings.encoder_kind == 0.0 || of(settings) != of(&Settings::default())
}

/// Asks the drive whether it can commutate; if not, the motor is aligned. Cautious gains: the loops are closed for an instant.
pub fn alignment(session: &mut Session, found: &mut Found) -> Result<String, Failure> {
    let settings = with_gains(&session.settings, &CAUTIOUS)?;
    session.configure(settings)?;
    session.look()?;
    let refused = session.link.order(&Order::Enable);
    if let Err(Failure::Refused(Refusal::NotAligned(_))) = refused {
        let command_timeout_s = session.settings.command_timeout_s;
        session.settings = Settings { command_timeout_s, ..session.link.align(session.stop)? };
        session.look()?;
        found.electrical_zero_m = Some(session.settings.commutation_offset_m);
        return Ok(format!("found at {:.3} mm", session.settings.commutation_offset_m * 1e3));
    }
    refused?;
    session.link.order(&Order::Disable)?;
    Ok("known for this encoder".to_owned())
}

/// Cautious gains, loops closed: noise at rest, then a push that has to move the stage its way.
pub fn safety(session: &mut Session, found: &mut Found) -> Result<String, Failure> {
    let settings = with_gains(&session.settings, &CAUTIOUS)?;
    session.configure(settings)?;
    session.enable()?;
    let rest = bounds(&settings).around(Shape::Pulse { amplitude: 0.0, length_s: 0.25 });
    let samples = session.capture(&Order::Excite(rest), 0.2, 1)?;
    let errors_m: Vec<f64> = samples.iter().map(|sample| sample.error_m).collect();
    let noise_m = filter::noise_rms(&errors_m);
    fit("noise / m rms", noise_m, 0.0, NOISE_MAX_M, "the encoder's signal is not good enough")?;
    found.noise_m = Some(noise_m);
    let push = Bounds { travel_m: 0.5e-3, ..bounds(&settings) };
    let push = push.around(Shape::Pulse { amplitude: PUSH_N, length_s: PUSH_S });
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
    let speed = SWEEP_SHARE * CARRIER_M_PER_S;
    let amplitude_n = |hz: f64| (LIGHTEST_KG * std::f64::consts::TAU * hz * speed).min(SWEEP_MAX_N);
    let tones: Vec<Tone> =
        logarithmic(SWEEP_HZ, SWEEP_POINTS).map(|hz| Tone { hz, amplitude: amplitude_n(hz) }).collect();
    session.enable()?;
    let mut carrier = Carrier::begin(session, CARRIER_M_PER_S)?;
    let readings = sweep(session, &tones, &bounds(&settings), Some(&mut carrier), (0, SWEEP_POINTS))?;
    let plant: Vec<Point> = readings.iter().map(|reading| sweep::plant(reading, settings.encoder_count_m)).collect();
    let mass_kg = frf::mass_kg(&plant, MASS_BAND_HZ)?;
    found.resonances = frf::resonances(&plant, PROMINENCE_DB)?;
    found.mass_kg = Some(mass_kg);
    found.plant = plant;
    let resonances: Vec<String> = found.resonances.iter().map(|r| format!("{:.0} Hz", r.frequency_hz)).collect();
    let resonances = if resonances.is_empty() { "none".to_owned() } else { resonances.join(", ") };
    Ok(format!("mass {mass_kg:.3} kg, resonances: {resonances}"))
}

/// Gains for the wanted loop, then the loop itself at large and small amplitudes.
pub fn tuning(session: &mut Session, found: &mut Found, wish: &Wish) -> Result<String, Failure> {
    if found.plant.is_empty() {
        return Err(Failure::Missing("the plant"));
    }
    found.wish = Some(*wish);
    let pid = tuning::pid(&found.plant, wish, SAMPLE_S)?;
    Stability::of(0.0, &tuning::loop_transmission(&found.plant, &pid, SAMPLE_S)).check()?;
    let settings = with_gains(&session.settings, &pid)?;
    session.configure(settings)?;
    session.enable()?;
    (found.loops, found.family) = (Vec::new(), Vec::new());
    for amplitude in FAMILY_N {
        let tones: Vec<Tone> = logarithmic(SWEEP_HZ, FAMILY_POINTS).map(|hz| Tone { hz, amplitude }).collect();
        let parts = (found.loops.len() * FAMILY_POINTS, FAMILY_N.len() * FAMILY_POINTS);
        let readings = sweep(session, &tones, &bounds(&settings), None, parts)?;
        let points: Vec<Point> = readings.iter().map(sweep::loop_transmission).collect();
        let stability = Stability::of(amplitude, &points);
        found.loops.push((amplitude, points));
        found.family.push(stability);
        stability.check()?;
    }
    found.gains = Some(pid);
    let margins = found.family[0].margins.ok_or(Failure::Missing("the crossover at the largest amplitude"))?;
    Ok(format!(
        "for {} Hz and {}°: k_P {:.3e} N/m, k_I {:.3e} N/(m s), k_D {:.0} N s/m; measured {:.1} Hz, {:.1}°; stable from {} to {} N",
        wish.crossover_hz,
        wish.phase_margin_deg,
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
