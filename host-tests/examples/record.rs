//! Writes the recording that the images in QEMU read, and prints its digest.
//!
//! `cargo run -p servo-host-tests --example record -- FILE`

use servo_host_tests::golden;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let file = std::env::args_os().nth(1).ok_or("the file to write is missing")?;
    let (ticks, digest) = golden::record()?;
    let bytes: Vec<u8> = ticks.iter().flat_map(|tick| tick.to_bytes()).collect();
    std::fs::write(file, bytes)?;
    print!("{digest}");
    Ok(())
}
