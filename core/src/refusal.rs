//! Why the drive did not do what it was told: always with the name, the value and what would have been allowed.

use crate::alignment::Reason;
use crate::encoder::sincos::FitError;
use crate::fault::Fault;
use crate::parameters::Parameter;
use crate::state::State;

/// What a refused value was meant for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Field {
    /// A parameter, by its id in [`crate::parameters::TABLE`].
    Parameter(u16),
    /// Target position of a move, m.
    Target,
    /// Speed limit of a move, m/s.
    Velocity,
    /// Acceleration of a move, m/s².
    Acceleration,
    /// Proportional gain k_P of the parallel form, N/m.
    ProportionalGain,
    /// Integral gain k_I of the parallel form, N/(m s).
    IntegralGain,
    /// Derivative gain k_D of the parallel form, N s/m.
    DerivativeGain,
    /// Number of samples of a capture.
    Samples,
    /// Decimation of a capture.
    Decimation,
    /// Measured bus voltage, V.
    BusVoltage,
    /// Number of signals of a capture.
    Signals,
    /// Number of samples of a capture from before its trigger.
    SamplesBefore,
    /// Jerk of a move, m/s³.
    Jerk,
    /// Amplitude of an excitation, in the unit of what it is added to.
    Amplitude,
    /// Frequency of an excitation, Hz.
    Frequency,
    /// Number of periods of an excitation.
    Periods,
    /// Share of its amplitude that an excitation has decayed to at its end.
    EndShare,
    /// Length of an excitation, s.
    Duration,
    /// Distance that an excitation may move the stage, m.
    Travel,
    /// Current during an excitation, A.
    Current,
}

impl Field {
    /// Name and unit for a person.
    pub fn name(self) -> (&'static str, &'static str) {
        match self {
            Field::Parameter(id) => match Parameter::by_id(id) {
                Some(parameter) => (parameter.name, parameter.unit),
                None => ("unknown parameter", ""),
            },
            Field::Target => ("target", "m"),
            Field::Velocity => ("velocity", "m/s"),
            Field::Acceleration => ("acceleration", "m/s²"),
            Field::ProportionalGain => ("proportional gain", "N/m"),
            Field::IntegralGain => ("integral gain", "N/(m s)"),
            Field::DerivativeGain => ("derivative gain", "N s/m"),
            Field::Samples => ("samples", ""),
            Field::Decimation => ("decimation", ""),
            Field::BusVoltage => ("bus voltage", "V"),
            Field::Signals => ("signals", ""),
            Field::SamplesBefore => ("samples before the trigger", ""),
            Field::Jerk => ("jerk", "m/s³"),
            Field::Amplitude => ("amplitude", ""),
            Field::Frequency => ("frequency", "Hz"),
            Field::Periods => ("periods", ""),
            Field::EndShare => ("end share", ""),
            Field::Duration => ("duration", "s"),
            Field::Travel => ("travel", "m"),
            Field::Current => ("current", "A"),
        }
    }
}

/// A command that was not carried out. Nothing has changed.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Refusal {
    /// A value outside its range (NaN is outside every range).
    OutOfRange {
        /// What it was for.
        field: Field,
        /// The value, in the field's unit.
        value: f64,
        /// Lowest allowed value.
        min: f64,
        /// Highest allowed value.
        max: f64,
    },
    /// No parameter has this id.
    UnknownParameter(u16),
    /// Not in this state.
    WrongState(State),
    /// A motion is running; stop it or wait.
    Moving,
    /// The encoder has no valid position.
    NoPosition,
    /// The drive has a command in hand; send again.
    Busy,
    /// A fault was acknowledged while its cause is still there.
    FaultPersists(Fault),
    /// Parameters are being stored.
    Saving,
    /// No valid parameters are stored.
    NothingStored,
    /// The drive is halted by the controlword.
    Halted,
    /// The motor's electrical zero is not known; why the last alignment failed, if there was one.
    NotAligned(Option<Reason>),
    /// The motor is being aligned.
    Aligning,
    /// The encoder is not one with sine and cosine.
    NoSignals,
    /// Sine and cosine cannot be corrected.
    Signals(FitError),
}

impl Refusal {
    /// `Ok(value)` if `min <= value <= max`, else the refusal that says so.
    pub fn check(field: Field, value: f64, min: f64, max: f64) -> Result<f64, Refusal> {
        if value >= min && value <= max { Ok(value) } else { Err(Refusal::OutOfRange { field, value, min, max }) }
    }
}

impl core::fmt::Display for Refusal {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match *self {
            Refusal::OutOfRange { field, value, min, max } => {
                let (name, unit) = field.name();
                let space = if unit.is_empty() { "" } else { " " };
                write!(f, "{name} = {value}{space}{unit} is outside {min} … {max}{space}{unit}")
            }
            Refusal::UnknownParameter(id) => write!(f, "there is no parameter {id:#06x}"),
            Refusal::WrongState(state) => write!(f, "not possible in state {state}"),
            Refusal::Moving => f.write_str("a motion is running: stop it or wait for its end"),
            Refusal::NoPosition => f.write_str("the encoder gives no valid position"),
            Refusal::FaultPersists(fault) => write!(f, "the cause is still there: {}", fault.explanation()),
            Refusal::Saving => f.write_str("parameters are being saved: wait for its end"),
            Refusal::NothingStored => f.write_str("there are no valid stored parameters: save some first"),
            Refusal::Halted => f.write_str("halted: clear the halt bit of the controlword first"),
            Refusal::NotAligned(None) => f.write_str("the motor is not aligned with this encoder: align it first"),
            Refusal::NotAligned(Some(reason)) => write!(f, "the motor is not aligned: {reason}"),
            Refusal::Aligning => f.write_str("the motor is being aligned: wait for its end, or disable"),
            Refusal::NoSignals => f.write_str("the encoder has no sine and cosine: see encoder_kind"),
            Refusal::Signals(error) => error.fmt(f),
            Refusal::Busy => f.write_str("the drive has not yet taken the last command: send this one again"),
        }
    }
}

impl core::error::Error for Refusal {}

#[cfg(test)]
mod tests {
    extern crate std;
    use super::*;
    use std::string::ToString;

    #[test]
    fn a_refusal_names_field_value_and_range() {
        let refused = Refusal::check(Field::Velocity, f64::NAN, 1e-6, 2.0).unwrap_err();
        assert_eq!(refused.to_string(), "velocity = NaN m/s is outside 0.000001 … 2 m/s");
        assert_eq!(Refusal::check(Field::Velocity, 2.0, 1e-6, 2.0), Ok(2.0));
    }
}
