//! libFuzzer on the BiSS-C decoder; started by `cargo xtask fuzz biss`.
#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| servo_fuzz::biss::check(bytes));
