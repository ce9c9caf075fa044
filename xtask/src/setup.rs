//! The one place where things get installed: what is missing, in named steps.

use std::process::Command;

use anyhow::{Context, Result, bail};

use crate::apt::Access;
use crate::embedded;
use crate::toolchain::{self, ADD_TARGET, Attempt, Choice, DEBIAN_CLIPPY, TARGET, Toolchain};
use crate::version::Version;
use crate::{process, scope};

/// Oldest QEMU whose instruction counts are known to be right.
const OLDEST_QEMU: Version = Version::new(7, 2);

/// Every step, or with `dry_run` what every step would do.
///
/// # Errors
/// When a step fails, with the one line to type.
pub fn all(dry_run: bool) -> Result<()> {
    if dry_run {
        for plan in [plan_toolchain()?, plan(&QEMU), plan(&C_COMPILER), plan(&NPM), plan(&CHROMIUM)] {
            eprintln!("setup: {plan}");
        }
        return Ok(());
    }
    firmware_toolchain()?;
    qemu()?;
    chromium()?;
    scope::bundle()
}

/// Makes sure that the firmware can be built, and says with what.
///
/// # Errors
/// When neither rustup nor Debian's packages bring a toolchain, with the one line to type.
pub fn firmware_toolchain() -> Result<Toolchain> {
    let mut facts = toolchain::find_facts()?;
    loop {
        match toolchain::choose(&facts) {
            Choice::Use(toolchain) => {
                eprintln!("setup: firmware toolchain: {}", toolchain.describe());
                return Ok(toolchain);
            }
            Choice::AddTarget => {
                eprintln!("setup: firmware toolchain: asking rustup for {TARGET}");
                // Captured: what rustup prints about an unreachable server is not the way on.
                let added = process::capture(
                    Command::new("rustup").args(["target", "add", TARGET]).env("RUSTUP_MAX_RETRIES", "1"),
                    "rustup target add",
                );
                if added.is_err() {
                    eprintln!("setup: firmware toolchain: rustup cannot get it, taking Debian's packages");
                }
                facts = toolchain::Facts { target_add: Attempt::Closed, ..toolchain::find_facts()? };
            }
            Choice::Install(packages) => {
                Access::find().install("firmware toolchain", &packages)?;
                let closed = Attempt::Closed;
                facts = toolchain::Facts { target_add: closed, debian_install: closed, ..toolchain::find_facts()? };
            }
            Choice::GiveUp(line) => {
                bail!("no toolchain for the firmware. Where its server can be reached, type:\n{line}")
            }
        }
    }
}

/// Makes sure that the emulator of the bare Cortex-M7 and the C compiler for its counting plug-in are there.
///
/// # Errors
/// When one of them cannot be installed, with the one line to type.
pub fn qemu() -> Result<()> {
    ensure(&QEMU)?;
    ensure(&C_COMPILER)
}

/// Makes sure that packages of the scope page can be fetched.
///
/// # Errors
/// When npm cannot be installed, with the one line to type.
pub fn npm() -> Result<()> {
    ensure(&NPM)
}

/// Makes sure that there is a browser for the tests of the scope page.
///
/// # Errors
/// When it cannot be installed, with the one line to type.
pub fn chromium() -> Result<()> {
    ensure(&CHROMIUM)
}

/// `cargo clippy` for the embedded workspace; further arguments are the caller's to add.
///
/// # Errors
/// When there is no toolchain, or Debian's has no lints and they cannot be installed, with the one line to type.
pub fn embedded_clippy() -> Result<Command> {
    let toolchain = firmware_toolchain()?;
    if let Toolchain::Debian { rust, .. } = &toolchain
        && !rust.clippy().exists()
    {
        Access::find().install("lints for the firmware", &[DEBIAN_CLIPPY])?;
    }
    Ok(toolchain.cargo("clippy", &embedded::target_dir()?))
}

/// A program that a Debian package brings.
struct Tool {
    name: &'static str,
    program: &'static str,
    package: &'static str,
    oldest: Version,
}

const QEMU: Tool = Tool { name: "QEMU", program: "qemu-system-arm", package: "qemu-system-arm", oldest: OLDEST_QEMU };
const C_COMPILER: Tool =
    Tool { name: "C compiler", program: "cc", package: "build-essential", oldest: Version::new(0, 0) };
/// The oldest that reads the lock file's version.
const NPM: Tool = Tool { name: "npm", program: "npm", package: "npm", oldest: Version::new(7, 0) };
/// The oldest that knows what the page's scripts use.
const CHROMIUM: Tool =
    Tool { name: "Chromium", program: "chromium", package: "chromium", oldest: Version::new(119, 0) };

/// Whether a tool does.
#[derive(Debug, PartialEq)]
enum State {
    Missing,
    TooOld(Version),
    There(Version),
}

fn state(tool: &Tool, printed: Option<&str>) -> State {
    match printed.and_then(Version::find) {
        None => State::Missing,
        Some(version) if version < tool.oldest => State::TooOld(version),
        Some(version) => State::There(version),
    }
}

fn look(tool: &Tool) -> State {
    let printed = process::capture(Command::new(tool.program).arg("--version"), tool.name);
    state(tool, printed.ok().as_deref())
}

fn ensure(tool: &Tool) -> Result<()> {
    let name = tool.name;
    let missing = look(tool) == State::Missing;
    if missing {
        Access::find().install(name, &[tool.package])?;
    }
    match look(tool) {
        State::There(version) => {
            eprintln!("setup: {name}: {} ({version})", if missing { "installed" } else { "already there" });
        }
        State::TooOld(version) => bail!("{name} {version} is too old; {} or newer is needed", tool.oldest),
        State::Missing => bail!("{name}: {} was installed but `{}` does not run", tool.package, tool.program),
    }
    Ok(())
}

fn plan(tool: &Tool) -> String {
    match look(tool) {
        State::There(version) => format!("{}: already there ({version})", tool.name),
        State::TooOld(version) => format!("{}: {version} is too old, {} is needed", tool.name, tool.oldest),
        State::Missing => format!("{}: {}", tool.name, Access::find().line(&[tool.package])),
    }
}

fn plan_toolchain() -> Result<String> {
    let what = match toolchain::choose(&toolchain::find_facts().context("looking for a toolchain")?) {
        Choice::Use(toolchain) => format!("already there ({})", toolchain.describe()),
        Choice::AddTarget => {
            format!("{ADD_TARGET}; if that fails: {}", Access::find().line(&toolchain::DEBIAN_PACKAGES))
        }
        Choice::Install(packages) => Access::find().line(&packages),
        Choice::GiveUp(line) => line.to_string(),
    };
    Ok(format!("firmware toolchain: {what}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_tool_is_missing_too_old_or_there() {
        let version = |major, minor| Version::new(major, minor);
        let cases = [
            (None, State::Missing),
            (Some("nonsense"), State::Missing),
            (Some("QEMU emulator version 6.2.0 (Debian 1:6.2+dfsg-2ubuntu6)"), State::TooOld(version(6, 2))),
            (Some("QEMU emulator version 7.2.0"), State::There(version(7, 2))),
            (Some("QEMU emulator version 10.1.0"), State::There(version(10, 1))),
        ];
        for (printed, expected) in cases {
            assert_eq!(state(&QEMU, printed), expected, "{printed:?}");
        }
    }
}
