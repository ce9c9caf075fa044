//! Critical sections by priority ceiling: BASEPRI masks P1 and below, the control loop at P0 is never delayed.
//!
//! The control interrupts therefore must not use anything that relies on a critical section: they hand over through
//! lock-free queues and atomics only.

use core::sync::atomic::{Ordering, compiler_fence};

use cortex_m::register::{basepri, basepri_max};
use critical_section::{Impl, RawRestoreState, set_impl};

/// BASEPRI value that masks P1 to P15.
const MASK_FROM_P1: u8 = 1 << 4;

struct Ceiling;
set_impl!(Ceiling);

// SAFETY: every context that uses critical sections runs in thread mode or at P1 or lower (`priorities::check`), and all
// of those are masked from the write of BASEPRI on; nesting restores the outer mask.
unsafe impl Impl for Ceiling {
    unsafe fn acquire() -> RawRestoreState {
        let before = basepri::read();
        // Only ever raises the mask.
        basepri_max::write(MASK_FROM_P1);
        cortex_m::asm::isb();
        compiler_fence(Ordering::SeqCst);
        before
    }

    unsafe fn release(before: RawRestoreState) {
        compiler_fence(Ordering::SeqCst);
        // SAFETY: restores what the matching `acquire` found.
        unsafe { basepri::write(before) };
    }
}
