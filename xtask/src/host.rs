//! cargo for the host workspace.

use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, Result};

use crate::process;
use crate::toolchain;
use crate::version::Version;

/// The release that the virtual board's emulator declares; older ones compile it too, but cargo must be told.
const EMULATOR_DECLARES: Version = Version::new(1, 98);

/// `cargo <word>` with the compiler that runs this program.
pub fn cargo(word: &str) -> Command {
    let mut command = Command::new(std::env::var_os("CARGO").unwrap_or("cargo".into()));
    command.arg(word);
    command
}

/// [`cargo`] for selections that contain the virtual board.
///
/// # Errors
/// When the compiler cannot be asked for its release.
pub fn cargo_with_emulator(word: &str) -> Result<Command> {
    let mut command = cargo(word);
    command.args(emulator_flag(toolchain::host_version()?));
    Ok(command)
}

fn emulator_flag(rustc: Version) -> Option<&'static str> {
    (rustc < EMULATOR_DECLARES).then_some("--ignore-rust-version")
}

/// Builds a program of the virtual board, optimised, and prepares its run on the firmware `elf`; arguments for the
/// program are the caller's to add.
///
/// # Errors
/// When the build fails or the ELF's path cannot be made absolute.
pub fn virtual_board(program: &str, elf: &Path) -> Result<Command> {
    const PACKAGE: [&str; 4] = ["--release", "--package", "servo-virtual-board", "--bin"];
    let mut build = cargo_with_emulator("build")?;
    process::run(build.args(PACKAGE).arg(program), "building the virtual board")?;
    let mut run = cargo_with_emulator("run")?;
    run.arg("--quiet").args(PACKAGE).args([program, "--"]).env("SERVO_ELF", absolute(elf)?);
    Ok(run)
}

/// `path` from the root: programs and tests start in other directories.
///
/// # Errors
/// When there is no current directory.
pub fn absolute(path: &Path) -> Result<PathBuf> {
    std::path::absolute(path).with_context(|| format!("the path {}", path.display()))
}

/// `path` as a person means it who is in `directory`, which may not be the workspace; `-` is no path.
pub fn seen_from(directory: &Path, path: PathBuf) -> PathBuf {
    let is_here = std::env::current_dir().is_ok_and(|here| here == directory);
    if is_here || path == Path::new("-") { path } else { directory.join(path) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_compilers_older_than_declared_are_told_to_ignore_it() {
        assert_eq!(emulator_flag(Version::new(1, 95)), Some("--ignore-rust-version"));
        assert_eq!(emulator_flag(Version { major: 1, minor: 97, patch: 9 }), Some("--ignore-rust-version"));
        assert_eq!(emulator_flag(Version::new(1, 98)), None);
        assert_eq!(emulator_flag(Version::new(2, 0)), None);
    }
}
