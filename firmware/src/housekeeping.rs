//! Housekeeping: ten times a second the stack, once a second everything that should not happen and did.

use defmt::{info, warn};
use embassy_time::{Duration, Ticker};
use servo_board::watchdog::{self, Client};
use servo_core::monitor::signals;

use crate::clients;
use crate::drive::Latest;

/// Time between two rounds.
const ROUND: Duration = Duration::from_millis(20);
/// Rounds between two looks at the stack.
const STACK_EVERY: u32 = 5;
/// Rounds between two reports.
const REPORT_EVERY: u32 = 50;
/// Below this the stack has come too near its end, bytes: a fault.
const STACK_RESERVE_BYTES: u32 = 2048;

/// Watches for ever.
#[embassy_executor::task]
pub async fn run(latest: &'static Latest) {
    let alive = Client::register(clients::HOUSEKEEPING);
    let mut ticker = Ticker::every(ROUND);
    let mut round = 0;
    let mut before = latest.snapshot.get();
    let mut garbled_before = 0;
    let mut least_free = u32::MAX;
    loop {
        ticker.next().await;
        alive.check_in();
        round = (round + 1) % REPORT_EVERY;
        if round.is_multiple_of(STACK_EVERY) {
            let stack_free = servo_board::stack_free_bytes();
            if stack_free < least_free {
                info!("stack: {=u32} bytes never used", stack_free);
            }
            if stack_free < STACK_RESERVE_BYTES {
                watchdog::report(signals::STACK_LOW);
            }
            least_free = stack_free;
        }
        if round != 0 {
            continue;
        }
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
        garbled_before = garbled;
        before = now;
    }
}
