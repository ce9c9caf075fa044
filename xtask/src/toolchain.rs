//! Which compiler builds the firmware.
//!
//! The standard library for the Cortex-M7 comes from rustup where its server can be reached. Elsewhere Debian's packages
//! of a newer compiler bring the library's source, and cargo builds it along. [`choose`] decides from [`Facts`] alone.

use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, Result};

use crate::process;
use crate::version::Version;

/// Cortex-M7 with hardware floating point.
pub const TARGET: &str = "thumbv7em-none-eabihf";

/// Oldest compiler that builds the firmware.
pub const OLDEST_RUST: Version = Version::new(1, 95);

/// Debian's compiler, its cargo and the standard library's source.
pub const DEBIAN_PACKAGES: [&str; 3] = ["rustc-web", "cargo-web", "rust-web-src"];

/// The lints of Debian's compiler; a build does without.
pub const DEBIAN_CLIPPY: &str = "rust-web-clippy";

/// The one line that installs the target where rustup's server can be reached.
pub const ADD_TARGET: &str = "rustup target add thumbv7em-none-eabihf";

/// Everything the choice depends on.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Facts {
    /// The active compiler has the target's library already.
    pub has_target: bool,
    /// How `rustup target add` stands.
    pub target_add: Attempt,
    /// Debian's packages, if all of them are installed.
    pub debian: Option<DebianRust>,
    /// How their installation stands.
    pub debian_install: Attempt,
    /// A linker for Arm: rustup's `rust-lld`, else `ld.lld` of Debian's package `lld`.
    pub linker: Option<PathBuf>,
}

/// Something that can be tried once.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Attempt {
    /// Not tried yet; may work.
    Open,
    /// Was tried and failed, or there is no tool for it.
    #[default]
    Closed,
}

/// The compiler of Debian's packages.
#[derive(Clone, Debug, PartialEq)]
pub struct DebianRust {
    /// Its release.
    pub version: Version,
    /// Its cargo (not rustup's shim).
    pub cargo: PathBuf,
    /// Its rustc (not rustup's shim).
    pub rustc: PathBuf,
}

impl DebianRust {
    /// Where its lints are if they are installed.
    pub fn clippy(&self) -> PathBuf {
        self.cargo.with_file_name("cargo-clippy")
    }
}

/// What to do next about the toolchain.
#[derive(Clone, Debug, PartialEq)]
pub enum Choice {
    /// Build with this.
    Use(Toolchain),
    /// Ask rustup for the target, then look again.
    AddTarget,
    /// Install these Debian packages, then look again.
    Install(Vec<&'static str>),
    /// Nothing is left to try; the text is the one line to type.
    GiveUp(&'static str),
}

/// A compiler that can build the firmware.
#[derive(Clone, Debug, PartialEq)]
pub enum Toolchain {
    /// The active compiler with the target's library.
    Native,
    /// Debian's compiler, building `core` from source.
    Debian {
        /// Compiler and cargo.
        rust: DebianRust,
        /// Linker for Arm.
        linker: PathBuf,
    },
}

/// Chooses the toolchain, or the next thing to try.
///
/// In order: what is installed (native target before Debian's packages), rustup, Debian's packages. A Debian compiler
/// older than [`OLDEST_RUST`] counts as none.
pub fn choose(facts: &Facts) -> Choice {
    if facts.has_target {
        return Choice::Use(Toolchain::Native);
    }
    let debian = facts.debian.as_ref().filter(|rust| rust.version >= OLDEST_RUST);
    if let (Some(rust), Some(linker)) = (debian, &facts.linker) {
        return Choice::Use(Toolchain::Debian { rust: rust.clone(), linker: linker.clone() });
    }
    if facts.target_add == Attempt::Open {
        return Choice::AddTarget;
    }
    if facts.debian_install == Attempt::Open {
        let mut packages = Vec::new();
        if debian.is_none() {
            packages.extend(DEBIAN_PACKAGES);
        }
        if facts.linker.is_none() {
            packages.push("lld");
        }
        return Choice::Install(packages);
    }
    Choice::GiveUp(ADD_TARGET)
}

/// Looks at the machine. Quick: asks the compiler and the package database, touches no network.
///
/// # Errors
/// When the active `rustc` cannot be asked.
pub fn find_facts() -> Result<Facts> {
    let library = process::capture(
        Command::new("rustc").args(["--print", "target-libdir", "--target", TARGET]),
        "asking rustc for its libraries",
    )?;
    let rustup = process::succeeds(Command::new("rustup").arg("--version"));
    let apt = process::succeeds(Command::new("apt-get").arg("--version"));
    Ok(Facts {
        has_target: has_library_core(Path::new(&library)),
        target_add: if rustup { Attempt::Open } else { Attempt::Closed },
        debian: find_debian_rust(),
        debian_install: if apt { Attempt::Open } else { Attempt::Closed },
        linker: find_linker()?,
    })
}

fn has_library_core(directory: &Path) -> bool {
    std::fs::read_dir(directory)
        .is_ok_and(|entries| entries.flatten().any(|entry| entry.file_name().to_string_lossy().starts_with("libcore-")))
}

fn find_debian_rust() -> Option<DebianRust> {
    let files = process::capture(Command::new("dpkg").arg("-L").args(DEBIAN_PACKAGES), "dpkg").ok()?;
    let cargo = program_in(&files, "/usr/bin/cargo")?;
    let rustc = program_in(&files, "/usr/bin/rustc")?;
    let version = Version::find(&process::capture(Command::new(&rustc).arg("--version"), "rustc").ok()?)?;
    Some(DebianRust { version, cargo, rustc })
}

/// The line of a package's file list that is `program` itself (there is a wrapper script of the same name elsewhere).
fn program_in(files: &str, program: &str) -> Option<PathBuf> {
    files.lines().find(|line| *line == program).map(PathBuf::from)
}

fn find_linker() -> Result<Option<PathBuf>> {
    let verbose = process::capture(Command::new("rustc").arg("-vV"), "asking rustc for its version")?;
    let sysroot = process::capture(Command::new("rustc").args(["--print", "sysroot"]), "asking rustc for its sysroot")?;
    let host = host_triple(&verbose).context("rustc does not name its host")?;
    let rust_lld = Path::new(&sysroot).join("lib/rustlib").join(host).join("bin/rust-lld");
    let debian_lld = PathBuf::from("/usr/bin/ld.lld");
    Ok([rust_lld, debian_lld].into_iter().find(|path| path.exists()))
}

fn host_triple(verbose: &str) -> Option<&str> {
    verbose.lines().find_map(|line| line.strip_prefix("host: "))
}

/// Release of the active compiler, which builds everything that runs on this machine.
///
/// # Errors
/// When `rustc` cannot be asked or prints no version.
pub fn host_version() -> Result<Version> {
    let text = process::capture(Command::new("rustc").arg("--version"), "asking rustc for its version")?;
    Version::find(&text).with_context(|| format!("rustc prints no version: {text:?}"))
}

impl Toolchain {
    /// Release of its compiler.
    ///
    /// # Errors
    /// When the active compiler cannot be asked.
    pub fn version(&self) -> Result<Version> {
        match self {
            Toolchain::Native => host_version(),
            Toolchain::Debian { rust, .. } => Ok(rust.version),
        }
    }

    /// One line that says which compiler and linker it is.
    pub fn describe(&self) -> String {
        match self {
            Toolchain::Native => format!("the active compiler with target {TARGET}"),
            Toolchain::Debian { rust, linker } => {
                let linker = linker.file_name().unwrap_or_default().to_string_lossy();
                format!("Debian's rustc {} with core built from source, linked by {linker}", rust.version)
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn debian(minor: u32) -> Option<DebianRust> {
        let path = |name: &str| PathBuf::from("bin").join(name);
        Some(DebianRust { version: Version::new(1, minor), cargo: path("cargo"), rustc: path("rustc") })
    }

    fn lld() -> Option<PathBuf> {
        Some(PathBuf::from("rust-lld"))
    }

    #[test]
    fn the_choice_follows_the_facts() {
        use Attempt::{Closed, Open};
        let bare = Facts { target_add: Open, debian_install: Open, linker: lld(), ..Facts::default() };
        let with_debian = Choice::Use(Toolchain::Debian { rust: debian(96).unwrap(), linker: lld().unwrap() });
        let all = DEBIAN_PACKAGES.to_vec();
        let all_and_lld = [&DEBIAN_PACKAGES[..], &["lld"]].concat();
        let cases = [
            ("target there", Facts { has_target: true, ..bare.clone() }, Choice::Use(Toolchain::Native)),
            (
                "both there",
                Facts { has_target: true, debian: debian(96), ..bare.clone() },
                Choice::Use(Toolchain::Native),
            ),
            ("Debian's there", Facts { debian: debian(96), ..bare.clone() }, with_debian.clone()),
            (
                "Debian's there, no network tool",
                Facts { debian: debian(96), target_add: Closed, ..bare.clone() },
                with_debian,
            ),
            ("nothing there", bare.clone(), Choice::AddTarget),
            ("Debian's too old", Facts { debian: debian(85), ..bare.clone() }, Choice::AddTarget),
            ("Debian's without linker", Facts { debian: debian(96), linker: None, ..bare.clone() }, Choice::AddTarget),
            ("rustup failed", Facts { target_add: Closed, ..bare.clone() }, Choice::Install(all.clone())),
            (
                "rustup failed, Debian's too old",
                Facts { target_add: Closed, debian: debian(85), ..bare.clone() },
                Choice::Install(all),
            ),
            (
                "rustup failed, no linker",
                Facts { target_add: Closed, linker: None, ..bare.clone() },
                Choice::Install(all_and_lld),
            ),
            (
                "only the linker is missing",
                Facts { target_add: Closed, debian: debian(96), linker: None, ..bare.clone() },
                Choice::Install(vec!["lld"]),
            ),
            (
                "all failed",
                Facts { target_add: Closed, debian_install: Closed, ..bare },
                Choice::GiveUp("rustup target add thumbv7em-none-eabihf"),
            ),
        ];
        for (name, facts, expected) in cases {
            assert_eq!(choose(&facts), expected, "{name}");
        }
    }

    #[test]
    fn the_program_is_found_among_a_packages_files() {
        let files = "/.\n/usr\n/usr/bin\n/usr/bin/cargo\n/usr/share/cargo/bin/cargo\n";
        assert_eq!(program_in(files, "/usr/bin/cargo"), Some(PathBuf::from("/usr/bin/cargo")));
        assert_eq!(program_in(files, "/usr/bin/rustc"), None);
    }

    #[test]
    fn the_host_triple_is_read_from_the_long_version() {
        assert_eq!(host_triple("rustc 1.95.0\nbinary: rustc\nhost: a-b-c\n"), Some("a-b-c"));
        assert_eq!(host_triple("rustc 1.95.0"), None);
    }
}
