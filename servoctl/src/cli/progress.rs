//! How far a long computation is: a bar on a terminal, a line every tenth of the way elsewhere. On standard error.

use std::io::IsTerminal;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use indicatif::{ProgressBar, ProgressStyle};

/// Lines that a computation shows when standard error is no terminal.
const LINES: u64 = 10;

/// Progress of one computation.
pub struct Progress {
    what: String,
    total: u64,
    done: AtomicU64,
    bar: Option<ProgressBar>,
}

impl Progress {
    /// Begins: `total` pieces of `unit` to do for `what`.
    pub fn new(what: &str, total: u64, unit: &str) -> Progress {
        let bar = std::io::stderr().is_terminal().then(|| {
            let bar = ProgressBar::new(total);
            let template = format!("{{msg}} [{{bar:30}}] {{pos}}/{{len}} {unit}, {{elapsed}} (still {{eta}})");
            bar.set_style(ProgressStyle::with_template(&template).unwrap_or_else(|_| ProgressStyle::default_bar()));
            bar.set_message(what.to_owned());
            bar.enable_steady_tick(Duration::from_millis(250));
            bar
        });
        if bar.is_none() {
            eprintln!("{what}: {total} {unit}");
        }
        Progress { what: what.to_owned(), total, done: AtomicU64::new(0), bar }
    }

    /// `pieces` more are done. From any thread.
    pub fn advance(&self, pieces: u64) {
        let before = self.done.fetch_add(pieces, Ordering::Relaxed);
        match &self.bar {
            Some(bar) => bar.inc(pieces),
            None => {
                let tenth = |done: u64| done * LINES / self.total.max(1);
                if tenth(before + pieces) > tenth(before) {
                    eprintln!("{}: {} %", self.what, tenth(before + pieces) * 100 / LINES);
                }
            }
        }
    }
}

impl Drop for Progress {
    fn drop(&mut self) {
        if let Some(bar) = &self.bar {
            bar.finish_and_clear();
        }
    }
}
