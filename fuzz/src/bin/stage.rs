//! libFuzzer on the stage file; started by `cargo xtask fuzz stage`.
#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| servo_fuzz::stage::check(bytes));
