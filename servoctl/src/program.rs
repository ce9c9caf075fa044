//! The program in a firmware's ELF, as it lies in flash: which drive runs it.

use std::path::Path;

use anyhow::{Context, Result, ensure};
use object::elf::{PT_LOAD, ProgramHeader32};
use object::read::elf::{ElfFile32, ProgramHeader};
use object::{LittleEndian, Object, ObjectSymbol};
use servo_core::fingerprint::Fingerprint;

/// First address of the flash.
const FLASH: u64 = 0x0800_0000;
/// As much as there is.
const FLASH_BYTES: u64 = 2 << 20;
/// What nobody has programmed.
const ERASED: u8 = 0xff;

/// Fingerprint of the program in the ELF at `path`: the one that a drive which runs it has in its
/// [`Identity`](servo_protocol::message::Identity).
///
/// # Errors
/// A file that cannot be read, or is no firmware of this drive.
pub fn fingerprint(path: &Path) -> Result<Fingerprint> {
    let elf = std::fs::read(path).with_context(|| format!("reading {}", path.display()))?;
    of_elf(&elf).with_context(|| format!("{} is no firmware of this drive", path.display()))
}

/// The same parts in the same order as `servo_board::program`: flash up to the last value of the data, then the image of the hot code.
fn of_elf(elf: &[u8]) -> Result<Fingerprint> {
    let file: ElfFile32<LittleEndian> = ElfFile32::parse(elf)?;
    let address = |name: &str| {
        let symbol = file.symbol_by_name(name).with_context(|| format!("it has no symbol {name}"))?;
        Ok::<u64, anyhow::Error>(symbol.address())
    };
    let bytes = |begin: &str, end: &str| Ok::<u64, anyhow::Error>(address(end)?.wrapping_sub(address(begin)?));
    let program_bytes = address("__sidata")?.wrapping_add(bytes("__sdata", "__edata")?).wrapping_sub(FLASH);
    let parts = [(FLASH, program_bytes), (address("__siitcm")?, bytes("__sitcm", "__eitcm")?)];
    parts.into_iter().try_fold(Fingerprint::default(), |so_far, (from, bytes)| {
        ensure!(bytes <= FLASH_BYTES, "its program of {bytes} bytes does not fit the flash");
        let mut flash = vec![ERASED; bytes as usize];
        file.elf_program_headers().iter().try_for_each(|header| put(&mut flash, from, header, elf))?;
        Ok(so_far.with(&flash))
    })
}

/// Puts what `header` loads where it is stored, as far as that is in `flash`, which begins at address `from`.
fn put(flash: &mut [u8], from: u64, header: &ProgramHeader32<LittleEndian>, elf: &[u8]) -> Result<()> {
    if header.p_type(LittleEndian) != PT_LOAD {
        return Ok(());
    }
    let bytes = header.data(LittleEndian, elf).map_err(|()| anyhow::anyhow!("it ends before its last segment"))?;
    let at = u64::from(header.p_paddr(LittleEndian));
    for (address, byte) in (at..).zip(bytes) {
        if let Some(place) = address.checked_sub(from).and_then(|offset| flash.get_mut(offset as usize)) {
            *place = *byte;
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_no_firmware_is_named() {
        let file = tempfile::NamedTempFile::new().unwrap();
        let error = format!("{:#}", fingerprint(file.path()).unwrap_err());
        assert!(error.contains("is no firmware of this drive"), "{error}");
        let error = format!("{:#}", fingerprint(Path::new("/no/such.elf")).unwrap_err());
        assert!(error.starts_with("reading /no/such.elf"), "{error}");
    }
}
