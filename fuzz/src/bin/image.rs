//! libFuzzer on the parameter store; started by `cargo xtask fuzz image`.
#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| servo_fuzz::image::check(bytes));
