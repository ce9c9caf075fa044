//! Parameters in flash: read at start, written by a task while the control loop goes on without torque.

use core::cell::Cell;

use defmt::{error, info, warn};
use embassy_time::{Duration, Ticker, Timer};
use servo_board::{FlashFault, ParameterFlash, watchdog};
use servo_core::image::{Invalid, SCHEMA};
use servo_core::monitor::signals;
use servo_core::parameters::Settings;
use servo_core::store::{Current, Opened, Slot, Step, Store};
use servo_protocol::message::{ParameterStore, SaveProgress};
use static_cell::StaticCell;

/// How often the task looks for an order.
const LOOK: Duration = Duration::from_millis(10);
/// How often it looks whether the flash is done: an erasure takes seconds, a word some 100 µs.
const ERASING: Duration = Duration::from_millis(5);
const PROGRAMMING: Duration = Duration::from_micros(100);

/// What the tasks know of the flash. They all run in one executor, so plain cells do.
pub struct Storage {
    stored: Cell<Option<Settings>>,
    image: Cell<Option<Current>>,
    invalid: Option<[Invalid; 2]>,
    order: Cell<Option<Settings>>,
    progress: Cell<SaveProgress>,
    news: Cell<bool>,
}

impl Storage {
    /// What to start with: the stored parameters, or the defaults.
    pub fn settings(&self) -> Settings {
        self.stored.get().unwrap_or_default()
    }

    /// The stored parameters, if there are valid ones.
    pub fn stored(&self) -> Option<Settings> {
        self.stored.get()
    }

    /// A save has been ordered and has not ended.
    pub fn is_saving(&self) -> bool {
        matches!(self.progress.get(), SaveProgress::Running { .. })
    }

    /// Orders a save.
    pub fn save(&self, settings: Settings) {
        self.progress.set(SaveProgress::Running { done: 0 });
        self.order.set(Some(settings));
    }

    /// A save has ended and the drive does not know yet.
    pub fn has_news(&self) -> bool {
        self.news.get()
    }

    /// The drive knows.
    pub fn told(&self) {
        self.news.set(false);
    }

    /// For the host; `used` are the parameters in use.
    pub fn status(&self, used: &Settings) -> ParameterStore {
        ParameterStore {
            image: self.image.get(),
            invalid: self.invalid,
            unsaved: self.stored.get() != Some(*used),
            save: self.progress.get(),
        }
    }
}

/// Reads the flash and makes final what a power cut may have left undecided. To be called once, before the control loop starts: it waits
/// for the flash, for seconds if an unfinished image has to be erased.
pub fn open(flash: &mut ParameterFlash) -> (Store, &'static Storage) {
    let Opened { store, settings, settle } = Store::open(|slot, index| flash.read(slot, index));
    for step in settle.into_iter().flatten() {
        warn!("parameters: the last save was cut short; settling sector {}", step_slot(&step));
        if let Err(fault) = flash.carry_out(&step) {
            error!("parameters: flash: {}", fault);
        }
    }
    match (&settings, store.newest()) {
        (Ok(_), Some(Current { slot, sequence, schema })) => {
            info!("parameters: image {=u32} in sector {}", sequence, slot);
            if schema != SCHEMA {
                warn!("parameters: taken over from schema {=u16}; save to keep them in schema {=u16}", schema, SCHEMA);
            }
        }
        (Err([a, b]), _) => {
            warn!("parameters: none that can be used (sector A: {}, sector B: {})", a, b);
            watchdog::report(signals::PARAMETERS_INVALID);
        }
        _ => {}
    }
    static STORAGE: StaticCell<Storage> = StaticCell::new();
    let storage = STORAGE.init(Storage {
        stored: Cell::new(settings.ok()),
        image: Cell::new(store.newest()),
        invalid: settings.err(),
        order: Cell::new(None),
        progress: Cell::new(SaveProgress::None),
        news: Cell::new(false),
    });
    (store, storage)
}

/// Saves what is ordered, for ever.
#[embassy_executor::task]
pub async fn run(mut flash: ParameterFlash, mut store: Store, storage: &'static Storage) {
    let mut ticker = Ticker::every(LOOK);
    loop {
        ticker.next().await;
        let Some(settings) = storage.order.take() else { continue };
        let mut save = store.save(&settings);
        let target = save.target();
        let ended = loop {
            let Some(step) = save.next() else { break Ok(()) };
            if let Err(fault) = carry_out(&mut flash, &step).await {
                break Err(fault);
            }
            storage.progress.set(SaveProgress::Running { done: save.done() });
        };
        storage.progress.set(match ended {
            Ok(()) => {
                info!("parameters: saved as image {=u32} in sector {}", target.sequence, target.slot);
                store.saved(&save);
                storage.stored.set(Some(settings));
                watchdog::withdraw(signals::PARAMETERS_INVALID);
                storage.image.set(store.newest());
                SaveProgress::Done
            }
            Err(fault) => {
                error!("parameters: not saved, flash: {}", fault);
                // Nothing half-written is to be found by the next start; if this fails as well, nothing worse is there than before.
                let _ = carry_out(&mut flash, &Step::Erase(target.slot)).await;
                SaveProgress::Failed
            }
        });
        storage.news.set(true);
    }
}

async fn carry_out(flash: &mut ParameterFlash, step: &Step) -> Result<(), FlashFault> {
    flash.begin(step)?;
    let pause = if matches!(step, Step::Erase(_)) { ERASING } else { PROGRAMMING };
    while flash.is_busy() {
        Timer::after(pause).await;
    }
    flash.end(step)
}

fn step_slot(step: &Step) -> Slot {
    match step {
        Step::Erase(slot) | Step::Program { slot, .. } => *slot,
    }
}
