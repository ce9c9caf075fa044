//! An image that the schema before this one wrote, kept as it came out of its firmware (`examples/golden_image.rs`), is still read.

use servo_core::config::Config;
use servo_core::image::{BLANK, Invalid, OLDEST_SCHEMA, WORD_BYTES, Word};
use servo_core::parameters::{Parameter, Settings, TABLE};
use servo_core::store::{Opened, Slot, Store};

const IMAGE: &[u8] = include_bytes!("images/schema-1.bin");
/// Where its two seals begin.
const SEALS_FROM: u32 = (IMAGE.len() / WORD_BYTES) as u32 - 2;
/// Id, name and value of each parameter in it.
const VALUES: &str = include_str!("images/schema-1.txt");

fn flash(slot: Slot, index: u32) -> Option<Word> {
    let image = if slot == Slot::B { IMAGE } else { &[] };
    let (words, _) = image.as_chunks::<WORD_BYTES>();
    Some(words.get(index as usize).copied().unwrap_or(BLANK))
}

#[test]
fn parameters_of_the_schema_before_keep_their_values_and_new_ones_change_nothing() {
    let Opened { store, settings, settle } = Store::open(flash);
    let newest = store.newest().unwrap();
    assert_eq!((newest.slot, newest.sequence, newest.schema), (Slot::B, 3, OLDEST_SCHEMA));
    assert_eq!(settle, [None; 4]);

    // Its drive was enabled with the offset that it had: that holds for the encoder that it has.
    let mut expected = Settings { commutation_identity: 0.0, ..Settings::default() };
    for line in VALUES.lines() {
        let [id, name, value] = line.split(' ').collect::<Vec<_>>()[..] else { panic!("{line}") };
        let id = u16::from_str_radix(id.trim_start_matches("0x"), 16).unwrap();
        // What is gone is ignored; what was renamed keeps its id.
        let Some(row) = Parameter::by_id(id) else { continue };
        row.set(&mut expected, value.parse().unwrap()).unwrap_or_else(|refusal| panic!("{name}: {refusal}"));
    }
    let settings = settings.unwrap();
    for row in TABLE {
        assert_eq!(row.get(&settings), row.get(&expected), "{}", row.name);
    }
    assert_ne!(settings, Settings::default());
    assert!(Config::new(&settings).unwrap().commutation_stored, "enabled as before");
    assert!(!Config::new(&Settings::default()).unwrap().commutation_stored, "unlike a new one");
}

#[test]
fn the_next_save_goes_to_the_other_sector_with_the_next_number_and_this_schema() {
    let opened = Store::open(flash);
    let target = opened.store.save(&opened.settings.unwrap()).target();
    assert_eq!((target.slot, target.sequence, target.schema), (Slot::A, 4, OLDEST_SCHEMA + 1));
}

#[test]
fn an_image_without_a_seal_is_not_used_and_both_sectors_are_accounted_for() {
    let opened = Store::open(|slot, index| if index < SEALS_FROM { flash(slot, index) } else { Some(BLANK) });
    assert_eq!(opened.settings, Err([Invalid::Blank, Invalid::Unsealed]));
}
