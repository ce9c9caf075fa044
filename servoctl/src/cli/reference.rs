//! The page of all commands, from the command line itself.

use std::fmt::Write;

use clap::{Command, CommandFactory, ValueEnum};

use super::{Arguments, parameter_page};

/// Pages that this program prints about itself.
#[derive(Clone, Copy, Debug, ValueEnum)]
pub enum Page {
    /// `docs/commands.md`
    Commands,
    /// `docs/parameters.md`
    Parameters,
}

impl Page {
    /// The page.
    pub fn text(self) -> String {
        match self {
            Page::Commands => commands(),
            Page::Parameters => parameter_page::parameters(),
        }
    }
}

const HEAD: &str = "\
# Commands of `servoctl`

Made by `cargo xtask docs` from the command line itself; a test compares the two. To begin with: [quickstart.md](quickstart.md).

Quantities are typed with their units: `5mm`, `200µm` (or `200um`), `-3nm`, `50mm/s`, `1m/s²` (or `1m/s2`), `20ms`, `4N/µm`. `--json FILE` writes what a
command prints as one line of JSON, units in the field names; `-` is standard output. Exit codes: 0 done, 1 failed (the reason is on standard error), 2 not
understood, 130 after Ctrl-C, which brakes a motion first.
";

/// `docs/commands.md`.
pub fn commands() -> String {
    let mut root = Arguments::command().bin_name("servoctl").term_width(110);
    root.build();
    let mut page = HEAD.to_owned();
    for command in root.get_subcommands() {
        section(&mut page, command, 2);
    }
    page
}

/// A command and those below it.
fn section(page: &mut String, command: &Command, level: usize) {
    if command.get_name() == "help" || command.is_hide_set() {
        return;
    }
    let name = command.get_bin_name().unwrap_or(command.get_name());
    // A heading has no options in it.
    let name = name.split_whitespace().filter(|word| !word.starts_with(['-', '[', '<'])).collect::<Vec<_>>().join(" ");
    let help = command.clone().term_width(110).render_help().to_string();
    let help = help.lines().map(str::trim_end).collect::<Vec<_>>().join("\n");
    let _ = write!(page, "\n{} `{name}`\n\n```text\n{}\n```\n", "#".repeat(level), help.trim_end());
    command.get_subcommands().for_each(|below| section(page, below, level + 1));
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_committed_page_is_current() {
        let file = concat!(env!("CARGO_MANIFEST_DIR"), "/../docs/commands.md");
        let committed = std::fs::read_to_string(file).unwrap_or_default();
        assert!(committed == commands(), "run `cargo xtask docs` and commit docs/commands.md");
    }
}
