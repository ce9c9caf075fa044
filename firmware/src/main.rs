//! Wiring of the drive.
#![no_std]
#![no_main]

use defmt_rtt as _;
use embassy_executor::Spawner;
use embassy_time::{Duration, Timer};
use static_cell::StaticCell;
use servo_board::{Bridge, Control, PhaseCodes, ServoSample};
use core::sync::atomic::{AtomicU32, Ordering::Relaxed};

struct Drive { enabled: bool, n: u32 }
static N: AtomicU32 = AtomicU32::new(0);
static T: AtomicU32 = AtomicU32::new(0);
static LAST: AtomicU32 = AtomicU32::new(0);
static F: AtomicU32 = AtomicU32::new(0);
static BUS: AtomicU32 = AtomicU32::new(0);
static PH: AtomicU32 = AtomicU32::new(0);
impl Control for Drive {
    fn on_period(&mut self, phases: PhaseCodes) -> Bridge {
        N.fetch_add(1, Relaxed);
        PH.store(phases.a as u32 | (phases.b as u32) << 16, Relaxed);
        Bridge { compare: [1250; 3], enabled: self.enabled }
    }
    fn on_servo(&mut self, s: &ServoSample) -> Bridge {
        T.fetch_add(1, Relaxed);
        LAST.fetch_max(s.last_tick_cycles, Relaxed);
        F.store((s.frame >> 32) as u32, Relaxed);
        BUS.store(s.bus_code as u32 | (s.temperature_code as u32) << 16, Relaxed);
        self.n += 1;
        if self.n == 100 { self.enabled = true; }
        if s.bridge_fault { self.enabled = false; }
        Bridge { compare: [1250; 3], enabled: self.enabled }
    }
}

#[embassy_executor::main]
async fn main(_spawner: Spawner) {
    let board = servo_board::init();
    defmt::info!("servo-firmware {} core {} Hz, reset {}, last words {}", env!("CARGO_PKG_VERSION"), board.core_hz, board.reset_cause, board.last_words);
    static DRIVE: StaticCell<Drive> = StaticCell::new();
    match board.power_stage.start(DRIVE.init(Drive { enabled: false, n: 0 })) {
        Ok(()) => defmt::info!("started"),
        Err(fault) => defmt::error!("not started: {}", fault),
    }
    loop {
        Timer::after(Duration::from_millis(10)).await;
        defmt::info!("periods {} ticks {} last {} frame {:x} bus/temp {:x} ph {:x}", N.load(Relaxed), T.load(Relaxed), LAST.load(Relaxed), F.load(Relaxed), BUS.load(Relaxed), PH.load(Relaxed));
    }
}
