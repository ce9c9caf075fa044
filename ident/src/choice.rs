//! Dahl or Maxwell slip: whichever the data need.

use serde::Serialize;

use crate::dahl::{self, DahlFit};
use crate::error::DataError;
use crate::maxwell::{self, MaxwellFit};
use crate::record::Record;

/// Residual of Dahl's model, against that of Maxwell slip, up to which the simpler model is preferred: its two parameters against
/// many.
pub const SIMPLER_UNTIL: f64 = 1.15;

/// A friction model.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Model {
    /// Two parameters, local memory.
    Dahl,
    /// Elements, non-local memory.
    MaxwellSlip,
}

/// Both fits and the choice between them.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Choice {
    /// The better model.
    pub model: Model,
    /// Dahl's.
    pub dahl: DahlFit,
    /// Maxwell slip.
    pub maxwell: MaxwellFit,
    /// Residual of Dahl's model on the samples that Maxwell slip is compared on, N rms.
    pub dahl_rms_n: f64,
}

impl Choice {
    /// σ of the chosen model, N/m: for Maxwell slip half the stiffness of all elements.
    pub fn sigma_n_per_m(&self) -> f64 {
        match self.model {
            Model::Dahl => self.dahl.sigma_n_per_m,
            Model::MaxwellSlip => self.maxwell.sigma_n_per_m(),
        }
    }

    /// F_C of the chosen model, N.
    pub fn coulomb_n(&self) -> f64 {
        match self.model {
            Model::Dahl => self.dahl.coulomb_n,
            Model::MaxwellSlip => self.maxwell.coulomb_n(),
        }
    }
}

/// Fits both models and compares them on the same samples.
///
/// # Errors
/// As for [`dahl::fit`] and [`maxwell::fit`].
///
/// # Source
/// Section 5.5: the simplest model that does; 6.1: a more complex curve wants a more complex model.
pub fn fit(record: &Record, elements: usize) -> Result<Choice, DataError> {
    let dahl = dahl::fit(record)?;
    let maxwell = maxwell::fit(record, elements)?;
    let model_n = dahl.force_n(record);
    let left = record.force_n.iter().zip(&model_n).skip(maxwell.first_sample).map(|(f, m)| (f - m) * (f - m));
    let dahl_rms_n = (left.sum::<f64>() / maxwell.samples as f64).sqrt();
    let simple = dahl_rms_n <= SIMPLER_UNTIL * maxwell.rms_n;
    Ok(Choice { model: if simple { Model::Dahl } else { Model::MaxwellSlip }, dahl, maxwell, dahl_rms_n })
}
