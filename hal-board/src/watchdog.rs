//! Supervision: tasks check in with the servo period, the servo period feeds the independent watchdog.
//!
//! The watchdog restarts the processor 50 ms after the servo period has stopped, whatever the reason. The servo period feeds it only
//! while every task has checked in in time, and reports one that has not ([`signals::TASK_HUNG`]): with the bridge on, the drive then
//! turns it off in that tick, which does not wait for the reset that follows.

use core::sync::atomic::{AtomicU32, Ordering};

use embassy_stm32::pac::iwdg::vals::{Key, Pr};
use embassy_stm32::pac::{DBGMCU, IWDG1};
use servo_core::SERVO_HZ;
use servo_core::monitor::signals;

/// Tasks that have not checked in for longer than this count as hung, servo periods: 100 ms.
const PATIENCE: u32 = SERVO_HZ / 10;
/// Servo periods between two feeds: 8 ms.
const FEED_EVERY: u32 = SERVO_HZ / 125;
/// Watchdog time-out in periods of its clock, 32 kHz / 4: 50 ms.
const TIMEOUT: u16 = 400;

/// Tasks that are to check in, one bit each.
static EXPECTED: AtomicU32 = AtomicU32::new(0);
/// Tasks that have.
static CHECKED_IN: AtomicU32 = AtomicU32::new(0);
/// Faults that tasks have reported, bits of [`signals`].
static REPORTED: AtomicU32 = AtomicU32::new(0);

/// A task under supervision.
#[derive(Clone, Copy)]
pub struct Client(u32);

impl Client {
    /// Client `number` (below 32). From now on it has to check in.
    pub fn register(number: u32) -> Client {
        let bit = 1 << (number & 31);
        EXPECTED.fetch_or(bit, Ordering::Relaxed);
        Client(bit)
    }

    /// Still alive. To be called several times in 100 ms.
    pub fn check_in(self) {
        CHECKED_IN.fetch_or(self.0, Ordering::Relaxed);
    }
}

/// Reports faults to the drive, bits of [`signals`], from the next servo period on, until they are withdrawn.
pub fn report(bits: u32) {
    REPORTED.fetch_or(bits & signals::FAULTS, Ordering::Relaxed);
}

/// The cause is gone; the drive stays in its fault until that is acknowledged.
pub fn withdraw(bits: u32) {
    REPORTED.fetch_and(!bits, Ordering::Relaxed);
}

/// The servo period's side.
pub(crate) struct Watchdog {
    waited: u32,
    unfed: u32,
    /// Until every task has checked in again.
    hung: bool,
}

impl Watchdog {
    pub(crate) const fn new() -> Self {
        Watchdog { waited: 0, unfed: FEED_EVERY, hung: false }
    }

    /// Starts the watchdog; it cannot be stopped.
    pub(crate) fn start() {
        // A halted core shall not be restarted.
        DBGMCU.apb4fzr1().modify(|w| w.set_iwdg1(true));
        IWDG1.kr().write(|w| w.set_key(Key::START));
        IWDG1.kr().write(|w| w.set_key(Key::ENABLE));
        IWDG1.pr().write(|w| w.set_pr(Pr::DIVIDE_BY4));
        IWDG1.rlr().write(|w| w.set_rl(TIMEOUT));
        feed();
    }

    /// Once per servo period: the bits of [`signals`] that supervision and tasks have to tell.
    #[inline(always)]
    pub(crate) fn tick(&mut self) -> u32 {
        let expected = EXPECTED.load(Ordering::Relaxed);
        if CHECKED_IN.load(Ordering::Relaxed) & expected == expected {
            // A check-in between the two is lost; the next one is not.
            CHECKED_IN.store(0, Ordering::Relaxed);
            self.waited = 0;
            self.hung = false;
        } else {
            self.waited = self.waited.saturating_add(1);
        }
        self.hung |= self.waited > PATIENCE;
        self.unfed += 1;
        if self.unfed >= FEED_EVERY && !self.hung {
            self.unfed = 0;
            feed();
        }
        REPORTED.load(Ordering::Relaxed) | if self.hung { signals::TASK_HUNG } else { 0 }
    }
}

#[inline(always)]
fn feed() {
    IWDG1.kr().write(|w| w.set_key(Key::RESET));
}
