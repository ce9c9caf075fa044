//! Commands: frames of the serial link in, one request at a time to the drive, replies out.

use defmt::info;
use embassy_executor::task;
use embassy_sync::blocking_mutex::raw::ThreadModeRawMutex;
use embassy_sync::channel::Channel;
use embassy_time::{Duration, Instant, Timer, with_timeout};
use embedded_io_async::Read;
use heapless::Vec;
use servo_board::watchdog::Client;
use servo_board::{LinkReceiver, LinkSender};
use servo_core::capture::{Complete, Progress};
use servo_core::cascade::{CascadeGains, ParallelGains};
use servo_core::config::{Compensator, Config};
use servo_core::drive::{Command, Commutation};
use servo_core::encoder::sincos::Correction;
use servo_core::measure;
use servo_core::parameters::{Access, Parameter, Settings, TABLE};
use servo_core::position::Position;
use servo_core::refusal::{Field, Refusal};
use servo_protocol::black_box::{self, Memory};
use servo_protocol::frame::{MAX_FRAME, TooLong, encode};
use servo_protocol::message::{BLOCK_WORDS, Identity, PARAMETERS_PER_REPLY, Reply, Request, Status};
use servo_protocol::server::{Incoming, Server};
use servo_protocol::stream;

use crate::clients;
use crate::drive::{Answer, BLACK_BOX, Commander, Latest};
use crate::storage::Storage;

/// While the line is silent, the task checks in with the watchdog this often.
const CHECK_IN: Duration = Duration::from_millis(20);
/// The drive hears of a host that only asks this often.
const HEAR: Duration = Duration::from_millis(10);

/// What the requests act upon.
pub struct Commands {
    /// Answer to the identity request.
    pub identity: Identity,
    /// Parameters in use.
    pub settings: Settings,
    /// What was last known of the motor's electrical zero.
    pub commutation: Commutation,
    /// Way into the control interrupts.
    pub commander: Commander,
    /// Way out of them.
    pub latest: &'static Latest,
    /// What is in the flash.
    pub storage: &'static Storage,
    /// When the drive last heard of a request.
    pub heard: Instant,
}

/// Frames on their way to the host, of every task.
static OUT: Channel<ThreadModeRawMutex, Frame, 8> = Channel::new();

/// A frame for the line.
pub struct Frame {
    bytes: [u8; MAX_FRAME],
    length: usize,
}

impl Frame {
    /// The frame of a reply.
    ///
    /// # Errors
    /// One that is too long.
    pub fn of(id: u32, reply: &Reply) -> Result<Frame, TooLong> {
        let mut bytes = [0; MAX_FRAME];
        let length = encode(id, reply, &mut bytes)?;
        Ok(Frame { bytes, length })
    }

    /// Sends a stream's block if there is room. The last places are for answers: they wait for one, and a stream that asks for more
    /// than the line carries must not take it from them.
    pub fn try_send(self) -> bool {
        OUT.free_capacity() > 2 && OUT.try_send(self).is_ok()
    }
}

/// Sends frames for ever.
#[task]
pub async fn send(mut tx: LinkSender) {
    loop {
        let frame = OUT.receive().await;
        // What could not be sent the host misses and asks for again.
        let _ = tx.send(&frame.bytes[..frame.length]).await;
    }
}

/// Serves the link for ever.
#[task]
pub async fn run(mut rx: LinkReceiver, mut commands: Commands) {
    let alive = Client::register(clients::COMMANDS);
    let mut server = Server::default();
    let mut bytes = [0; 64];
    loop {
        alive.check_in();
        let received = match with_timeout(CHECK_IN, rx.read(&mut bytes)).await {
            Ok(Ok(received)) => received,
            Ok(Err(_)) => {
                server.count_unreadable();
                continue;
            }
            Err(_) => continue,
        };
        for byte in &bytes[..received] {
            let incoming = server.push(*byte);
            commands.latest.unreadable_frames.set(server.unreadable());
            let Some(incoming) = incoming else { continue };
            commands.hear().await;
            let (id, reply, restart) = match incoming {
                Incoming::Repeated { id, reply } => (id, reply, false),
                Incoming::Fresh { id, request } => {
                    let restart = matches!(request, Request::Restart);
                    let reply = commands.handle(id, request).await;
                    server.answered(id, &reply);
                    (id, reply, restart)
                }
            };
            // Replies are bounded by the protocol; one that did not fit is one the host misses and asks for again.
            if let Ok(frame) = Frame::of(id, &reply) {
                OUT.send(frame).await;
            }
            if restart && matches!(reply, Reply::Done { .. }) {
                // What is in the queue takes less.
                Timer::after_millis(50).await;
                servo_board::restart();
            }
        }
    }
}

impl Commands {
    async fn handle(&mut self, id: u32, request: Request) -> Reply {
        self.tell_of_save().await;
        self.take_commutation();
        let outcome = match request {
            Request::Identity => return Reply::Identity(self.identity.clone()),
            Request::Status => return Reply::Status(self.status()),
            Request::Settling => return Reply::Settling(self.latest.snapshot.get().settling),
            Request::Excitation => return self.excitation(),
            Request::ReadCapture { first } => return Reply::Capture { first, words: self.captured(first) },
            Request::ReadBlackBox { first } => return Reply::BlackBox { first, words: black_box_words(first) },
            Request::GetParameter(id) => match Parameter::by_id(id) {
                Some(parameter) => return Reply::Parameter { id, value: parameter.get(&self.settings) },
                None => Err(Refusal::UnknownParameter(id)),
            },
            Request::ReadParameters { first } => return Reply::Parameters(self.parameters(first)),
            Request::ParameterStore => return Reply::ParameterStore(self.storage.status(&self.settings)),
            Request::SaveParameters => self.save().await,
            Request::LoadParameters => match self.storage.stored() {
                Some(settings) => self.configure(settings).await,
                None => Err(Refusal::NothingStored),
            },
            Request::ResetParameters => self.configure(Settings::default()).await,
            Request::Enable => self.commander.execute(Command::Enable).await,
            Request::Disable => self.commander.execute(Command::Disable).await,
            Request::ResetFault => self.commander.execute(Command::ResetFault).await,
            Request::Stop => self.commander.execute(Command::Stop).await,
            Request::Move { target_ct, limits } => {
                self.commander.execute(Command::Move { target: Position(target_ct), limits }).await
            }
            Request::Excite(request) => self.excite(&request).await,
            Request::Compensator(compensator) => self.choose(compensator).await,
            Request::Gains(gains) => self.set_gains(gains).await,
            Request::SetParameters(values) => self.set_parameters(&values).await,
            Request::Align => self.commander.execute(Command::Align).await,
            Request::CollectSignals => self.commander.execute(Command::CollectSignals).await,
            Request::CorrectSignals => self.correct_signals().await,
            Request::Control(word) => self.commander.execute(Command::Control(word)).await,
            Request::Capture(order) => self.commander.capture(order).await,
            Request::Restart => self.keep_torque_off().await,
            Request::Stream(order) => self.stream(id, order),
        };
        match outcome {
            Ok(tick) => Reply::Done { tick },
            Err(refusal) => {
                info!("refused: {}", refusal);
                Reply::Refused(refusal)
            }
        }
    }

    fn status(&self) -> Status {
        let snapshot = self.latest.snapshot.get();
        Status {
            bad_requests: self.latest.unreadable_frames.get(),
            lost_records: snapshot.records_dropped,
            lost_blocks: self.latest.lost_blocks.get(),
            subdivisional_error_m: snapshot.subdivisional_error_m,
            ..Status::of(&snapshot.record, snapshot.status_word, snapshot.counters, snapshot.capture)
        }
    }

    fn excitation(&self) -> Reply {
        let snapshot = self.latest.snapshot.get();
        Reply::Excitation { tick: snapshot.record.sequence, reading: snapshot.excitation }
    }

    async fn excite(&mut self, request: &measure::Request) -> Answer {
        let order = measure::Order::new(request, self.settings.encoder_count_m)?;
        self.commander.execute(Command::Excite(order)).await
    }

    /// Words of a complete capture from index `first` on, as many as there are and fit a reply.
    fn captured(&self, first: u32) -> Vec<u32, BLOCK_WORDS> {
        let words = match self.latest.snapshot.get().capture {
            Progress::Complete(Complete { order, .. }) => order.samples * order.words.count() as u32,
            _ => 0,
        };
        let end = words.min(first.saturating_add(BLOCK_WORDS as u32));
        (first..end).map_while(|index| servo_board::capture::load(index as usize)).collect()
    }

    /// Hands the order to the telemetry task, which has the records.
    fn stream(&self, id: u32, order: stream::Order) -> Answer {
        Refusal::check(Field::Decimation, f64::from(order.every_ticks), 1.0, 8000.0)?;
        self.latest.stream.set(Some((id, order)));
        Ok(self.latest.record.get().sequence)
    }

    /// Values from id `first` on, as many as fit a reply.
    fn parameters(&self, first: u16) -> Vec<(u16, f64), PARAMETERS_PER_REPLY> {
        let rows = TABLE.iter().filter(|row| row.id >= first).take(PARAMETERS_PER_REPLY);
        rows.map(|row| (row.id, row.get(&self.settings))).collect()
    }

    /// Begins a save, if the drive agrees: no torque, and none until the drive has been told of the end.
    async fn save(&mut self) -> Answer {
        let tick = self.keep_torque_off().await?;
        self.storage.save(self.settings);
        Ok(tick)
    }

    /// No torque, none from now on, and the flash at rest: what a save needs as well.
    async fn keep_torque_off(&mut self) -> Answer {
        if self.storage.is_saving() {
            return Err(Refusal::Saving);
        }
        self.commander.execute(Command::BeginSave).await
    }

    /// Whatever the host asks is a sign of life; the drive itself sees only commands.
    async fn hear(&mut self) {
        if self.settings.command_timeout_s > 0.0 && self.heard.elapsed() >= HEAR {
            self.heard = Instant::now();
            // One that is refused has been heard.
            let _ = self.commander.execute(Command::KeepAlive).await;
        }
    }

    /// Tells the drive how a save has ended: with the next request, because nobody but a request can ask for torque.
    async fn tell_of_save(&mut self) {
        if self.storage.has_news() && self.commander.execute(Command::EndSave).await.is_ok() {
            self.storage.told();
        }
    }

    /// What an alignment has found is a parameter in use from then on, to be saved like the others.
    fn take_commutation(&mut self) {
        let commutation = self.latest.snapshot.get().commutation;
        if commutation != self.commutation
            && let Commutation::Found(zero) = commutation
        {
            self.settings = self.settings.with_commutation_zero(zero);
        }
        self.commutation = commutation;
    }

    /// What fits the signals collected is a parameter in use from then on, to be saved like the others.
    async fn correct_signals(&mut self) -> Answer {
        if self.settings.encoder_kind < 0.5 {
            return Err(Refusal::NoSignals);
        }
        let signals = self.commander.signals().await?.solve().map_err(Refusal::Signals)?;
        let settings = self.settings.with_signals(&signals);
        settings.validate()?;
        let tick = self.commander.execute(Command::CorrectSignals(Correction::new(&signals))).await?;
        self.settings = settings;
        Ok(tick)
    }

    async fn choose(&mut self, compensator: Compensator) -> Answer {
        let tick = self.commander.execute(Command::Compensator(compensator)).await?;
        self.settings.compensator = f64::from(compensator as u8);
        Ok(tick)
    }

    async fn set_gains(&mut self, gains: ParallelGains) -> Answer {
        let gains = CascadeGains::from_parallel(gains)?;
        let settings = Settings {
            position_gain_per_s: gains.position_per_s,
            velocity_gain_n_s_per_m: gains.velocity_n_s_per_m,
            velocity_integral_per_s: gains.integral_per_s,
            ..self.settings
        };
        self.configure(settings).await
    }

    async fn set_parameters(&mut self, values: &[(u16, f64)]) -> Answer {
        let mut settings = self.settings;
        for (id, value) in values {
            let parameter = Parameter::by_id(*id).ok_or(Refusal::UnknownParameter(*id))?;
            parameter.set(&mut settings, *value)?;
        }
        self.configure(settings).await
    }

    /// Swaps all coefficients at once; the settings in use stay as they are unless the drive takes the new ones.
    async fn configure(&mut self, settings: Settings) -> Answer {
        let config = Config::new(&settings)?;
        let needs_bridge_off = TABLE
            .iter()
            .any(|row| matches!(row.access, Access::BridgeOff) && row.get(&settings) != row.get(&self.settings));
        let tick = self.commander.execute(Command::Configure { config, needs_bridge_off }).await?;
        self.settings = settings;
        Ok(tick)
    }
}

/// A block of the black box.
fn black_box_words(first: u32) -> Vec<u32, BLOCK_WORDS> {
    let end = (black_box::WORDS as u32).min(first.saturating_add(BLOCK_WORDS as u32));
    (first..end).map(|index| BLACK_BOX.0.load(index as usize)).collect()
}
