//! The host's client in front of the firmware's ELF, on a serial line that loses and flips bytes, and on one that is pulled in mid-move.
//! Everything on the board's own clock.

mod common;

use std::io;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use common::{black_box, enabled, status};
use rand_pcg::Pcg64;
use rand_pcg::rand_core::{Rng, SeedableRng};
use servo_core::cascade::ParallelGains;
use servo_core::compensator::Compensator;
use servo_core::fault::Fault;
use servo_core::profile::Limits;
use servo_core::state::State;
use servo_protocol::black_box::BlackBox;
use servo_protocol::message::{Reply, Request, Status};
use servo_virtual_board::port::{BoardPort, Shared};
use servo_virtual_board::{Link, VirtualBoard};
use servoctl::link::{Client, Drive, Error, Patience, Port};

/// The line to a board, and what it does to bytes, both ways.
struct BadLine {
    port: BoardPort,
    random: Pcg64,
    /// Bytes of a thousand that are lost, and as many in which a bit is flipped.
    per_mille: u64,
    /// Nothing gets through any more, and nobody says so.
    pulled: Arc<AtomicBool>,
}

impl BadLine {
    fn new(board: &Shared, per_mille: u64, pulled: &Arc<AtomicBool>) -> Box<BadLine> {
        let (port, random) = (BoardPort::new(board.clone()), Pcg64::seed_from_u64(9));
        Box::new(BadLine { port, random, per_mille, pulled: pulled.clone() })
    }

    fn carried(&mut self, bytes: &[u8]) -> Vec<u8> {
        if self.pulled.load(Ordering::Relaxed) {
            return Vec::new();
        }
        let damaged = bytes.iter().filter_map(|byte| {
            let (fate, bit) = (self.random.next_u64() % 1000, self.random.next_u64() % 8);
            match fate {
                fate if fate < self.per_mille => None,
                fate if fate < 2 * self.per_mille => Some(byte ^ 1 << bit),
                _ => Some(*byte),
            }
        });
        damaged.collect()
    }
}

impl Port for BadLine {
    fn send(&mut self, bytes: &[u8]) -> io::Result<()> {
        let bytes = self.carried(bytes);
        self.port.send(&bytes)
    }

    fn receive(&mut self, bytes: &mut [u8], until: Instant) -> io::Result<usize> {
        loop {
            let length = self.port.receive(bytes, until)?;
            let arrived = self.carried(&bytes[..length]);
            if length == 0 || !arrived.is_empty() {
                bytes[..arrived.len()].copy_from_slice(&arrived);
                return Ok(arrived.len());
            }
        }
    }

    fn now(&self) -> Instant {
        self.port.now()
    }
}

/// The board again, once nobody else has it.
fn taken_back(board: Shared) -> VirtualBoard {
    Arc::into_inner(board).expect("nobody else has it").into_inner().unwrap()
}

/// A command of a kind that a servo tick carries out, whatever has been before it.
fn any_command(random: &mut Pcg64) -> Request {
    let mut number = |below: u64| random.next_u64() % below;
    // Some nanometres: at rest again before the next command.
    let limits = Limits { velocity_m_per_s: 0.1, acceleration_m_per_s2: 1.0, jerk_m_per_s3: None };
    match number(8) {
        0 => Request::Enable,
        1 => Request::ResetFault,
        2 => Request::Stop,
        3 => Request::Move { target_ct: number(100) as i64, limits },
        4 => Request::Compensator([Compensator::None, Compensator::Niasa][number(2) as usize]),
        5 => Request::SetParameters([(0x0504, 0.01 + 0.001 * number(10) as f64)].into_iter().collect()),
        6 => Request::LoadParameters,
        _ => {
            let kd_n_s_per_m = 900.0 + number(20) as f64;
            Request::Gains(ParallelGains { kp_n_per_m: 5.5e5, ki_n_per_m_s: 7e7, kd_n_s_per_m })
        }
    }
}

/// The black box numbers every command that a tick carries out: so the drive itself says how many there were.
#[test]
fn the_firmware_carries_out_each_command_of_a_script_once_on_a_line_that_loses_and_flips_bytes() {
    const COMMANDS: u32 = 400;
    let (mut board, mut link) = enabled();
    board.set_bridge_fault(true).unwrap();
    board.run_for(Duration::from_millis(40)).unwrap();
    let before = last_command(&mut board, &mut link);

    let (board, whole) = (Arc::new(Mutex::new(enabled().0)), Arc::default());
    // A lost request costs 10 ms instead of 125: less to emulate.
    let patience = Patience { reply: Duration::from_millis(10), attempts: 20, ..Patience::SERIAL };
    let mut client = Client::new(BadLine::new(&board, 10, &whole), patience, 77);
    let mut random = Pcg64::seed_from_u64(4);
    let mut last_tick = 0;
    for _ in 0..COMMANDS {
        let request = any_command(&mut random);
        match client.request(&request) {
            Ok(Reply::Done { tick }) => {
                assert!(tick > last_tick, "{request:?} in tick {tick}, the one before in {last_tick}");
                last_tick = tick;
            }
            other => panic!("{request:?}: {other:?}"),
        }
    }
    let losses = client.losses();
    println!("{COMMANDS} commands, {losses:?}");
    assert!(losses.repeated > 100 && losses.unreadable > 30, "{losses:?}");

    // The bridge's fault ends the recording, and the black box can be read.
    drop(client);
    let mut board = taken_back(board);
    let mut link = Link::new();
    assert!(status(&mut board, &mut link).bad_requests > 30, "the drive has seen the damage as well");
    board.set_bridge_fault(true).unwrap();
    board.run_for(Duration::from_millis(40)).unwrap();
    assert_eq!(last_command(&mut board, &mut link) - before, COMMANDS);
    board.check_told().unwrap();
}

/// Number of the last command in a black box that has ended.
fn last_command(board: &mut VirtualBoard, link: &mut Link) -> u32 {
    let words = black_box(board, link);
    let entries = BlackBox(&words[..]);
    assert!(entries.is_intact());
    entries.entries().filter_map(|entry| entry.command_number()).last().expect("a command within the last ticks")
}

/// `fault_reaction_option`: the bridge goes off at once, or the drive brakes first.
#[test]
fn a_cable_pulled_in_mid_move_is_reported_within_a_second_and_the_drive_ends_the_move_by_its_time_out() {
    const TIMEOUT_S: f64 = 0.2;
    for (option, stops_within_m) in [(0.0, 2e-3), (2.0, 1e-3)] {
        let (board, cut) = (Arc::new(Mutex::new(enabled().0)), Arc::default());
        let mut drive = Drive::connect(Client::new(BadLine::new(&board, 0, &cut), Patience::SERIAL, 5)).unwrap();
        let now_ns = || board.lock().unwrap().time_ns();
        drive.set_parameters(&[(0x0602, TIMEOUT_S), (0x040a, option)]).unwrap();
        let limits = Limits { velocity_m_per_s: 0.02, acceleration_m_per_s2: 1.0, jerk_m_per_s3: None };
        drive.order(&Request::Move { target_ct: 655_360_000, limits }).unwrap();
        let begun_ns = now_ns();
        let mut pulled = None;
        let pull = |status: &Status| {
            if pulled.is_none() && now_ns() > begun_ns + 300_000_000 {
                pulled = Some((now_ns(), *status));
                cut.store(true, Ordering::Relaxed);
            }
            true
        };
        let error = drive.wait_until("moving", 80_000, pull, |status| !status.moving).unwrap_err();
        let (pulled_ns, last): (u64, Status) = pulled.expect("it was still moving");
        let reported = Duration::from_nanos(now_ns() - pulled_ns);
        assert!(matches!(error, Error::NoReply { .. }), "{error}");
        assert!(reported < Duration::from_secs(1), "{reported:?}");
        println!("option {option}: reported after {reported:?}");

        // The same board, seen by somebody else once the cable is in again.
        drop(drive);
        let mut board = taken_back(board);
        assert!(!board.bridge_enabled().unwrap());
        let status = status(&mut board, &mut Link::new());
        assert_eq!((status.state, status.fault, status.moving), (State::Fault, Some(Fault::CommandTimeout), false));
        let count_m = 4e-6 / 65536.0;
        let went_on_m = (status.position_ct - last.position_ct) as f64 * count_m;
        let until_timeout_m = 0.02 * TIMEOUT_S;
        assert!(went_on_m > 0.9 * until_timeout_m && went_on_m < until_timeout_m + stops_within_m, "{went_on_m} m");
        board.check_told().unwrap();
    }
}
