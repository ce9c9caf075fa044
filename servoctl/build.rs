//! Takes the scope page's plotting library into the program: from `web/vendor`, where `cargo xtask scope` puts it. Without it
//! everything but `servoctl scope` works, and that says what to type.

use std::path::PathBuf;
use std::{env, fs};

fn main() {
    // The whole directory, because a file that is not there would count as changed for ever.
    println!("cargo::rerun-if-changed=web");
    let out = PathBuf::from(env::var_os("OUT_DIR").expect("cargo sets it"));
    for file in ["uPlot.esm.js", "uPlot.min.css"] {
        let text = fs::read_to_string(PathBuf::from("web/vendor").join(file)).unwrap_or_default();
        fs::write(out.join(file), text).expect("the build directory can be written");
    }
}
