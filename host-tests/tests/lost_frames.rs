//! One or two frames that do not arrive: the stage goes on, what is measured around the gap is still watched, and nothing is taken for
//! a jump that is none.

use servo_core::axis::ServoSample;
use servo_core::drive::Command;
use servo_core::encoder::biss;
use servo_core::fault::Fault;
use servo_core::position::Position;
use servo_core::profile::Limits;
use servo_core::state::State;
use servo_host_tests::{Bench, FastBench, tuning};
use servo_sim::{Stage, encoder};

const FIVE_MM: Position = Position(81_920_000);
/// No answer: the line rests.
const NOTHING: u64 = u64::MAX;

type Tamper = fn(&mut ServoSample);

/// `ticks_into_move` into 5 mm at 1 m/s².
fn moving_bench(ticks_into_move: u32) -> Bench {
    let stage = Stage::default();
    let mut bench = Bench::new(&stage, &tuning::settings(&stage, &tuning::STANDARD).unwrap(), 3).unwrap();
    bench.enable().unwrap();
    let limits = Limits { velocity_m_per_s: 0.5, acceleration_m_per_s2: 1.0, jerk_m_per_s3: None };
    bench.command(Command::Move { target: FIVE_MM, limits }).unwrap();
    bench.run(ticks_into_move, |_| ());
    bench
}

/// Position of the stage, m, over 200 ticks in which the first `bad` frames are replaced.
fn path_after_bad_frames(bad: u32, ticks_into_move: u32, replace: Tamper) -> Vec<f64> {
    let mut bench = moving_bench(ticks_into_move);
    (0..200)
        .map(|tick| {
            bench.tick_with(None, |s| {
                if tick < bad {
                    replace(s)
                }
            });
            assert_eq!(bench.axis.drive().state(), State::OperationEnabled);
            bench.plant.position_m()
        })
        .collect()
}

#[test]
fn one_or_two_bad_frames_move_the_stage_no_more_than_the_noise_that_they_replace() {
    // In mid-move at 37 mm/s the stage is a free mass: the noise of one reading (0.44 nm) through the D part (912 N s/m) is a kick
    // of 0.2 µm/s, which a 100 Hz loop brings back after some 0.4 nm; two of them are allowed per frame. At rest the contact stiffness
    // (17.3 N/µm) gives way to the same 4.5 mN by 0.26 nm.
    for (ticks_into_move, allowed_m) in [(300, 0.8e-9), (4 * 8000, 0.26e-9)] {
        let clean = path_after_bad_frames(0, ticks_into_move, |_| ());
        for bad in [1, 2] {
            let broken: [Tamper; 4] =
                [|s| s.frame = u64::MAX, |s| s.frame = 0, |s| s.frame ^= 1 << 35, |s| s.frame ^= 0b11 << 20];
            for replace in broken {
                let disturbed = path_after_bad_frames(bad, ticks_into_move, replace);
                let worst = clean.iter().zip(&disturbed).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
                assert!(worst < f64::from(bad) * allowed_m, "{bad} bad frames at {ticks_into_move}: {worst:e} m");
            }
        }
    }
}

/// A drive on the carriage alone, holding its position.
fn holding() -> FastBench {
    let stage = Stage::default();
    let mut bench = FastBench::new(&stage, &tuning::settings(&stage, &tuning::STANDARD).unwrap(), 3).unwrap();
    bench.enable().unwrap();
    bench
}

/// At 10 m/s² from one tick to the next, the stage stays behind its set-point by some µm more in every tick: as much as the largest
/// change of speed that counts as possible (1 µm a tick), and the position assumed for a lost frame does not know it.
#[test]
fn a_frame_lost_anywhere_in_a_hard_start_or_stop_is_no_jump() {
    let mut bench = holding();
    let limits = Limits { velocity_m_per_s: 0.5, acceleration_m_per_s2: 10.0, jerk_m_per_s3: None };
    bench.command(Command::Move { target: FIVE_MM, limits }).unwrap();
    let (mut tick, mut fastest_ct, mut error_ct) = (0, 0, 0);
    while bench.is_moving() || tick < 800 {
        for lost in 1..=2 {
            let mut bench = bench.clone();
            for after in 0..lost + 8 {
                let output = bench.tick_altered(None, |frame| if after < lost { NOTHING } else { frame });
                assert_eq!(output.record.fault, None, "{lost} lost in tick {tick}, seen {after} ticks later");
            }
        }
        let record = bench.tick(None).record;
        fastest_ct = fastest_ct.max((record.error_ct - error_ct).abs());
        error_ct = record.error_ct;
        tick += 1;
    }
    let jump_ct = bench.drive.config().monitor.jump_ct;
    assert!(fastest_ct > 2 * jump_ct, "the error changed by {fastest_ct} counts a tick at most: nothing was tried");
}

/// The healthy frame of a stage `shift_ct` further on.
fn shifted(frame: u64, shift_ct: i32) -> u64 {
    let counts = biss::decode(frame).unwrap().counts;
    encoder::frame(counts.wrapping_add_signed(shift_ct), false, false, 2)
}

/// Mean speeds over m and n ticks may differ by (m + n) / 2 times the change in a tick.
#[test]
fn a_jump_is_seen_in_the_first_frame_that_shows_it_also_after_lost_ones() {
    let jump_ct = f64::from(holding().drive.config().monitor.jump_ct);
    // Frames lost, frames that arrive before the jump, and the smallest jump in units of what is allowed per tick.
    for (lost, between, smallest) in [(0, 0, 1.0), (1, 0, 3.0), (2, 0, 6.0), (1, 1, 1.5), (2, 1, 2.0), (2, 2, 1.0)] {
        for (share, fault) in [(1.1, Some(Fault::EncoderJump)), (0.9, None)] {
            for sign in [1.0, -1.0] {
                let shift_ct = (sign * share * smallest * jump_ct) as i32;
                let mut bench = holding();
                for tick in 0..lost + between {
                    let output = bench.tick_altered(None, |frame| if tick < lost { NOTHING } else { frame });
                    assert_eq!(output.record.fault, None);
                }
                let output = bench.tick_altered(None, |frame| shifted(frame, shift_ct));
                assert_eq!(output.record.fault, fault, "{lost} lost, {between} between, {share} of the bound");
                assert_eq!(output.demand.enabled, fault.is_none());
            }
        }
    }
}
