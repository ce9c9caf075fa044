//! Capture memory: AXI SRAM as an array of words that the control interrupt writes and a task reads.
//!
//! Atomic words, so that neither side needs a lock; who may read which part when is agreed between the two by the
//! application. The contents are undefined until written and survive a warm reset.

use core::sync::atomic::{AtomicU32, Ordering};

/// Size of the capture memory, 32-bit words.
pub const WORDS: usize = 512 * 1024 / 4;

#[unsafe(link_section = ".axisram.capture")]
static MEMORY: [AtomicU32; WORDS] = [const { AtomicU32::new(0) }; WORDS];

/// Stores a word; an index beyond the end is ignored.
#[inline(always)]
pub fn store(index: usize, word: u32) {
    if let Some(cell) = MEMORY.get(index) {
        cell.store(word, Ordering::Relaxed);
    }
}

/// The word at `index`, or `None` beyond the end.
pub fn load(index: usize) -> Option<u32> {
    MEMORY.get(index).map(|cell| cell.load(Ordering::Relaxed))
}
