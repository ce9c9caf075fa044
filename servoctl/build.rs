//! Takes uPlot into the program where `cargo xtask web` has fetched it. Without it everything builds, and the page says what is missing.

use std::path::Path;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    // The folder, which exists in any case: a file that does not would have everything built anew each time.
    println!("cargo:rerun-if-changed=web");
    let fetched = Path::new(&std::env::var("CARGO_MANIFEST_DIR")?).join("web/node_modules/uplot/dist");
    let out = std::env::var("OUT_DIR")?;
    for (from, to) in [("uPlot.iife.min.js", "uplot.js"), ("uPlot.min.css", "uplot.css")] {
        let from = fetched.join(from);
        std::fs::write(Path::new(&out).join(to), std::fs::read(&from).unwrap_or_default())?;
    }
    Ok(())
}
