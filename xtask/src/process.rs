//! Running other programs: streamed output, a sign of life while they are silent, errors that name the command.

use std::io::{BufRead, BufReader, IsTerminal, Read, Write};
use std::process::{Command, Stdio};
use std::sync::mpsc::{self, RecvTimeoutError};
use std::thread;
use std::time::{Duration, Instant};

use anyhow::{Context, Result, bail};

/// Longest silence on a pipe: after it a line says that the program still runs.
const HEARTBEAT: Duration = Duration::from_secs(10);

/// Words that begin cargo's own status lines. On a pipe they are folded into the heartbeat.
const ACTIVITIES: [&str; 10] = [
    "Compiling",
    "Checking",
    "Documenting",
    "Downloading",
    "Downloaded",
    "Updating",
    "Locking",
    "Adding",
    "Blocking",
    "Fresh",
];

/// Runs `command` to its end and shows what it prints.
///
/// On a terminal the program owns the screen (cargo draws its own progress). On a pipe its lines are passed on, cargo's
/// status lines are held back, and after 10 s of silence a line gives the elapsed time and the last status.
///
/// # Errors
/// When the program cannot be started or ends with anything but success; the message names `label`.
pub fn run(command: &mut Command, label: &str) -> Result<()> {
    let status = if std::io::stderr().is_terminal() {
        command.status().with_context(|| cannot_start(command, label))?
    } else {
        run_on_pipe(command, label)?
    };
    if !status.success() {
        bail!("{label} failed ({status})");
    }
    Ok(())
}

/// Runs `command` silently and returns its standard output without surrounding white space.
///
/// # Errors
/// When the program cannot be started or fails; the message ends with the last line of its standard error.
pub fn capture(command: &mut Command, label: &str) -> Result<String> {
    let output = command.stdin(Stdio::null()).output().with_context(|| cannot_start(command, label))?;
    if !output.status.success() {
        let stderr = String::from_utf8_lossy(&output.stderr);
        let reason = stderr.trim().lines().last().unwrap_or_default().to_string();
        bail!("{label} failed ({}): {reason}", output.status);
    }
    Ok(String::from_utf8_lossy(&output.stdout).trim().to_string())
}

/// Whether `command` can be run at all and succeeds; its output is discarded.
pub fn succeeds(command: &mut Command) -> bool {
    command
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .status()
        .is_ok_and(|status| status.success())
}

/// Elapsed time for people: `7.3 s`, `4 min 05 s`.
pub fn elapsed(time: Duration) -> String {
    let seconds = time.as_secs();
    if seconds < 60 {
        format!("{:.1} s", time.as_secs_f64())
    } else {
        format!("{} min {:02} s", seconds / 60, seconds % 60)
    }
}

fn cannot_start(command: &Command, label: &str) -> String {
    let program = command.get_program().to_string_lossy();
    format!("{label}: `{program}` cannot be started")
}

enum Line {
    Out(String),
    Err(String),
}

fn run_on_pipe(command: &mut Command, label: &str) -> Result<std::process::ExitStatus> {
    let start = Instant::now();
    let mut child =
        command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().with_context(|| cannot_start(command, label))?;
    let (send, lines) = mpsc::channel();
    if let Some(stdout) = child.stdout.take() {
        forward(stdout, send.clone(), Line::Out);
    }
    if let Some(stderr) = child.stderr.take() {
        forward(stderr, send, Line::Err);
    }
    let mut activity = None;
    let mut deadline = start + HEARTBEAT;
    loop {
        match lines.recv_timeout(deadline.saturating_duration_since(Instant::now())) {
            Ok(Line::Err(line)) if cargo_activity(&line).is_some() => {
                activity = cargo_activity(&line);
                continue; // silent: the heartbeat keeps its pace
            }
            // A reader that has gone (`| head`) is no reason to stop.
            Ok(Line::Out(line)) => drop(writeln!(std::io::stdout(), "{line}")),
            Ok(Line::Err(line)) => eprintln!("{line}"),
            Err(RecvTimeoutError::Timeout) => {
                eprintln!("{}", heartbeat(label, start.elapsed(), activity.as_deref()))
            }
            Err(RecvTimeoutError::Disconnected) => break,
        }
        deadline = Instant::now() + HEARTBEAT;
    }
    child.wait().with_context(|| format!("{label}: lost the process"))
}

fn forward(pipe: impl Read + Send + 'static, send: mpsc::Sender<Line>, wrap: fn(String) -> Line) {
    thread::spawn(move || {
        let mut pipe = BufReader::new(pipe);
        let mut bytes = Vec::new();
        while pipe.read_until(b'\n', &mut bytes).is_ok_and(|count| count > 0) {
            let line = String::from_utf8_lossy(&bytes).trim_end().to_string();
            bytes.clear();
            if send.send(wrap(line)).is_err() {
                break;
            }
        }
    });
}

fn heartbeat(label: &str, time: Duration, activity: Option<&str>) -> String {
    let last = activity.map_or_else(String::new, |activity| format!(", last: {activity}"));
    format!("    ... {label}, {} s{last}", time.as_secs())
}

/// What cargo says it is doing, or `None` for any other line: `   Compiling libm v0.2.16 (path)` is `compiling libm`.
fn cargo_activity(line: &str) -> Option<String> {
    let mut words = line.split_whitespace();
    let verb = words.next().filter(|verb| line.starts_with(' ') && ACTIVITIES.contains(verb))?;
    let object = words.next().unwrap_or_default();
    Some(format!("{} {object}", verb.to_lowercase()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cargo_status_lines_are_told_from_messages() {
        let cases = [
            ("   Compiling libm v0.2.16", Some("compiling libm")),
            ("    Checking xtask v0.1.0 (/somewhere)", Some("checking xtask")),
            ("    Blocking waiting for file lock on build directory", Some("blocking waiting")),
            ("    Finished `dev` profile in 3.2s", None),
            ("     Running unittests src/lib.rs", None),
            ("warning: unused variable", None),
            ("Compiling a program's own message", None),
            ("", None),
        ];
        for (line, expected) in cases {
            assert_eq!(cargo_activity(line).as_deref(), expected, "{line:?}");
        }
    }

    #[test]
    fn a_heartbeat_names_the_step_the_time_and_the_last_crate() {
        let time = Duration::from_secs(40);
        assert_eq!(heartbeat("firmware", time, Some("compiling libm")), "    ... firmware, 40 s, last: compiling libm");
        assert_eq!(heartbeat("firmware", time, None), "    ... firmware, 40 s");
    }

    #[test]
    fn times_read_naturally() {
        assert_eq!(elapsed(Duration::from_millis(7_340)), "7.3 s");
        assert_eq!(elapsed(Duration::from_secs(245)), "4 min 05 s");
    }

    #[test]
    fn failures_name_the_step_and_the_reason() {
        let missing = capture(&mut Command::new("no-such-program-here"), "looking").unwrap_err();
        assert_eq!(missing.to_string(), "looking: `no-such-program-here` cannot be started");
        let failing =
            capture(Command::new("sh").args(["-c", "echo first >&2; echo why >&2; exit 3"]), "trying").unwrap_err();
        assert_eq!(failing.to_string(), "trying failed (exit status: 3): why");
        assert_eq!(capture(Command::new("sh").args(["-c", "echo ' yes '"]), "asking").unwrap(), "yes");
    }
}
