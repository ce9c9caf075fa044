//! The live scope: a page in the browser that shows a drive and commands it.
//!
//! ```text
//! drive ── pilot (a thread) ── hub ── server (a thread) ── pages
//! ```
//! The pilot owns the link and nobody else talks to the drive; orders reach it through a bounded queue, news leave it for all pages,
//! and a page that is too slow loses the oldest, which is counted and shown. One page commands, any page may stop.
//!
//! - [`access`]: who may talk to the server
//! - [`assets`]: the page's files
//! - [`messages`]: what page and server say
//! - [`hub`]: who is there, who commands
//! - [`pilot`]: the drive's thread
//! - [`moves`]: the moves made and their settling
//! - [`server`]: HTTP and WebSocket

use std::net::{SocketAddr, TcpListener};
use std::sync::Arc;
use std::thread::{self, JoinHandle};

use anyhow::{Context, Result, ensure};

pub mod access;
pub mod assets;
pub mod hub;
pub mod messages;
pub mod moves;
pub mod pilot;
pub mod server;

use access::{Access, SHORTEST_TOKEN, random_token};
use hub::Hub;
use pilot::Connect;
use server::Shared;

/// A scope that runs; dropped, it brakes what moves and ends.
pub struct Scope {
    url: String,
    hub: Arc<Hub>,
    end: Option<tokio::sync::oneshot::Sender<()>>,
    threads: Vec<JoinHandle<()>>,
}

impl Scope {
    /// Serves the drive that `connect` reaches at `address` (port 0: any that is free). An address that others can reach needs a
    /// `token`; on loopback there is one of this start's own.
    ///
    /// # Errors
    /// The address cannot be used, or there is no fit token.
    pub fn start(connect: Connect, address: SocketAddr, token: Option<String>) -> Result<Self> {
        let token = fit_token(address, token)?;
        let listener = TcpListener::bind(address).with_context(|| format!("listening at {address}"))?;
        listener.set_nonblocking(true).context("the page's socket")?;
        let access = Access::new(listener.local_addr().context("the page's socket")?, token);
        let url = access.url();
        let runtime =
            tokio::runtime::Builder::new_current_thread().enable_all().build().context("the page's server")?;
        let (hub, orders) = Hub::new();
        let shared = Shared { access: Arc::new(access), hub: hub.clone() };
        let (end, ended) = tokio::sync::oneshot::channel();
        let pilot = {
            let hub = hub.clone();
            thread::spawn(move || pilot::run(&hub, &orders, connect))
        };
        let server = thread::spawn(move || {
            runtime.block_on(async {
                let serve = async {
                    let listener = tokio::net::TcpListener::from_std(listener)?;
                    axum::serve(listener, server::router(shared)).await
                };
                tokio::select! {
                    served = serve => if let Err(error) = served { eprintln!("the page's server ended: {error}") },
                    _ = ended => {}
                }
            });
        });
        Ok(Scope { url, hub, end: Some(end), threads: vec![pilot, server] })
    }

    /// What a person opens in a browser; holds the token.
    pub fn url(&self) -> &str {
        &self.url
    }
}

impl Drop for Scope {
    fn drop(&mut self) {
        self.hub.end();
        if let Some(end) = self.end.take() {
            let _ = end.send(());
        }
        for thread in self.threads.drain(..) {
            let _ = thread.join();
        }
    }
}

fn fit_token(address: SocketAddr, token: Option<String>) -> Result<String> {
    match token {
        Some(token) => {
            let plain = token.chars().all(|c| c.is_ascii_alphanumeric() || c == '-' || c == '_');
            ensure!(
                plain && token.len() >= SHORTEST_TOKEN,
                "a token has at least {SHORTEST_TOKEN} letters, digits, - or _; this one has {} characters",
                token.chars().count()
            );
            Ok(token)
        }
        None => {
            ensure!(address.ip().is_loopback(), "others can reach {address}: give a --token that they must know");
            random_token()
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_loopback_needs_no_token() {
        let fit = |address: &str, token: Option<&str>| fit_token(address.parse().unwrap(), token.map(str::to_owned));
        assert!(fit("127.0.0.1:0", None).is_ok() && fit("[::1]:0", None).is_ok());
        for open in ["0.0.0.0:8080", "192.168.0.7:8080", "[::]:8080"] {
            let refused = fit(open, None).unwrap_err().to_string();
            assert_eq!(refused, format!("others can reach {open}: give a --token that they must know"));
            assert_eq!(fit(open, Some("a-long-enough-token")).unwrap(), "a-long-enough-token");
            for bad in ["short", "", "has spaces in the middle", "has#hash-in-the-middle"] {
                assert!(fit(open, Some(bad)).is_err(), "{bad}");
            }
        }
    }
}
