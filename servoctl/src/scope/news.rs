//! What browsers are told and what they ask for, as JSON.

use serde::{Deserialize, Serialize};
use servo_core::parameters::{Access, Settings, TABLE};

use crate::cli::drive::settled::Report;

/// What the drive does now.
#[derive(Clone, Debug, Default, Serialize)]
pub struct State {
    /// Time on the drive's clock, s.
    pub time_s: f64,
    /// Name of the state.
    pub state: String,
    /// Number and explanation of the fault.
    pub fault: Option<(u16, String)>,
    /// The loops are closed.
    pub enabled: bool,
    /// A profile moves the set-point.
    pub moving: bool,
    /// Bus voltage, V.
    pub bus_v: f32,
}

/// Samples of the live traces: columns of equal length.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Live {
    /// Time on the drive's clock, s.
    pub time_s: Vec<f64>,
    /// Measured position, mm.
    pub position_mm: Vec<f64>,
    /// Set-point − position, nm.
    pub error_nm: Vec<f64>,
    /// Force, N.
    pub force_n: Vec<f64>,
}

/// A capture around the end of a move, every fourth tick.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Captured {
    /// Time since the end of the profile, ms.
    pub time_ms: Vec<f64>,
    /// Set-point − position, nm.
    pub error_nm: Vec<f64>,
    /// Position − target, µm.
    pub displacement_um: Vec<f64>,
    /// Force, N.
    pub force_n: Vec<f64>,
}

/// A parameter for the editor.
#[derive(Clone, Debug, Serialize)]
pub struct Parameter {
    name: &'static str,
    value: f64,
    unit: &'static str,
    min: f64,
    max: f64,
    bridge_off: bool,
    doc: &'static str,
}

/// All parameters, in the table's order.
pub fn parameters(settings: &Settings) -> Vec<Parameter> {
    let parameter = |row: &servo_core::parameters::Parameter| Parameter {
        name: row.name,
        value: row.get(settings),
        unit: row.unit,
        min: row.min,
        max: row.max,
        bridge_off: matches!(row.access, Access::BridgeOff),
        doc: row.doc,
    };
    TABLE.iter().map(parameter).collect()
}

/// To browsers.
#[derive(Clone, Debug, Serialize)]
#[serde(tag = "type", rename_all = "snake_case")]
pub enum News {
    /// Who the drive is, and who you are.
    Hello {
        /// Board, firmware, serial number.
        drive: String,
        /// Nothing real moves.
        simulated: bool,
        /// Number of this browser.
        you: u64,
    },
    /// The drive's state.
    State(State),
    /// More of the live traces.
    Live(Live),
    /// A move has settled.
    Settled {
        /// With NIASA or without: the name of the compensator.
        compensator: String,
        /// From and to, mm.
        from_mm: f64,
        /// Target, mm.
        to_mm: f64,
        /// How it settled.
        report: Report,
    },
    /// The capture of that move.
    Captured(Captured),
    /// All parameters.
    Parameters {
        /// In the table's order.
        rows: Vec<Parameter>,
    },
    /// Who commands.
    Commander {
        /// Number of the browser.
        holder: Option<u64>,
    },
    /// An answer to what this browser wanted.
    Answer {
        /// It was done.
        done: bool,
        /// What was done, or why not.
        text: String,
    },
    /// The link broke: nothing more will come.
    Ended {
        /// Why.
        text: String,
    },
}

/// From a browser.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(tag = "do", rename_all = "snake_case", deny_unknown_fields)]
pub enum Wish {
    /// Close the loops.
    Enable,
    /// Bridge off.
    Disable,
    /// Brake.
    Stop,
    /// Acknowledge the fault.
    Clear,
    /// Move; quantities as typed, with units.
    Move {
        /// Target or distance.
        target: String,
        /// The target is a distance.
        #[serde(default)]
        relative: bool,
        /// Acceleration.
        #[serde(default)]
        acceleration: Option<String>,
    },
    /// Set a parameter, value as typed.
    Set {
        /// Name.
        name: String,
        /// Value.
        value: String,
    },
    /// Give the command up.
    Release,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn wishes_are_read_as_the_page_writes_them() {
        let read = |text: &str| serde_json::from_str::<Wish>(text);
        assert_eq!(read(r#"{"do":"stop"}"#).unwrap(), Wish::Stop);
        let Wish::Move { target, relative, acceleration } = read(r#"{"do":"move","target":"5mm"}"#).unwrap() else {
            panic!("no move")
        };
        assert_eq!((target.as_str(), relative, acceleration), ("5mm", false, None));
        for wrong in ["", "{}", r#"{"do":"fly"}"#, r#"{"do":"move"}"#, r#"{"do":"stop","now":1}"#, "[]"] {
            assert!(read(wrong).is_err(), "{wrong}");
        }
    }
}
