//! Streams over the emulated UART: complete where the line carries them, every loss counted where it does not.

mod common;

use std::time::Duration;

use common::enabled;
use servo_core::record::{Selection, WORDS};
use servo_protocol::frame::{Collector, MAX_FRAME, encode};
use servo_protocol::message::{Reply, Request, Status};
use servo_protocol::stream::{Order, Tally};
use servo_virtual_board::VirtualBoard;

/// What came from the drive.
#[derive(Default)]
struct Line {
    collector: Collector,
    tally: Tally,
    unreadable: u32,
    /// Blocks with a multiple of this as number are not counted, as if the line had lost it; but not the first, and the last is followed by another.
    drop_every: Option<u32>,
    dropped_blocks: u64,
    dropped_samples: u64,
    waiting: Option<u64>,
}

impl Line {
    /// Lets virtual time pass and counts blocks; the last other reply.
    fn run(&mut self, board: &mut VirtualBoard, order: &Order, time: Duration) -> Option<Reply> {
        let mut reply = None;
        let end_ns = board.time_ns() + time.as_nanos() as u64;
        while board.time_ns() < end_ns {
            board.run_for(Duration::from_millis(5)).unwrap();
            for byte in board.received().unwrap() {
                match self.collector.push::<Reply>(byte) {
                    Some(Ok((7, Reply::Block(block)))) if self.drops(block.number) => {
                        self.waiting = Some(block.samples(order.words).count() as u64);
                    }
                    Some(Ok((7, Reply::Block(block)))) => {
                        self.tally.count(order, &block);
                        // A loss can be seen when something follows it.
                        if let Some(samples) = self.waiting.take() {
                            self.dropped_blocks += 1;
                            self.dropped_samples += samples;
                        }
                    }
                    Some(Ok((_, other))) => reply = Some(other),
                    Some(Err(_)) => self.unreadable += 1,
                    None => {}
                }
            }
        }
        reply
    }

    fn drops(&self, number: u32) -> bool {
        self.drop_every.is_some_and(|every| number > 0 && number.is_multiple_of(every))
    }

    fn ask(&mut self, board: &mut VirtualBoard, order: &Order, id: u32, request: &Request) -> Reply {
        let mut frame = [0; MAX_FRAME];
        let length = encode(id, request, &mut frame).unwrap();
        board.send(&frame[..length]).unwrap();
        self.run(board, order, Duration::from_millis(30)).expect("a reply within 30 ms")
    }

    fn status(&mut self, board: &mut VirtualBoard, order: &Order) -> Status {
        match self.ask(board, order, 1, &Request::Status) {
            Reply::Status(status) => status,
            other => panic!("{other:?}"),
        }
    }
}

#[test]
fn four_signals_of_every_tick_arrive_for_twenty_seconds_without_a_loss() {
    let (mut board, _) = enabled();
    let words = Selection::named(["position_low_ct", "error_ct", "force_n", "iq_a"]).unwrap();
    let (order, mut line) = (Order { words, every_ticks: 1 }, Line::default());
    assert!(matches!(line.ask(&mut board, &order, 7, &Request::Stream(order)), Reply::Done { .. }));
    line.run(&mut board, &order, Duration::from_secs(20));
    let status = line.status(&mut board, &order);
    assert_eq!((line.tally.lost_samples, line.tally.lost_blocks, line.unreadable), (0, 0, 0));
    assert_eq!((status.lost_blocks, status.lost_records, status.counters.overruns), (0, 0, 0));
    // 20 s and the requests around them, less the block that is being filled.
    assert!((160_000..161_000).contains(&line.tally.samples), "{}", line.tally.samples);
    board.check_told().unwrap();
}

#[test]
fn blocks_lost_on_the_line_are_counted_to_the_sample() {
    let (mut board, _) = enabled();
    let order = Order { words: Selection::ERROR_POSITION_FORCE, every_ticks: 1 };
    let mut line = Line { drop_every: Some(7), ..Line::default() };
    line.ask(&mut board, &order, 7, &Request::Stream(order));
    line.run(&mut board, &order, Duration::from_millis(500));
    assert!(line.dropped_samples > 300, "{}", line.dropped_samples);
    assert_eq!(line.tally.lost_samples, line.dropped_samples);
    assert_eq!(line.tally.lost_blocks, line.dropped_blocks);
    board.check_told().unwrap();
}

#[test]
fn more_than_the_line_carries_is_dropped_by_blocks_and_the_control_loop_does_not_notice() {
    let (mut board, _) = enabled();
    let order = Order { words: Selection((1 << WORDS) - 1), every_ticks: 1 };
    let mut line = Line::default();
    line.ask(&mut board, &order, 7, &Request::Stream(order));
    line.run(&mut board, &order, Duration::from_millis(500));
    line.ask(&mut board, &order, 8, &Request::Stream(Order { words: Selection(0), every_ticks: 1 }));
    let status = line.status(&mut board, &order);
    assert!(line.tally.lost_blocks > 50 && line.tally.samples > 1000, "{:?}", line.tally);
    // Those dropped behind the last one that arrived only the drive knows of.
    let unseen = u64::from(status.lost_blocks) - line.tally.lost_blocks;
    assert!(unseen < 32, "{unseen} of {}", status.lost_blocks);
    assert_eq!((status.lost_records, status.counters.overruns, line.unreadable), (0, 0, 0));
    board.check_told().unwrap();
}
