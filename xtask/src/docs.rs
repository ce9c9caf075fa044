//! Pages of `docs/` that are made from tables in code.

use anyhow::{Context, Result};

use crate::{fault_page, host, process, protocol_page};

/// Where a page is, and what makes it.
type Page = (&'static str, fn() -> String);

const PAGES: [Page; 2] = [("docs/faults.md", fault_page::faults), ("docs/protocol.md", protocol_page::protocol)];

/// The host tool prints these itself, by name, and has the tests that compare.
const PRINTED: [(&str, &str); 2] = [("docs/commands.md", "commands"), ("docs/parameters.md", "parameters")];

/// Writes every page anew and says which ones have changed.
///
/// # Errors
/// When a page cannot be written.
pub fn write() -> Result<()> {
    let mut pages = Vec::from(PAGES.map(|(path, render)| (path, render())));
    for (path, name) in PRINTED {
        let mut print = host::cargo("run");
        print.args(["--quiet", "--package", "servoctl", "--", "reference", name]);
        // What is captured comes without its last line end.
        pages.push((path, process::capture(&mut print, "servoctl reference")? + "\n"));
    }
    for (path, now) in pages {
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
