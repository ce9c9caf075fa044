//! Debian packages: who may install them, and what to type when nobody here may.

use std::process::Command;

use anyhow::{Result, bail};

use crate::process;

/// How this user gets packages.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Access {
    /// Directly.
    Root,
    /// Through `sudo`, which asks no password.
    Sudo,
    /// Through `sudo`, which asks for a password: not without the person.
    SudoPassword,
    /// Through `su` only: not without the person.
    Su,
    /// There is no `apt-get` on this machine.
    NoApt,
}

impl Access {
    /// Asks the machine.
    pub fn find() -> Access {
        let user = process::capture(Command::new("id").arg("-u"), "id");
        if !process::succeeds(Command::new("apt-get").arg("--version")) {
            Access::NoApt
        } else if user.is_ok_and(|user| user == "0") {
            Access::Root
        } else if process::succeeds(Command::new("sudo").args(["-n", "true"])) {
            Access::Sudo
        } else if process::succeeds(Command::new("sudo").arg("--version")) {
            Access::SudoPassword
        } else {
            Access::Su
        }
    }

    /// The one line that installs `packages` when a person types it.
    pub fn line(self, packages: &[&str]) -> String {
        let names = packages.join(" ");
        let line = |prefix: &str| {
            format!("{prefix}apt-get update && {prefix}apt-get install -y --no-install-recommends {names}")
        };
        match self {
            Access::Root => line(""),
            Access::Sudo | Access::SudoPassword => line("sudo "),
            Access::Su => format!("su -c '{}'", line("")),
            Access::NoApt => {
                format!("(no apt-get here: install what Debian calls {names} in this system's way)")
            }
        }
    }

    /// Installs `packages` for the step named `step`; shows what `apt-get` prints.
    ///
    /// # Errors
    /// When it takes a person (no privilege, no `apt-get`) or fails; the message ends with the line to type.
    pub fn install(self, step: &str, packages: &[&str]) -> Result<()> {
        if matches!(self, Access::Root | Access::Sudo) {
            eprintln!("setup: {step}: installing {}", packages.join(", "));
        }
        let done = match self {
            Access::Root => apt_get(Command::new("apt-get"), packages),
            Access::Sudo => {
                let mut sudo = Command::new("sudo");
                sudo.args(["-n", "env", "DEBIAN_FRONTEND=noninteractive", "apt-get"]);
                apt_get(sudo, packages)
            }
            Access::SudoPassword | Access::Su | Access::NoApt => bail!(self.please_type(packages)),
        };
        done.map_err(|error| error.context(self.please_type(packages)))
    }

    fn please_type(self, packages: &[&str]) -> String {
        format!("{} cannot be installed from here. Please type:\n{}", packages.join(", "), self.line(packages))
    }
}

/// Refreshes the lists, then installs; `program` is `apt-get` with whatever goes before it.
fn apt_get(program: Command, packages: &[&str]) -> Result<()> {
    let command = |words: &[&str]| {
        let mut command = Command::new(program.get_program());
        command
            .args(program.get_args())
            .args(["-q", "-o", "DPkg::Lock::Timeout=300", "-o", "Dpkg::Use-Pty=0"])
            .args(words);
        command.env("DEBIAN_FRONTEND", "noninteractive");
        command
    };
    process::run(&mut command(&["update"]), "apt-get update")?;
    let mut install = command(&["install", "-y", "--no-install-recommends"]);
    process::run(install.args(packages), "apt-get install")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_line_to_type_fits_the_privilege() {
        let packages = ["a", "b"];
        let root = "apt-get update && apt-get install -y --no-install-recommends a b";
        let sudo = "sudo apt-get update && sudo apt-get install -y --no-install-recommends a b";
        let cases = [
            (Access::Root, root.to_string()),
            (Access::Sudo, sudo.to_string()),
            (Access::SudoPassword, sudo.to_string()),
            (Access::Su, format!("su -c '{root}'")),
        ];
        for (access, expected) in cases {
            assert_eq!(access.line(&packages), expected);
        }
        assert!(Access::NoApt.line(&packages).contains("a b"));
    }

    #[test]
    fn without_privilege_nothing_is_run_and_the_message_ends_with_the_line() {
        for access in [Access::SudoPassword, Access::Su, Access::NoApt] {
            let message = access.install("step", &["a"]).unwrap_err().to_string();
            assert_eq!(message.lines().last(), Some(access.line(&["a"]).as_str()));
        }
    }
}
