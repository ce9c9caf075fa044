//! What the drive and its host say to each other.
//!
//! A [`message::Request`] or [`message::Reply`] is serialised by postcard, followed by its CRC-16, made free of zeros by COBS and
//! ended by a zero ([`frame`]). The host numbers its requests; a reply carries the number of its request.
#![no_std]

pub mod black_box;
pub mod frame;
pub mod message;
