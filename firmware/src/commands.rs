//! Commands: frames of the serial link in, one request at a time to the drive, replies out.

use defmt::info;
use embassy_executor::task;
use embassy_time::{Duration, with_timeout};
use embedded_io_async::{Read, Write};
use heapless::Vec;
use servo_board::Link;
use servo_board::watchdog::Client;
use servo_core::capture::{Progress, WORDS_PER_SAMPLE};
use servo_core::cascade::{CascadeGains, ParallelGains};
use servo_core::config::{Compensator, Config};
use servo_core::drive::{Command, Outcome};
use servo_core::parameters::{Access, Parameter, Settings, TABLE};
use servo_core::position::Position;
use servo_core::record::flags;
use servo_core::refusal::Refusal;
use servo_protocol::frame::{Collector, MAX_FRAME, encode};
use servo_protocol::message::{BLOCK_WORDS, Identity, PARAMETERS_PER_REPLY, Reply, Request, Status};

use crate::clients;
use crate::drive::{Commander, Latest};
use crate::storage::Storage;

/// While the line is silent, the task checks in with the watchdog this often.
const CHECK_IN: Duration = Duration::from_millis(20);

/// What the requests act upon.
pub struct Commands {
    /// Answer to the identity request.
    pub identity: Identity,
    /// Parameters in use.
    pub settings: Settings,
    /// Way into the control interrupts.
    pub commander: Commander,
    /// Way out of them.
    pub latest: &'static Latest,
    /// What is in the flash.
    pub storage: &'static Storage,
}

/// Serves the link for ever.
#[task]
pub async fn run(link: Link, mut commands: Commands) {
    let alive = Client::register(clients::COMMANDS);
    let (mut tx, mut rx) = link.split();
    let mut collector = Collector::default();
    let mut bytes = [0; 64];
    let mut frame = [0; MAX_FRAME];
    loop {
        alive.check_in();
        let received = match with_timeout(CHECK_IN, rx.read(&mut bytes)).await {
            Ok(Ok(received)) => received,
            Ok(Err(_)) => {
                commands.count_garbled();
                continue;
            }
            Err(_) => continue,
        };
        for byte in &bytes[..received] {
            match collector.push::<Request>(*byte) {
                None => {}
                Some(Err(_)) => commands.count_garbled(),
                Some(Ok((id, request))) => {
                    let reply = commands.handle(request).await;
                    // Replies are bounded by the protocol; one that did not fit or could not be sent is one the host
                    // misses and asks for again.
                    if let Ok(length) = encode(id, &reply, &mut frame) {
                        let _ = tx.write_all(&frame[..length]).await;
                    }
                }
            }
        }
    }
}

impl Commands {
    fn count_garbled(&self) {
        self.latest.garbled_frames.set(self.latest.garbled_frames.get().wrapping_add(1));
    }

    async fn handle(&mut self, request: Request) -> Reply {
        self.tell_of_save().await;
        let outcome = match request {
            Request::Identity => return Reply::Identity(self.identity),
            Request::Status => return Reply::Status(self.status()),
            Request::Settling => return Reply::Settling(self.latest.snapshot.get().settling),
            Request::ReadCapture { first } => return Reply::Capture { first, words: self.captured(first) },
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
            Request::Compensator(compensator) => self.choose(compensator).await,
            Request::Gains(gains) => self.set_gains(gains).await,
            Request::SetParameters(values) => self.set_parameters(&values).await,
            Request::Capture(order) => self.commander.capture(order),
        };
        match outcome {
            Ok(()) => Reply::Done,
            Err(refusal) => {
                info!("refused: {}", refusal);
                Reply::Refused(refusal)
            }
        }
    }

    fn status(&self) -> Status {
        let record = self.latest.record.get();
        let snapshot = self.latest.snapshot.get();
        Status {
            state: record.state,
            fault: record.fault,
            moving: record.flags & flags::MOVING != 0,
            position_ct: record.position.0,
            error_ct: record.error_ct,
            force_n: record.force_n,
            bus_v: record.bus_v,
            counters: snapshot.counters,
            capture: snapshot.capture,
            bad_requests: self.latest.garbled_frames.get(),
            lost_records: snapshot.records_dropped,
        }
    }

    /// Captured words from index `first` on, as many as there are and fit a reply.
    fn captured(&self, first: u32) -> Vec<u32, BLOCK_WORDS> {
        let samples = match self.latest.snapshot.get().capture {
            Progress::Running(samples) | Progress::Complete(samples) => samples,
            Progress::Idle | Progress::Armed => 0,
        };
        let end = samples.saturating_mul(WORDS_PER_SAMPLE).min(first.saturating_add(BLOCK_WORDS as u32));
        (first..end).map_while(|index| servo_board::capture::load(index as usize)).collect()
    }

    /// Values from id `first` on, as many as fit a reply.
    fn parameters(&self, first: u16) -> Vec<(u16, f64), PARAMETERS_PER_REPLY> {
        let rows = TABLE.iter().filter(|row| row.id >= first).take(PARAMETERS_PER_REPLY);
        rows.map(|row| (row.id, row.get(&self.settings))).collect()
    }

    /// Begins a save, if the drive agrees: no torque, and none until the drive has been told of the end.
    async fn save(&mut self) -> Outcome {
        if self.storage.is_saving() {
            return Err(Refusal::Saving);
        }
        self.commander.execute(Command::BeginSave).await?;
        self.storage.save(self.settings);
        Ok(())
    }

    /// Tells the drive how a save has ended: with the next request, because nobody but a request can ask for torque.
    async fn tell_of_save(&mut self) {
        if self.storage.has_news() && self.commander.execute(Command::EndSave).await.is_ok() {
            self.storage.told();
        }
    }

    async fn choose(&mut self, compensator: Compensator) -> Outcome {
        self.commander.execute(Command::Compensator(compensator)).await?;
        self.settings.compensator = f64::from(compensator as u8);
        Ok(())
    }

    async fn set_gains(&mut self, gains: ParallelGains) -> Outcome {
        let gains = CascadeGains::from_parallel(gains)?;
        let settings = Settings {
            position_gain_per_s: gains.position_per_s,
            velocity_gain_n_s_per_m: gains.velocity_n_s_per_m,
            velocity_integral_per_s: gains.integral_per_s,
            ..self.settings
        };
        self.configure(settings).await
    }

    async fn set_parameters(&mut self, values: &[(u16, f64)]) -> Outcome {
        let mut settings = self.settings;
        for (id, value) in values {
            let parameter = Parameter::by_id(*id).ok_or(Refusal::UnknownParameter(*id))?;
            parameter.set(&mut settings, *value)?;
        }
        self.configure(settings).await
    }

    /// Swaps all coefficients at once; the settings in use stay as they are unless the drive takes the new ones.
    async fn configure(&mut self, settings: Settings) -> Outcome {
        let config = Config::new(&settings)?;
        let needs_bridge_off = TABLE
            .iter()
            .any(|row| matches!(row.access, Access::BridgeOff) && row.get(&settings) != row.get(&self.settings));
        self.commander.execute(Command::Configure { config, needs_bridge_off }).await?;
        self.settings = settings;
        Ok(())
    }
}
