//! The ticks around a fault are kept, survive a reset, and come out the same, to the last bit, when they are run again.

use std::cell::Cell;

use servo_core::axis::ServoSample;
use servo_core::black_box::{AFTER_TICKS, BEFORE_TICKS, Entry, Mismatch, Phase, Recorder};
use servo_core::compensator::Compensator;
use servo_core::config::Config;
use servo_core::drive::{Command, Outcome};
use servo_core::fault::Fault;
use servo_core::monitor::signals;
use servo_core::parameters::Settings;
use servo_core::position::Position;
use servo_core::profile::Limits;
use servo_core::record::flags;
use servo_host_tests::{Bench, tuning};
use servo_protocol::black_box::{BlackBox, Memory, ReplayError, WORDS};
use servo_sim::Stage;

const FIRMWARE: [u16; 3] = [0, 1, 0];

#[derive(Clone)]
struct Ram(Vec<Cell<u32>>);

impl Memory for Ram {
    fn load(&self, index: usize) -> u32 {
        self.0.get(index).map_or(0, Cell::get)
    }

    fn store(&self, index: usize, word: u32) {
        if let Some(cell) = self.0.get(index) {
            cell.set(word);
        }
    }
}

/// The bench as the firmware has it: a black box that sees every tick, and tasks that come by some ticks later.
struct Recorded {
    bench: Bench,
    recorder: Recorder,
    black_box: BlackBox<Ram>,
    commands: u32,
}

fn settings() -> Settings {
    tuning::settings(&Stage::default(), &tuning::STANDARD).unwrap()
}

fn moves(target: i64) -> Command {
    let limits = Limits { velocity_m_per_s: 0.5, acceleration_m_per_s2: 1.0, jerk_m_per_s3: None };
    Command::Move { target: Position(target), limits }
}

impl Recorded {
    fn new() -> Self {
        let black_box = BlackBox(Ram(vec![Cell::new(0xdead_beef); WORDS]));
        assert_eq!(black_box.find(), None, "what memory holds at power-up is no recording");
        black_box.clear(FIRMWARE);
        let bench = Bench::new(&Stage::default(), &settings(), 3).unwrap();
        Recorded { bench, recorder: Recorder::recording(), black_box, commands: 0 }
    }

    fn tick(&mut self, command: Option<Command>, tamper: impl FnOnce(&mut ServoSample)) -> Option<Outcome> {
        let mut number = 0;
        if let Some(command) = &command {
            self.commands += 1;
            number = self.commands;
            self.black_box.note(number, command).unwrap();
        }
        let output = self.bench.tick_with(command, tamper);
        match self.recorder.step(&output.record) {
            Some(index) => {
                let entry = Entry::new(&output.inputs, number, &output.record);
                self.black_box.store(index, &entry, self.recorder.written());
            }
            None => self.black_box.end(),
        }
        if self.recorder.copy_is_due() {
            self.black_box.copy(output.record.sequence, self.bench.axis.drive()).unwrap();
        }
        output.outcome
    }

    fn run(&mut self, ticks: u32) {
        for _ in 0..ticks {
            self.tick(None, |_| ());
        }
    }

    fn obey(&mut self, command: Command) {
        self.tick(Some(command), |_| ()).unwrap().unwrap();
    }

    /// Enabled, and on the way with a compensator and new gains.
    fn under_way(&mut self, compensator: Compensator) {
        self.run(5);
        self.obey(Command::Enable);
        self.run(3_000);
        self.obey(Command::Compensator(compensator));
        self.obey(moves(81_920_000));
        self.run(300);
        let stiffer =
            Settings { velocity_gain_n_s_per_m: 950.0, compensator: f64::from(compensator as u8), ..settings() };
        self.obey(Command::Configure { config: Config::new(&stiffer).unwrap(), needs_bridge_off: false });
        self.run(200);
    }

    /// Ticks with `tamper` until the recording has ended; then sealed.
    fn until_kept(&mut self, mut tamper: impl FnMut(&mut ServoSample)) {
        for _ in 0..4_000 {
            self.tick(None, &mut tamper);
            if self.black_box.is_to_be_sealed() {
                self.black_box.seal();
                return;
            }
        }
        panic!("no fault");
    }

    /// Ticks before the first with a fault, and from it on.
    fn lengths(&self) -> (u32, u32) {
        let before = self.black_box.entries().take_while(|entry| entry.fault_number() == 0).count() as u32;
        (before, self.black_box.entries().count() as u32 - before)
    }
}

#[test]
fn a_fault_keeps_512_ticks_before_and_64_after_it_that_come_out_the_same() {
    type Tamper = fn(&mut ServoSample);
    let causes: [(Fault, Tamper); 3] = [
        (Fault::EncoderChecksum, |s| s.frame ^= 1 << 35),
        (Fault::BusUnderVoltage, |s| s.bus_code = 0),
        (Fault::BridgeFault, |s| s.signals = signals::BRIDGE_FAULT),
    ];
    for (fault, tamper) in causes {
        let mut recorded = Recorded::new();
        recorded.under_way(Compensator::Niasa);
        recorded.until_kept(tamper);
        let (before, after) = recorded.lengths();
        assert!(before >= BEFORE_TICKS && after == 1 + AFTER_TICKS, "{fault:?}: {before}, {after}");
        let last = recorded.black_box.entries().last().unwrap();
        assert_eq!(last.fault_number(), fault.number());
        let replayed = recorded.black_box.replay().unwrap();
        assert!(replayed > BEFORE_TICKS + AFTER_TICKS, "{fault:?}: {replayed}");
    }
}

#[test]
fn ticks_of_every_compensator_come_out_the_same_through_a_move_a_change_of_gains_and_lost_frames() {
    for compensator in Compensator::ALL {
        let mut recorded = Recorded::new();
        recorded.under_way(compensator);
        recorded.tick(None, |s| s.frame = u64::MAX);
        recorded.run(30);
        recorded.tick(Some(Command::Stop), |s| s.last_tick_cycles = 9_999);
        recorded.run(30);
        recorded.until_kept(|s| s.signals = signals::TASK_HUNG);
        let replayed = recorded.black_box.replay();
        assert!(replayed.is_ok_and(|ticks| ticks > BEFORE_TICKS + AFTER_TICKS), "{compensator:?}: {replayed:?}");
    }
}

#[test]
fn ticks_of_an_alignment_come_out_the_same() {
    let mut recorded = Recorded::new();
    recorded.run(800);
    recorded.obey(Command::Align);
    recorded.run(400);
    recorded.until_kept(|s| s.signals = signals::BRIDGE_FAULT);
    assert!(recorded.black_box.replay().unwrap() > BEFORE_TICKS + AFTER_TICKS);
    let aligning = |entry: &Entry| entry.0[14] & u32::from(flags::ALIGNING) != 0;
    assert!(recorded.black_box.entries().filter(aligning).count() > 300);
}

#[test]
fn a_reset_in_mid_move_leaves_the_ticks_before_it() {
    let mut recorded = Recorded::new();
    recorded.under_way(Compensator::Niasa);
    // The next run finds this memory as it is.
    let after_reset = BlackBox(recorded.black_box.0.clone());
    let written = after_reset.find().unwrap();
    assert_eq!((written, after_reset.firmware()), (recorded.recorder.written(), FIRMWARE));
    assert!(after_reset.is_intact());
    assert!(after_reset.replay().unwrap() > BEFORE_TICKS);
    assert_eq!(after_reset.find(), Some(written), "and once more");
}

#[test]
fn what_is_kept_stays_until_the_bridge_is_on_again_and_then_a_new_recording_begins() {
    let mut recorded = Recorded::new();
    recorded.under_way(Compensator::Niasa);
    recorded.until_kept(|s| s.signals = signals::BRIDGE_FAULT);
    let kept: Vec<_> = recorded.black_box.entries().collect();
    recorded.obey(Command::ResetFault);
    recorded.run(1_000);
    assert!(recorded.black_box.is_intact() && recorded.black_box.entries().eq(kept));

    recorded.obey(Command::Enable);
    recorded.run(100);
    assert_eq!(recorded.recorder.phase(), Phase::Recording);
    assert!(!recorded.black_box.is_sealed());
    recorded.obey(moves(1_000_000));
    recorded.run(100);
    recorded.until_kept(|s| s.signals = signals::BRIDGE_FAULT);
    let (before, after) = recorded.lengths();
    assert_eq!((before, after), (recorded.recorder.written() - after, 1 + AFTER_TICKS));
    // All but the first tick, after which the drive was copied.
    assert_eq!(recorded.black_box.replay(), Ok(before + after - 1));
}

#[test]
fn one_wrong_bit_is_noticed_by_the_checksum_and_by_the_replay() {
    let mut recorded = Recorded::new();
    recorded.under_way(Compensator::Niasa);
    recorded.until_kept(|s| s.bus_code = 0);
    let ram = &recorded.black_box.0;
    for index in [5, 6, 8, 9, 9 + 21 * 300 + 16, WORDS - 1] {
        let word = ram.load(index);
        ram.store(index, word ^ 1 << 3);
        assert!(!recorded.black_box.is_intact(), "word {index}");
        assert_eq!(recorded.black_box.find(), None, "word {index}");
        ram.store(index, word);
    }
    assert!(recorded.black_box.is_intact());

    // A frame of the newest round with another bit: CRC error where there was none.
    let entries: Vec<_> = recorded.black_box.entries().collect();
    let tampered = entries[entries.len() - 200];
    let at = (0..WORDS).find(|at| (0..21).all(|i| ram.load(at + i) == tampered.0[i])).unwrap();
    ram.store(at + 17, ram.load(at + 17) ^ 1 << 3);
    assert_eq!(recorded.black_box.replay(), Err(ReplayError::Damaged));
    recorded.black_box.seal();
    let replayed = recorded.black_box.replay();
    let Err(ReplayError::Mismatch(Mismatch::Word { sequence, .. })) = replayed else { panic!("{replayed:?}") };
    assert_eq!(sequence, tampered.sequence());
}

#[test]
fn a_flood_of_changes_shortens_what_can_be_run_again_and_nothing_else() {
    let mut recorded = Recorded::new();
    recorded.under_way(Compensator::Niasa);
    let config = Config::new(&settings()).unwrap();
    for _ in 0..100 {
        recorded.obey(Command::Configure { config, needs_bridge_off: false });
        recorded.run(1);
    }
    recorded.until_kept(|s| s.bus_code = 0);
    assert!(recorded.lengths().0 >= BEFORE_TICKS);
    let replayed = recorded.black_box.replay();
    assert!(replayed.is_ok_and(|ticks| ticks < BEFORE_TICKS), "{replayed:?}");
}
