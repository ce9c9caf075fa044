//! Pages of `docs/` that are made from tables in code.

use anyhow::{Context, Result};

use crate::{fault_page, host, parameter_page, process, protocol_page};

/// Where a page is, and what makes it.
type Page = (&'static str, fn() -> String);

const PAGES: [Page; 3] = [
    ("docs/faults.md", fault_page::faults),
    ("docs/parameters.md", parameter_page::parameters),
    ("docs/protocol.md", protocol_page::protocol),
];

/// The host tool prints this one itself, and has the test that compares.
const COMMANDS: &str = "docs/commands.md";

/// Writes every page anew and says which ones have changed.
///
/// # Errors
/// When a page cannot be written.
pub fn write() -> Result<()> {
    let commands = process::capture(
        host::cargo("run").args(["--quiet", "--package", "servoctl", "--", "reference"]),
        "servoctl reference",
    )?;
    // What is captured comes without its last line end.
    let commands = commands + "\n";
    let pages = PAGES.map(|(path, render)| (path, render()));
    for (path, now) in pages.into_iter().chain([(COMMANDS, commands)]) {
        let before = std::fs::read_to_string(path).unwrap_or_default();
        std::fs::write(path, &now).with_context(|| format!("writing {path}"))?;
        println!("{path}: {}", if before == now { "was current" } else { "written" });
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::path::Path;

    #[test]
    fn the_committed_pages_are_current() {
        let workspace = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
        for (path, render) in PAGES {
            let committed = std::fs::read_to_string(workspace.join(path)).unwrap_or_default();
            assert!(committed == render(), "run `cargo xtask docs` and commit {path}");
        }
    }
}
