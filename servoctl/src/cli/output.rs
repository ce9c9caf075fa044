//! What a command prints: words for a person, JSON for a program.

use anyhow::{Context, Result};
use serde::Serialize;
use std::io::{ErrorKind, Write};
use std::path::{Path, PathBuf};

/// The option `--json`.
#[derive(Debug, Clone, Default, clap::Args)]
pub struct Json {
    /// Write the result as one line of JSON; `-` for standard output, instead of the words for a person
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,
}

impl Json {
    /// Prints `text()`, or writes `value` as JSON: to a file beside the text, to standard output instead of it.
    ///
    /// # Errors
    /// A file that cannot be written, with its name.
    pub fn write(&self, value: &impl Serialize, text: impl FnOnce() -> String) -> Result<()> {
        let Some(file) = &self.json else { return print(&text()) };
        let line = serde_json::to_string(value)? + "\n";
        if file == Path::new("-") {
            return print(&line);
        }
        std::fs::write(file, line).with_context(|| format!("--json {}: cannot write", file.display()))?;
        print(&text())
    }
}

/// Prints to standard output; a reader that has gone away (`| head`) is no error.
fn print(text: &str) -> Result<()> {
    match std::io::stdout().lock().write_all(text.as_bytes()) {
        Err(error) if error.kind() != ErrorKind::BrokenPipe => Err(error).context("cannot write to standard output"),
        _ => Ok(()),
    }
}
