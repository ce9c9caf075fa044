//! What happens when the firmware cannot go on: bridge off, message kept over a reset, reset.

use core::arch::global_asm;
use core::cell::UnsafeCell;
use core::fmt::{self, Write};
use core::mem::MaybeUninit;
use core::panic::PanicInfo;
use core::sync::atomic::{Ordering, compiler_fence};

use cortex_m::peripheral::SCB;

use crate::pwm;

/// Bytes kept of a message.
const CAPACITY: usize = 240;
/// Marks a message that was written completely.
const MAGIC: u32 = 0x4c57_4f31;

/// In RAM that start-up code leaves alone.
struct Block {
    magic: u32,
    length: u32,
    text: [u8; CAPACITY],
}

struct BlockCell(UnsafeCell<MaybeUninit<Block>>);

// SAFETY: used by `take` before interrupts and tasks exist, and by the handlers below after which nothing else runs.
unsafe impl Sync for BlockCell {}

#[unsafe(link_section = ".uninit.last_words")]
static BLOCK: BlockCell = BlockCell(UnsafeCell::new(MaybeUninit::uninit()));

/// The message of the panic or fault that ended the previous run, once.
pub(crate) fn take() -> Option<&'static str> {
    // SAFETY: first thing in `init`, nothing else refers to the block. After a power cycle it holds anything, which is a
    // valid `Block`; volatile, so that the compiler makes no assumption about memory that nobody wrote.
    let block = unsafe { (*BLOCK.0.get()).as_mut_ptr() };
    // SAFETY: as above.
    let (magic, length) =
        unsafe { ((&raw const (*block).magic).read_volatile(), (&raw const (*block).length).read_volatile()) };
    // SAFETY: as above.
    unsafe { (&raw mut (*block).magic).write_volatile(0) };
    if magic != MAGIC {
        return None;
    }
    // SAFETY: as above, and `magic` says that the text has been written.
    let text: &'static [u8; CAPACITY] = unsafe { &(*block).text };
    let text = text.get(..length as usize)?;
    match str::from_utf8(text) {
        Ok(text) => Some(text),
        Err(error) => str::from_utf8(&text[..error.valid_up_to()]).ok(),
    }
}

/// Truncating writer into the block.
struct Writer<'a> {
    text: &'a mut [u8; CAPACITY],
    length: usize,
}

impl Write for Writer<'_> {
    fn write_str(&mut self, s: &str) -> fmt::Result {
        let room = &mut self.text[self.length..];
        let n = room.len().min(s.len());
        room[..n].copy_from_slice(&s.as_bytes()[..n]);
        self.length += n;
        Ok(())
    }
}

/// Bridge off, `message` into the block, reset.
fn die(message: fmt::Arguments) -> ! {
    pwm::bridge_off();
    cortex_m::interrupt::disable();
    // SAFETY: interrupts are masked and this function does not return: nothing else refers to the block.
    let block = unsafe { (*BLOCK.0.get()).write(Block { magic: 0, length: 0, text: [0; CAPACITY] }) };
    let mut writer = Writer { text: &mut block.text, length: 0 };
    let _ = writer.write_fmt(message);
    block.length = writer.length as u32;
    compiler_fence(Ordering::SeqCst);
    block.magic = MAGIC;
    SCB::sys_reset()
}

#[panic_handler]
fn panic(info: &PanicInfo) -> ! {
    die(format_args!("{info}"))
}

// The handler must not trust the stack: its overflow is one of the causes. The old stack pointer goes into r0 and a fresh
// stack begins at the top, over what is lost anyway.
global_asm!(
    ".section .text.HardFault, \"ax\"",
    ".global HardFault",
    ".type HardFault, %function",
    ".thumb_func",
    "HardFault:",
    "mrs r0, msp",
    "ldr r1, =_stack_start",
    "msr msp, r1",
    "ldr r1, ={handler}",
    "bx r1",
    handler = sym hard_fault,
);

extern "C" fn hard_fault(stack_pointer: u32) -> ! {
    pwm::bridge_off();
    // SAFETY: reads of fault status registers, without side effects.
    let (cfsr, mmfar, bfar) = unsafe {
        let scb = &*SCB::PTR;
        (scb.cfsr.read(), scb.mmfar.read(), scb.bfar.read())
    };
    die(format_args!("hard fault: sp {stack_pointer:#010x} cfsr {cfsr:#010x} mmfar {mmfar:#010x} bfar {bfar:#010x}"))
}
