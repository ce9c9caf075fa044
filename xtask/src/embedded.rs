//! cargo for the embedded workspace: its environment, flags and target directory.

use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, Result};

use crate::process;
use crate::toolchain::{TARGET, Toolchain};

/// Where the embedded workspace builds: `firmware/target`, or beside the host's if `CARGO_TARGET_DIR` moves that.
pub fn target_dir() -> Result<PathBuf> {
    let directory = match std::env::var_os("CARGO_TARGET_DIR") {
        Some(host) => Path::new(&host).join("firmware"),
        None => PathBuf::from("firmware/target"),
    };
    std::path::absolute(directory).context("the target directory")
}

/// Builds one program of the embedded workspace, optimised, and returns the path of its ELF.
///
/// # Errors
/// When the compiler fails.
pub fn build(toolchain: &Toolchain, package: &str, program: &str) -> Result<PathBuf> {
    let mut cargo = toolchain.cargo("build", &target_dir()?);
    process::run(cargo.args(["--package", package, "--bin", program]), &format!("building {program}"))?;
    Ok(target_dir()?.join(TARGET).join("release").join(program))
}

impl Toolchain {
    /// `cargo <word>` for the embedded workspace: started in `firmware/`, for [`TARGET`], optimised, into `target_dir`.
    ///
    /// The environment of the calling cargo is cleared of what would leak into the build; where the registry is and how
    /// it is reached stays.
    pub fn cargo(&self, word: &str, target_dir: &Path) -> Command {
        let mut command = match self {
            Toolchain::Native => Command::new(std::env::var_os("CARGO").unwrap_or("cargo".into())),
            // Called by its path: a cargo of Debian's would find rustup's lints first.
            Toolchain::Debian { rust, .. } if word == "clippy" => Command::new(rust.clippy()),
            Toolchain::Debian { rust, .. } => Command::new(&rust.cargo),
        };
        for (name, _) in std::env::vars_os() {
            if leaks(&name.to_string_lossy()) {
                command.env_remove(name);
            }
        }
        command.current_dir("firmware").arg(word).args(["--release", "--target", TARGET]);
        command.arg("--target-dir").arg(target_dir);
        if let Toolchain::Debian { rust, linker } = self {
            command
                .arg("-Zbuild-std=core")
                .env_remove("RUSTUP_TOOLCHAIN")
                .env("RUSTC_BOOTSTRAP", "1")
                .env("CARGO", &rust.cargo)
                .env("RUSTC", &rust.rustc)
                .env("RUSTDOC", rust.rustc.with_file_name("rustdoc"))
                .env("CARGO_TARGET_THUMBV7EM_NONE_EABIHF_LINKER", linker);
        }
        command
    }
}

/// Whether the environment variable would change an embedded build: flags, wrappers and compilers chosen for the host, and
/// what the outer cargo tells the program it runs. Registry, network and terminal settings do not.
fn leaks(name: &str) -> bool {
    const HARMLESS: [&str; 6] = [
        "CARGO_HOME",
        "CARGO_REGISTR", // CARGO_REGISTRY_…, CARGO_REGISTRIES_…
        "CARGO_SOURCE_",
        "CARGO_HTTP_",
        "CARGO_NET_",
        "CARGO_TERM_",
    ];
    const BUILD: [&str; 4] = ["CARGO", "RUSTC", "RUSTDOC", "RUSTFLAGS"];
    let begins = |prefixes: &[&str]| prefixes.iter().any(|prefix| name.starts_with(prefix));
    name == "LD_LIBRARY_PATH" || (begins(&BUILD) && !begins(&HARMLESS))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn host_settings_do_not_leak_into_the_embedded_build() {
        let leaking =
            ["CARGO", "CARGO_MANIFEST_DIR", "CARGO_TARGET_DIR", "CARGO_BUILD_TARGET", "CARGO_ENCODED_RUSTFLAGS"];
        let more =
            ["RUSTC", "RUSTC_WRAPPER", "RUSTFLAGS", "RUSTDOCFLAGS", "LD_LIBRARY_PATH", "CARGO_PROFILE_RELEASE_LTO"];
        for name in leaking.into_iter().chain(more) {
            assert!(leaks(name), "{name}");
        }
        let kept = ["PATH", "HOME", "CARGO_HOME", "CARGO_HTTP_CAINFO", "CARGO_REGISTRIES_X_INDEX", "CARGO_NET_RETRY"];
        for name in kept.into_iter().chain(["RUSTUP_HOME", "RUSTUP_TOOLCHAIN", "DEFMT_LOG"]) {
            assert!(!leaks(name), "{name}");
        }
    }
}
