//! `servoctl faults`: what happened, and its acknowledgement.

use anyhow::Result;
use serde_json::json;
use servo_protocol::message::Request;

use super::super::output::Json;
use super::{Link, black_box};

/// Options of `faults`.
#[derive(Debug, clap::Args)]
pub struct Options {
    /// What to do [default: show the fault]
    #[command(subcommand)]
    action: Option<Action>,
    #[command(flatten)]
    json: Json,
}

#[derive(Debug, clap::Subcommand)]
enum Action {
    /// Acknowledge the fault, whose cause must be gone
    Clear,
    /// Show the first fault since the last acknowledgement
    Last,
    /// Show the ticks around the fault, and whether this program computes the same from what the drive was told
    Blackbox(black_box::Options),
}

/// Shows or acknowledges.
///
/// # Errors
/// A cause that persists; those of the link.
pub fn run(link: &Link, options: &Options) -> Result<()> {
    if let Some(Action::Blackbox(wanted)) = &options.action {
        return black_box::run(link, wanted, &options.json);
    }
    let mut drive = link.connect()?.drive;
    if matches!(options.action, Some(Action::Clear)) {
        drive.order(&Request::ResetFault)?;
    }
    let status = drive.status()?;
    let value = json!({
        "state": status.state.to_string(),
        "fault": status.fault.map(|fault| fault.number()),
        "explanation": status.fault.map(|fault| fault.explanation()),
    });
    options.json.write(&value, || match status.fault {
        None => format!("no fault; {}\n", status.state),
        Some(fault) => format!(
            "fault {}: {}\n  state: {}\n  remove the cause, then `servoctl faults clear`\n",
            fault.number(),
            fault.explanation(),
            status.state
        ),
    })
}
