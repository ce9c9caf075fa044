//! The firmware: the drive of `servo-core` on the board of `servo-board`, and the tasks around it. Wiring only.
#![no_std]
#![no_main]

mod commands;
mod drive;
mod housekeeping;
mod storage;
mod telemetry;

use defmt::{error, info, warn};
use defmt_rtt as _;
use embassy_executor::{SpawnError, SpawnToken, Spawner};
use embassy_time::Instant;
use heapless::String;
use servo_core::axis::Axis;
use servo_core::config::Config;
use servo_core::drive::Commutation;
use servo_core::fingerprint::Fingerprint;
use servo_protocol::message::{Identity, PROTOCOL};
use static_cell::StaticCell;

use crate::commands::Commands;
use crate::drive::Latest;

/// Numbers under which tasks check in with the watchdog.
mod clients {
    pub const TELEMETRY: u32 = 0;
    pub const HOUSEKEEPING: u32 = 1;
    pub const COMMANDS: u32 = 2;
}

/// Version of the firmware: major, minor, patch.
const VERSION: [u16; 3] = [
    number(env!("CARGO_PKG_VERSION_MAJOR")),
    number(env!("CARGO_PKG_VERSION_MINOR")),
    number(env!("CARGO_PKG_VERSION_PATCH")),
];

#[embassy_executor::main]
async fn main(spawner: Spawner) {
    let board = servo_board::init();
    info!(
        "servo-firmware {=str}: core {=u32} Hz, reset by {}, priorities {}",
        env!("CARGO_PKG_VERSION"),
        board.core_hz,
        board.reset_cause,
        servo_board::priorities::ReadBack,
    );
    if let Some(message) = board.last_words {
        warn!("the previous run ended with: {=str}", message);
    }
    let mut flash = board.flash;
    let (store, storage) = storage::open(&mut flash);
    let settings = storage.settings();
    let config = match Config::new(&settings) {
        Ok(config) => config,
        Err(refusal) => return error!("not started: {}", refusal),
    };
    let (in_interrupts, commander, reports) = drive::split(Axis::new(config), VERSION);
    static LATEST: StaticCell<Latest> = StaticCell::new();
    let latest: &'static Latest = LATEST.init(Latest::default());

    if let Err(fault) = board.power_stage.start(in_interrupts) {
        error!("control loop not started: {}", fault);
    }
    let program = servo_board::program().iter().fold(Fingerprint::default(), |so_far, part| so_far.with(part));
    let identity = Identity {
        protocol: PROTOCOL,
        firmware: VERSION,
        program: program.0,
        board: String::try_from(servo_board::NAME).unwrap_or_default(),
        serial: board.serial,
    };
    match board.link {
        Ok((tx, rx)) => {
            spawn(&spawner, commands::send(tx));
            let (commutation, heard) = (Commutation::default(), Instant::MIN);
            let commands = Commands { identity, settings, commutation, commander, latest, storage, heard };
            spawn(&spawner, commands::run(rx, commands));
        }
        Err(error) => error!("no serial link: {}", error),
    }
    spawn(&spawner, storage::run(flash, store, storage));
    spawn(&spawner, telemetry::run(reports, latest));
    spawn(&spawner, housekeeping::run(latest));
}

fn spawn<S>(spawner: &Spawner, task: Result<SpawnToken<S>, SpawnError>) {
    match task {
        Ok(token) => spawner.spawn(token),
        Err(_) => error!("a task is started twice"),
    }
}

/// A decimal number, at compile time.
const fn number(digits: &str) -> u16 {
    match u16::from_str_radix(digits, 10) {
        Ok(number) => number,
        Err(_) => u16::MAX,
    }
}
