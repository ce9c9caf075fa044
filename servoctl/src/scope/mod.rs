//! The live scope: a page on loopback that shows the drive and, from one browser at a time, commands it.
//!
//! ```text
//! browser ◄── WebSocket ──► server (tokio) ──orders──► drive thread ──► drive
//!    ▲                          ▲                          │
//!    └───────── page            └────────── news ◄─────────┘
//! ```
//! The drive thread alone talks to the drive. Whatever it learns goes to every browser; what a browser wants goes through [`access`],
//! which lets one of them command.

pub mod access;
mod assets;
mod hub;
pub mod news;
mod server;

pub use hub::{Hub, Order};
pub use server::{Settings, serve};
