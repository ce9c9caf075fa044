//! Proof on the finished ELF that hot code and data are where `memory.x` means them to be.
//!
//! The linker script finds hot functions by patterns in section names, and a renamed module or a new compiler could make
//! a pattern miss without a word. A host test includes this file (`#[path = "../../firmware/image_check.rs"]`) and calls
//! [`check`] on the image. Needs the crate `object` with its `read` and `elf` features.

use object::{Object, ObjectSection, ObjectSymbol, SymbolKind};
use std::ops::Range;

const ITCM: Range<u64> = 0x0000_0000..0x0001_0000;
const DTCM: Range<u64> = 0x2000_0000..0x2002_0000;
const AXI_SRAM: Range<u64> = 0x2400_0000..0x2408_0000;
/// Bank 1 without its last sector, which holds the image of ITCM.
const PROGRAM: Range<u64> = 0x0800_0000..0x080E_0000;
/// The stack, at the bottom of DTCM.
const STACK: Range<u64> = 0x2000_0000..0x2000_4000;

/// Interrupts of the control loop.
const INTERRUPTS: [&str; 3] = ["TIM1_UP", "ADC", "SPI1"];
/// What they call through `dyn Control`, by parts of the mangled names; all else may have been inlined into these.
const HOT: [&str; 2] = ["Control8on_servo", "Control9on_period"];

/// Modules of the control core that only tasks call, log formatting, and what turns types into bytes.
const COLD: [&str; 8] = ["config", "parameters", "refusal", "fault", "5image", "5store", "Format", "serde"];
/// Where hot code may jump to outside of ITCM: nowhere while all is well.
const MAY_LEAVE: [&str; 2] = ["panic", "defmt"];

/// Where things are.
#[derive(Debug)]
pub struct Report {
    /// Code and constants copied to ITCM, bytes.
    pub itcm_bytes: u64,
    /// Program in flash, bytes.
    pub flash_bytes: u64,
    /// Data in DTCM apart from the stack, bytes.
    pub dtcm_bytes: u64,
    /// Functions in ITCM, by address.
    pub hot_functions: Vec<String>,
}

/// Checks the image.
///
/// # Errors
/// One line for everything that is not where it should be.
pub fn check(elf: &[u8]) -> Result<Report, Vec<String>> {
    let file = object::File::parse(elf).map_err(|error| vec![format!("not an ELF file: {error}")])?;
    let mut wrong = Vec::new();
    let mut hot_functions = Vec::new();
    for symbol in file.symbols() {
        let Ok(name) = symbol.name() else { continue };
        let address = symbol.address() & !1;
        match symbol.kind() {
            SymbolKind::Text if symbol.size() > 0 => {
                let thunk = name.contains("Thunk");
                let any_of = |parts: &[&str]| parts.iter().any(|part| name.contains(part));
                let hot = INTERRUPTS.contains(&name)
                    || any_of(&HOT)
                    || (name.contains("servo_core") && !thunk && !any_of(&COLD));
                if ITCM.contains(&address) {
                    hot_functions.push((address, name.to_string()));
                } else if hot {
                    wrong.push(format!("{name} is at {address:#010x}, not in ITCM"));
                }
                // The linker makes a long-branch thunk for every jump out of ITCM.
                if ITCM.contains(&address) && thunk && !any_of(&MAY_LEAVE) {
                    wrong.push(format!("{name} leaves ITCM"));
                }
            }
            SymbolKind::Data if symbol.size() > 0 => {
                let data = DTCM.contains(&address) && !STACK.contains(&address);
                if !data && !AXI_SRAM.contains(&address) && !PROGRAM.contains(&address) && !ITCM.contains(&address) {
                    wrong.push(format!("{name} is at {address:#010x}, in no memory of the drive"));
                }
            }
            _ => {}
        }
    }
    hot_functions.sort();
    let hot_functions: Vec<String> = hot_functions.into_iter().map(|(_, name)| name).collect();
    for name in INTERRUPTS.iter().chain(&HOT) {
        if !hot_functions.iter().any(|hot| hot.contains(name)) {
            wrong.push(format!("no function {name} in ITCM"));
        }
    }
    let bytes = |range: &Range<u64>| -> u64 {
        file.sections().filter(|s| range.contains(&s.address()) && s.address() + s.size() > 0).map(|s| s.size()).sum()
    };
    let report = Report {
        itcm_bytes: file.section_by_name(".itcm").map_or(0, |s| s.size()),
        flash_bytes: bytes(&PROGRAM),
        dtcm_bytes: bytes(&DTCM),
        hot_functions,
    };
    if wrong.is_empty() { Ok(report) } else { Err(wrong) }
}
