//! The drive on both sides of the interrupt boundary, and the queues between.
//!
//! ```text
//!            orders (3)                       records (127)     telemetry
//! commands ─────────────▶ control interrupts ─────────────────▶ task
//!   task   ◀─────────────   Axis             ─────────────────▶
//!         answers (3), fits (1)               snapshots, copies of the drive (1)
//! ```
//! Every queue is lock-free with one producer and one consumer. The interrupts never wait: what does not fit is dropped
//! and counted.

use core::cell::Cell;

use defmt::{info, warn};
use embassy_time::Timer;
use heapless::spsc::{Consumer, Producer, Queue};
use servo_board::{Control, Encoder};
use servo_core::axis::{Axis, ServoSample};
use servo_core::black_box::{Entry, Recorder};
use servo_core::capture;
use servo_core::current::{Bridge, PhaseCodes};
use servo_core::drive::{Command, Commutation, Counters, Drive};
use servo_core::encoder::sincos::Fit;
use servo_core::measure::Reading;
use servo_core::record::TickRecord;
use servo_core::refusal::Refusal;
use servo_core::settling::Settling;
use servo_protocol::black_box::{BlackBox, Memory, WORDS};
use servo_protocol::stream;
use static_cell::{ConstStaticCell, StaticCell};

/// Records that fit between two visits of the telemetry task: 15 ms.
const RECORDS: usize = 128;

/// The black box, in memory that a warm reset leaves alone.
pub static BLACK_BOX: BlackBox<KeptMemory> = BlackBox(KeptMemory);

/// See [`servo_board::black_box`].
pub struct KeptMemory;

const _: () = assert!(WORDS <= servo_board::black_box::WORDS, "the black box does not fit its memory");

impl Memory for KeptMemory {
    #[inline(always)]
    fn load(&self, index: usize) -> u32 {
        servo_board::black_box::load(index)
    }

    #[inline(always)]
    fn store(&self, index: usize, word: u32) {
        servo_board::black_box::store(index, word);
    }
}

/// What tasks hand to the servo tick; it takes one per tick.
#[derive(Clone, Copy)]
#[expect(clippy::large_enum_variant, reason = "there is no allocator to box with")]
pub enum Order {
    /// For the drive.
    Command {
        /// Its number in the black box, from 1.
        number: u32,
        /// What to do.
        command: Command,
    },
    /// For the capture, checked beforehand.
    Capture(capture::Order),
    /// To hand over what has been collected of sine and cosine.
    Signals,
}

/// The number of the tick that carried an order out, or why it did not.
pub type Answer = Result<u32, Refusal>;

/// A tick's record, and what the drive knew about itself beyond it: of one tick, so that what a status says and what is asked for
/// after it agree.
#[derive(Clone, Copy, Default)]
pub struct Snapshot {
    /// Record of the tick that it was taken in.
    pub record: TickRecord,
    /// Counts and extremes since start.
    pub counters: Counters,
    /// How the last move settled, so far.
    pub settling: Settling,
    /// Where the capture stands.
    pub capture: capture::Progress,
    /// What the excitation has found, so far.
    pub excitation: Reading,
    /// Records that found the queue full.
    pub records_dropped: u32,
    /// What is known of the motor's electrical zero.
    pub commutation: Commutation,
    /// See [`Drive::subdivisional_error_m`].
    pub subdivisional_error_m: Option<f32>,
    /// See [`Drive::status_word`].
    pub status_word: u16,
}

/// The interrupts' side: the axis and its ends of the queues.
pub struct InInterrupts {
    axis: Axis,
    orders: Consumer<'static, Order>,
    answers: Producer<'static, Answer>,
    fits: Producer<'static, Fit>,
    records: Producer<'static, TickRecord>,
    snapshots: Producer<'static, Snapshot>,
    records_dropped: u32,
    recorder: Recorder,
    copies: Producer<'static, Drive>,
}

impl Control for InInterrupts {
    fn on_period(&mut self, phases: PhaseCodes) -> Bridge {
        let bridge = self.axis.on_period(phases);
        // Between two ticks the drive does not change, and there is time.
        if self.recorder.copy_is_due() {
            let _ = self.copies.enqueue(self.axis.drive().clone());
        }
        bridge
    }

    fn on_servo(&mut self, sample: &ServoSample) -> Bridge {
        // Looked at in its place in the queue: a copy of it is long.
        let order = self.orders.peek();
        let (number, command) = match order {
            Some(Order::Command { number, command }) => (*number, Some(command)),
            Some(Order::Capture(order)) => {
                self.axis.arm_capture(*order);
                (0, None)
            }
            Some(Order::Signals) => {
                if let Some(fit) = self.axis.drive().signal_fit() {
                    let _ = self.fits.enqueue(*fit);
                }
                (0, None)
            }
            None => (0, None),
        };
        let output = self.axis.on_servo(sample, command);
        if order.is_some() {
            let _ = self.orders.dequeue();
            // As many fit as orders, so there is room.
            let tick = output.record.sequence;
            let _ = self.answers.enqueue(output.outcome.unwrap_or(Ok(())).map(|()| tick));
        }
        if let Some(sample) = output.sample {
            for (offset, word) in sample.words.into_iter().enumerate().take(sample.count as usize) {
                servo_board::capture::store(sample.at as usize + offset, word);
            }
        }
        match self.recorder.step(&output.record) {
            Some(index) => {
                let entry = Entry::new(&output.inputs, number, &output.record);
                BLACK_BOX.store(index, &entry, self.recorder.written());
            }
            None => BLACK_BOX.end(),
        }
        if self.records.enqueue(output.record).is_err() {
            self.records_dropped += 1;
        }
        if self.snapshots.ready() {
            let drive = self.axis.drive();
            let _ = self.snapshots.enqueue(Snapshot {
                record: output.record,
                counters: drive.counters(),
                settling: drive.settling(),
                capture: self.axis.capture().progress(),
                excitation: drive.measured(),
                records_dropped: self.records_dropped,
                commutation: drive.commutation(),
                subdivisional_error_m: drive.subdivisional_error_m().map(|error_m| error_m as f32),
                status_word: drive.status_word(&output.record),
            });
        }
        output.bridge
    }

    fn encoder(&self) -> Encoder {
        if self.axis.drive().config().sin_cos.is_some() { Encoder::SinCos } else { Encoder::BissC }
    }
}

/// The telemetry task's side.
pub struct Reports {
    /// One per servo tick.
    pub records: Consumer<'static, TickRecord>,
    /// A new one is made as soon as the last one has been taken.
    pub snapshots: Consumer<'static, Snapshot>,
    /// For the black box.
    pub copies: Consumer<'static, Drive>,
}

/// The command task's side.
pub struct Commander {
    orders: Producer<'static, Order>,
    answers: Consumer<'static, Answer>,
    fits: Consumer<'static, Fit>,
    /// Commands given so far.
    commands: u32,
}

impl Commander {
    /// Hands a command to the next servo tick and waits for the answer, one or two ticks.
    ///
    /// # Errors
    /// The drive's refusal, or [`Refusal::Busy`] if no tick took the command within 10 ms.
    pub async fn execute(&mut self, command: Command) -> Answer {
        // From 1 on for ever: 0 means none.
        self.commands = self.commands.checked_add(1).unwrap_or(1);
        if BLACK_BOX.note(self.commands, &command).is_err() {
            warn!("black box: a command does not fit");
        }
        self.order(Order::Command { number: self.commands, command }).await
    }

    /// Orders a capture and waits until it is armed.
    ///
    /// # Errors
    /// What [`capture::Order::check`] refuses, or [`Refusal::Busy`].
    pub async fn capture(&mut self, order: capture::Order) -> Answer {
        self.order(Order::Capture(order.check(servo_board::capture::WORDS as u32)?)).await
    }

    /// Sine and cosine as collected so far; nothing was if nobody asked for it.
    ///
    /// # Errors
    /// [`Refusal::Busy`].
    pub async fn signals(&mut self) -> Result<Fit, Refusal> {
        while self.fits.dequeue().is_some() {}
        self.order(Order::Signals).await?;
        Ok(self.fits.dequeue().unwrap_or_default())
    }

    async fn order(&mut self, order: Order) -> Answer {
        while self.answers.dequeue().is_some() {}
        self.orders.enqueue(order).map_err(|_| Refusal::Busy)?;
        for _ in 0..40 {
            Timer::after_micros(250).await;
            if let Some(answer) = self.answers.dequeue() {
                return answer;
            }
        }
        Err(Refusal::Busy)
    }
}

/// What the telemetry task last saw, for the other tasks. All tasks run in one executor, so plain cells do.
#[derive(Default)]
pub struct Latest {
    /// Record of the newest tick.
    pub record: Cell<TickRecord>,
    /// Newest snapshot.
    pub snapshot: Cell<Snapshot>,
    /// Frames on the serial link that could not be read.
    pub unreadable_frames: Cell<u32>,
    /// What is to be streamed, and the number of the request that said so: for the telemetry task to take.
    pub stream: Cell<Option<(u32, stream::Order)>>,
    /// Blocks of streams that found the line busy.
    pub lost_blocks: Cell<u32>,
}

/// Splits the drive. To be called once.
///
/// The black box keeps what an earlier run has left in it; what is new is marked as by `firmware`.
pub fn split(axis: Axis, firmware: [u16; 3]) -> (&'static mut InInterrupts, Commander, Reports) {
    static ORDERS: ConstStaticCell<Queue<Order, 4>> = ConstStaticCell::new(Queue::new());
    static ANSWERS: ConstStaticCell<Queue<Answer, 4>> = ConstStaticCell::new(Queue::new());
    static FITS: ConstStaticCell<Queue<Fit, 2>> = ConstStaticCell::new(Queue::new());
    static RECORDS_QUEUE: ConstStaticCell<Queue<TickRecord, RECORDS>> = ConstStaticCell::new(Queue::new());
    static SNAPSHOTS: ConstStaticCell<Queue<Snapshot, 2>> = ConstStaticCell::new(Queue::new());
    static COPIES: ConstStaticCell<Queue<Drive, 2>> = ConstStaticCell::new(Queue::new());
    static IN_INTERRUPTS: StaticCell<InInterrupts> = StaticCell::new();
    let (orders_in, orders_out) = ORDERS.take().split();
    let (answers_in, answers_out) = ANSWERS.take().split();
    let (fits_in, fits_out) = FITS.take().split();
    let (records_in, records_out) = RECORDS_QUEUE.take().split();
    let (snapshots_in, snapshots_out) = SNAPSHOTS.take().split();
    let (copies_in, copies_out) = COPIES.take().split();
    let recorder = match BLACK_BOX.find() {
        Some(written) => {
            info!("black box: holds the last ticks of an earlier run");
            Recorder::keeping(written)
        }
        None => {
            BLACK_BOX.clear(firmware);
            Recorder::recording()
        }
    };
    let in_interrupts = IN_INTERRUPTS.init(InInterrupts {
        axis,
        orders: orders_out,
        answers: answers_in,
        fits: fits_in,
        records: records_in,
        snapshots: snapshots_in,
        records_dropped: 0,
        recorder,
        copies: copies_in,
    });
    let commander = Commander { orders: orders_in, answers: answers_out, fits: fits_out, commands: 0 };
    (in_interrupts, commander, Reports { records: records_out, snapshots: snapshots_out, copies: copies_out })
}
