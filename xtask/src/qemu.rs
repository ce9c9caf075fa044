//! The control core on a bare Cortex-M7 in QEMU: the host's bits, and instruction counts within a budget.
//!
//! The host records a run of the drive on the simulated stage. Two images repeat it: `axis` as the firmware calls the core,
//! `stages` with every part as a function of its own. A plug-in counts the instructions of these functions.

use std::path::Path;
use std::process::Command;

use anyhow::{Context, Result, ensure};
use serde_json::{Value, json};

use crate::toolchain::Toolchain;
use crate::version::Version;
use crate::{embedded, host, process, setup};

mod budget;
mod calls;
mod image;

use budget::Budget;
use calls::Counts;
use image::Image;

/// The digest that host and images must come to.
const GOLDEN: &str = "qemu/golden.txt";

/// The instructions that the control core may take.
const BUDGET: &str = "qemu/budget.toml";

/// The images, by the names of their programs.
const IMAGES: [&str; 2] = ["axis", "stages"];

/// Compares bits and instruction counts with what is agreed upon, and prints the counts.
///
/// # Errors
/// When set-up or a build fails, the bits differ, or a count exceeds its budget.
pub fn run() -> Result<()> {
    let measured = measure()?;
    let golden = read(GOLDEN)?;
    ensure!(
        measured.digest == golden.trim(),
        "the bits have changed; if that is meant: cargo xtask qemu --bless\nagreed:\n{golden}measured:\n{}",
        measured.digest
    );
    let budget = Budget::parse(&read(BUDGET)?).context(BUDGET)?;
    let (table, exceeded) = budget.compare(&measured.counts, measured.rustc)?;
    print!("{table}");
    ensure!(
        exceeded.is_empty(),
        "over budget ({BUDGET}):\n  {}\nif that is meant and below the caps: cargo xtask qemu --bless",
        exceeded.join("\n  ")
    );
    eprintln!("host and images have the agreed bits, and the counts are within the budget");
    Ok(())
}

/// The counts beside their budget, not judged: as a table and as JSON, by image and region.
///
/// # Errors
/// When set-up or a build fails, or host and images differ.
pub fn report() -> Result<(String, Value)> {
    let measured = measure()?;
    let budget = Budget::parse(&read(BUDGET)?).context(BUDGET)?;
    let table = budget.compare(&measured.counts, measured.rustc)?.0;
    Ok((table, json!({ "rustc": measured.rustc.to_string(), "counts": measured.counts.to_json() })))
}

/// Takes bits and counts of now as those agreed upon. Caps stay as they are and still hold.
///
/// # Errors
/// When set-up or a build fails, host and images differ, or a count exceeds its cap.
pub fn bless() -> Result<()> {
    let measured = measure()?;
    let old = read(BUDGET)?;
    let budget = Budget::parse(&old).context(BUDGET)?.measured(&measured.counts, measured.rustc)?;
    let (table, exceeded) = budget.compare(&measured.counts, measured.rustc)?;
    print!("{table}");
    ensure!(exceeded.is_empty(), "nothing was written:\n  {}", exceeded.join("\n  "));
    std::fs::write(GOLDEN, format!("{}\n", measured.digest)).with_context(|| format!("writing {GOLDEN}"))?;
    std::fs::write(BUDGET, budget.rewrite(&old)).with_context(|| format!("writing {BUDGET}"))
}

/// What a run gave.
struct Measured {
    /// Of host and images alike.
    digest: String,
    counts: Counts,
    /// Compiler of the images.
    rustc: Version,
}

fn measure() -> Result<Measured> {
    setup::qemu()?;
    let toolchain = setup::firmware_toolchain()?;
    let directory = embedded::target_dir()?.join("qemu");
    std::fs::create_dir_all(&directory).context("creating the directory of the recording")?;
    let digest = record(&directory.join("recording.bin"))?;
    build_plugin(&directory)?;
    let mut counts = Counts::default();
    for name in IMAGES {
        let image = build_image(&toolchain, name)?;
        let (found, log) = emulate(&image, &directory)?;
        ensure!(found == digest, "image {name} does not have the host's bits\nhost:\n{digest}\nimage:\n{found}");
        ensure!(emulate(&image, &directory)? == (found, log.clone()), "two runs of image {name} differ");
        let calls = calls::parse(&log).with_context(|| format!("image {name}"))?;
        calls::check_calibration(&calls, &image)?;
        counts.add(&calls);
    }
    Ok(Measured { digest, counts, rustc: toolchain.version()? })
}

fn read(file: impl AsRef<Path>) -> Result<String> {
    let file = file.as_ref();
    let name = file.file_name().unwrap_or_default().to_string_lossy().to_string();
    std::fs::read_to_string(file).with_context(|| format!("reading {name}"))
}

/// Writes the recording; returns the digest of the run on the host.
fn record(file: &Path) -> Result<String> {
    // From the whole workspace, so that the crates below it are built as `cargo test` builds them.
    process::run(host::cargo("build").args(["--example", "record"]), "building the recorder")?;
    process::capture(host::cargo("run").args(["--quiet", "--example", "record", "--"]).arg(file), "recording")
}

fn build_plugin(directory: &Path) -> Result<()> {
    let printed = process::capture(Command::new("qemu-system-arm").arg("--version"), "QEMU")?;
    let interface = plugin_interface(Version::find(&printed).context("QEMU prints no version")?);
    let mut compiler = Command::new("cc");
    compiler.args(["-std=c11", "-O2", "-Wall", "-Wextra", "-shared", "-fPIC"]);
    compiler.arg(format!("-DPLUGIN_INTERFACE={interface}"));
    compiler.arg("-o").arg(directory.join("libicount.so")).arg("qemu/plugin/icount.c");
    process::run(&mut compiler, "compiling the counting plug-in")
}

/// The interface that a plug-in must ask for: QEMU 9 refuses the one before.
fn plugin_interface(qemu: Version) -> u32 {
    if qemu < Version::new(9, 0) { 1 } else { 2 }
}

fn build_image(toolchain: &Toolchain, name: &str) -> Result<Image> {
    Image::read(&embedded::build(toolchain, "servo-qemu", name)?)
}

/// Runs an image; returns what it prints and what the plug-in writes.
fn emulate(image: &Image, directory: &Path) -> Result<(String, String)> {
    let log = format!("{}.counts", image.name);
    let regions = image.regions.iter().map(|region| format!(",{}={:x}", region.name, region.address));
    let mut qemu = Command::new("qemu-system-arm");
    // Relative names: a comma in a path would end the plug-in's argument.
    qemu.current_dir(directory).args(["-M", "mps2-an500", "-nographic", "-monitor", "none", "-serial", "none"]);
    qemu.args(["-semihosting-config", "enable=on,target=native", "-icount", "shift=0,sleep=off"]);
    qemu.arg("-plugin").arg(format!("./libicount.so,out={log}{}", regions.collect::<String>()));
    qemu.arg("-kernel").arg(&image.path);
    let printed = process::capture(&mut qemu, &format!("image {} in QEMU", image.name))?;
    Ok((printed, read(directory.join(log))?))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn newer_emulators_get_the_newer_interface() {
        let cases = [((7, 2), 1), ((8, 2), 1), ((9, 0), 2), ((10, 1), 2)];
        for ((major, minor), interface) in cases {
            assert_eq!(plugin_interface(Version::new(major, minor)), interface);
        }
    }
}
