//! Linker arguments of the images.

use std::env::VarError;

fn main() -> Result<(), VarError> {
    // Asked for at run time: a target directory may outlive the place that this script was compiled in.
    let here = std::env::var("CARGO_MANIFEST_DIR")?;
    println!("cargo:rustc-link-search={here}");
    println!("cargo:rerun-if-changed=memory.x");
    for argument in ["--nmagic", "-Tlink.x"] {
        println!("cargo:rustc-link-arg-bins={argument}");
    }
    Ok(())
}
