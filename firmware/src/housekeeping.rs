//! Housekeeping: once a second, everything that should not happen and did.

use defmt::{info, warn};
use embassy_time::{Duration, Ticker};

use crate::drive::Latest;

/// Below this the stack has come too near its end, bytes.
const STACK_RESERVE_BYTES: u32 = 2048;

/// Watches for ever.
#[embassy_executor::task]
pub async fn run(latest: &'static Latest) {
    let mut ticker = Ticker::every(Duration::from_secs(1));
    let mut before = latest.snapshot.get();
    let mut garbled_before = 0;
    let mut longest_stack = u32::MAX;
    loop {
        ticker.next().await;
        let now = latest.snapshot.get();
        let counters = now.counters;
        if counters.ticks == before.counters.ticks {
            warn!("no servo tick within a second");
        }
        if counters.longest_tick_cycles != before.counters.longest_tick_cycles {
            info!("longest tick {=u32} cycles", counters.longest_tick_cycles);
        }
        if counters.overruns != before.counters.overruns {
            warn!("{=u32} ticks over their limit", counters.overruns);
        }
        if counters.bad_frames != before.counters.bad_frames {
            warn!("{=u32} unusable encoder frames", counters.bad_frames);
        }
        if now.records_dropped != before.records_dropped {
            warn!("{=u32} tick records dropped", now.records_dropped);
        }
        let garbled = latest.unreadable_frames.get();
        if garbled != garbled_before {
            warn!("{=u32} garbled frames on the serial link", garbled);
        }
        let stack_free = servo_board::stack_free_bytes();
        if stack_free < longest_stack {
            info!("stack: {=u32} bytes never used", stack_free);
            if stack_free < STACK_RESERVE_BYTES {
                warn!("stack nearly full");
            }
        }
        longest_stack = stack_free;
        garbled_before = garbled;
        before = now;
    }
}
