//! What the drive and its host say to each other.
//!
//! A [`message::Request`] or [`message::Reply`] is serialised by postcard, followed by its CRC-32, made free of zeros by COBS and
//! ended by a zero ([`frame`]). The host numbers its requests; a reply carries the number of its request. What got lost the host
//! sends again with the same number, and the drive carries out a command once however often it arrives ([`server`]).
#![no_std]

pub mod black_box;
pub mod endpoint;
pub mod frame;
pub mod message;
pub mod server;
pub mod stream;
