//! The firmware looks for the motor's electrical zero on the virtual board.

mod common;

use std::sync::OnceLock;
use std::time::Duration;

use servo_core::alignment::Reason;
use servo_core::fault::Fault;
use servo_core::parameters::{Parameter, Settings};
use servo_core::refusal::Refusal;
use servo_core::state::State;
use servo_protocol::message::{Reply, Request, Status};
use servo_sim::{Plant, Stage};
use servo_virtual_board::{Config, Session, Snapshot, VirtualBoard, flash};

const PITCH_M: f64 = 0.03;
const TRAVEL_M: f64 = 200e-6;
/// An alignment takes 7.0 s.
const PATIENCE: Duration = Duration::from_secs(8);
/// Start angles, a turn apart altogether.
const ANGLES: u32 = 36;

/// A drive whose parameters have been saved and whose motor was never aligned, on a stage whose magnets are at `turns` in mid-travel.
fn session(mut stage: Stage, turns: f64, wire: fn(&mut Plant)) -> Session {
    static BOOTED: OnceLock<Snapshot> = OnceLock::new();
    let booted = BOOTED.get_or_init(|| {
        let config = Config { parameters: flash::saved(&Settings::default()), ..Config::default() };
        let mut board = VirtualBoard::boot(&common::elf(), &config).unwrap();
        board.run_for(common::BOOT).unwrap();
        board.snapshot().unwrap()
    });
    let mut session = Session::new(VirtualBoard::from_snapshot(booted).unwrap());
    stage.motor.commutation_offset_m = turns * PITCH_M;
    let put = move |plant: &mut Plant| {
        *plant = Plant::new(&stage, 1);
        wire(plant);
    };
    session.board.with_plant(put).unwrap();
    session
}

fn refusal(session: &mut Session, request: &Request) -> Refusal {
    match session.ask(request).unwrap() {
        Reply::Refused(refusal) => refusal,
        other => panic!("{request:?} was answered by {other:?}"),
    }
}

/// Aligns; the status at the end, and how far the stage was from its beginning at most, m.
fn align(session: &mut Session) -> (Status, f64) {
    session.board.start_trace().unwrap();
    session.order(&Request::Align).unwrap();
    let give_up_ns = session.board.time_ns() + PATIENCE.as_nanos() as u64;
    let status = loop {
        session.board.run_for(Duration::from_millis(50)).unwrap();
        let status = session.status().unwrap();
        if matches!(status.state, State::SwitchOnDisabled | State::Fault) {
            break status;
        }
        assert!(session.board.time_ns() < give_up_ns, "{status:?}");
    };
    assert!(!session.board.bridge_enabled().unwrap());
    let trace = session.board.take_trace().unwrap();
    (status, trace.iter().map(|truth| truth.position_m.abs()).fold(0.0, f64::max))
}

fn value(session: &mut Session, name: &str) -> f64 {
    let id = Parameter::by_name(name).unwrap().id;
    match session.ask(&Request::GetParameter(id)).unwrap() {
        Reply::Parameter { value, .. } => value,
        other => panic!("{other:?}"),
    }
}

/// Aligns a drive whose magnets are at `turns`, which refuses to be enabled before; off by how much, degrees, and the furthest way, m.
fn aligned(turns: f64) -> (Session, f64, f64) {
    let mut session = session(Stage::default(), turns, |_| ());
    assert_eq!(refusal(&mut session, &Request::Enable), Refusal::NotAligned(None));
    let (status, furthest_m) = align(&mut session);
    assert_eq!((status.state, status.fault), (State::SwitchOnDisabled, None), "{turns}");
    assert!(furthest_m <= TRAVEL_M, "{furthest_m} m at {turns}");

    let found_turns = value(&mut session, "commutation_offset_m") / PITCH_M;
    let wrong = 360.0 * ((found_turns - turns + 0.5).rem_euclid(1.0) - 0.5);
    assert!(wrong.abs() < 0.05, "{wrong} degrees at {turns}");
    assert_eq!(value(&mut session, "commutation_identity"), 0.0);
    (session, wrong, furthest_m)
}

fn enable(session: &mut Session) {
    session.order(&Request::Enable).unwrap();
    session.board.run_for(Duration::from_millis(50)).unwrap();
    assert_eq!(session.status().unwrap().state, State::OperationEnabled);
    session.board.check_told().unwrap();
}

/// Saved with the number of the encoder, the offset holds after the next start, and for that encoder alone.
#[test]
fn what_is_found_is_saved_with_the_encoder_that_it_holds_for() {
    let (mut session, ..) = aligned(0.5);
    session.save_parameters().unwrap();
    session.board.reset().unwrap();
    session.board.run_for(common::BOOT).unwrap();
    enable(&mut session);
    session.order(&Request::Disable).unwrap();
    common::set(&mut session, "encoder_identity", 4711.0);
    assert_eq!(refusal(&mut session, &Request::Enable), Refusal::NotAligned(None));
    common::set(&mut session, "encoder_identity", 0.0);
    enable(&mut session);
}

#[test]
fn from_36_angles_the_zero_is_found_within_the_travel_and_the_drive_enabled() {
    std::thread::scope(|scope| {
        for part in 0..2 {
            scope.spawn(move || {
                for angle in (part..ANGLES).step_by(2) {
                    let (mut session, wrong, furthest_m) = aligned(f64::from(angle) / f64::from(ANGLES));
                    enable(&mut session);
                    eprintln!("{angle}/{ANGLES} turns: {wrong:+.4}° off, at most {:.1} µm away", furthest_m * 1e6);
                }
            });
        }
    });
}

#[test]
fn what_is_wrong_with_stage_motor_or_encoder_is_refused_by_name() {
    let mut blocked = Stage::default();
    blocked.mechanics.travel_m = 1e-6;
    let good = Stage::default();
    type Case = (&'static str, Stage, fn(&mut Plant), Reason);
    let cases: [Case; 4] = [
        ("blocked stage", blocked, |_| (), Reason::Blocked),
        ("reversed phases", good, Plant::exchange_phases, Reason::Reversed),
        ("encoder reversed", good, Plant::reverse_encoder, Reason::Reversed),
        ("open phase", good, |plant| plant.set_open_phase(Some(1)), Reason::NoCurrent),
    ];
    for (what, stage, wire, reason) in cases {
        let mut session = session(stage, 0.3, wire);
        let (status, furthest_m) = align(&mut session);
        assert_eq!((status.state, status.fault), (State::Fault, Some(Fault::Alignment)), "{what}");
        assert!(furthest_m <= 1.001 * TRAVEL_M, "{furthest_m} m, {what}");
        session.order(&Request::ResetFault).unwrap();
        session.board.run_for(Duration::from_millis(20)).unwrap();
        assert_eq!(refusal(&mut session, &Request::Enable), Refusal::NotAligned(Some(reason)), "{what}");
    }
}
