//! Writes the hand-made inputs of a target into a folder, for the fuzzer to begin with.

use std::path::Path;

fn main() -> std::io::Result<()> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [target, folder] = &arguments[..] else { return Err(std::io::Error::other("which target, and which folder?")) };
    let Some(target) = servo_fuzz::TARGETS.iter().find(|known| known.name == target) else {
        return Err(std::io::Error::other(format!("there is no target {target}")));
    };
    for (number, seed) in (target.seeds)().into_iter().enumerate() {
        std::fs::write(Path::new(folder).join(format!("seed-{number}")), seed)?;
    }
    Ok(())
}
