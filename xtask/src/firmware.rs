//! Building the firmware's ELF and saying what is in it.

use std::fmt;
use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, Result, anyhow, bail};
use object::read::elf::{ElfFile32, ProgramHeader};
use sha2::{Digest, Sha256};

use crate::process;
use crate::{embedded, setup};

#[path = "../../firmware/image_check.rs"]
mod image_check;

/// The chip as probe-rs names it.
const CHIP: &str = "STM32H743ZITx";

/// Where memory lies on the STM32H743ZI: name, first address, bytes.
const REGIONS: [(&str, u32, u32); 5] = [
    ("FLASH", 0x0800_0000, 2 * 1024 * 1024),
    ("ITCM", 0x0000_0000, 64 * 1024),
    ("DTCM", 0x2000_0000, 128 * 1024),
    ("AXI", 0x2400_0000, 512 * 1024),
    ("SRAM", 0x3000_0000, 288 * 1024),
];

/// A built firmware.
pub struct Firmware {
    /// The ELF, relative to the workspace unless the target directory is elsewhere.
    pub elf: PathBuf,
    /// Bytes used per memory region.
    pub usage: Vec<Usage>,
    /// Of the ELF, in hexadecimal.
    pub sha256: String,
}

/// What a program takes of one memory region.
#[derive(Debug, PartialEq)]
pub struct Usage {
    /// Name of the region.
    pub region: &'static str,
    /// Bytes taken, load images of RAM sections included where they are stored.
    pub used_bytes: u32,
    /// Bytes there are.
    pub size_bytes: u32,
}

/// Builds the firmware, optimised, after making sure that it can be built.
///
/// # Errors
/// When set-up or compiler fail, or what they leave is no ELF for the STM32H743.
pub fn build() -> Result<Firmware> {
    let toolchain = setup::firmware_toolchain()?;
    inspect(&embedded::build(&toolchain, "servo-firmware", "servo-firmware")?)
}

/// Builds the firmware and runs it on the board that a debug probe finds, showing its log.
///
/// # Errors
/// When the build fails, `probe-rs` is missing (with the line to type), or no board answers.
pub fn flash() -> Result<()> {
    let firmware = build()?;
    if !process::succeeds(Command::new("probe-rs").arg("--version")) {
        bail!("probe-rs is missing. Please type:\ncargo install probe-rs-tools --locked");
    }
    let mut probe = Command::new("probe-rs");
    process::run(probe.args(["run", "--chip", CHIP]).arg(&firmware.elf), "probe-rs run")
}

impl Firmware {
    /// Checks that hot code, stack and data are in the memories meant for them, and says what is in ITCM.
    ///
    /// # Errors
    /// When the ELF cannot be read or anything is elsewhere, one line each.
    pub fn check_layout(&self) -> Result<()> {
        let elf = std::fs::read(&self.elf).with_context(|| format!("reading {}", self.elf.display()))?;
        let report = image_check::check(&elf).map_err(|wrong| anyhow!("wrong layout:\n  {}", wrong.join("\n  ")))?;
        eprintln!(
            "ITCM {} bytes, flash {} bytes, DTCM {} bytes; {} functions in ITCM, all where they should be",
            report.itcm_bytes,
            report.flash_bytes,
            report.dtcm_bytes,
            report.hot_functions.len()
        );
        Ok(())
    }
}

/// Reads a firmware's ELF.
///
/// # Errors
/// When it cannot be read, is no 32-bit little-endian ELF, or loads outside the chip's memory.
pub fn inspect(elf: &Path) -> Result<Firmware> {
    let shown = from_here(elf);
    let bytes = std::fs::read(elf).with_context(|| format!("reading {}", shown.display()))?;
    let segments = segments(&bytes).with_context(|| format!("{} is no firmware", shown.display()))?;
    let sha256 = Sha256::digest(&bytes).iter().map(|byte| format!("{byte:02x}")).collect();
    Ok(Firmware { elf: shown, usage: usage(&segments)?, sha256 })
}

/// The path relative to the current directory if it lies below it.
fn from_here(path: &Path) -> PathBuf {
    let here = std::env::current_dir().unwrap_or_default();
    path.strip_prefix(here).unwrap_or(path).to_path_buf()
}

/// One loadable piece of a program.
struct Segment {
    /// Where it is when the program runs.
    run_address: u32,
    run_bytes: u32,
    /// Where it is stored.
    load_address: u32,
    load_bytes: u32,
}

fn segments(elf: &[u8]) -> Result<Vec<Segment>> {
    let file: ElfFile32<object::LittleEndian> = ElfFile32::parse(elf)?;
    let endian = object::LittleEndian;
    let loadable = |header: &&object::elf::ProgramHeader32<object::LittleEndian>| {
        header.p_type(endian) == object::elf::PT_LOAD && header.p_memsz(endian) > 0
    };
    let segment = |header: &object::elf::ProgramHeader32<object::LittleEndian>| Segment {
        run_address: header.p_vaddr(endian),
        run_bytes: header.p_memsz(endian),
        load_address: header.p_paddr(endian),
        load_bytes: header.p_filesz(endian),
    };
    Ok(file.elf_program_headers().iter().filter(loadable).map(segment).collect())
}

/// Bytes per region that anything occupies, running or stored.
fn usage(segments: &[Segment]) -> Result<Vec<Usage>> {
    let mut used_bytes = [0_u32; REGIONS.len()];
    for segment in segments {
        let runs_in = region(segment.run_address)?;
        used_bytes[runs_in] += segment.run_bytes;
        if segment.load_bytes > 0 && segment.load_address != segment.run_address {
            used_bytes[region(segment.load_address)?] += segment.load_bytes;
        }
    }
    let usage = REGIONS.iter().zip(used_bytes);
    Ok(usage.map(|(&(region, _, size_bytes), used_bytes)| Usage { region, used_bytes, size_bytes }).collect())
}

fn region(address: u32) -> Result<usize> {
    REGIONS
        .iter()
        .position(|&(_, first, bytes)| (first..first + bytes).contains(&address))
        .with_context(|| format!("address {address:#010x} is in no memory of the STM32H743"))
}

impl fmt::Display for Firmware {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "{}", self.elf.display())?;
        for Usage { region, used_bytes, size_bytes } in &self.usage {
            if *used_bytes > 0 {
                let percent = 100.0 * f64::from(*used_bytes) / f64::from(*size_bytes);
                writeln!(f, "  {region:<6} {used_bytes:>8} of {size_bytes:>8} bytes {percent:>5.1} %")?;
            }
        }
        write!(f, "  sha256 {}", self.sha256)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn segment(run_address: u32, run_bytes: u32, load_address: u32, load_bytes: u32) -> Segment {
        Segment { run_address, run_bytes, load_address, load_bytes }
    }

    fn used(segments: &[Segment]) -> Vec<(&'static str, u32)> {
        let all = usage(segments).unwrap();
        all.iter().filter(|usage| usage.used_bytes > 0).map(|usage| (usage.region, usage.used_bytes)).collect()
    }

    #[test]
    fn a_ram_section_with_content_counts_where_it_runs_and_where_it_is_stored() {
        let vectors_and_code = segment(0x0800_0000, 0x1000, 0x0800_0000, 0x1000);
        let hot_code = segment(0x0000_0000, 0x300, 0x0800_1000, 0x300);
        let data = segment(0x2000_8000, 0x40, 0x0800_1300, 0x40);
        let zeroed = segment(0x2400_0000, 0x8000, 0x2400_0000, 0);
        assert_eq!(
            used(&[vectors_and_code, hot_code, data, zeroed]),
            [("FLASH", 0x1340), ("ITCM", 0x300), ("DTCM", 0x40), ("AXI", 0x8000)]
        );
    }

    #[test]
    fn a_segment_outside_the_chips_memory_is_refused_with_its_address() {
        let error = usage(&[segment(0x6000_0000, 4, 0x6000_0000, 4)]).unwrap_err();
        assert!(error.to_string().contains("0x60000000"), "{error}");
    }

    #[test]
    fn a_file_that_is_no_elf_is_refused() {
        assert!(segments(b"not an ELF").is_err());
        assert!(segments(&[]).is_err());
    }
}
