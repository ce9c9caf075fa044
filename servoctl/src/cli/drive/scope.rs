//! `servoctl scope`: the live scope page.

use std::net::SocketAddr;
use std::sync::atomic::Ordering;
use std::thread;
use std::time::Duration;

use anyhow::Result;
use serde_json::json;

use super::super::interrupt;
use super::super::output::Json;
use super::Link;
use crate::scope::{Scope, assets};

/// How soon Ctrl-C is noticed.
const LOOK: Duration = Duration::from_millis(50);

/// Options of `scope`.
#[derive(Debug, clap::Args)]
pub struct Options {
    /// Where to listen; port 0 takes a free one. Anything but loopback needs --token, and is plain HTTP: for a bench network only
    #[arg(long, value_name = "ADDRESS:PORT", default_value = "127.0.0.1:0")]
    bind: SocketAddr,
    /// What the page's address ends with, so that nobody else can command the drive [default: random]
    #[arg(long)]
    token: Option<String>,
    #[command(flatten)]
    json: Json,
}

/// Connects, serves the page and prints its address; Ctrl-C brakes what moves and ends.
///
/// # Errors
/// No drive, no page in this program, an address that cannot be used, a token that is missing or too short.
pub fn run(link: &Link, options: &Options) -> Result<()> {
    assets::complete()?;
    let interrupted = interrupt::flag_saying("braking what moves; Ctrl-C again leaves the drive to itself")?;
    // What is wrong with the first connection is said here, with the later ones on the page.
    let mut first = Some(link.connect()?);
    let link = link.clone();
    let connect = Box::new(move || first.take().map_or_else(|| link.connect(), Ok));
    let scope = Scope::start(connect, options.bind, options.token.clone())?;
    options.json.write(&json!({ "url": scope.url() }), || format!("{}\n", scope.url()))?;
    eprintln!("open this address in a browser on this computer; the first page commands. Ctrl-C ends");
    while !interrupted.load(Ordering::Relaxed) {
        thread::sleep(LOOK);
    }
    drop(scope);
    Ok(())
}
