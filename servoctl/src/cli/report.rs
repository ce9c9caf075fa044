//! `servoctl report`: the thesis beside the simulation, on one page.

use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;

use anyhow::{Context, Result, ensure};

use super::interrupt;
use super::output::Json;
use super::progress::Progress;
use super::stage::read_stage;
use crate::reproduce::experiments::Experiment;
use crate::thesis::page;
use crate::thesis::pictures::Picture;
use crate::thesis::run::{Observer, Request, Size, run as compute};

/// Options of `report`.
#[derive(Debug, clap::Args)]
pub struct Options {
    /// A few dozen moves per configuration: a minute or two [default]
    #[arg(long, conflicts_with = "full")]
    quick: bool,
    /// As many moves as the thesis made
    #[arg(long)]
    full: bool,
    /// Moves per configuration, 1 to 1 000 000, instead of --quick or --full
    #[arg(long, value_name = "N", conflicts_with_all = ["quick", "full"])]
    moves: Option<u64>,
    /// Stage file (TOML) [default: the stage of the thesis]
    #[arg(long, value_name = "FILE")]
    stage: Option<PathBuf>,
    /// Seed of friction and noise
    #[arg(long, value_name = "S", default_value_t = 1)]
    seed: u64,
    /// The page
    #[arg(short, long, value_name = "FILE", default_value = "out/thesis.html")]
    output: PathBuf,
    /// Write the pictures of the read-me into this directory, too
    #[arg(long, value_name = "DIR")]
    pictures: Option<PathBuf>,
    #[command(flatten)]
    json: Json,
}

/// Progress of each part; Ctrl-C.
struct Terminal {
    stop: &'static AtomicBool,
}

impl Observer for Terminal {
    fn begin(&self, part: &str, pieces: u64, unit: &str) -> Box<dyn Fn(u64) + Sync> {
        let progress = Progress::new(part, pieces, unit);
        Box::new(move |pieces| progress.advance(pieces))
    }

    fn stop(&self) -> &AtomicBool {
        self.stop
    }
}

/// Computes, writes the page and prints the comparisons.
///
/// # Errors
/// Options out of range, a wrong stage file, a refusal of the drive, a file that cannot be written.
pub fn run(options: &Options) -> Result<()> {
    let size = match options.moves {
        Some(moves) => {
            ensure!((1..=1_000_000).contains(&moves), "moves = {moves} is outside 1 to 1000000");
            Size::Moves(moves)
        }
        None if options.full => Size::Full,
        None => Size::Quick,
    };
    let stage = read_stage(options.stage.as_deref(), Experiment::Exp1.travel_m())?;
    let mut request = Request { stage, ..Request::new(size, options.seed) };
    if let Some(file) = &options.stage {
        request.stage_name = file.file_name().unwrap_or(file.as_os_str()).to_string_lossy().into_owned();
    }
    let computed = compute(request, &Terminal { stop: interrupt::flag()? })?;
    write(&options.output, &page::render(&computed))?;
    if let Some(directory) = &options.pictures {
        Picture::write_all(&computed.pictures, directory)?;
    }
    options.json.write(&page::json(&computed), || format!("{}\n{}\n", page::text(&computed), options.output.display()))
}

fn write(file: &Path, content: &str) -> Result<()> {
    if let Some(directory) = file.parent() {
        std::fs::create_dir_all(directory).with_context(|| format!("{}: cannot make it", directory.display()))?;
    }
    std::fs::write(file, content).with_context(|| format!("{}: cannot write", file.display()))
}
