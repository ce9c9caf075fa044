//! What a command prints: words for a person, JSON for a program.

use anyhow::{Context, Result};
use serde::Serialize;
use serde_json::Value;
use std::fs::File;
use std::io::{ErrorKind, Write};
use std::path::{Path, PathBuf};

/// The option `--json`.
#[derive(Debug, Clone, Default, clap::Args)]
pub struct Json {
    /// Write the result as one line of JSON (what comes line by line, as lines of it); `-` for standard output, instead of the words for a person
    #[arg(long, global = true, value_name = "FILE")]
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
        if self.is_stdout() {
            return print(&line);
        }
        std::fs::write(file, line).with_context(|| format!("--json {}: cannot write", file.display()))?;
        print(&text())
    }

    /// Whether JSON goes to standard output, in place of the words.
    fn is_stdout(&self) -> bool {
        self.json.as_deref() == Some(Path::new("-"))
    }

    /// For commands that print line by line.
    ///
    /// # Errors
    /// A file that cannot be written, with its name.
    pub fn lines(&self) -> Result<Lines> {
        let file = match &self.json {
            Some(file) if !self.is_stdout() => {
                Some(File::create(file).with_context(|| format!("--json {}: cannot write", file.display()))?)
            }
            _ => None,
        };
        Ok(Lines { file, instead: self.is_stdout() })
    }
}

/// Lines of words on standard output, lines of JSON in a file beside them or in their place.
#[derive(Debug)]
pub struct Lines {
    file: Option<File>,
    instead: bool,
}

impl Lines {
    /// Writes one thing, in one line of JSON or the lines of `text()`. `false`: the reader has gone away (`| head`), nobody needs more.
    ///
    /// # Errors
    /// What cannot be written.
    pub fn write(&mut self, value: &Value, text: impl FnOnce() -> String) -> Result<bool> {
        if let Some(file) = &mut self.file {
            writeln!(file, "{value}").context("--json: cannot write")?;
        }
        let text = if self.instead { format!("{value}\n") } else { text() };
        let mut out = std::io::stdout().lock();
        match out.write_all(text.as_bytes()).and_then(|()| out.flush()) {
            Err(error) if error.kind() == ErrorKind::BrokenPipe => Ok(false),
            other => other.context("cannot write to standard output").map(|()| true),
        }
    }
}

/// Prints to standard output; a reader that has gone away (`| head`) is no error.
///
/// # Errors
/// When standard output cannot be written otherwise.
pub fn print(text: &str) -> Result<()> {
    match std::io::stdout().lock().write_all(text.as_bytes()) {
        Err(error) if error.kind() != ErrorKind::BrokenPipe => Err(error).context("cannot write to standard output"),
        _ => Ok(()),
    }
}
