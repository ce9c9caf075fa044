//! libFuzzer on the frame parser; started by `cargo xtask fuzz frame`.
#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| servo_fuzz::frame::check(bytes));
