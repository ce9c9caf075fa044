//! What a drive's parameter flash holds after a save, without a drive that saves.

use servo_core::image::{BLANK, Word};
use servo_core::parameters::Settings;
use servo_core::store::{Slot, Step, Store};

use crate::ParameterSectors;

/// The two parameter sectors after the first save of `settings`.
#[must_use]
pub fn saved(settings: &Settings) -> ParameterSectors {
    let mut sectors: [Vec<Word>; 2] = [Vec::new(), Vec::new()];
    for step in Store::default().save(settings) {
        match step {
            Step::Erase(slot) => sectors[place(slot)].clear(),
            Step::Program { slot, index, word } => {
                let sector = &mut sectors[place(slot)];
                let index = index as usize;
                sector.resize(sector.len().max(index + 1), BLANK);
                sector[index] = word;
            }
        }
    }
    sectors.map(|words| words.concat())
}

fn place(slot: Slot) -> usize {
    match slot {
        Slot::A => 0,
        Slot::B => 1,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_drive_finds_what_was_saved() {
        let settings = Settings { niasa_time_constant_s: 0.02, ..Settings::default() };
        let sectors = saved(&settings);
        let read = |slot: Slot, index: u32| {
            let word = sectors[place(slot)].chunks_exact(BLANK.len()).nth(index as usize);
            Some(word.map_or(BLANK, |word| word.try_into().unwrap()))
        };
        assert_eq!(Store::open(read).settings, Ok(settings));
    }
}
