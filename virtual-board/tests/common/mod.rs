//! What the tests of this crate share: one snapshot after boot, from which every test starts.
#![allow(dead_code, reason = "every test binary uses another part")]

use std::cell::Cell;
use std::sync::OnceLock;
use std::time::Duration;

use servo_core::black_box::{AFTER_TICKS, BEFORE_TICKS};
use servo_core::fault::Fault;
use servo_core::parameters::{Parameter, Settings};
use servo_core::profile::Limits;
use servo_core::record::flags;
use servo_core::state::State;
use servo_protocol::black_box::{BlackBox, WORDS};
use servo_protocol::message::{Reply, Request, Status};
use servo_virtual_board::{Config, Elf, Error, Link, LogLine, ParameterSectors, Session, Snapshot, VirtualBoard};

/// The converters' calibration and the start-up take 76 ms.
pub const BOOT: Duration = Duration::from_millis(150);

pub fn elf() -> Elf {
    Elf::find(None).unwrap_or_else(|error| panic!("{error}"))
}

/// The defaults, for a motor that has been aligned: its offset is that of the built-in stage.
pub fn aligned() -> Settings {
    Settings { commutation_identity: 0.0, ..Settings::default() }
}

/// What the flash of a drive holds whose user has saved these.
pub fn commissioned() -> &'static ParameterSectors {
    static COMMISSIONED: OnceLock<ParameterSectors> = OnceLock::new();
    COMMISSIONED.get_or_init(|| {
        let mut board = VirtualBoard::boot(&elf(), &Config::default()).unwrap();
        board.run_for(BOOT).unwrap();
        let mut session = Session::new(board);
        session.commission(&aligned()).unwrap();
        session.board.read_parameters().unwrap()
    })
}

/// A board with these parameters, stage and processor as built in.
pub fn config() -> Config {
    Config { parameters: commissioned().clone(), ..Config::default() }
}

/// Longest wait for a drive that has to erase a sector before it starts.
const PATIENCE_NS: u64 = 5_000_000_000;

/// A drive that starts with these parameters, answering.
pub fn started(parameters: ParameterSectors) -> Session {
    let mut board = VirtualBoard::boot(&elf(), &Config { parameters, ..Config::default() }).unwrap();
    board.run_for(BOOT).unwrap();
    let mut link = Link::new();
    loop {
        match link.request(&mut board, &Request::Identity) {
            Ok(_) => return Session::new(board),
            Err(Error::NoReply { .. }) if board.time_ns() < PATIENCE_NS => {}
            Err(error) => panic!("{error}"),
        }
    }
}

/// Sets one parameter.
pub fn set(session: &mut Session, name: &str, value: f64) {
    let id = Parameter::by_name(name).unwrap().id;
    session.order(&Request::SetParameters([(id, value)].into_iter().collect())).unwrap();
}

/// The state after boot, and what had been logged by then.
pub fn booted() -> &'static (Snapshot, Vec<LogLine>) {
    static BOOTED: OnceLock<(Snapshot, Vec<LogLine>)> = OnceLock::new();
    BOOTED.get_or_init(|| {
        let mut board = VirtualBoard::boot(&elf(), &config()).unwrap();
        board.run_for(BOOT).unwrap();
        let log = board.log().unwrap();
        (board.snapshot().unwrap(), log)
    })
}

/// A board just after boot.
pub fn board() -> VirtualBoard {
    VirtualBoard::from_snapshot(&booted().0).unwrap()
}

pub fn logged(lines: &[LogLine], text: &str) -> bool {
    lines.iter().any(|line| line.message.contains(text))
}

/// A board with the loop closed and at rest for 50 ms, and the host's end of its serial line.
pub fn enabled() -> (VirtualBoard, Link) {
    static ENABLED: OnceLock<Snapshot> = OnceLock::new();
    let snapshot = ENABLED.get_or_init(|| {
        let mut board = board();
        assert!(matches!(Link::new().request(&mut board, &Request::Enable).unwrap(), Reply::Done { .. }));
        board.run_for(Duration::from_millis(50)).unwrap();
        assert_eq!(status(&mut board, &mut Link::new()).state, State::OperationEnabled);
        board.snapshot().unwrap()
    });
    (VirtualBoard::from_snapshot(snapshot).unwrap(), Link::new())
}

pub fn status(board: &mut VirtualBoard, link: &mut Link) -> Status {
    match link.request(board, &Request::Status).unwrap() {
        Reply::Status(status) => status,
        other => panic!("{other:?} instead of a status"),
    }
}

/// The move of most tests: 5 mm at 1 m/s².
pub fn five_mm() -> Request {
    let limits = Limits { velocity_m_per_s: 0.5, acceleration_m_per_s2: 1.0, jerk_m_per_s3: None };
    Request::Move { target_ct: 81_920_000, limits }
}

/// The memory of the black box, read over the link.
pub fn black_box(board: &mut VirtualBoard, link: &mut Link) -> Vec<Cell<u32>> {
    let mut all = Vec::new();
    while all.len() < WORDS {
        let first = all.len() as u32;
        match link.request(board, &Request::ReadBlackBox { first }).unwrap() {
            Reply::BlackBox { first: told, words } if told == first && !words.is_empty() => {
                all.extend(words.into_iter().map(Cell::new));
            }
            other => panic!("{other:?}"),
        }
    }
    all
}

/// The black box tells of `fault`: complete and intact, the bridge off in the tick that saw it and in those after it, and all of its ticks
/// computed again by this computer, to the last bit.
pub fn assert_in_black_box(board: &mut VirtualBoard, link: &mut Link, fault: Fault) {
    let words = black_box(board, link);
    let black_box = BlackBox(&words[..]);
    assert!(black_box.is_intact(), "{fault:?}");
    let before = black_box.entries().take_while(|entry| entry.fault_number() == 0).count() as u32;
    let from_it_on: Vec<_> = black_box.entries().skip(before as usize).collect();
    assert!(before >= BEFORE_TICKS && from_it_on.len() as u32 == 1 + AFTER_TICKS, "{fault:?}: {before}");
    for entry in from_it_on {
        let bridge_on = entry.record()[14] & u32::from(flags::BRIDGE_ON) != 0;
        assert_eq!((entry.fault_number(), bridge_on), (fault.number(), false), "{fault:?}: {entry:?}");
    }
    let replayed = black_box.replay().unwrap_or_else(|error| panic!("{fault:?}: {error}"));
    assert!(replayed > BEFORE_TICKS + AFTER_TICKS, "{fault:?}: {replayed}");
}
