//! A drive at the other end of a line: ports, requests, and what a person does with them.
//!
//! [`Port`] moves bytes, [`Client`] gets each request answered however bad the line is, [`Drive`] is what the commands use.

mod client;
mod drive;
mod error;
mod port;
pub mod units;
pub mod virtual_drive;

pub use client::{Client, Losses, Patience, random_id};
pub use drive::{Capture, Drive};
pub use error::{Error, help};
pub use port::{BAUD, Port, open};
