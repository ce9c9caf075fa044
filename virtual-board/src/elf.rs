//! The firmware's ELF file: what is flashed with a probe is what boots here.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use defmt_decoder::Table;
use rigless::image::Image;
use rigless::symbols::Symbols;
use servo_protocol::message::VIRTUAL_SERIAL;
use sha2::{Digest, Sha256};

use crate::Error;

/// Environment variable that names the firmware where no path is given.
pub const ELF_VARIABLE: &str = "SERVO_ELF";

/// The symbol of the RTT control block, which `defmt-rtt` exports.
const RTT_CONTROL_BLOCK: &str = "_SEGGER_RTT";

/// Where the STM32H743 keeps its serial number, RM0433 rev 9 section 61.1.
const SERIAL_ADDRESS: u64 = 0x1FF1_E800;

/// A firmware image with its symbols and log strings. Cloning is cheap.
#[derive(Clone)]
pub struct Elf {
    inner: Arc<Inner>,
}

struct Inner {
    path: PathBuf,
    images: [Image; 2],
    symbols: Symbols,
    log_table: Table,
    rtt_address: u64,
    sha256: String,
}

impl std::fmt::Debug for Elf {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        formatter.debug_struct("Elf").field("path", &self.inner.path).field("sha256", &self.inner.sha256).finish()
    }
}

impl Elf {
    /// Reads the firmware at `path`.
    ///
    /// # Errors
    /// [`Error::Elf`] with the path and the reason: no such file, no ELF file, or no defmt log table or RTT block in it.
    pub fn read(path: &Path) -> Result<Self, Error> {
        let refuse = |reason: String| Error::Elf { path: path.to_owned(), reason };
        let bytes =
            std::fs::read(path).map_err(|error| refuse(format!("{error}; build it with `cargo xtask firmware`")))?;
        let symbols = Symbols::read(&bytes, std::convert::identity).map_err(|error| refuse(error.to_string()))?;
        let rtt_address = symbols.get(RTT_CONTROL_BLOCK).map_err(|error| refuse(error.to_string()))?;
        let log_table = Table::parse(&bytes)
            .map_err(|error| refuse(error.to_string()))?
            .ok_or_else(|| refuse("it has no defmt log table".to_owned()))?;
        let sha256 = Sha256::digest(&bytes).iter().map(|byte| format!("{byte:02x}")).collect();
        let image = |path, bytes, at| Image::new(path, bytes, at).map_err(|error| refuse(error.to_string()));
        let serial = VIRTUAL_SERIAL.iter().flat_map(|word| word.to_le_bytes()).collect();
        let images =
            [image(path, bytes, None)?, image(Path::new("the chip's serial number"), serial, Some(SERIAL_ADDRESS))?];
        let inner = Inner { path: path.to_owned(), images, symbols, log_table, rtt_address, sha256 };
        Ok(Self { inner: Arc::new(inner) })
    }

    /// Reads the firmware at `path`, or at `SERVO_ELF` where `path` is `None`.
    ///
    /// # Errors
    /// [`Error::NoElf`] where neither is given; else as [`Elf::read`].
    pub fn find(path: Option<&Path>) -> Result<Self, Error> {
        match (path, std::env::var_os(ELF_VARIABLE)) {
            (Some(path), _) => Self::read(path),
            (None, Some(path)) => Self::read(Path::new(&path)),
            (None, None) => Err(Error::NoElf),
        }
    }

    /// Where the file was read from.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.inner.path
    }

    /// SHA-256 of the whole file, lowercase hexadecimal.
    #[must_use]
    pub fn sha256(&self) -> &str {
        &self.inner.sha256
    }

    /// The address of the symbol called `name` exactly as `nm` prints it (mangled, for a Rust item without `no_mangle`).
    ///
    /// # Errors
    /// [`Error::Symbol`] where the firmware has no such symbol, or several.
    pub fn address(&self, name: &str) -> Result<u64, Error> {
        self.inner.symbols.get(name).map_err(|error| Error::Symbol { reason: error.to_string() })
    }

    pub(crate) fn images(&self) -> &[Image] {
        &self.inner.images
    }

    pub(crate) fn log_table(&self) -> &Table {
        &self.inner.log_table
    }

    pub(crate) fn rtt_address(&self) -> u64 {
        self.inner.rtt_address
    }
}
