//! The two parameter sectors at the end of flash bank 2: begun here, waited for elsewhere.
//!
//! Code runs from bank 1 and from ITCM, so that neither an erasure (1 to 3 s) nor a word (some 100 µs) stalls it. Nothing in here waits:
//! the caller begins a step, does something else until [`ParameterFlash::is_busy`] is false, and ends it.

use core::arch::asm;
use core::ptr::{with_exposed_provenance, with_exposed_provenance_mut};

use cortex_m::peripheral::SCB;
use embassy_stm32::pac::FLASH;
use embassy_stm32::pac::flash::{Bank, regs};
use servo_core::image::{WORD_BYTES, Word};
use servo_core::store::{Slot, Step};

use crate::memory::{PARAMETER_SECTOR_BYTES, PARAMETER_SECTORS};

const FLASH_START: usize = 0x0800_0000;
const BANK_BYTES: u32 = 1 << 20;
const KEYS: [u32; 2] = [0x4567_0123, 0xCDEF_89AB];
/// Programming by 64 bits, the reset value: what the supply of this board allows.
const PARALLELISM: u8 = 3;
/// In CCR: handlers of negative priority, and code with FAULTMASK set, ignore bus errors of their loads.
const IGNORE_BUS_ERRORS: u32 = 1 << 8;
const BUS_FAULT_STATUS: u32 = 0xff << 8;

/// Why the flash did not do what it was told.
#[derive(Clone, Copy, Debug, PartialEq, Eq, defmt::Format)]
pub enum FlashFault {
    /// The sector is write-protected by option bytes.
    Protected,
    /// The controller did not take the sequence of accesses.
    Sequence,
    /// Programming or erasing failed.
    Operation,
    /// A word does not read as it was programmed.
    Verify,
}

/// Permission to change the parameter sectors; there is one.
pub struct ParameterFlash(());

impl ParameterFlash {
    pub(crate) fn new() -> Self {
        ParameterFlash(())
    }

    /// A word, or `None` if it cannot be read (two wrong bits or more) or does not exist. Thread mode only.
    ///
    /// A word that power left half-programmed answers with a bus error, which would end in the hard-fault handler: for these eight loads
    /// it is ignored and the controller's flag is asked instead. They take less than 1 µs and are the only thing in the firmware that masks
    /// the control interrupts; at start those do not run yet, and afterwards the drive has no torque when parameters are read.
    pub fn read(&self, slot: Slot, index: u32) -> Option<Word> {
        let address = address(slot, index)?;
        let bank = bank();
        bank.ccr().write(|w| w.set_clr_dbeccerr(true));
        let mut words = [0u32; WORD_BYTES / 4];
        // SAFETY: an aligned read of flash that nothing writes meanwhile, since writing takes `&mut self`. FAULTMASK was clear
        // (thread mode), and CCR and the fault's status are put back as they were.
        unsafe {
            let scb = &*SCB::PTR;
            scb.ccr.modify(|ccr| ccr | IGNORE_BUS_ERRORS);
            asm!("cpsid f", "dsb", "isb");
            for (offset, word) in words.iter_mut().enumerate() {
                *word = with_exposed_provenance::<u32>(address).add(offset).read_volatile();
            }
            asm!("dsb", "cpsie f", "isb");
            scb.ccr.modify(|ccr| ccr & !IGNORE_BUS_ERRORS);
            scb.cfsr.write(BUS_FAULT_STATUS);
        }
        if bank.sr().read().dbeccerr() {
            bank.ccr().write(|w| w.set_clr_dbeccerr(true));
            return None;
        }
        let mut bytes = [0; WORD_BYTES];
        for (to, word) in bytes.as_chunks_mut().0.iter_mut().zip(words) {
            *to = word.to_le_bytes();
        }
        Some(bytes)
    }

    /// Begins a step. A word that does not exist is [`FlashFault::Sequence`].
    ///
    /// # Errors
    /// Nothing has begun.
    pub fn begin(&mut self, step: &Step) -> Result<(), FlashFault> {
        let bank = bank();
        if self.is_busy() {
            return Err(FlashFault::Sequence);
        }
        bank.ccr().write_value(errors());
        if bank.cr().read().lock() {
            for key in KEYS {
                bank.keyr().write_value(key);
            }
        }
        match step {
            Step::Erase(slot) => {
                let sector = (PARAMETER_SECTORS[*slot as usize] - BANK_BYTES) / PARAMETER_SECTOR_BYTES;
                let mut erase = control();
                erase.set_ser(true);
                erase.set_snb(sector as u8);
                bank.cr().write_value(erase);
                erase.set_start(true);
                bank.cr().write_value(erase);
            }
            Step::Program { slot, index, word } => {
                let address = address(*slot, *index).ok_or(FlashFault::Sequence)?;
                let mut program = control();
                program.set_pg(true);
                bank.cr().write_value(program);
                cortex_m::asm::dsb();
                for (offset, bytes) in word.as_chunks().0.iter().enumerate() {
                    // SAFETY: within a parameter sector, which holds no code and no object of the program.
                    unsafe {
                        with_exposed_provenance_mut::<u32>(address)
                            .add(offset)
                            .write_volatile(u32::from_le_bytes(*bytes));
                    }
                }
                cortex_m::asm::dsb();
            }
        }
        Ok(())
    }

    /// Whether the step that was begun is still going on.
    pub fn is_busy(&self) -> bool {
        let status = bank().sr().read();
        status.bsy() || status.qw() || status.wbne()
    }

    /// Ends a step that is no longer busy: locks the flash again and says whether it did what it should. A programmed word is read back.
    ///
    /// # Errors
    /// What the controller or the read-back found.
    pub fn end(&mut self, step: &Step) -> Result<(), FlashFault> {
        let bank = bank();
        let status = bank.sr().read();
        let mut locked = control();
        bank.cr().write_value(locked);
        locked.set_lock(true);
        bank.cr().write_value(locked);
        bank.ccr().write_value(errors());
        if status.wrperr() {
            return Err(FlashFault::Protected);
        }
        if status.pgserr() || status.incerr() || status.strberr() {
            return Err(FlashFault::Sequence);
        }
        if status.operr() {
            return Err(FlashFault::Operation);
        }
        match step {
            Step::Program { slot, index, word } if self.read(*slot, *index) != Some(*word) => Err(FlashFault::Verify),
            _ => Ok(()),
        }
    }

    /// Carries out a step and waits for its end. Only before the control loop is started.
    ///
    /// # Errors
    /// As [`ParameterFlash::begin`] and [`ParameterFlash::end`].
    pub fn carry_out(&mut self, step: &Step) -> Result<(), FlashFault> {
        self.begin(step)?;
        while self.is_busy() {
            cortex_m::asm::delay(4_000);
        }
        self.end(step)
    }
}

fn bank() -> Bank {
    FLASH.bank(1)
}

fn control() -> regs::Cr {
    let mut control = regs::Cr(0);
    control.set_psize(PARALLELISM);
    control
}

fn errors() -> regs::Ccr {
    let mut flags = regs::Ccr(0);
    flags.set_clr_eop(true);
    flags.set_clr_wrperr(true);
    flags.set_clr_pgserr(true);
    flags.set_clr_strberr(true);
    flags.set_clr_incerr(true);
    flags.set_clr_operr(true);
    flags
}

/// Address of a word, if the sector has it.
fn address(slot: Slot, index: u32) -> Option<usize> {
    let offset = index.checked_mul(WORD_BYTES as u32).filter(|offset| *offset < PARAMETER_SECTOR_BYTES)?;
    Some(FLASH_START + (PARAMETER_SECTORS[slot as usize] + offset) as usize)
}
