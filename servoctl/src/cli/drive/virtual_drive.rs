//! `servoctl virtual`: the virtual drive, started and ended by hand.

use std::net::SocketAddr;

use anyhow::{Result, bail, ensure};
use serde_json::json;

use super::super::output::Json;
use crate::link::virtual_drive;

/// Options of `virtual`.
#[derive(Debug, clap::Args)]
pub struct Options {
    /// Where to listen; port 0 takes a free one
    #[arg(long, value_name = "ADDRESS:PORT", default_value = "127.0.0.1:0")]
    listen: SocketAddr,
    /// Listen on an address that other computers reach: anybody there can move the drive
    #[arg(long)]
    any_address: bool,
    /// Stage file (TOML) [default: the stage of the thesis]
    #[arg(long, value_name = "FILE")]
    stage: Option<String>,
    /// Seed of friction and noise
    #[arg(long)]
    seed: Option<u64>,
    /// A new drive, whose parameters nobody has saved
    #[arg(long)]
    blank: bool,
    /// Let time pass while nobody is connected
    #[arg(long)]
    runs_on: bool,
    /// End the one that runs
    #[arg(long)]
    stop: bool,
    #[command(flatten)]
    json: Json,
}

/// Starts a virtual drive in the background and prints its address, or ends it.
///
/// # Errors
/// One runs already; a build that fails.
pub fn run(options: &Options) -> Result<()> {
    if options.stop {
        let ended = virtual_drive::stop()?;
        let words = if ended { "ended\n" } else { "there was none\n" };
        return options.json.write(&json!({ "ended": ended }), || words.to_owned());
    }
    if let Some(address) = virtual_drive::find() {
        bail!("a virtual drive runs at {address}: `servoctl virtual --stop` ends it");
    }
    ensure!(
        options.listen.ip().is_loopback() || options.any_address,
        "--listen {}: other computers can reach this address; --any-address says that they may",
        options.listen
    );
    let mut arguments = vec!["--listen".to_owned(), options.listen.to_string()];
    arguments.extend(options.any_address.then(|| "--any-address".to_owned()));
    if let Some(stage) = &options.stage {
        arguments.extend(["--stage".to_owned(), std::path::absolute(stage)?.display().to_string()]);
    }
    arguments.extend(options.seed.iter().flat_map(|seed| ["--seed".to_owned(), seed.to_string()]));
    arguments.extend(options.blank.then(|| "--blank".to_owned()));
    arguments.extend(options.runs_on.then(|| "--runs-on".to_owned()));
    let address = virtual_drive::start(&arguments)?;
    options.json.write(&json!({ "address": address }), || format!("{address}\n"))
}
