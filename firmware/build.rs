//! Linker arguments of the firmware. Here and not in `.cargo/config.toml`, because other packages of this workspace are
//! linked in other ways.

use std::env::VarError;

fn main() -> Result<(), VarError> {
    // Asked for at run time: a target directory may outlive the place that this script was compiled in.
    let here = std::env::var("CARGO_MANIFEST_DIR")?;
    println!("cargo:rustc-link-search={here}/..");
    println!("cargo:rerun-if-changed=../memory.x");
    for argument in ["--nmagic", "-Tlink.x", "-Tdefmt.x"] {
        println!("cargo:rustc-link-arg-bins={argument}");
    }
    Ok(())
}
