//! Parameters in the flash of the emulated part: a new drive, a save, and power that goes in the middle of one.

mod common;

use std::time::Duration;

use common::{BOOT, elf, logged};
use servo_core::fault::Fault;
use servo_core::image::{OLDEST_SCHEMA, SCHEMA, WORDS};
use servo_core::parameters::{Parameter, Settings};
use servo_core::refusal::Refusal;
use servo_core::state::State;
use servo_core::store::{Current, Save, Slot};
use servo_protocol::message::{Reply, Request};
use servo_virtual_board::{Config, Error, Link, ParameterSectors, Session, VirtualBoard};

/// A quarter of the servo period: what the tick may take from sampling to the new compare values.
const TICK_LIMIT_NS: u64 = 125_000 / 4;
/// Longest wait for a drive that has to erase a sector before it starts.
const PATIENCE_NS: u64 = 5_000_000_000;

/// A drive with these sectors, answering.
fn started(parameters: ParameterSectors) -> Session {
    let board = VirtualBoard::boot(&elf(), &Config { parameters, ..Config::default() }).unwrap();
    answering(board)
}

fn answering(mut board: VirtualBoard) -> Session {
    board.run_for(BOOT).unwrap();
    let mut link = Link::new();
    loop {
        match link.request(&mut board, &Request::Identity) {
            Ok(_) => return Session::new(board),
            Err(Error::NoReply { .. }) if board.time_ns() < PATIENCE_NS => {}
            Err(error) => panic!("{error}"),
        }
    }
}

fn refusal(session: &mut Session, request: &Request) -> Refusal {
    match session.ask(request).unwrap() {
        Reply::Refused(refusal) => refusal,
        other => panic!("{request:?} was answered by {other:?}"),
    }
}

fn set(session: &mut Session, name: &str, value: f64) {
    let id = Parameter::by_name(name).unwrap().id;
    session.order(&Request::SetParameters([(id, value)].into_iter().collect())).unwrap();
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

    session.commission(&Settings { niasa_coulomb_n: 0.7, ..Settings::default() }).unwrap();
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
    assert_eq!(session.parameters().unwrap(), Settings::default());
    assert!(!session.parameter_store().unwrap().unsaved);
    set(&mut session, "niasa_coulomb_n", 0.9);
    session.order(&Request::ResetParameters).unwrap();
    assert_eq!(session.parameters().unwrap(), Settings::default());
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
    assert!(logged(&session.board.log().unwrap(), "taken over from schema"));
}

/// Values of one parameter that tell the images apart: in sector A, in sector B (the one in use), and in the save that goes to A again.
const FIRST: f64 = 0.65;
const OLD: f64 = 0.7;
const NEW: f64 = 0.75;

fn settings(niasa_coulomb_n: f64) -> Settings {
    Settings { niasa_coulomb_n, ..Settings::default() }
}

/// Sector A after the erasure and after every word of a save to it that nothing disturbs, and what both held before.
struct Watched {
    before: ParameterSectors,
    after_step: Vec<Vec<u8>>,
}

/// A save of [`NEW`], looked at from outside while it goes on.
fn watched_save() -> Watched {
    let mut session = Session::new(common::board());
    for value in [OLD - 0.1, FIRST, OLD] {
        set(&mut session, "niasa_coulomb_n", value);
        session.save_parameters().unwrap();
    }
    // The defaults went to A, and so on in turn.
    let store = session.parameter_store().unwrap();
    assert_eq!(store.image, Some(Current { slot: Slot::B, sequence: 4, schema: SCHEMA }));
    let before = session.board.read_parameters().unwrap();

    set(&mut session, "niasa_coulomb_n", NEW);
    session.order(&Request::SaveParameters).unwrap();
    let (mut last, mut after_step) = (before[0].clone(), Vec::new());
    while after_step.len() < usize::from(Save::STEPS) {
        // While words are programmed nobody may ask the drive anything: a word takes less time than a reply.
        session
            .board
            .run_for(if after_step.is_empty() { Duration::from_millis(1) } else { Duration::from_micros(40) })
            .unwrap();
        assert!(session.board.time_ns() < 4 * PATIENCE_NS, "{} steps", after_step.len());
        let [a, b] = session.board.read_parameters().unwrap();
        assert!(b == before[1], "the sector in use is touched");
        if a != last {
            after_step.push(a.clone());
            last = a;
        }
    }
    Watched { before, after_step }
}

/// Deterministic noise.
fn noise(seed: u64) -> impl FnMut() -> u8 {
    let mut state = seed.wrapping_mul(2) + 1;
    move || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 56) as u8
    }
}

/// The sector with a part of its bits erased: `progress` of 8, at random.
fn half_erased(sector: &[u8], progress: u32, seed: u64) -> Vec<u8> {
    let mut noise = noise(seed);
    let mut erased = || (0..8).fold(0, |bits, bit| bits | u8::from(u32::from(noise()) < 32 * progress) << bit);
    sector.iter().map(|byte| byte | erased()).collect()
}

/// The sector after `step`, with the next word torn: some of its bits programmed, others not yet.
fn torn(watched: &Watched, step: usize, seed: u64) -> Vec<u8> {
    let mut noise = noise(seed);
    let (before, after) = (&watched.after_step[step - 1], &watched.after_step[step]);
    before.iter().zip(after).map(|(before, after)| if before == after { *before } else { after | noise() }).collect()
}

/// Starts a drive on these sectors; the value it found, which must be one of `allowed`, and the sectors as it left them.
fn found(parameters: ParameterSectors, allowed: &[f64], what: &str) -> (f64, ParameterSectors) {
    let mut session = started(parameters);
    assert_eq!(session.status().unwrap().fault, None, "{what}: lost");
    let used = session.parameters().unwrap();
    let value = allowed.iter().find(|value| used == settings(**value));
    (*value.unwrap_or_else(|| panic!("{what}: {used:?}")), session.board.read_parameters().unwrap())
}

#[test]
fn power_lost_anywhere_in_a_save_leaves_the_old_parameters_or_the_new_ones_also_twice_in_a_row() {
    let watched = watched_save();
    let in_use = watched.before[1].clone();
    let cut = |sector: Vec<u8>| [sector, in_use.clone()];

    for progress in 0..=8 {
        let sector = half_erased(&watched.before[0], progress, progress.into());
        found(cut(sector), &[OLD], &format!("{progress}/8 erased"));
    }
    let (first_seal, steps) = (WORDS + 1, usize::from(Save::STEPS));
    for step in 1..steps {
        let allowed = if step < first_seal { &[OLD][..] } else { &[OLD, NEW] };
        let what = format!("torn in step {step}");
        let (value, left) = found(cut(torn(&watched, step, step as u64)), allowed, &what);
        if [1, first_seal - 1, first_seal, steps - 1].contains(&step) {
            // Power comes back, the next save begins, and power is lost again.
            let target = if value == NEW { 1 } else { 0 };
            let mut again = left;
            again[target] = half_erased(&again[target], 4, 99);
            found(again, &[value], &format!("{what}, then in the next erasure"));
        }
    }
    for (step, value) in [(first_seal - 1, OLD), (first_seal, NEW), (steps - 1, NEW)] {
        let what = format!("between steps, after {step}");
        let (_, left) = found(cut(watched.after_step[step].clone()), &[value], &what);
        found(left, &[value], &format!("{what}, next start"));
    }
}
