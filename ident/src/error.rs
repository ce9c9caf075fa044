//! Why data are refused.

/// Data that a fit does not accept, or that say nothing of what is wanted. `sample` counts from 0.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum DataError {
    /// Fewer samples than a fit needs.
    #[error("samples = {found} is too few: {least} or more are needed")]
    TooFewSamples {
        /// How many there are.
        found: usize,
        /// How many are needed.
        least: usize,
    },
    /// Columns that do not belong together.
    #[error("{field} has {found} samples, time_s has {expected}")]
    Length {
        /// The column.
        field: &'static str,
        /// Its length.
        found: usize,
        /// That of the time.
        expected: usize,
    },
    /// NaN or infinite.
    #[error("{field} = {value} is not a finite number")]
    NotFinite {
        /// The column.
        field: &'static str,
        /// Where.
        sample: usize,
        /// What stands there.
        value: f64,
    },
    /// A sample that is not later than the one before.
    #[error("time_s = {time_s} goes backwards: the sample before has {before_s}")]
    TimeBackwards {
        /// Where.
        sample: usize,
        /// Its time, s.
        time_s: f64,
        /// That of the sample before, s.
        before_s: f64,
    },
    /// Dropped samples.
    #[error(
        "time_s = {time_s}: a gap of {step_s:.9} s before it, dropped samples; the others are {usual_s:.9} s apart"
    )]
    Gap {
        /// The first sample after the gap.
        sample: usize,
        /// Its time, s.
        time_s: f64,
        /// Length of the gap, s.
        step_s: f64,
        /// Median distance of samples, s.
        usual_s: f64,
    },
    /// A stage that stands still, as far as can be told.
    #[error(
        "position_m spans {span_m:e} m: no motion beyond its noise of {noise_m:e} m rms; {least_m:e} m or more are needed"
    )]
    NoMotion {
        /// Highest minus lowest position, m.
        span_m: f64,
        /// Estimated white noise, m rms.
        noise_m: f64,
        /// Span that is needed, m.
        least_m: f64,
    },
    /// Motion that never turns back.
    #[error("position_m has no reversal: the motion has to turn back once or more")]
    NoReversal,
    /// The amplifier was at its limit.
    #[error("current_a = {value_a} is saturated: {samples} samples in a row at this extreme")]
    Saturated {
        /// First sample at the limit.
        sample: usize,
        /// The limit, A.
        value_a: f64,
        /// How many in a row.
        samples: usize,
    },
    /// A force that drives the motion instead of resisting it.
    #[error("{field} = {value} has the wrong sign: the force would drive the motion, {work_j:e} J in the whole record")]
    WrongSign {
        /// `force-constant`, or `force_n` if the force was given.
        field: &'static str,
        /// The force constant, N/A, or the mean force along the motion, N.
        value: f64,
        /// Work against friction, J, below 0.
        work_j: f64,
    },
    /// A parameter that cannot be what it is said to be; NaN is in no range.
    #[error("{field} = {value} is outside {min:?} to {max:?}")]
    OutOfRange {
        /// Which.
        field: &'static str,
        /// Its value.
        value: f64,
        /// Least allowed value.
        min: f64,
        /// Greatest allowed value.
        max: f64,
    },
    /// The data do not determine a result.
    #[error("{what} cannot be told from these data: {why}")]
    Undetermined {
        /// Which result.
        what: &'static str,
        /// What is missing, with its value.
        why: String,
    },
}

impl DataError {
    /// Its kind in words, without values: for counting.
    pub fn kind(&self) -> &'static str {
        match self {
            DataError::TooFewSamples { .. } => "too few samples",
            DataError::Length { .. } => "columns of different length",
            DataError::NotFinite { .. } => "not a finite number",
            DataError::TimeBackwards { .. } => "time goes backwards",
            DataError::Gap { .. } => "dropped samples",
            DataError::NoMotion { .. } => "no motion beyond noise",
            DataError::NoReversal => "no reversal",
            DataError::Saturated { .. } => "saturated current",
            DataError::WrongSign { .. } => "wrong sign of the force",
            DataError::OutOfRange { .. } => "parameter out of range",
            DataError::Undetermined { .. } => "not determined by the data",
        }
    }

    /// The sample it is about, from 0, if it is about one.
    pub fn sample(&self) -> Option<usize> {
        match self {
            DataError::NotFinite { sample, .. }
            | DataError::TimeBackwards { sample, .. }
            | DataError::Gap { sample, .. }
            | DataError::Saturated { sample, .. } => Some(*sample),
            _ => None,
        }
    }
}

/// `value`, if it lies within `min..=max`.
///
/// # Errors
/// [`DataError::OutOfRange`] otherwise, and for NaN.
pub(crate) fn within(field: &'static str, value: f64, min: f64, max: f64) -> Result<f64, DataError> {
    if (min..=max).contains(&value) { Ok(value) } else { Err(DataError::OutOfRange { field, value, min, max }) }
}
