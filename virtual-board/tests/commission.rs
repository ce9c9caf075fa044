//! The firmware's ELF and `servoctl`'s procedure: from a drive that nobody has set up to one that settles with NIASA, unattended, over the
//! serial line. One stage here; the others take as long each and run in `cargo xtask commission-stages`.

mod common;

use std::sync::atomic::AtomicBool;
use std::sync::{Arc, Mutex};

use common::{BOOT, elf};
use servo_core::config::Compensator;
use servo_core::state::State;
use servo_sim::Stage;
use servo_virtual_board::port::BoardPort;
use servo_virtual_board::{Config, Session, VirtualBoard};
use servoctl::commission::{Found, LEAST_GAIN, OnLine, Step, data_sheet, run};
use servoctl::link::{Client, Drive, Patience};

static NEVER: AtomicBool = AtomicBool::new(false);

/// A new drive on this stage, commissioned; then what the drive itself says, and what the truth is.
fn commission(name: &str, toml: &str) {
    let stage = Stage::from_toml(toml).unwrap();
    let mut board = VirtualBoard::boot(&elf(), &Config { stage, ..Config::default() }).unwrap();
    board.run_for(BOOT).unwrap();
    let board = Arc::new(Mutex::new(board));
    let client = Client::new(Box::new(BoardPort::new(board.clone())), Patience::SERIAL, 1);
    let (mut link, _) = OnLine::new(Drive::connect(client).unwrap()).unwrap();
    let settings = data_sheet(&stage).unwrap();
    link.prepare(&settings).unwrap();
    let mut found = Found::default();
    run(&mut link, &settings, &mut found, Step::Offsets, &NEVER, |step, result| match result {
        Ok(words) => println!("{name}: {}: {words}", step.purpose()),
        Err(why) => println!("{name}: {}: refused: {why}", step.purpose()),
    })
    .unwrap();
    drop(link);
    let mut session = Session::new(Arc::into_inner(board).unwrap().into_inner().unwrap());
    println!("{name}: {:.1} s of virtual time", session.board.time_ns() as f64 * 1e-9);

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
