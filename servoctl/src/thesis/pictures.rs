//! The pictures of the read-me: a few plots of the page as files of their own.

use std::path::Path;

use anyhow::{Context, Result};

use super::sections::settling::settling_plot;
use super::sections::theory_mass::Comparison;
use super::sections::traces::{Traces, error_plot};
use crate::plot::Plot;
use crate::reproduce::outcome::Run;

/// A picture with the name of its file.
#[derive(Debug, Clone, PartialEq)]
pub struct Picture {
    /// Name of the file, without directory.
    pub file: &'static str,
    /// The picture.
    pub plot: Plot,
}

impl Picture {
    /// Figure 51: a friction observer with a model ten per cent too stiff, and NIASA.
    pub fn of_theory(comparisons: &[Comparison]) -> Option<Picture> {
        let comparison = comparisons.iter().find(|c| c.delta == -0.1)?;
        Some(Picture { file: "stiffer-model.svg", plot: comparison.plot.clone() })
    }

    /// Mean settling time per tolerance; the last 100 nm of some moves with PID and with NIASA.
    pub fn of_first_experiment(run: &Run, traces: &[Traces]) -> Vec<Picture> {
        let mut pictures = vec![Picture { file: "settling-time.svg", plot: settling_plot(run) }];
        if let [pid, niasa] = traces {
            let mut plot = error_plot(pid, 300.0, 100.0);
            plot.description = "Position error after the move, with PID and with NIASA".to_owned();
            plot.series.extend(error_plot(niasa, 300.0, 100.0).series);
            pictures.push(Picture { file: "settling.svg", plot });
        }
        pictures
    }

    /// Writes pictures into a directory, which is made if it does not exist.
    ///
    /// # Errors
    /// A file that cannot be written, with its name.
    pub fn write_all(pictures: &[Picture], directory: &Path) -> Result<()> {
        std::fs::create_dir_all(directory).with_context(|| format!("{}: cannot make it", directory.display()))?;
        for picture in pictures {
            let file = directory.join(picture.file);
            std::fs::write(&file, picture.plot.svg_file())
                .with_context(|| format!("{}: cannot write", file.display()))?;
        }
        Ok(())
    }
}
