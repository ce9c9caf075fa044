//! The virtual drive in the background: found if it runs, else built and started.
//!
//! It writes its address to a state file and ends when that file is removed, so that no process has to be hunted. While it lives it holds a
//! lock on the file, which the system takes away however the process ends: a file without a lock is what a killed one has left.

use std::fs::{File, TryLockError};
use std::io::{BufRead, BufReader, Read, Write};
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use anyhow::{Context, Result, bail, ensure};
use serde::Deserialize;

/// Names the program where there is no workspace to build it in; the firmware is then named by [`ELF`].
pub const PROGRAM: &str = "SERVO_VIRTUAL_DRIVE";
/// Names the firmware.
pub const ELF: &str = "SERVO_ELF";
/// Another place for the state file: a second virtual drive beside the first.
pub const STATE: &str = "SERVO_VIRTUAL_STATE";

/// How long the drive may take to start, after it has been built.
const START: Duration = Duration::from_secs(120);

/// How long the drive may take to see that its state file is gone.
const END: Duration = Duration::from_secs(10);

/// What `cargo xtask virtual` prints.
#[derive(Debug, Deserialize)]
struct Built {
    program: PathBuf,
    elf: PathBuf,
}

/// Where the running virtual drive writes its address.
pub fn state_file() -> PathBuf {
    if let Some(file) = std::env::var_os(STATE) {
        return file.into();
    }
    let user = std::env::var("USER").unwrap_or_else(|_| "user".to_owned());
    let directory = std::env::var_os("XDG_RUNTIME_DIR").map_or_else(std::env::temp_dir, PathBuf::from);
    directory.join(format!("servoctl-virtual-{user}"))
}

/// Where its log is.
pub fn log_file() -> PathBuf {
    state_file().with_extension("log")
}

/// The address of the virtual drive that runs, if one does. What a killed one has left is cleared away.
pub fn find() -> Option<String> {
    find_at(&state_file())
}

fn find_at(state: &Path) -> Option<String> {
    let mut file = File::open(state).ok()?;
    match file.try_lock_shared() {
        // Held by the drive; where there are no locks, the file has to be believed.
        Err(TryLockError::WouldBlock | TryLockError::Error(_)) => {}
        Ok(()) => {
            let _ = std::fs::remove_file(state);
            return None;
        }
    }
    let mut address = String::new();
    file.read_to_string(&mut address).ok()?;
    Some(format!("tcp://{}", address.trim()))
}

/// For the drive: says at `state` where it is, as long as it keeps what this returns.
///
/// # Errors
/// The file cannot be written or locked.
pub fn publish(state: &Path, address: SocketAddr) -> std::io::Result<File> {
    // Whole and locked, or not at all: somebody may be waiting for it.
    let unfinished = state.with_extension("new");
    let mut file = File::create(&unfinished)?;
    file.lock()?;
    write!(file, "{address}")?;
    std::fs::rename(&unfinished, state)?;
    Ok(file)
}

/// Ends the virtual drive and waits until it has; `false` if there was none.
///
/// # Errors
/// The state file cannot be removed, or the drive goes on without it.
pub fn stop() -> Result<bool> {
    stop_at(&state_file())
}

fn stop_at(state: &Path) -> Result<bool> {
    let file = match File::open(state) {
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(false),
        opened => opened.with_context(|| format!("opening {}", state.display()))?,
    };
    std::fs::remove_file(state).with_context(|| format!("removing {}", state.display()))?;
    // A new one at the same place would keep the old one alive.
    let begun = Instant::now();
    while let Err(TryLockError::WouldBlock) = file.try_lock_shared() {
        ensure!(begun.elapsed() < END, "the virtual drive does not end: its state file {} is gone", state.display());
        std::thread::sleep(Duration::from_millis(10));
    }
    Ok(true)
}

/// Starts the virtual drive in the background, built first if need be, and returns its address. `arguments` go to the program.
///
/// # Errors
/// No workspace and no [`PROGRAM`], a failed build, a drive that does not start.
pub fn start(arguments: &[String]) -> Result<String> {
    let Built { program, elf } = build()?;
    let state = state_file();
    let mut command = Command::new(&program);
    command.arg("--state").arg(&state).arg("--log").arg(log_file()).arg("--elf").arg(&elf).args(arguments);
    command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::piped());
    // Ctrl-C at the terminal is for this program, not for the drive.
    #[cfg(unix)]
    std::os::unix::process::CommandExt::process_group(&mut command, 0);
    let mut child = command.spawn().with_context(|| format!("starting {}", program.display()))?;
    let started = Instant::now();
    loop {
        if let Some(address) = find() {
            eprintln!("virtual drive started: {address} (`servoctl virtual --stop` ends it)");
            return Ok(address);
        }
        if child.try_wait().context("the virtual drive")?.is_some() {
            let complaint = child.stderr.take().and_then(|text| BufReader::new(text).lines().next()?.ok());
            bail!("the virtual drive did not start: {}", complaint.unwrap_or_default());
        }
        ensure!(started.elapsed() < START, "the virtual drive did not start within {} s", START.as_secs());
        std::thread::sleep(Duration::from_millis(20));
    }
}

fn build() -> Result<Built> {
    match (std::env::var_os(PROGRAM), std::env::var_os(ELF)) {
        (Some(program), Some(elf)) => return Ok(Built { program: program.into(), elf: elf.into() }),
        (Some(_), None) => bail!("{PROGRAM} names the virtual drive, but {ELF} does not name its firmware"),
        _ => {}
    }
    let workspace = workspace().with_context(|| {
        format!("no workspace here to build the virtual drive in: go there, or set {PROGRAM} and {ELF}")
    })?;
    eprintln!("building firmware and virtual drive (some ten minutes the first time, nothing later)");
    let mut cargo = Command::new(std::env::var_os("CARGO").unwrap_or("cargo".into()));
    let output = cargo
        .args(["run", "--quiet", "--package", "xtask", "--", "virtual"])
        .current_dir(&workspace)
        .stdin(Stdio::null())
        .stderr(Stdio::inherit())
        .output()
        .context("starting cargo")?;
    ensure!(output.status.success(), "the virtual drive could not be built: `cargo xtask virtual` says why");
    let text = String::from_utf8_lossy(&output.stdout);
    let line = text.lines().last().unwrap_or_default();
    serde_json::from_str(line).with_context(|| format!("`cargo xtask virtual` printed {line:?}"))
}

/// The workspace that this program was started in, by cargo or by a person below it.
fn workspace() -> Option<PathBuf> {
    let by_cargo = std::env::var_os("CARGO_MANIFEST_DIR").map(PathBuf::from);
    let here = by_cargo.or_else(|| std::env::current_dir().ok())?;
    here.ancestors().find(|directory| directory.join("xtask/Cargo.toml").exists()).map(Path::to_owned)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_drive_is_found_while_it_lives_and_what_a_killed_one_left_is_cleared_away() {
        let directory = tempfile::tempdir().unwrap();
        let state = directory.path().join("state");
        assert_eq!(find_at(&state), None);
        let alive = publish(&state, "127.0.0.1:5025".parse().unwrap()).unwrap();
        for _ in 0..2 {
            assert_eq!(find_at(&state).as_deref(), Some("tcp://127.0.0.1:5025"));
        }
        // As the system does it when the process is killed.
        drop(alive);
        assert!(state.exists());
        assert_eq!(find_at(&state), None);
        assert!(!state.exists());
    }

    #[test]
    fn a_drive_is_stopped_when_it_has_ended() {
        let directory = tempfile::tempdir().unwrap();
        let state = directory.path().join("state");
        assert!(!stop_at(&state).unwrap());
        let alive = publish(&state, "127.0.0.1:5025".parse().unwrap()).unwrap();
        let stopper = std::thread::spawn({
            let state = state.clone();
            move || stop_at(&state).unwrap()
        });
        while state.exists() {
            std::thread::sleep(Duration::from_millis(1));
        }
        assert!(!stopper.is_finished());
        drop(alive);
        assert!(stopper.join().unwrap());
    }
}
