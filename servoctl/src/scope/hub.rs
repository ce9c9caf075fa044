//! The drive thread: the only one that talks to the drive. Orders in, news out.

use std::sync::mpsc::{Receiver, Sender, TryRecvError, channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use servo_core::SERVO_HZ;
use servo_core::capture::{self, Trigger};
use servo_core::parameters::Settings;
use servo_core::profile::Limits;
use servo_core::record::Selection;
use servo_protocol::message::{Request, Status};
use tokio::sync::{broadcast, oneshot};

use super::news::{Captured, Live, News, State, Wish, parameters};
use crate::cli::drive::motion::compensator_name;
use crate::cli::drive::settled::Report;
use crate::cli::drive::{Connected, params};
use crate::link::{Drive, Error, units};

/// News that a browser may be behind before it misses some.
const BACKLOG: usize = 256;
/// Time between two messages of live traces.
const NEWS_EVERY: Duration = Duration::from_millis(50);
/// Time between two looks at the drive.
const LOOK: Duration = Duration::from_millis(4);
/// Acceleration of a move that names none, m/s².
const ACCELERATION_M_PER_S2: f64 = 1.0;
/// The capture of a move: 50 ms before the end of its profile and 450 ms after it.
const CAPTURE: capture::Order = capture::Order {
    words: Selection::ERROR_POSITION_FORCE,
    samples: 2000,
    before: 200,
    every_ticks: 2,
    trigger: Trigger::MoveEnd,
};

/// A wish of a browser that may have it, and where its answer goes.
pub struct Order {
    /// What.
    pub wish: Wish,
    /// What was done, or why not.
    pub answer: oneshot::Sender<Result<String, String>>,
}

/// The near end of the drive thread. Cloning is cheap.
#[derive(Clone)]
pub struct Hub {
    orders: Sender<Order>,
    /// Parameters as they are now.
    settings: Arc<Mutex<Settings>>,
    news: broadcast::Sender<Arc<str>>,
    /// What every browser is told first.
    pub greeting: Greeting,
}

/// Who the drive is.
#[derive(Clone, Debug)]
pub struct Greeting {
    /// Board, firmware, serial number.
    pub drive: String,
    /// Nothing real moves.
    pub simulated: bool,
}

impl Hub {
    /// Starts the drive thread.
    ///
    /// # Errors
    /// The drive's parameters cannot be read.
    pub fn start(connected: Connected) -> Result<Hub, Error> {
        let Connected { mut drive, is_virtual } = connected;
        let settings = drive.parameters()?;
        let identity = drive.identity();
        let [major, minor, patch] = identity.firmware;
        let serial: String = identity.serial.iter().map(|word| format!("{word:08x}")).collect();
        let greeting = Greeting {
            drive: format!("{} · firmware {major}.{minor}.{patch} · {serial}", identity.board),
            simulated: is_virtual,
        };
        let (orders, inbox) = channel();
        let (news, _) = broadcast::channel(BACKLOG);
        let shared = Arc::new(Mutex::new(settings));
        let hub = Hub { orders, settings: shared.clone(), news: news.clone(), greeting };
        let mut thread = Thread { drive, settings, shared, news, live: Live::default(), under_way: None };
        std::thread::spawn(move || {
            if let Err(error) = thread.run(&inbox) {
                thread.tell(&News::Ended { text: error.to_string() });
            }
        });
        Ok(hub)
    }

    /// What comes from now on, as JSON.
    pub fn listen(&self) -> broadcast::Receiver<Arc<str>> {
        self.news.subscribe()
    }

    /// The parameters as they are now.
    pub fn parameters(&self) -> News {
        News::Parameters { rows: parameters(&self.settings.lock().unwrap_or_else(PoisonError::into_inner)) }
    }

    /// Tells every browser.
    pub fn tell(&self, news: &News) {
        tell(&self.news, news);
    }

    /// Has a wish carried out.
    ///
    /// # Errors
    /// The drive's refusal, in words.
    pub async fn order(&self, wish: Wish) -> Result<String, String> {
        let gone = || "the link to the drive is broken".to_owned();
        let (answer, answered) = oneshot::channel();
        self.orders.send(Order { wish, answer }).map_err(|_| gone())?;
        answered.await.map_err(|_| gone())?
    }
}

fn tell(to: &broadcast::Sender<Arc<str>>, news: &News) {
    // Plain data: it always has a JSON form. That nobody listens is no error.
    if let Ok(text) = serde_json::to_string(news) {
        let _ = to.send(text.into());
    }
}

/// A move whose settling is to be told.
struct UnderWay {
    from_m: f64,
    target_m: f64,
    compensator: f64,
}

struct Thread {
    drive: Drive,
    settings: Settings,
    shared: Arc<Mutex<Settings>>,
    news: broadcast::Sender<Arc<str>>,
    live: Live,
    under_way: Option<UnderWay>,
}

impl Thread {
    fn tell(&self, news: &News) {
        tell(&self.news, news);
    }

    /// Until nobody can order any more, or the link breaks.
    fn run(&mut self, orders: &Receiver<Order>) -> Result<(), Error> {
        let mut told = Instant::now();
        loop {
            match orders.try_recv() {
                Err(TryRecvError::Disconnected) => return Ok(()),
                Err(TryRecvError::Empty) => {}
                Ok(Order { wish, answer }) => {
                    let result = self.carry_out(&wish);
                    // Who asked may be gone.
                    let _ = answer.send(result.as_ref().map(String::clone).map_err(ToString::to_string));
                    if let Err(error @ (Error::Broken(_) | Error::NoReply { .. })) = result {
                        return Err(error);
                    }
                }
            }
            let status = self.drive.status()?;
            self.watch(&status);
            self.follow_move(&status)?;
            if told.elapsed() >= NEWS_EVERY {
                told = Instant::now();
                self.tell(&News::State(state(&status)));
                let live = std::mem::take(&mut self.live);
                self.tell(&News::Live(live));
            }
            std::thread::sleep(LOOK);
        }
    }

    fn watch(&mut self, status: &Status) {
        let count_m = self.settings.encoder_count_m;
        let live = &mut self.live;
        live.time_s.push(f64::from(status.tick) / f64::from(SERVO_HZ));
        live.position_mm.push(status.position_ct as f64 * count_m * 1e3);
        live.error_nm.push(f64::from(status.error_ct) * count_m * 1e9);
        live.force_n.push(status.force_n.into());
    }

    /// After the end of a profile: settling first, then the capture, once.
    fn follow_move(&mut self, status: &Status) -> Result<(), Error> {
        if self.under_way.is_none() {
            return Ok(());
        }
        if status.fault.is_some() {
            self.under_way = None;
            return Ok(());
        }
        if status.moving {
            return Ok(());
        }
        let settling = self.drive.settling()?;
        if !Report::is_ready(&settling) {
            return Ok(());
        }
        let Some(UnderWay { from_m, target_m, compensator, .. }) = self.under_way.take() else { return Ok(()) };
        let report = Report::new(&settling, self.settings.encoder_count_m);
        let compensator = compensator_name(compensator);
        self.tell(&News::Settled { compensator, from_mm: from_m * 1e3, to_mm: target_m * 1e3, report });
        let captured = self.captured(target_m)?;
        self.tell(&News::Captured(captured));
        Ok(())
    }

    fn captured(&mut self, target_m: f64) -> Result<Captured, Error> {
        let count_m = self.settings.encoder_count_m;
        let capture = self.drive.read_capture(|_, _| {})?;
        let column = |name: &str| capture.column(name).unwrap_or_default();
        let position_ct = column("position_low_ct");
        Ok(Captured {
            time_ms: capture.times_s().iter().map(|time_s| time_s * 1e3).collect(),
            error_nm: column("error_ct").iter().map(|error_ct| error_ct * count_m * 1e9).collect(),
            displacement_um: position_ct.iter().map(|ct| (ct * count_m - target_m) * 1e6).collect(),
            force_n: column("force_n"),
        })
    }

    fn carry_out(&mut self, wish: &Wish) -> Result<String, Error> {
        let done = |text: &str| Ok(text.to_owned());
        match wish {
            Wish::Enable => self.drive.enable().and_then(|_| done("enabled")),
            Wish::Disable => self.drive.order(&Request::Disable).and_then(|_| done("disabled")),
            Wish::Stop => self.drive.order(&Request::Stop).and_then(|_| done("braking")),
            Wish::Clear => self.drive.order(&Request::ResetFault).and_then(|_| done("fault acknowledged")),
            Wish::Release => done("released"),
            Wish::Move { target, relative, acceleration } => {
                self.begin_move(target, *relative, acceleration.as_deref())
            }
            Wish::Set { name, value } => {
                let row = params::parse(name, value).map_err(|error| Error::Typed(error.to_string()))?;
                self.drive.set_parameters(&[row])?;
                self.settings = self.drive.parameters()?;
                *self.shared.lock().unwrap_or_else(PoisonError::into_inner) = self.settings;
                self.tell(&News::Parameters { rows: parameters(&self.settings) });
                done(&format!("{name} = {value}"))
            }
        }
    }

    fn begin_move(&mut self, target: &str, relative: bool, acceleration: Option<&str>) -> Result<String, Error> {
        let settings = &self.settings;
        let target_m = units::length(target).map_err(Error::Typed)?;
        let acceleration = match acceleration {
            None => ACCELERATION_M_PER_S2.min(settings.acceleration_max_m_per_s2),
            Some(text) => units::acceleration(text).map_err(Error::Typed)?,
        };
        let limits = Limits {
            velocity_m_per_s: settings.velocity_max_m_per_s as f32,
            acceleration_m_per_s2: acceleration as f32,
            jerk_m_per_s3: None,
        };
        let count_m = settings.encoder_count_m;
        let status = self.drive.status()?;
        let from_ct = status.position_ct + i64::from(status.error_ct);
        let target_ct = (target_m / count_m).round() as i64 + if relative { from_ct } else { 0 };
        let compensator = settings.compensator;
        self.drive.arm_capture(CAPTURE)?;
        self.drive.order(&Request::Move { target_ct, limits })?;
        let (from_m, target_m) = (from_ct as f64 * count_m, target_ct as f64 * count_m);
        self.under_way = Some(UnderWay { from_m, target_m, compensator });
        Ok(format!("moving to {}", units::show_length(target_m)))
    }
}

fn state(status: &Status) -> State {
    State {
        time_s: f64::from(status.tick) / f64::from(SERVO_HZ),
        state: status.state.to_string(),
        fault: status.fault.map(|fault| (fault.number(), fault.explanation().to_owned())),
        enabled: status.state.has_torque(),
        moving: status.moving,
        bus_v: status.bus_v,
    }
}
