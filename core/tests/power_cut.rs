//! The parameter store against a flash that loses power, as hostile as its data sheet allows: afterwards there is exactly the old image
//! or the new one, and whichever a power-up found, every later one finds.

use proptest::prelude::*;
use servo_core::image::{BLANK, Word};
use servo_core::parameters::Settings;
use servo_core::store::{Opened, Save, Slot, Step, Store};

/// Steps of a save: the erasure, the words, two seals.
const STEPS: usize = Save::STEPS as usize;

/// Words of a sector that are simulated; those behind stay erased.
const WORDS: usize = 200;

/// Power was lost in the middle of a step.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct PowerCut;

/// One flash word.
#[derive(Clone, Copy, Debug)]
enum Cell {
    /// Erased or programmed, completely.
    Stable(Word),
    /// Programming was cut short.
    Torn { was: Word, target: Word },
    /// Erasing was cut short.
    HalfErased { was: Word },
    /// Programmed twice with different data: its check bits fit nothing.
    Ruined,
}

#[derive(Clone, Debug)]
struct Flash {
    cells: [[Cell; WORDS]; 2],
    /// Decides what unstable words read as.
    seed: u64,
    power_ups: u64,
    /// Steps until the next power cut.
    left: Option<usize>,
}

/// Some well-mixed function of its arguments (the finaliser of SplitMix64 after each).
fn mix(values: &[u64]) -> u64 {
    values.iter().fold(0x9e37_79b9_7f4a_7c15, |hash, value| {
        let mut z = (hash ^ value).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ z >> 30).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ z >> 31
    })
}

impl Flash {
    fn new(seed: u64) -> Self {
        Flash { cells: [[Cell::Stable(BLANK); WORDS]; 2], seed, power_ups: 0, left: None }
    }

    /// What a word reads as: the same until the next power-up.
    fn read(&self, slot: Slot, index: u32) -> Option<Word> {
        let Some(cell) = self.cells[slot as usize].get(index as usize) else { return Some(BLANK) };
        let dice = mix(&[self.seed, self.power_ups, slot as u64, u64::from(index)]);
        let random = |toward: Word| toward.map(|byte| byte ^ (mix(&[dice, byte.into()]) & dice >> 8) as u8);
        match (*cell, dice % 4) {
            (Cell::Stable(word), _) => Some(word),
            (_, 0) => None,
            (Cell::Torn { was, .. } | Cell::HalfErased { was }, 1) => Some(was),
            (Cell::Torn { target, .. }, 2) => Some(target),
            (Cell::HalfErased { .. }, 2) => Some(BLANK),
            (Cell::Torn { target: word, .. } | Cell::HalfErased { was: word }, _) => Some(random(word)),
            (Cell::Ruined, _) => Some(random([0; 32])),
        }
    }

    fn carry_out(&mut self, step: Step) -> Result<(), PowerCut> {
        let cut = self.left == Some(0);
        self.left = self.left.map(|left| left.saturating_sub(1));
        match step {
            Step::Erase(slot) => {
                for cell in &mut self.cells[slot as usize] {
                    *cell = match *cell {
                        _ if !cut => Cell::Stable(BLANK),
                        Cell::Stable(was) => Cell::HalfErased { was },
                        Cell::Torn { target, .. } => Cell::HalfErased { was: target },
                        unstable => unstable,
                    };
                }
            }
            Step::Program { slot, index, word } => {
                let cell = &mut self.cells[slot as usize][index as usize];
                *cell = match *cell {
                    Cell::Stable(was) => {
                        assert_eq!(was, BLANK, "a programmed word is programmed again");
                        if cut { Cell::Torn { was, target: word } } else { Cell::Stable(word) }
                    }
                    // The same bits, once more.
                    Cell::Torn { target, .. } if target == word => {
                        if cut {
                            *cell
                        } else {
                            Cell::Stable(word)
                        }
                    }
                    _ => Cell::Ruined,
                };
            }
        }
        if cut { Err(PowerCut) } else { Ok(()) }
    }
}

/// Settings that are told apart by this number.
fn numbered(number: u32) -> Settings {
    Settings { niasa_coulomb_n: 1.0 + 1e-6 * f64::from(number), ..Settings::default() }
}

/// A drive's dealings with its flash, and what must be found in it.
#[derive(Clone, Debug)]
struct Bench {
    flash: Flash,
    /// Set while the drive has power and has read its parameters.
    store: Option<Store>,
    /// What a power-up may find; exactly one entry unless a save was cut short.
    allowed: Vec<Option<u32>>,
    saves: u32,
    /// A drive that leaves things undecided: the control experiment.
    careless: bool,
}

impl Bench {
    fn new(seed: u64) -> Self {
        Bench { flash: Flash::new(seed), store: None, allowed: vec![None], saves: 0, careless: false }
    }

    /// Power on; lost again after `cut` steps, if there are as many to do. Only a power-up that comes through counts.
    fn power_up(&mut self, cut: Option<usize>) -> Result<(), String> {
        self.flash.power_ups += 1;
        self.flash.left = cut;
        self.store = None;
        let Opened { store, settings, settle } = Store::open(|slot, index| self.flash.read(slot, index));
        if !self.careless && settle.into_iter().flatten().any(|step| self.flash.carry_out(step).is_err()) {
            return Ok(());
        }
        self.flash.left = None;
        let numbers = (0..=self.saves).find(|number| settings == Ok(numbered(*number)));
        if settings.is_ok() != numbers.is_some() {
            return Err("settings that nobody ever saved".into());
        }
        if !self.allowed.contains(&numbers) {
            return Err(format!("found {numbers:?}, but only {:?} would be right", self.allowed));
        }
        self.allowed = vec![numbers];
        self.store = Some(store);
        Ok(())
    }

    /// Saves the next settings; power is lost in step `cut`, if there is one.
    fn save(&mut self, cut: Option<usize>) {
        let Some(store) = &mut self.store else { return };
        self.saves += 1;
        self.flash.left = cut;
        let save = store.save(&numbered(self.saves));
        if save.clone().any(|step| self.flash.carry_out(step).is_err()) {
            self.allowed.push(Some(self.saves));
            self.store = None;
        } else {
            store.saved(&save);
            self.allowed = vec![Some(self.saves)];
        }
        self.flash.left = None;
    }

    /// A drive that has saved `saves` times and has power.
    fn after_saves(seed: u64, saves: u32) -> Self {
        let mut bench = Bench::new(seed);
        bench.power_up(None).unwrap();
        for _ in 0..saves {
            bench.save(None);
        }
        bench
    }
}

#[test]
fn without_power_cuts_the_last_save_counts() {
    let mut bench = Bench::new(0);
    for _ in 0..10 {
        bench.power_up(None).unwrap();
        bench.save(None);
        bench.save(None);
    }
    bench.power_up(None).unwrap();
    assert_eq!(bench.allowed, [Some(20)]);
}

#[test]
fn a_power_cut_in_any_step_of_a_save_leaves_the_old_image_or_the_new_one() {
    for saves_before in 0..3 {
        let (mut old, mut new) = (0, 0);
        for cut in 0..STEPS {
            for seed in 0..200 {
                let mut bench = Bench::after_saves(seed, saves_before);
                let before = bench.allowed[0];
                bench.save(Some(cut));
                for _ in 0..4 {
                    bench.power_up(None).unwrap_or_else(|wrong| panic!("cut {cut}, seed {seed}: {wrong}"));
                }
                if bench.allowed == [before] {
                    old += 1
                } else {
                    new += 1
                }
                assert!(cut >= STEPS - 2 || bench.allowed == [before], "step {cut} is before the first seal");
            }
        }
        assert!(old > 0 && new > 0, "{old} {new}");
    }
}

#[test]
fn two_power_cuts_in_a_row_lose_nothing_either() {
    for first in 0..STEPS {
        for settling in [None, Some(0), Some(1), Some(2)] {
            for second in 0..STEPS {
                for seed in 0..8 {
                    let mut bench = Bench::after_saves(seed, 2);
                    bench.save(Some(first));
                    let mut run = || {
                        bench.power_up(settling)?;
                        bench.power_up(None)?;
                        bench.save(Some(second));
                        (0..3).try_for_each(|_| bench.power_up(None))
                    };
                    run().unwrap_or_else(|wrong| panic!("{first}, {settling:?}, {second}, seed {seed}: {wrong}"));
                    assert!(bench.allowed[0].is_some(), "lost");
                }
            }
        }
    }
}

/// What can happen to a drive.
#[derive(Clone, Copy, Debug)]
enum Event {
    PowerUp(Option<usize>),
    Save(Option<usize>),
}

fn any_events() -> impl Strategy<Value = Vec<Event>> {
    let event = prop_oneof![
        proptest::option::weighted(0.3, 0..4usize).prop_map(Event::PowerUp),
        proptest::option::weighted(0.7, 0..STEPS).prop_map(Event::Save),
        proptest::option::weighted(0.7, STEPS - 3..STEPS).prop_map(Event::Save),
    ];
    proptest::collection::vec(event, 1..60)
}

fn live_through(bench: &mut Bench, events: &[Event]) -> Result<(), String> {
    events.iter().try_for_each(|event| match *event {
        Event::PowerUp(cut) => bench.power_up(cut),
        Event::Save(cut) => {
            bench.save(cut);
            Ok(())
        }
    })
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(2_000))]

    #[test]
    fn no_history_of_saves_and_power_cuts_gives_anything_else(seed: u64, events in any_events()) {
        let mut bench = Bench::new(seed);
        prop_assert_eq!(live_through(&mut bench, &events), Ok(()));
        prop_assert_eq!(bench.power_up(None), Ok(()));
    }
}

/// The flash of these tests is hostile enough: a drive that leaves undecided what a power cut left undecided loses its parameters.
#[test]
fn a_drive_that_does_not_settle_is_found_out() {
    let outcome = |careless| {
        (0..2_000).try_for_each(|seed| {
            let mut bench = Bench { careless, ..Bench::after_saves(seed, 2) };
            bench.save(Some(STEPS - 2));
            bench.power_up(None)?;
            bench.save(Some(0));
            (0..3).try_for_each(|_| bench.power_up(None))
        })
    };
    assert!(outcome(true).is_err());
    assert_eq!(outcome(false), Ok(()));
}
