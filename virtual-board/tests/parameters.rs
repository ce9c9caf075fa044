//! Parameters in the flash of the emulated part: a new drive, a save, and power that goes in the middle of one.

mod common;

use std::time::Duration;

use common::{BOOT, logged, set, started};
use servo_core::fault::Fault;
use servo_core::image::{OLDEST_SCHEMA, SCHEMA};
use servo_core::parameters::Settings;
use servo_core::refusal::Refusal;
use servo_core::state::State;
use servo_core::store::{Current, Slot};
use servo_protocol::message::{Reply, Request};
use servo_virtual_board::Session;

/// A quarter of the servo period: what the tick may take from sampling to the new compare values.
const TICK_LIMIT_NS: u64 = 125_000 / 4;
fn refusal(session: &mut Session, request: &Request) -> Refusal {
    match session.ask(request).unwrap() {
        Reply::Refused(refusal) => refusal,
        other => panic!("{request:?} was answered by {other:?}"),
    }
}

#[test]
fn a_new_drive_says_so_and_is_enabled_only_after_a_save() {
    let mut session = started([Vec::new(), Vec::new()]);
    let status = session.status().unwrap();
    assert_eq!((status.state, status.fault), (State::Fault, Some(Fault::ParametersInvalid)));
    assert!(logged(&session.board.log().unwrap(), "parameters: none that can be used"));
    assert_eq!(refusal(&mut session, &Request::Enable), Refusal::WrongState(State::Fault));
    assert_eq!(refusal(&mut session, &Request::ResetFault), Refusal::FaultPersists(Fault::ParametersInvalid));
    assert_eq!(refusal(&mut session, &Request::LoadParameters), Refusal::NothingStored);
    assert!(session.parameter_store().unwrap().unsaved);

    session.commission(&Settings { niasa_coulomb_n: 0.7, ..common::aligned() }).unwrap();
    session.board.run_for(Duration::from_millis(10)).unwrap();
    assert_eq!(session.status().unwrap().state, State::SwitchOnDisabled);
    let store = session.parameter_store().unwrap();
    assert_eq!(store.image, Some(Current { slot: Slot::A, sequence: 1, schema: SCHEMA }));
    assert!(!store.unsaved);

    // Saved means saved: the reset pin, and the drive is what it was.
    session.board.reset().unwrap();
    session.board.run_for(BOOT).unwrap();
    assert_eq!(session.status().unwrap().fault, None);
    assert_eq!(session.parameters().unwrap().niasa_coulomb_n, 0.7);
    session.order(&Request::Enable).unwrap();
    session.board.run_for(Duration::from_millis(10)).unwrap();
    assert!(session.board.bridge_enabled().unwrap());
    session.board.check_told().unwrap();
}

#[test]
fn load_returns_to_what_is_stored_and_reset_to_the_defaults() {
    let mut session = Session::new(common::board());
    set(&mut session, "niasa_coulomb_n", 0.9);
    assert!(session.parameter_store().unwrap().unsaved);
    session.order(&Request::LoadParameters).unwrap();
    assert_eq!(session.parameters().unwrap(), common::aligned());
    assert!(!session.parameter_store().unwrap().unsaved);
    set(&mut session, "niasa_coulomb_n", 0.9);
    session.order(&Request::ResetParameters).unwrap();
    assert_eq!(session.parameters().unwrap(), Settings::default());
    assert_eq!(refusal(&mut session, &Request::Enable), Refusal::NotAligned(None), "as new");
}

#[test]
fn flash_and_torque_exclude_each_other() {
    let (board, _) = common::enabled();
    let mut session = Session::new(board);
    assert_eq!(refusal(&mut session, &Request::SaveParameters), Refusal::WrongState(State::OperationEnabled));
    session.order(&Request::Disable).unwrap();
    session.order(&Request::SaveParameters).unwrap();
    assert_eq!(refusal(&mut session, &Request::Enable), Refusal::Saving);
    assert_eq!(refusal(&mut session, &Request::SaveParameters), Refusal::Saving);
}

/// What the drive does 8,000 times a second goes on while the flash is erased and written.
#[test]
fn a_save_delays_no_tick() {
    let mut session = Session::new(common::board());
    let before = session.board.counts().unwrap().updates;
    let from_ns = session.board.time_ns();
    session.save_parameters().unwrap();
    let periods = session.board.counts().unwrap().updates - before;
    assert!(periods.abs_diff((session.board.time_ns() - from_ns) / 25_000) <= 1);
    let status = session.status().unwrap();
    assert_eq!((status.counters.overruns, status.counters.bad_frames, status.lost_records), (0, 0, 0));
    let longest_ns = session.board.counts().unwrap().servo_tick.max_ns;
    assert!(longest_ns <= TICK_LIMIT_NS, "{longest_ns} ns");
    session.board.check_told().unwrap();
}

#[test]
fn an_image_of_the_schema_before_is_taken_over() {
    let image = include_bytes!("../../core/tests/images/schema-1.bin").to_vec();
    let mut session = started([Vec::new(), image]);
    let store = session.parameter_store().unwrap();
    assert_eq!(store.image, Some(Current { slot: Slot::B, sequence: 3, schema: OLDEST_SCHEMA }));
    assert_eq!(session.parameters().unwrap().niasa_coulomb_n, 0.6375);
    // Its drive was enabled with the offset that it had.
    assert_eq!(session.parameters().unwrap().commutation_identity, 0.0);
    assert!(logged(&session.board.log().unwrap(), "taken over from schema"));
}
