//! Memory of the black box: words of DTCM that start-up code leaves alone.
//!
//! DTCM and not AXI SRAM, because what the data cache still holds is lost in a reset, and because its error correction covers single
//! words: each store is complete by itself. The contents are undefined after power-up and survive a warm reset.

use core::sync::atomic::{AtomicU32, Ordering};

/// Size of the memory, 32-bit words.
pub const WORDS: usize = 18_432;

#[unsafe(link_section = ".uninit.black_box")]
static MEMORY: [AtomicU32; WORDS] = [const { AtomicU32::new(0) }; WORDS];

/// The word at `index`; 0 beyond the end.
#[inline(always)]
pub fn load(index: usize) -> u32 {
    MEMORY.get(index).map_or(0, |cell| cell.load(Ordering::Relaxed))
}

/// Stores a word; an index beyond the end is ignored.
#[inline(always)]
pub fn store(index: usize, word: u32) {
    if let Some(cell) = MEMORY.get(index) {
        cell.store(word, Ordering::Relaxed);
    }
}
