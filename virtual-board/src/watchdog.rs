//! The independent watchdog, of which the emulator only stores the registers (RM0433 rev 9 chapter 48).
//!
//! Modelled: start and feeding by key, prescaler and reload value as the registers hold them when it is fed, the reset when the
//! counter has run out, and that only a reset stops it. Not modelled: the write protection of prescaler and reload value, the delay until they
//! apply, the window, and the tolerance of the 32 kHz oscillator.

use std::num::NonZeroU64;

/// Nominal clock, DS12110 rev 11 table 48.
const LSI_HZ: NonZeroU64 = NonZeroU64::new(32_000).expect("not zero");
const NS_PER_S: u64 = 1_000_000_000;
const KEY_START: u64 = 0xCCCC;
const KEY_FEED: u64 = 0xAAAA;

/// What the two registers hold that set the time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Reload {
    /// `PR`: the clock is divided by 4 · 2^this, at most 256.
    pub prescaler: u64,
    /// `RLR`: where the counter begins.
    pub value: u64,
}

impl Reload {
    /// Time from feeding to the reset.
    const fn timeout_ns(self) -> u64 {
        let prescaler = if self.prescaler < 6 { self.prescaler } else { 6 };
        (self.value + 1) * (4 << prescaler) * NS_PER_S / LSI_HZ.get()
    }
}

/// The counter.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Watchdog {
    /// When it resets the processor, if it has been started.
    expires_ns: Option<u64>,
}

impl Watchdog {
    /// A write of `key` to `KR`. Whether it fed the watchdog.
    pub fn on_key(&mut self, key: u64, reload: Reload, now_ns: u64) -> bool {
        let feeds = key & 0xFFFF == KEY_FEED;
        match key & 0xFFFF {
            KEY_START if self.expires_ns.is_none() => self.expires_ns = Some(now_ns + reload.timeout_ns()),
            KEY_FEED if self.expires_ns.is_some() => self.expires_ns = Some(now_ns + reload.timeout_ns()),
            _ => {}
        }
        feeds
    }

    /// Whether the counter has run out by `now_ns`.
    #[must_use]
    pub fn has_expired(&self, now_ns: u64) -> bool {
        self.expires_ns.is_some_and(|expires_ns| now_ns >= expires_ns)
    }

    /// The processor has been reset: the watchdog stands until it is started again.
    pub fn reset(&mut self) {
        *self = Watchdog::default();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// 401 periods of 32 kHz / 4.
    const FIFTY_MS: Reload = Reload { prescaler: 0, value: 400 };

    #[test]
    fn it_expires_its_time_after_the_last_feeding_and_never_before_it_is_started() {
        let mut watchdog = Watchdog::default();
        assert!(watchdog.on_key(KEY_FEED, FIFTY_MS, 0));
        assert!(!watchdog.has_expired(u64::MAX));
        assert!(!watchdog.on_key(KEY_START, FIFTY_MS, 1_000));
        watchdog.on_key(KEY_FEED, FIFTY_MS, 2_000);
        assert!(!watchdog.has_expired(2_000 + 50_125_000 - 1));
        assert!(watchdog.has_expired(2_000 + 50_125_000));
        // Starting it twice, or another key, is no feeding.
        watchdog.on_key(KEY_START, FIFTY_MS, 40_000_000);
        watchdog.on_key(0x5555, FIFTY_MS, 40_000_000);
        assert!(watchdog.has_expired(2_000 + 50_125_000));
        watchdog.reset();
        assert!(!watchdog.has_expired(u64::MAX));
    }

    #[test]
    fn the_prescaler_divides_by_256_at_most() {
        for (prescaler, ms) in [(0, 512), (1, 1_024), (6, 32_768), (7, 32_768)] {
            assert_eq!(Reload { prescaler, value: 0xFFF }.timeout_ns(), ms * 1_000_000);
        }
    }
}
