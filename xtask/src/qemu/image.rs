//! The functions of an image that are counted, and those that must not be in it.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, ensure};
use object::{Object, ObjectSection, ObjectSymbol, SymbolKind};

/// The module whose functions are counted, as it appears in mangled names.
const MODULE: &str = "7regions";

/// Double-precision arithmetic in software, by its names in the ABI and in the compiler's library. The core has a
/// double-precision FPU; conversions from and to 64-bit integers are functions all the same. Comparisons are not among
/// them: rustup's library is compiled for a core without that FPU, and printing an `f64` compares.
const SOFT_DOUBLE: [&str; 18] = [
    "__aeabi_dadd",
    "__aeabi_dsub",
    "__aeabi_drsub",
    "__aeabi_dmul",
    "__aeabi_ddiv",
    "__aeabi_i2d",
    "__aeabi_ui2d",
    "__aeabi_d2iz",
    "__aeabi_d2uiz",
    "__aeabi_f2d",
    "__aeabi_d2f",
    "adddf3",
    "subdf3",
    "muldf3",
    "divdf3",
    "floatsidf",
    "extendsfdf2",
    "truncdfsf2",
];

/// A linked image.
pub struct Image {
    /// Name of its file.
    pub name: String,
    /// Where it is.
    pub path: PathBuf,
    /// What is counted in it.
    pub regions: Vec<Region>,
}

/// A counted function.
#[derive(Debug, PartialEq)]
pub struct Region {
    /// Its name without path.
    pub name: String,
    /// Its first instruction.
    pub address: u32,
    /// Number of instructions in it.
    pub instructions: u64,
}

impl Image {
    /// Reads the ELF.
    ///
    /// # Errors
    /// When it cannot be read, has nothing to count, or contains arithmetic that the FPU should do.
    pub fn read(path: &Path) -> Result<Image> {
        let name = path.file_name().unwrap_or_default().to_string_lossy().to_string();
        let bytes = std::fs::read(path).with_context(|| format!("reading image {name}"))?;
        let elf = object::File::parse(&*bytes).with_context(|| format!("image {name}"))?;
        let text = elf.section_by_name(".text").with_context(|| format!("image {name} has no code"))?;
        let code = text.data().with_context(|| format!("image {name}"))?;
        let mut regions = Vec::new();
        for symbol in elf.symbols().filter(|symbol| symbol.kind() == SymbolKind::Text) {
            let mangled = symbol.name().unwrap_or_default();
            ensure!(
                !SOFT_DOUBLE.iter().any(|soft| mangled.contains(soft)),
                "image {name} does double-precision arithmetic in software: {mangled}"
            );
            if let Some(region) = function_of_module(mangled) {
                let address = symbol.address() & !1;
                let start = (address - text.address()) as usize;
                let body = code.get(start..start + symbol.size() as usize).context("a function outside of .text")?;
                let instructions = instructions(body);
                regions.push(Region { name: region.to_string(), address: address as u32, instructions });
            }
        }
        ensure!(!regions.is_empty(), "image {name} has no functions to count");
        regions.sort_by_key(|region| region.address);
        Ok(Image { name, path: path.to_path_buf(), regions })
    }

    /// The counted function of this name.
    pub fn region(&self, name: &str) -> Option<&Region> {
        self.regions.iter().find(|region| region.name == name)
    }
}

/// The function's name if it is one of [`MODULE`]: both manglings write it after the module's, its length in front.
fn function_of_module(mangled: &str) -> Option<&str> {
    let (_, rest) = mangled.split_once(MODULE)?;
    let digits = rest.find(|c: char| !c.is_ascii_digit())?;
    rest.get(digits..digits + rest[..digits].parse::<usize>().ok()?)
}

/// Number of Thumb instructions in `code`: those that begin with 0b11101, 0b11110 or 0b11111 are four bytes long.
fn instructions(code: &[u8]) -> u64 {
    let mut halves = code.chunks_exact(2).map(|half| u16::from_le_bytes([half[0], half[1]]));
    let mut count = 0;
    while let Some(half) = halves.next() {
        if half >> 11 >= 0b11101 {
            halves.next();
        }
        count += 1;
    }
    count
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn functions_of_the_module_are_found_in_both_manglings() {
        let cases = [
            ("_RNvNtCs3eq5o6AxfXf_10servo_qemu7regions10servo_tick", Some("servo_tick")),
            ("_ZN10servo_qemu7regions10servo_tick17h0123456789abcdefE", Some("servo_tick")),
            ("_RNvNtCs3eq5o6AxfXf_10servo_qemu7regions7sin_cos", Some("sin_cos")),
            ("_RNvMNtCs1Te2j5ogJsu_10servo_core6configNtB2_6Config3new", None),
            ("memcpy", None),
        ];
        for (mangled, expected) in cases {
            assert_eq!(function_of_module(mangled), expected, "{mangled}");
        }
    }

    #[test]
    fn thumb_instructions_of_both_lengths_are_counted() {
        // push {r7, lr}; mov r7, sp; bl …; mov.w r0, #…; pop {r7, pc}
        let code = [0xb580_u16, 0x466f, 0xf000, 0xf801, 0xf04f, 0x0001, 0xbd80];
        let bytes: Vec<u8> = code.iter().flat_map(|half| half.to_le_bytes()).collect();
        assert_eq!(instructions(&bytes), 5);
        assert_eq!(instructions(&[]), 0);
    }
}
