//! Power that goes in the middle of a save, on the flash of the emulated part: the firmware finds the old parameters or the new ones.

mod common;

use std::time::Duration;

use common::{set, started};
use servo_core::image::{SCHEMA, WORD_BYTES, WORDS};
use servo_core::parameters::Settings;
use servo_core::store::{Current, Save, Slot};
use servo_protocol::message::Request;
use servo_virtual_board::{PARAMETER_ADDRESSES, ParameterSectors, Session};

/// Values of one parameter that tell the images apart: in sector A, in sector B (the one in use), and in the save that goes to A again.
const FIRST: f64 = 0.65;
const OLD: f64 = 0.7;
const NEW: f64 = 0.75;

/// So long nothing changes: the erasure of a sector takes 1 s in the emulated part.
const NEARLY_ERASED_NS: u64 = 990_000_000;

fn settings(niasa_coulomb_n: f64) -> Settings {
    Settings { niasa_coulomb_n, ..common::aligned() }
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
    let erased_ns = session.board.time_ns() + NEARLY_ERASED_NS;
    let (mut last, mut after_step) = (before[0][..(WORDS + 2) * WORD_BYTES].to_vec(), Vec::new());
    while after_step.len() < usize::from(Save::STEPS) {
        // While words are programmed nobody may ask the drive anything: a word takes less time than a reply.
        let erasing = session.board.time_ns() < erased_ns;
        session.board.run_for(if erasing { Duration::from_millis(1) } else { Duration::from_micros(40) }).unwrap();
        assert!(session.board.time_ns() < erased_ns + 100_000_000, "only {} steps seen", after_step.len());
        let a = session.board.read_memory(PARAMETER_ADDRESSES[0], (WORDS + 2) * WORD_BYTES).unwrap();
        if a != last {
            after_step.push(a.clone());
            last = a;
        }
    }
    assert!(session.board.read_parameters().unwrap()[1] == before[1], "the sector in use was touched");
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
