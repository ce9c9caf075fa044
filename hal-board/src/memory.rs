//! Memories that need more than the linker: hot code in ITCM, parameter sectors in flash.

use core::arch::global_asm;

/// Erase unit of the flash, bytes.
pub(crate) const PARAMETER_SECTOR_BYTES: u32 = 128 * 1024;
/// Offsets from the start of flash of the two sectors that hold the parameter images: the end of bank 2, so that writing
/// them does not stall code, which runs from bank 1.
pub(crate) const PARAMETER_SECTORS: [u32; 2] = [0x1C_0000, 0x1E_0000];

/// What may be done with a region of memory.
#[derive(Clone, Copy)]
enum Access {
    ReadAndExecute,
    ReadAndWrite,
    /// Every access happens as it is written and nothing is read ahead: a torn word answers with a bus error.
    Device,
    None,
}

/// Regions of the memory protection unit: start, log₂ of the size in bytes, access. A later one has priority. Elsewhere
/// the default map stays.
const REGIONS: [(u32, u32, Access); 6] = [
    (0x0000_0000, 16, Access::ReadAndExecute), // ITCM: hot code
    (0x0800_0000, 20, Access::ReadAndExecute), // flash bank 1: program
    (0x0810_0000, 20, Access::Device),         // flash bank 2: parameters
    (0x2000_0000, 17, Access::ReadAndWrite),   // DTCM: stack and data
    (0x2400_0000, 19, Access::ReadAndWrite),   // AXI SRAM: captures
    (0x2000_0000, 9, Access::None),            // guard below the stack: an overflow is a fault at once
];

/// Makes code read-only, data not executable, and the bytes below the stack untouchable.
pub(crate) fn protect() {
    const REGION_VALID: u32 = 1 << 4;
    const NO_EXECUTE: u32 = 1 << 28;
    const READ_WRITE: u32 = 0b011 << 24;
    const READ_ONLY: u32 = 0b110 << 24;
    /// Normal memory, write-back, allocating: TEX 1, C, B.
    const NORMAL: u32 = 0b001 << 19 | 1 << 17 | 1 << 16;
    /// Shareable device memory: TEX 0, B.
    const DEVICE: u32 = 1 << 16;
    const ENABLE: u32 = 1;
    const DEFAULT_MAP_ELSEWHERE: u32 = 1 << 2;
    for (number, (start, size_log2, access)) in (0..).zip(REGIONS) {
        let attributes = match access {
            Access::ReadAndExecute => READ_ONLY | NORMAL,
            Access::ReadAndWrite => READ_WRITE | NO_EXECUTE | NORMAL,
            Access::Device => READ_WRITE | NO_EXECUTE | DEVICE,
            Access::None => NO_EXECUTE | NORMAL,
        };
        // SAFETY: called once from `init`; nothing else uses the unit, and the program needs no other access than it is given.
        unsafe {
            let mpu = &*cortex_m::peripheral::MPU::PTR;
            mpu.rbar.write(start | REGION_VALID | number);
            mpu.rasr.write(attributes | (size_log2 - 1) << 1 | ENABLE);
        }
    }
    // SAFETY: as above.
    unsafe { (*cortex_m::peripheral::MPU::PTR).ctrl.write(DEFAULT_MAP_ELSEWHERE | ENABLE) };
    cortex_m::asm::dsb();
    cortex_m::asm::isb();
}

/// Bytes of the stack that have never been used, from the paint that start-up code put there.
///
/// A function of its own under its own name: tests on the virtual board break it to break a task.
// SAFETY: no other symbol has this name.
#[unsafe(no_mangle)]
#[inline(never)]
pub fn stack_free_bytes() -> u32 {
    unsafe extern "C" {
        static _stack_end: u32;
        static _stack_start: u32;
    }
    let (mut word, top) = (&raw const _stack_end, &raw const _stack_start);
    let mut free_bytes = 0;
    // SAFETY: aligned reads of RAM between the linker's limits; volatile, because the stack is in use meanwhile.
    while word < top && unsafe { word.read_volatile() } == cortex_m_rt::STACK_PAINT_VALUE {
        // SAFETY: at most one past the end.
        word = unsafe { word.add(1) };
        free_bytes += 4;
    }
    free_bytes
}

/// The program as it lies in flash: from the vectors to the first values of the data, and the image of the hot code.
pub fn program() -> [&'static [u8]; 2] {
    unsafe extern "C" {
        static __sdata: u8;
        static __edata: u8;
        static __sidata: u8;
        static __sitcm: u8;
        static __eitcm: u8;
        static __siitcm: u8;
    }
    const FLASH: usize = 0x0800_0000;
    let data_bytes = (&raw const __edata).addr() - (&raw const __sdata).addr();
    let program_bytes = (&raw const __sidata).addr() + data_bytes - FLASH;
    let hot_bytes = (&raw const __eitcm).addr() - (&raw const __sitcm).addr();
    // SAFETY: flash of bank 1 between the linker's limits; nothing ever writes there.
    unsafe {
        [
            core::slice::from_raw_parts(core::ptr::with_exposed_provenance(FLASH), program_bytes),
            core::slice::from_raw_parts(&raw const __siitcm, hot_bytes),
        ]
    }
}

// Copies hot code to ITCM before `main`. In assembly because Rust code must not run before RAM is initialised, and here
// because the compiler may call functions that live in ITCM anywhere, `memcpy` first of all.
global_asm!(
    ".section .text.__pre_init, \"ax\"",
    ".global __pre_init",
    ".type __pre_init, %function",
    ".thumb_func",
    "__pre_init:",
    "ldr r0, =__sitcm",
    "ldr r1, =__eitcm",
    "ldr r2, =__siitcm",
    "0: cmp r0, r1",
    "bhs 1f",
    "ldm r2!, {{r3}}",
    "stm r0!, {{r3}}",
    "b 0b",
    "1: dsb",
    "isb",
    "bx lr",
);
