//! The thread that runs the emulator, and the calls that cross to it.
//!
//! The emulator calls its driver at every access and every stop. The driver here feeds the coupling, and where the run has
//! reached the instant it was sent to, it waits for the next request: so virtual time advances only when asked, and whoever asks
//! finds everything standing still.

use std::path::Path;
use std::sync::mpsc::{Receiver, Sender, channel};
use std::thread::JoinHandle;

use rigless::emulator::{self, Driver, Host, Settled, Start, Stop};
use rigless::image;
use rigless::session::Session;
use rigless::snapshot::{self, store};
use rigless::time::VirtualNanos;
use serde::{Deserialize, Serialize};

use crate::Error;
use crate::board::Nucleo;
use crate::coupling::Coupling;
use crate::elf::Elf;
use crate::log::LogReader;

/// The log is read at whole milliseconds of virtual time, as a probe does, wherever the run is asked to stop in between.
const LOG_PERIOD_NS: u64 = 1_000_000;

/// Everything within reach while the emulator stands still.
pub(crate) struct Halted<'a> {
    pub session: &'a mut Session<Nucleo>,
    pub host: &'a mut dyn Host,
    pub stop: Stop,
    pub coupling: &'a mut Coupling,
    pub log: &'a mut LogReader,
}

type Job = Box<dyn FnOnce(&mut Halted<'_>) + Send>;

enum Request {
    RunUntil(u64),
    Do(Job),
}

/// What the driver keeps of its own in a snapshot file: nothing, the coupling is cloned beside it.
#[derive(Debug, Serialize, Deserialize)]
struct Nothing;
store!(Nothing);

/// A snapshot: the machine as the emulator writes it, and the coupling and log as they stood.
pub(crate) struct State {
    machine: snapshot::Snapshot,
    coupling: Coupling,
    log: LogReader,
}

/// The near end of the emulator's thread.
pub(crate) struct Runner {
    requests: Option<Sender<Request>>,
    reached: Receiver<u64>,
    thread: Option<JoinHandle<Result<(), Error>>>,
}

impl Runner {
    /// Starts the emulator with `board` out of reset, standing before its first instruction.
    pub(crate) fn start(elf: &Elf, board: Nucleo, coupling: Coupling) -> Result<Self, Error> {
        let log = LogReader::new(elf.clone());
        Self::spawn(elf, board, coupling, log, None)
    }

    /// Starts the emulator where `state` was taken.
    pub(crate) fn resume(elf: &Elf, board: Nucleo, state: &State) -> Result<Self, Error> {
        Self::spawn(elf, board, state.coupling.clone(), state.log.clone(), Some(&state.machine))
    }

    fn spawn(
        elf: &Elf,
        board: Nucleo,
        coupling: Coupling,
        log: LogReader,
        machine: Option<&snapshot::Snapshot>,
    ) -> Result<Self, Error> {
        let (requests, inbox) = channel();
        let (outbox, reached) = channel();
        let mut session = Session::new(Box::new(board), 0, VirtualNanos(0))?;
        let resume = match machine {
            Some(machine) => Some(machine.restore(&mut session, &image::digest(elf.images(), None), &mut Nothing)?),
            None => None,
        };
        let driver = LockStep {
            coupling,
            log,
            inbox,
            outbox,
            target_ns: 0,
            next_log_ns: machine.map_or(0, |machine| next_log_ns(machine.stop().at.0)),
            resuming: machine.is_some(),
        };
        let elf = elf.clone();
        let thread = std::thread::Builder::new()
            .name("emulator".to_owned())
            .spawn(move || {
                let mut start = Start::new(elf.images());
                start.resume = resume.as_ref();
                emulator::run(session, &start, driver)?;
                Ok(())
            })
            .map_err(|error| Error::Ended { reason: error.to_string() })?;
        let mut runner = Self { requests: Some(requests), reached, thread: Some(thread) };
        runner.wait()?;
        Ok(runner)
    }

    /// Runs until virtual time `until_ns`.
    pub(crate) fn run_until(&mut self, until_ns: u64) -> Result<(), Error> {
        self.request(Request::RunUntil(until_ns))?;
        self.wait()
    }

    /// Calls `job` on the emulator's thread and returns its answer.
    pub(crate) fn call<R: Send + 'static>(
        &mut self,
        job: impl FnOnce(&mut Halted<'_>) -> R + Send + 'static,
    ) -> Result<R, Error> {
        let (answer, answered) = channel();
        self.request(Request::Do(Box::new(move |halted| {
            // The caller waits below; were it gone, nobody would miss the answer.
            let _ = answer.send(job(halted));
        })))?;
        answered.recv().map_err(|_| self.why_ended())
    }

    fn request(&mut self, request: Request) -> Result<(), Error> {
        let sent = self.requests.as_ref().is_some_and(|requests| requests.send(request).is_ok());
        if sent { Ok(()) } else { Err(self.why_ended()) }
    }

    fn wait(&mut self) -> Result<(), Error> {
        self.reached.recv().map(|_| ()).map_err(|_| self.why_ended())
    }

    fn why_ended(&mut self) -> Error {
        let ended = |reason: &str| Error::Ended { reason: reason.to_owned() };
        match self.thread.take().map(JoinHandle::join) {
            None => ended("it had ended before"),
            Some(Ok(Ok(()))) => ended("the run is over"),
            Some(Ok(Err(error))) => error,
            Some(Err(panic)) => {
                let text = panic.downcast_ref::<String>().map(String::as_str);
                ended(text.or_else(|| panic.downcast_ref::<&str>().copied()).unwrap_or("panic in the emulator"))
            }
        }
    }
}

impl Drop for Runner {
    /// Ends the run: with no request to come, the driver lets the emulator go.
    fn drop(&mut self) {
        self.requests = None;
        if let Some(thread) = self.thread.take() {
            // Its result would have reached the caller with the last request.
            let _ = thread.join();
        }
    }
}

/// The emulator's driver.
struct LockStep {
    coupling: Coupling,
    log: LogReader,
    inbox: Receiver<Request>,
    outbox: Sender<u64>,
    target_ns: u64,
    next_log_ns: u64,
    /// Set until the first stop of a run that started from a snapshot, which repeats the stop it was taken at.
    resuming: bool,
}

fn next_log_ns(now_ns: u64) -> u64 {
    (now_ns / LOG_PERIOD_NS + 1) * LOG_PERIOD_NS
}

impl LockStep {
    /// Reports that the run stands at `stop` and serves requests until one lets it go on: the next instant to reach, or `None`
    /// where nobody asks any more.
    fn serve(&mut self, session: &mut Session<Nucleo>, host: &mut dyn Host, stop: Stop) -> Option<()> {
        self.outbox.send(stop.at.0).ok()?;
        loop {
            match self.inbox.recv().ok()? {
                Request::RunUntil(until_ns) if until_ns > stop.at.0 => {
                    self.target_ns = until_ns;
                    return Some(());
                }
                Request::RunUntil(_) => self.outbox.send(stop.at.0).ok()?,
                Request::Do(job) => {
                    job(&mut Halted { session, host, stop, coupling: &mut self.coupling, log: &mut self.log })
                }
            }
        }
    }

    fn next_stop(&self) -> VirtualNanos {
        VirtualNanos(self.target_ns.min(self.next_log_ns))
    }
}

impl Driver<Nucleo> for LockStep {
    fn on_settled(&mut self, session: &mut Session<Nucleo>, host: &mut dyn Host, settled: Settled) {
        match settled {
            Settled::Access { access, value } => self.coupling.on_access(session.board_mut(), &access, value),
            Settled::Stop(stop) if self.resuming => {
                self.resuming = false;
                match self.serve(session, host, stop) {
                    Some(()) => session.run_until(self.next_stop()),
                    None => session.run_until(stop.at),
                }
            }
            Settled::Stop(stop) => self.coupling.on_stop(session.board_mut(), stop),
            _ => {}
        }
    }

    fn on_stop(&mut self, session: &mut Session<Nucleo>, stop: Stop, host: &mut dyn Host) -> Option<VirtualNanos> {
        let now_ns = stop.at.0;
        if now_ns >= self.next_log_ns {
            self.next_log_ns = next_log_ns(now_ns);
            // Memory that cannot be read holds no log: the address comes from the ELF that was placed there.
            let _ = self.log.drain(host, now_ns);
        }
        if now_ns >= self.target_ns {
            self.serve(session, host, stop)?;
        }
        self.coupling.watch(session.board_mut(), stop.at);
        Some(self.next_stop())
    }
}

impl Halted<'_> {
    /// Virtual time since power-on.
    pub(crate) fn now_ns(&self) -> u64 {
        self.stop.at.0
    }

    pub(crate) fn board(&mut self) -> &mut Nucleo {
        self.session.board_mut()
    }

    /// Writes everything down.
    pub(crate) fn snapshot(&mut self, elf: &Elf) -> Result<State, Error> {
        let digest = image::digest(elf.images(), None);
        let taken = snapshot::take(self.session, self.host, self.stop, &digest, &Nothing)?;
        Ok(State { machine: read_back(&taken.file)?, coupling: self.coupling.clone(), log: self.log.clone() })
    }
}

/// The emulator reads snapshots from files only.
fn read_back(bytes: &[u8]) -> Result<snapshot::Snapshot, Error> {
    let file = tempfile::NamedTempFile::new().map_err(|error| Error::Snapshot { reason: error.to_string() })?;
    std::fs::write(file.path(), bytes).map_err(|error| Error::Snapshot { reason: error.to_string() })?;
    let path: &Path = file.path();
    Ok(snapshot::Snapshot::read(path)?)
}
