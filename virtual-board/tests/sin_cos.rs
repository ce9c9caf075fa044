//! An encoder with sine and cosine at the board's converters and at the counter of its edges: 2 % of offset and gain, 2° of phase, noise
//! (`sim/stages/sin-cos.toml`), found by a person who only has the link.

mod common;

use std::sync::OnceLock;
use std::time::Duration;

use servo_core::capture::{Order, Trigger};
use servo_core::encoder::sincos::FitError;
use servo_core::encoder::tracker::LOST_AFTER;
use servo_core::fault::Fault;
use servo_core::parameters::Settings;
use servo_core::profile::Limits;
use servo_core::record::Selection;
use servo_core::refusal::Refusal;
use servo_core::settling::TOLERANCES_NM;
use servo_core::state::State;
use servo_host_tests::tuning;
use servo_protocol::message::{Reply, Request};
use servo_sim::Stage;
use servo_virtual_board::{AdcFault, Analog, Config, CounterFault, Session, Snapshot, VirtualBoard, flash};

const PERIOD_M: f64 = 4e-6;
const COUNT_M: f64 = PERIOD_M / 65_536.0;
const SERVO_PERIOD_NS: u64 = 125_000;
/// An alignment takes 7.0 s.
const PATIENCE_NS: u64 = 8_000_000_000;

fn stage() -> Stage {
    Stage::from_toml(include_str!("../../sim/stages/sin-cos.toml")).unwrap()
}

/// As a person would set them who has the data sheets: the signals as they should be, not as they are.
fn settings() -> Settings {
    Settings {
        compensator: 1.0,
        feedforward_mass_kg: 1.8,
        ..tuning::uncalibrated(&stage(), &tuning::STANDARD).unwrap()
    }
}

/// A drive with this encoder that has been switched on, aligned and enabled; and the largest error within a period that it told on the
/// way, m.
fn enabled() -> (Session, f32) {
    static ENABLED: OnceLock<(Snapshot, f32)> = OnceLock::new();
    let (snapshot, worst_m) = ENABLED.get_or_init(|| {
        let config = Config { stage: stage(), parameters: flash::saved(&settings()), ..Config::default() };
        let mut board = VirtualBoard::boot(&common::elf(), &config).unwrap();
        board.run_for(common::BOOT).unwrap();
        let mut session = Session::new(board);
        let worst_m = align(&mut session);
        session.order(&Request::Enable).unwrap();
        session.board.run_for(Duration::from_millis(50)).unwrap();
        (session.board.snapshot().unwrap(), worst_m)
    });
    let mut session = Session::new(VirtualBoard::from_snapshot(snapshot).unwrap());
    let status = session.status().unwrap();
    assert_eq!((status.state, status.fault), (State::OperationEnabled, None));
    (session, *worst_m)
}

/// An incremental encoder begins anew each time: nothing stored can say where the magnets are.
fn align(session: &mut Session) -> f32 {
    assert_eq!(refusal(session, &Request::Enable), Refusal::NotAligned(None));
    session.order(&Request::Align).unwrap();
    let give_up_ns = session.board.time_ns() + PATIENCE_NS;
    let mut worst_m = 0.0_f32;
    loop {
        session.board.run_for(Duration::from_millis(50)).unwrap();
        let status = session.status().unwrap();
        assert!(status.fault.is_none() && session.board.time_ns() < give_up_ns, "{status:?}");
        worst_m = worst_m.max(status.subdivisional_error_m.unwrap_or(0.0));
        if status.state == State::SwitchOnDisabled {
            return worst_m;
        }
    }
}

fn refusal(session: &mut Session, request: &Request) -> Refusal {
    match session.ask(request).unwrap() {
        Reply::Refused(refusal) => refusal,
        other => panic!("{request:?} was answered by {other:?}"),
    }
}

fn go(session: &mut Session, to_m: f64, velocity_m_per_s: f32, acceleration_m_per_s2: f32) {
    let limits = Limits { velocity_m_per_s, acceleration_m_per_s2, jerk_m_per_s3: None };
    session.move_to((to_m / COUNT_M) as i64, limits).unwrap();
}

/// What `servoctl calibrate-encoder` does.
fn calibrate(session: &mut Session) {
    session.order(&Request::CollectSignals).unwrap();
    go(session, 0.1e-3, 0.97e-3, 0.1);
    go(session, 0.0, 0.97e-3, 0.1);
    session.order(&Request::CorrectSignals).unwrap();
}

/// A drive whose encoder has been calibrated over the link.
fn calibrated() -> Session {
    static CALIBRATED: OnceLock<Snapshot> = OnceLock::new();
    let snapshot = CALIBRATED.get_or_init(|| {
        let (mut session, _) = enabled();
        calibrate(&mut session);
        session.board.snapshot().unwrap()
    });
    Session::new(VirtualBoard::from_snapshot(snapshot).unwrap())
}

/// True position in every tick of a slow motion, m, and measured less true, m.
fn slow_motion(session: &mut Session) -> Vec<[f64; 2]> {
    const SAMPLES: u32 = 4_000;
    let words = Selection::named(["position_low_ct"]).unwrap();
    let order = Order { words, samples: SAMPLES, before: 0, every_ticks: 1, trigger: Trigger::MoveStart };
    session.order(&Request::Capture(order)).unwrap();
    session.board.start_trace().unwrap();
    go(session, 0.6e-3, 0.97e-3, 0.1);
    let truth_m: Vec<f64> = session.board.take_trace().unwrap().iter().map(|truth| truth.position_m).collect();
    let mut measured_m = Vec::new();
    while measured_m.len() < SAMPLES as usize {
        match session.ask(&Request::ReadCapture { first: measured_m.len() as u32 }).unwrap() {
            Reply::Capture { words, .. } if !words.is_empty() => {
                measured_m.extend(words.iter().map(|word| f64::from(*word as i32) * COUNT_M));
            }
            other => panic!("{other:?}"),
        }
    }
    // Which tick the trigger was in, the beginning of the motion tells: there a tick more or less makes nanometres.
    let pairs = |late: usize| truth_m[late..].iter().zip(&measured_m).map(|(truth_m, m)| [*truth_m, m - truth_m]);
    let spread_m2 = |late: &usize| {
        let mean_m = pairs(*late).map(|[_, off_m]| off_m).sum::<f64>() / f64::from(SAMPLES);
        pairs(*late).map(|[_, off_m]| (off_m - mean_m).powi(2)).sum::<f64>()
    };
    let late = (0..=truth_m.len() - measured_m.len()).min_by(|a, b| spread_m2(a).total_cmp(&spread_m2(b))).unwrap();
    pairs(late).collect()
}

/// What repeats with every signal period of measured less true position, half of peak to peak, m: the mean in each 32nd of a period over
/// 120 periods, so that 0.44 nm of noise leave 0.04 nm rms.
fn subdivisional_error_m(session: &mut Session) -> f64 {
    let mut bins = [(0.0, 0u32); 32];
    for [truth_m, off_m] in slow_motion(session) {
        let bin = &mut bins[((truth_m / PERIOD_M).rem_euclid(1.0) * 32.0) as usize];
        *bin = (bin.0 + off_m, bin.1 + 1);
    }
    let means_m = bins.map(|(sum_m, n)| sum_m / f64::from(n));
    0.5 * (means_m.iter().copied().fold(f64::MIN, f64::max) - means_m.iter().copied().fold(f64::MAX, f64::min))
}

#[test]
fn a_calibration_over_the_link_takes_the_error_within_a_period_from_tens_of_nanometres_to_below_a_third_of_one() {
    let (mut session, before_m) = enabled();
    assert!((15e-9..40e-9).contains(&before_m), "{before_m} m");
    // What the drive has learnt on the small motions of the alignment is better, and not good enough.
    let learnt_m = session.status().unwrap().subdivisional_error_m.unwrap();
    assert!((0.5e-9..10e-9).contains(&learnt_m), "{learnt_m} m");
    let too_few = FitError::TooFewSamples { octant: 0, samples: 0 };
    assert_eq!(refusal(&mut session, &Request::CorrectSignals), Refusal::Signals(too_few));
    let mut session = calibrated();
    let left_m = subdivisional_error_m(&mut session);
    let health_m = session.status().unwrap().subdivisional_error_m.unwrap();
    println!(
        "estimated: {before_m:e} m raw, {learnt_m:e} m after alignment, {health_m:e} m calibrated; {left_m:e} m in truth"
    );
    assert!(left_m < 0.3e-9, "{left_m} m");
    assert!(health_m < 0.3e-9, "{health_m} m");
    session.board.check_told().unwrap();
}

#[test]
fn what_was_found_is_saved_with_the_other_parameters_and_used_after_the_next_start() {
    let mut session = calibrated();
    let signals = |session: &mut Session| session.parameters().unwrap().signals();
    let found = signals(&mut session);
    for (what, is, should) in [
        ("cosine's offset", found.cos_offset, 0.02),
        ("sine's offset", found.sin_offset, -0.02),
        ("gain", found.gain, 1.02),
        ("phase", found.phase_rad, 0.0349),
        ("amplitude", found.amplitude, 0.75),
    ] {
        assert!((is - should).abs() < 1e-4, "{what}: {is}, {should}");
    }
    session.order(&Request::Disable).unwrap();
    session.save_parameters().unwrap();
    session.board.reset().unwrap();
    session.board.run_for(common::BOOT).unwrap();
    assert_eq!(signals(&mut session), found);
    assert!(!session.parameter_store().unwrap().unsaved);
    assert_eq!(
        refusal(&mut session, &Request::Enable),
        Refusal::NotAligned(None),
        "it begins somewhere else each time"
    );
    session.board.check_told().unwrap();
}

/// Mean settling time to ±10 nm after the profile, s: 5 mm at 1 m/s² without feedforward, as the first experiment, to and fro five times,
/// of which the first one only makes the friction forget where it was.
fn settled_s(session: &mut Session) -> f64 {
    common::set(session, "feedforward_mass_kg", 0.0);
    let ten_nm = TOLERANCES_NM.iter().position(|nm| *nm == 10).unwrap();
    let mut settled_s = Vec::new();
    for to_m in [5e-3, 0.0].repeat(5) {
        go(session, to_m, 0.5, 1.0);
        session.board.run_for(Duration::from_millis(250)).unwrap();
        let settling = session.settling().unwrap();
        settled_s.push(settling.settled_after_s(ten_nm).unwrap_or_else(|| panic!("{to_m} m: {settling:?}")));
    }
    let status = session.status().unwrap();
    assert_eq!((status.counters.bad_frames, status.counters.overruns), (0, 0));
    let counted_s = &settled_s[2..];
    counted_s.iter().sum::<f64>() / counted_s.len() as f64
}

#[test]
fn moves_settle_as_with_an_absolute_encoder() {
    let stage = Stage::default();
    let absolute = Settings { compensator: 1.0, ..tuning::settings(&stage, &tuning::STANDARD).unwrap() };
    let config = Config { stage, parameters: flash::saved(&absolute), ..Config::default() };
    let mut board = VirtualBoard::boot(&common::elf(), &config).unwrap();
    board.run_for(common::BOOT).unwrap();
    let mut session = Session::new(board);
    session.order(&Request::Enable).unwrap();
    session.board.run_for(Duration::from_millis(50)).unwrap();

    let (sin_cos_s, absolute_s) = (settled_s(&mut calibrated()), settled_s(&mut session));
    println!("{sin_cos_s} s with sine and cosine, {absolute_s} s with BiSS-C");
    assert!((0.8..1.2).contains(&(sin_cos_s / absolute_s)), "{sin_cos_s} s, {absolute_s} s");
}

#[test]
fn no_period_is_lost_at_thirty_times_the_speed_that_an_arctangent_can_follow() {
    let mut session = calibrated();
    let offset_m = |session: &mut Session| {
        session.board.run_for(Duration::from_millis(50)).unwrap();
        session.status().unwrap().position_ct as f64 * COUNT_M - session.board.plant().unwrap().position_m()
    };
    let before_m = offset_m(&mut session);
    for (to_m, velocity_m_per_s, acceleration_m_per_s2) in [(5e-3, 0.5, 1.0), (-20e-3, 0.5, 20.0)] {
        session.board.start_trace().unwrap();
        go(&mut session, to_m, velocity_m_per_s, acceleration_m_per_s2);
        let trace = session.board.take_trace().unwrap();
        let fastest_m_per_s = trace.iter().map(|truth| truth.velocity_m_per_s.abs()).fold(0.0, f64::max);
        let off_m = offset_m(&mut session) - before_m;
        println!("{fastest_m_per_s} m/s, {off_m:e} m");
        assert!(fastest_m_per_s > 0.07, "{fastest_m_per_s} m/s");
        assert!(off_m.abs() < 0.05e-6, "{off_m} m after {to_m} m: a period is 4 µm");
    }
    assert_eq!(session.status().unwrap().counters.bad_frames, 0);
    session.board.check_told().unwrap();
}

/// Ticks until the bridge is off, and the fault.
fn broken(session: &mut Session, fault: impl FnOnce(&mut VirtualBoard)) -> (u64, Option<Fault>) {
    fault(&mut session.board);
    let start_ns = session.board.time_ns();
    while session.board.bridge_enabled().unwrap() {
        assert!(session.board.time_ns() - start_ns < 10 * SERVO_PERIOD_NS, "not seen");
        session.board.run_for(Duration::from_micros(1)).unwrap();
    }
    let ticks = (session.board.time_ns() - start_ns).div_ceil(SERVO_PERIOD_NS);
    session.board.run_for(Duration::from_millis(20)).unwrap();
    let status = session.status().unwrap();
    assert_eq!(status.state, State::Fault);
    session.board.check_told().unwrap();
    (ticks, status.fault)
}

/// Where sine and cosine are both far from their ends.
fn at_rest_between() -> Session {
    static AT_REST: OnceLock<Snapshot> = OnceLock::new();
    let snapshot = AT_REST.get_or_init(|| {
        let mut session = calibrated();
        go(&mut session, 10.625e-6, 1e-3, 0.1);
        session.board.run_for(Duration::from_millis(100)).unwrap();
        session.board.snapshot().unwrap()
    });
    Session::new(VirtualBoard::from_snapshot(snapshot).unwrap())
}

#[test]
fn signals_out_of_their_window_turn_the_bridge_off_within_three_ticks() {
    type Break = fn(&mut VirtualBoard);
    let cases: [(&str, Break); 5] = [
        ("dead sine, its amplifier at mid-range", |board| {
            board.set_adc_fault(Analog::Sine, Some(AdcFault::Stuck { code: 32_768 })).unwrap();
        }),
        ("cosine's wire is off", |board| board.set_adc_fault(Analog::Cosine, Some(AdcFault::Open)).unwrap()),
        ("sine at the upper end", |board| {
            board.set_adc_fault(Analog::Sine, Some(AdcFault::Stuck { code: u16::MAX })).unwrap();
        }),
        ("half the amplitude: dirt on the scale, lamp going out", |board| {
            for signal in [Analog::Sine, Analog::Cosine] {
                board.set_adc_fault(signal, Some(AdcFault::Faded { percent: 50 })).unwrap();
            }
        }),
        ("half a period counted that was none", |board| {
            board.set_counter_fault(Some(CounterFault::Invented { edges: 2 })).unwrap();
        }),
    ];
    for (what, fault) in cases {
        let (ticks, fault) = broken(&mut at_rest_between(), fault);
        assert_eq!(fault, Some(Fault::EncoderSignal), "{what}");
        assert!(ticks <= u64::from(LOST_AFTER), "{what}: {ticks} ticks");
    }
}

/// In motion: what stands still in place of several periods a tick is at odds with the sine, or a jump.
#[test]
fn comparators_that_stop_in_motion_turn_the_bridge_off_within_three_ticks() {
    let mut session = calibrated();
    let limits = Limits { velocity_m_per_s: 0.5, acceleration_m_per_s2: 1.0, jerk_m_per_s3: None };
    session.order(&Request::Move { target_ct: (5e-3 / COUNT_M) as i64, limits }).unwrap();
    session.board.run_for(Duration::from_millis(60)).unwrap();
    let (ticks, fault) = broken(&mut session, |board| board.set_counter_fault(Some(CounterFault::Stopped)).unwrap());
    assert!(matches!(fault, Some(Fault::EncoderSignal | Fault::EncoderJump)), "{fault:?}");
    assert!(ticks <= u64::from(LOST_AFTER), "{ticks} ticks");
}

#[test]
fn two_bad_samples_in_a_row_are_bridged_in_motion() {
    let mut session = calibrated();
    let limits = Limits { velocity_m_per_s: 0.5, acceleration_m_per_s2: 1.0, jerk_m_per_s3: None };
    session.order(&Request::Move { target_ct: (5e-3 / COUNT_M) as i64, limits }).unwrap();
    session.board.run_for(Duration::from_millis(60)).unwrap();
    for signal in [Analog::Sine, Analog::Cosine] {
        session.board.set_adc_fault(signal, Some(AdcFault::Stuck { code: 32_768 })).unwrap();
    }
    session.board.run_for(Duration::from_nanos(2 * SERVO_PERIOD_NS)).unwrap();
    for signal in [Analog::Sine, Analog::Cosine] {
        session.board.set_adc_fault(signal, None).unwrap();
    }
    session.board.run_for(Duration::from_millis(100)).unwrap();
    let status = session.status().unwrap();
    assert_eq!((status.state, status.fault, status.counters.bad_frames), (State::OperationEnabled, None, 2));
}

/// The kind of encoder is a parameter like the others: used from the next servo period on, bridge off.
#[test]
fn a_drive_told_of_the_other_kind_of_encoder_finds_none_and_is_not_enabled() {
    let mut session = Session::new(common::board());
    assert_eq!(refusal(&mut session, &Request::CollectSignals), Refusal::NoSignals);
    assert_eq!(refusal(&mut session, &Request::CorrectSignals), Refusal::NoSignals);
    common::set(&mut session, "encoder_kind", 1.0);
    session.board.run_for(Duration::from_millis(10)).unwrap();
    assert_eq!(refusal(&mut session, &Request::Align), Refusal::NoPosition);
    common::set(&mut session, "encoder_kind", 0.0);
    session.board.run_for(Duration::from_millis(10)).unwrap();
    session.order(&Request::Enable).unwrap();
    session.board.run_for(Duration::from_millis(20)).unwrap();
    assert_eq!(session.status().unwrap().state, State::OperationEnabled);
    session.board.check_told().unwrap();
}
