//! `servoctl scope`: the live page.

use std::net::SocketAddr;

use anyhow::{Context, Result};

use super::Link;
use crate::scope::{Hub, Settings, serve};

/// Options of `scope`.
#[derive(Debug, clap::Args)]
pub struct Options {
    /// Where to serve; port 0 takes a free one
    #[arg(long, default_value = "127.0.0.1:0")]
    listen: SocketAddr,
    /// Let other computers in that know this token (at least 16 characters); needed for an address that they reach
    #[arg(long, value_name = "TOKEN")]
    remote_token: Option<String>,
}

/// Serves until Ctrl-C.
///
/// # Errors
/// An address that cannot be served; those of the link.
pub fn run(link: &Link, options: &Options) -> Result<()> {
    let hub = Hub::start(link.connect()?)?;
    let settings = Settings { listen: options.listen, remote_token: options.remote_token.clone() };
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().context("starting the server")?;
    runtime.block_on(async {
        tokio::select! {
            ended = serve(hub.clone(), settings, |address| println!("{address}")) => ended,
            _ = tokio::signal::ctrl_c() => {
                // Nobody is left to stop it.
                let _ = hub.order(crate::scope::news::Wish::Stop).await;
                Ok(())
            }
        }
    })
}
