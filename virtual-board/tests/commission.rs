//! The firmware's ELF and `servoctl`'s procedure: from a drive that nobody has set up to one that settles with NIASA, unattended, over the
//! serial line. One stage here; the others take as long each and run in `cargo xtask commission-stages`.

mod common;

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use common::{BOOT, elf};
use servo_core::config::Compensator;
use servo_core::parameters::Settings;
use servo_core::state::State;
use servo_sim::Stage;
use servo_virtual_board::port::{BoardPort, Shared};
use servo_virtual_board::{Config, Session, VirtualBoard};
use servoctl::commission::{Event, Failure, Found, LEAST_GAIN, OnLine, Plan, Step, data_sheet, run};
use servoctl::link::{Client, Drive, Patience};

/// A new drive on this stage with these parameters, in front of the procedure.
fn new_drive(stage: &Stage, settings: &Settings) -> (Shared, OnLine) {
    let mut board = VirtualBoard::boot(&elf(), &Config { stage: *stage, ..Config::default() }).unwrap();
    board.run_for(BOOT).unwrap();
    let board = Arc::new(Mutex::new(board));
    let client = Client::new(Box::new(BoardPort::new(board.clone())), Patience::SERIAL, 1);
    let (mut link, _) = OnLine::new(Drive::connect(client).unwrap()).unwrap();
    link.prepare(settings).unwrap();
    (board, link)
}

/// The board alone, when the procedure has ended.
fn afterwards(board: Shared) -> Session {
    Session::new(Arc::into_inner(board).unwrap().into_inner().unwrap())
}

fn seconds(board: &Shared) -> f64 {
    board.lock().unwrap().time_ns() as f64 * 1e-9
}

/// A new drive on this stage, commissioned; then what the drive itself says, and what the truth is.
fn commission(name: &str, toml: &str) {
    let stage = Stage::from_toml(toml).unwrap();
    let settings = data_sheet(&stage).unwrap();
    let (board, mut link) = new_drive(&stage, &settings);
    let (mut found, never, started) = (Found::default(), AtomicBool::new(false), Instant::now());
    run(&mut link, &Plan::new(settings), &mut found, &never, &mut |event| {
        let Event::Ended(step, result) = event else { return };
        let (virtual_s, wall_s) = (seconds(&board), started.elapsed().as_secs_f64());
        let words = result.clone().unwrap_or_else(|why| format!("refused: {why}"));
        println!("{name}: {virtual_s:.1} s virtual, {wall_s:.0} s wall: {}: {words}", step.name());
    })
    .unwrap();
    drop(link);
    let mut session = afterwards(board);

    assert!(found.gain().unwrap() >= LEAST_GAIN, "{name}: {:?}", found.gain());
    assert!((found.mass_kg.unwrap() / stage.mechanics.mass_kg - 1.0).abs() < 0.03, "{name}: {:?} kg", found.mass_kg);
    assert!(!session.board.bridge_enabled().unwrap());
    let status = session.status().unwrap();
    assert_eq!((status.state, status.fault), (State::SwitchOnDisabled, None));
    assert_eq!((status.counters.overruns, status.counters.bad_frames, status.lost_records), (0, 0, 0));
    assert!(!session.parameter_store().unwrap().unsaved);
    session.board.check_told().unwrap();

    // What was found outlives the power.
    session.board.reset().unwrap();
    session.board.run_for(BOOT).unwrap();
    let stored = session.parameters().unwrap();
    assert_eq!(stored.compensator, f64::from(Compensator::Niasa as u8));
    assert_eq!(stored.niasa_coulomb_n, found.niasa.unwrap().coulomb_n);
    assert_eq!(stored.command_timeout_s, settings.command_timeout_s);
}

macro_rules! stages {
    ($($(#[$attribute:meta])* $name:ident: $file:literal;)+) => {
        $($(#[$attribute])* #[test] fn $name() {
            commission(stringify!($name), include_str!(concat!("../../sim/stages/", $file)));
        })+
    };
}

stages! {
    light_stiff: "light-stiff.toml";
    #[ignore = "as long as the first"]
    table_4: "gms-table-4.toml";
    #[ignore = "as long as the first"]
    heavy_soft: "heavy-soft.toml";
    #[ignore = "as long as the first"]
    light_dahl: "light-dahl.toml";
    #[ignore = "as long as the first"]
    heavy_dahl: "heavy-dahl.toml";
}

/// Magnets anywhere, and parameters that say so: the first thing to find is the electrical zero. A stop in the middle of the next step
/// leaves the bridge off.
#[test]
fn a_motor_that_nobody_has_aligned_is_aligned_first_and_a_stop_turns_the_bridge_off() {
    let mut stage = Stage::default();
    stage.friction.spread = None;
    stage.motor.commutation_offset_m = 0.37 * stage.motor.magnet_pitch_m;
    let settings = data_sheet(&stage).unwrap();
    assert_eq!((settings.commutation_identity, settings.commutation_offset_m), (-1.0, 0.0));
    let (board, mut link) = new_drive(&stage, &settings);
    let (mut found, stop, mut at) = (Found::default(), AtomicBool::new(false), Step::Offsets);
    let ended = run(&mut link, &Plan::new(settings), &mut found, &stop, &mut |event| match event {
        Event::Begins(step) => at = step,
        Event::Done(2.., _) if at == Step::Plant => stop.store(true, Ordering::Relaxed),
        _ => (),
    });
    assert_eq!(ended, Err((Step::Plant, Failure::Stopped)));
    let off_turns = found.electrical_zero_m.unwrap() / stage.motor.magnet_pitch_m - 0.37;
    assert!((off_turns - off_turns.round()).abs() < 0.1 / 360.0, "{off_turns} turns");
    drop(link);
    let mut session = afterwards(board);
    assert!(!session.board.bridge_enabled().unwrap());
    // A status is up to 10 ms old.
    session.board.run_for(Duration::from_millis(20)).unwrap();
    let status = session.status().unwrap();
    assert_eq!((status.state, status.fault, status.moving), (State::SwitchOnDisabled, None, false));
}
