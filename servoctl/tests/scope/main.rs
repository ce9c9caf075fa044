//! The scope page as people use it: a real Chromium in front, the drive of core on the simulated stage behind.
//!
//! Tests with a browser need Chromium and the page's plotting library: `cargo xtask test --only scope` brings both.

mod bench_drive;
mod browser;
mod orders;
mod page;
mod socket;
mod strangers;
mod virtual_drive;

use bench_drive::{BenchDrive, Cable};
use servoctl::scope::Scope;

/// A scope of a drive of its own, at any free port on loopback.
fn scope() -> (Scope, Cable) {
    let cable = Cable::default();
    let connect = {
        let cable = cable.clone();
        Box::new(move || BenchDrive::connect(&cable))
    };
    (Scope::start(connect, "127.0.0.1:0".parse().unwrap(), None).unwrap(), cable)
}

/// Address and token of a scope.
fn parts(scope: &Scope) -> (String, String) {
    let (page, token) = scope.url().split_once("/#").unwrap();
    (page.trim_start_matches("http://").to_owned(), token.to_owned())
}
