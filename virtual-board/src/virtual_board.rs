//! The handle: a board that runs for as long as it is asked to, and stands still in between.

use std::num::NonZeroU64;
use std::sync::Arc;
use std::time::Duration;

use rigless::emulator::Memory;
use rigless::soc::Width;
use servo_sim::{Plant, Stage};

use crate::Error;
use crate::board::{Analog, Nucleo};
use crate::coupling::{Counts, Coupling, TruthSample};
use crate::elf::Elf;
use crate::encoder::{EncoderFault, Lasting};
use crate::log::LogLine;
use crate::runner::{Halted, Runner, State};
use crate::sensor_fault::{AdcFault, CounterFault};
use crate::told::{self, Told};

/// Instructions per second of the emulated core at which tests and the demo run. The emulator has one uniform rate; a Cortex-M7
/// at 400 MHz with code in ITCM does better than this on average.
pub const NOMINAL_INSTRUCTIONS_PER_SECOND: NonZeroU64 = NonZeroU64::new(250_000_000).expect("not zero");

/// How to build a board.
#[derive(Clone, Debug)]
pub struct Config {
    /// The stage, motor, amplifier and encoder.
    pub stage: Stage,
    /// Seed of every random number in the plant.
    pub seed: u64,
    /// How fast the emulated core is.
    pub instructions_per_second: NonZeroU64,
    /// What the two parameter sectors hold at power-on, from their first bytes; erased behind that.
    pub parameters: ParameterSectors,
}

/// The two parameter sectors, A and B, as [`VirtualBoard::read_parameters`] gives them.
pub type ParameterSectors = [Vec<u8>; 2];

/// Addresses of the parameter sectors, as `memory.x` has them.
pub const PARAMETER_ADDRESSES: [u64; 2] = [0x081C_0000, 0x081E_0000];
/// As much of a parameter sector as is ever written: an image and its seals.
const PARAMETER_BYTES: usize = 8 * 1024;

impl Default for Config {
    /// The built-in stage, seed 1, [`NOMINAL_INSTRUCTIONS_PER_SECOND`].
    fn default() -> Self {
        Self {
            stage: Stage::default(),
            seed: 1,
            instructions_per_second: NOMINAL_INSTRUCTIONS_PER_SECOND,
            parameters: [Vec::new(), Vec::new()],
        }
    }
}

/// A board's whole state at an instant: processor, memory, peripherals, plant and log. Cloning is cheap.
///
/// The emulator keeps the bytes of every snapshot until the process ends (about 3 MB each).
#[derive(Clone)]
pub struct Snapshot {
    elf: Elf,
    instructions_per_second: NonZeroU64,
    state: Arc<State>,
    time_ns: u64,
}

impl std::fmt::Debug for Snapshot {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        formatter
            .debug_struct("Snapshot")
            .field("elf", &self.elf)
            .field("time_ns", &self.time_ns)
            .finish_non_exhaustive()
    }
}

/// A running board. Virtual time advances only inside [`VirtualBoard::run_for`] and [`VirtualBoard::run_until_ns`]; the same
/// calls give the same run to the bit, however the time is cut into pieces.
pub struct VirtualBoard {
    elf: Elf,
    instructions_per_second: NonZeroU64,
    runner: Runner,
    /// The instant asked for; the emulator may stand an instruction later.
    time_ns: u64,
}

impl std::fmt::Debug for VirtualBoard {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        formatter
            .debug_struct("VirtualBoard")
            .field("elf", &self.elf)
            .field("time_ns", &self.time_ns)
            .finish_non_exhaustive()
    }
}

impl VirtualBoard {
    /// A board at power-on, with `elf` in its flash and not an instruction run.
    ///
    /// # Errors
    /// Where the emulator refuses the image, for example one built for another processor.
    pub fn boot(elf: &Elf, config: &Config) -> Result<Self, Error> {
        let board = Nucleo::new(config.instructions_per_second)?;
        let coupling = Coupling::new(Plant::new(&config.stage, config.seed));
        let runner = Runner::start(elf, board, coupling)?;
        let instructions_per_second = config.instructions_per_second;
        let mut board = Self { elf: elf.clone(), instructions_per_second, runner, time_ns: 0 };
        for (address, bytes) in PARAMETER_ADDRESSES.into_iter().zip(&config.parameters) {
            board.program(address, bytes)?;
        }
        Ok(board)
    }

    /// Writes down the whole state. The board can go on afterwards.
    ///
    /// # Errors
    /// [`Error::Snapshot`] where no temporary file can be written; [`Error::Emulator`] in the instant of a reset.
    pub fn snapshot(&mut self) -> Result<Snapshot, Error> {
        let elf = self.elf.clone();
        let state = self.runner.call(move |halted| halted.snapshot(&elf))??;
        Ok(Snapshot {
            elf: self.elf.clone(),
            instructions_per_second: self.instructions_per_second,
            state: Arc::new(state),
            time_ns: self.time_ns,
        })
    }

    /// A new board that stands where `snapshot` was taken and goes on exactly as that one did.
    ///
    /// # Errors
    /// Where the emulator cannot load the state, which would be its own mistake.
    pub fn from_snapshot(snapshot: &Snapshot) -> Result<Self, Error> {
        let board = Nucleo::new(snapshot.instructions_per_second)?;
        let runner = Runner::resume(&snapshot.elf, board, &snapshot.state)?;
        Ok(Self {
            elf: snapshot.elf.clone(),
            instructions_per_second: snapshot.instructions_per_second,
            runner,
            time_ns: snapshot.time_ns,
        })
    }

    /// Lets virtual time pass; below a nanosecond nothing happens.
    ///
    /// # Errors
    /// [`Error::Ended`] where the emulator gave up, with its reason.
    pub fn run_for(&mut self, duration: Duration) -> Result<(), Error> {
        let ns = u64::try_from(duration.as_nanos()).unwrap_or(u64::MAX);
        self.run_until_ns(self.time_ns.saturating_add(ns))
    }

    /// Runs until `time_ns` since power-on; an instant in the past does nothing.
    ///
    /// # Errors
    /// [`Error::Ended`] where the emulator gave up, with its reason.
    pub fn run_until_ns(&mut self, time_ns: u64) -> Result<(), Error> {
        if time_ns > self.time_ns {
            self.runner.run_until(time_ns)?;
            self.time_ns = time_ns;
        }
        Ok(())
    }

    /// Virtual time since power-on.
    #[must_use]
    pub fn time_ns(&self) -> u64 {
        self.time_ns
    }

    /// The firmware.
    #[must_use]
    pub fn elf(&self) -> &Elf {
        &self.elf
    }

    /// Puts `bytes` on USART3's receive line, one after the other at the firmware's baud rate, from now on.
    ///
    /// # Errors
    /// [`Error::Ended`].
    pub fn send(&mut self, bytes: &[u8]) -> Result<(), Error> {
        let bytes = bytes.to_vec();
        self.runner.call(move |halted| halted.board().serial().send(&bytes))
    }

    /// Takes what the firmware has sent on USART3 since the last call.
    ///
    /// # Errors
    /// [`Error::Ended`].
    pub fn received(&mut self) -> Result<Vec<u8>, Error> {
        self.runner.call(|halted| halted.board().serial().take_received())
    }

    /// Takes the log lines since the last call, up to the last whole millisecond.
    ///
    /// # Errors
    /// [`Error::Ended`].
    pub fn log(&mut self) -> Result<Vec<LogLine>, Error> {
        self.runner.call(|halted| halted.log.take_lines())
    }

    /// Everything the emulator remarked about the run so far.
    ///
    /// # Errors
    /// [`Error::Ended`].
    pub fn told(&mut self) -> Result<Vec<Told>, Error> {
        self.runner.call(|halted| told::collect(halted.session))
    }

    /// Succeeds where every remark of the emulator is explained.
    ///
    /// # Errors
    /// [`Error::Unexplained`] with the lines that are not.
    pub fn check_told(&mut self) -> Result<(), Error> {
        let lines: Vec<String> =
            self.told()?.iter().filter(|told| told.explanation.is_none()).map(Told::to_string).collect();
        if lines.is_empty() { Ok(()) } else { Err(Error::Unexplained { lines }) }
    }

    /// A copy of the truth as it is now. Looking does not change the run.
    ///
    /// # Errors
    /// [`Error::Ended`].
    pub fn plant(&mut self) -> Result<Plant, Error> {
        self.runner.call(|halted| halted.coupling.plant_at(halted.now_ns()))
    }

    /// Changes the truth, advanced to now. A whole other plant may be put in its place.
    ///
    /// # Errors
    /// [`Error::Ended`].
    pub fn with_plant<R: Send + 'static>(
        &mut self,
        change: impl FnOnce(&mut Plant) -> R + Send + 'static,
    ) -> Result<R, Error> {
        self.runner.call(move |halted| {
            let now_ns = halted.now_ns();
            change(halted.coupling.plant_mut(now_ns))
        })
    }

    /// Draws the friction of move `move_index`.
    ///
    /// # Errors
    /// [`Error::Ended`].
    pub fn redraw_friction(&mut self, move_index: u64) -> Result<(), Error> {
        self.with_plant(move |plant| plant.redraw_friction(move_index))
    }

    /// Whether the bridge is driven.
    ///
    /// # Errors
    /// [`Error::Ended`].
    pub fn bridge_enabled(&mut self) -> Result<bool, Error> {
        self.runner.call(|halted| halted.coupling.bridge().enabled)
    }

    /// Breaks the encoder or its line from the next frame on.
    ///
    /// # Errors
    /// [`Error::Ended`].
    pub fn inject_encoder_fault(&mut self, fault: EncoderFault, lasting: Lasting) -> Result<(), Error> {
        self.runner.call(move |halted| halted.board().encoder().inject(fault, lasting))
    }

    /// Mends the encoder.
    ///
    /// # Errors
    /// [`Error::Ended`].
    pub fn heal_encoder(&mut self) -> Result<(), Error> {
        self.runner.call(|halted| halted.board().encoder().heal())
    }

    /// Encoder frames clocked so far, and how many of them a fault was applied to.
    ///
    /// # Errors
    /// [`Error::Ended`].
    pub fn encoder_frames(&mut self) -> Result<(u64, u64), Error> {
        self.runner.call(|halted| {
            let encoder = halted.board().encoder();
            (encoder.frames(), encoder.faulty_frames())
        })
    }

    /// Breaks or, with `None`, mends an analogue signal from its next conversion on. A bus-voltage reading is overridden with
    /// [`AdcFault::Stuck`].
    ///
    /// # Errors
    /// [`Error::Ended`].
    pub fn set_adc_fault(&mut self, signal: Analog, fault: Option<AdcFault>) -> Result<(), Error> {
        self.runner.call(move |halted| halted.coupling.set_adc_fault(signal, fault))
    }

    /// Breaks or, with `None`, mends the comparators that count the quarter periods of sine and cosine.
    ///
    /// # Errors
    /// [`Error::Ended`].
    pub fn set_counter_fault(&mut self, fault: Option<CounterFault>) -> Result<(), Error> {
        self.runner.call(move |halted| halted.coupling.set_counter_fault(fault))
    }

    /// Sets or clears the fault output of the power stage, which trips TIM1's break input.
    ///
    /// # Errors
    /// [`Error::Ended`].
    pub fn set_bridge_fault(&mut self, fault: bool) -> Result<(), Error> {
        self.runner.call(move |halted| {
            let at = halted.stop.at;
            halted.board().set_bridge_fault(fault, at);
            halted.coupling.switch_bridge(halted.session.board_mut(), at.0);
        })
    }

    /// Garbles USART3 towards the firmware: words in a million with noise and with a framing error.
    ///
    /// # Errors
    /// [`Error::Ended`].
    pub fn set_serial_errors(
        &mut self,
        noise_per_million: u32,
        framing_per_million: u32,
        seed: u64,
    ) -> Result<(), Error> {
        self.runner.call(move |halted| halted.board().set_serial_errors(noise_per_million, framing_per_million, seed))
    }

    /// Pulls the reset pin for an instant. RAM, flash and the plant stay as they are.
    ///
    /// # Errors
    /// [`Error::Ended`].
    pub fn reset(&mut self) -> Result<(), Error> {
        self.runner.call(|halted| {
            let Halted { session, host, stop, coupling, .. } = halted;
            session.reset_by_pin(stop.at, stop.instruction_count, *host);
            coupling.after_reset(session.board_mut(), stop.at);
        })
    }

    /// Resets since power-on, whoever asked for them.
    ///
    /// # Errors
    /// [`Error::Ended`].
    pub fn resets(&mut self) -> Result<usize, Error> {
        self.runner.call(|halted| halted.session.resets().len())
    }

    /// Starts recording the truth at every servo tick.
    ///
    /// # Errors
    /// [`Error::Ended`].
    pub fn start_trace(&mut self) -> Result<(), Error> {
        self.runner.call(|halted| halted.coupling.start_trace())
    }

    /// Ends the recording and returns it.
    ///
    /// # Errors
    /// [`Error::Ended`].
    pub fn take_trace(&mut self) -> Result<Vec<TruthSample>, Error> {
        self.runner.call(|halted| halted.coupling.take_trace())
    }

    /// Event counts and interrupt timing since power-on, as seen from outside the firmware.
    ///
    /// # Errors
    /// [`Error::Ended`].
    pub fn counts(&mut self) -> Result<Counts, Error> {
        self.runner.call(|halted| *halted.coupling.counts())
    }

    /// Reads `length` bytes of memory at `address`.
    ///
    /// # Errors
    /// [`Error::Emulator`] where there is no memory.
    pub fn read_memory(&mut self, address: u64, length: usize) -> Result<Vec<u8>, Error> {
        let bytes = self.runner.call(move |halted| {
            (0..length as u64)
                .map(|offset| Memory::read(halted.host, address + offset, Width::W8).map(|byte| byte as u8))
                .collect::<Result<Vec<u8>, _>>()
        })??;
        Ok(bytes)
    }

    /// Writes a 32-bit word of RAM, as a stray pointer would.
    ///
    /// # Errors
    /// [`Error::Emulator`] where there is no memory to write.
    pub fn write_memory(&mut self, address: u64, word: u32) -> Result<(), Error> {
        self.runner.call(move |halted| Memory::write(halted.host, address, Width::W32, u64::from(word)))??;
        Ok(())
    }

    /// Puts the instruction `code` (16 bits) at `address` in flash in place of what is there, and returns that.
    ///
    /// # Errors
    /// [`Error::Emulator`] where there is no flash.
    pub fn patch(&mut self, address: u64, code: u16) -> Result<u16, Error> {
        let before = self.runner.call(move |halted| {
            let before = Memory::read(halted.host, address, Width::W16)?;
            Memory::program(halted.host, address, Width::W16, u64::from(code))?;
            Ok::<_, rigless::emulator::Error>(before as u16)
        })??;
        Ok(before)
    }

    /// Puts `bytes` into flash at `address`, as a programmer would.
    fn program(&mut self, address: u64, bytes: &[u8]) -> Result<(), Error> {
        let bytes = bytes.to_vec();
        self.runner.call(move |halted| {
            let places = (address..).zip(bytes);
            places.into_iter().try_for_each(|(at, byte)| Memory::program(halted.host, at, Width::W8, u64::from(byte)))
        })??;
        Ok(())
    }

    /// What the two parameter sectors hold, as much of them as is ever written.
    ///
    /// # Errors
    /// [`Error::Ended`].
    pub fn read_parameters(&mut self) -> Result<ParameterSectors, Error> {
        let [a, b] = PARAMETER_ADDRESSES;
        Ok([self.read_memory(a, PARAMETER_BYTES)?, self.read_memory(b, PARAMETER_BYTES)?])
    }

    /// Reads the 32-bit word at the symbol `name`.
    ///
    /// # Errors
    /// [`Error::Symbol`] where there is no such symbol.
    pub fn read_symbol_u32(&mut self, name: &str) -> Result<u32, Error> {
        let address = self.elf.address(name)?;
        let bytes = self.read_memory(address, 4)?;
        Ok(bytes.iter().rev().fold(0, |word, byte| word << 8 | u32::from(*byte)))
    }
}
