//! One tick, written down.

use crate::fault::Fault;
use crate::position::Position;
use crate::state::State;

/// Conditions of a tick, as bits of [`TickRecord::flags`].
pub mod flags {
    /// A profile moves the reference.
    pub const MOVING: u16 = 1 << 0;
    /// The force limit acts: integrators hold.
    pub const FORCE_LIMITED: u16 = 1 << 1;
    /// NIASA's rate limit (8.1) acts.
    pub const RATE_LIMITED: u16 = 1 << 2;
    /// NIASA acts.
    pub const COMPENSATED: u16 = 1 << 3;
    /// This tick's encoder frame was unusable.
    pub const FRAME_BAD: u16 = 1 << 4;
    /// The encoder's warning bit.
    pub const ENCODER_WARNING: u16 = 1 << 5;
    /// The bridge is on.
    pub const BRIDGE_ON: u16 = 1 << 6;
    /// The current loop asks for more voltage than the bus gives.
    pub const VOLTAGE_LIMITED: u16 = 1 << 7;
    /// The motor is being aligned: the current's direction is not that of a force.
    pub const ALIGNING: u16 = 1 << 8;
    /// An excitation acts.
    pub const EXCITED: u16 = 1 << 9;

    /// Limits that act, apart from faults: bit, name, meaning.
    pub const LIMITS: [(u16, &str, &str); 3] = [
        (FORCE_LIMITED, "current limit", "The force asked for is beyond `current_limit_a`; integrators hold."),
        (RATE_LIMITED, "rate limit", "The nonlinear integrator moves by `niasa_rate_limit_n` per tick (8.1)."),
        (VOLTAGE_LIMITED, "voltage limit", "The current loop asks for more than the bus gives; its integrators hold."),
    ];
}

/// Number of 32-bit words of a record.
pub const WORDS: usize = 16;

/// What the drive saw, thought and did in one servo tick.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct TickRecord {
    /// Tick number since start; gaps are lost records.
    pub sequence: u32,
    /// Measured position.
    pub position: Position,
    /// Set-point − position, counts.
    pub error_ct: i32,
    /// Proportional and derivative force, N.
    pub proportional_n: f32,
    /// Force of the linear integrator, N.
    pub integral_n: f32,
    /// Force of the compensator, N.
    pub compensator_n: f32,
    /// Acceleration feedforward, N.
    pub feedforward_n: f32,
    /// Force asked of the motor, N: the sum, limited.
    pub force_n: f32,
    /// Modelled friction, N.
    pub friction_n: f32,
    /// Modelled slope of friction, N/m.
    pub slope_n_per_m: f32,
    /// Current set-point, A.
    pub iq_set_a: f32,
    /// Measured current, A.
    pub iq_a: f32,
    /// Bus voltage, V.
    pub bus_v: f32,
    /// See [`flags`].
    pub flags: u16,
    /// Power state.
    pub state: State,
    /// First fault, if any.
    pub fault: Option<Fault>,
    /// Duration of the previous tick, CPU cycles, saturated.
    pub tick_cycles: u16,
}

impl TickRecord {
    /// The record as words in a fixed order, floats by their bits: what captures store and golden hashes cover.
    pub fn words(&self) -> [u32; WORDS] {
        let fault = self.fault.map_or(0, Fault::number);
        [
            self.sequence,
            self.position.0 as u32,
            (self.position.0 >> 32) as u32,
            self.error_ct as u32,
            self.proportional_n.to_bits(),
            self.integral_n.to_bits(),
            self.compensator_n.to_bits(),
            self.feedforward_n.to_bits(),
            self.force_n.to_bits(),
            self.friction_n.to_bits(),
            self.slope_n_per_m.to_bits(),
            self.iq_set_a.to_bits(),
            self.iq_a.to_bits(),
            self.bus_v.to_bits(),
            u32::from(self.flags) | u32::from(self.tick_cycles) << 16,
            u32::from(fault) | (self.state as u32) << 16,
        ]
    }
}

/// How a word of a record is read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// An unsigned number.
    Unsigned,
    /// A signed number.
    Signed,
    /// A float by its bits.
    Float,
}

impl Kind {
    /// The value of a word.
    pub fn value(self, word: u32) -> f64 {
        match self {
            Kind::Unsigned => f64::from(word),
            Kind::Signed => f64::from(word as i32),
            Kind::Float => f64::from(f32::from_bits(word)),
        }
    }
}

/// Names of the words of a record, in their order, and how they are read. The low word of the position is read as signed: 26 cm of a
/// 61 pm encoder.
pub const COLUMNS: [(&str, Kind); WORDS] = [
    ("tick", Kind::Unsigned),
    ("position_low_ct", Kind::Signed),
    ("position_high_ct", Kind::Signed),
    ("error_ct", Kind::Signed),
    ("proportional_n", Kind::Float),
    ("integral_n", Kind::Float),
    ("compensator_n", Kind::Float),
    ("feedforward_n", Kind::Float),
    ("force_n", Kind::Float),
    ("friction_n", Kind::Float),
    ("slope_n_per_m", Kind::Float),
    ("iq_set_a", Kind::Float),
    ("iq_a", Kind::Float),
    ("bus_v", Kind::Float),
    ("flags_and_tick_cycles", Kind::Unsigned),
    ("fault_and_state", Kind::Unsigned),
];

/// Some words of a record: bit n is the n-th one. Bits beyond [`WORDS`] mean nothing.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Selection(pub u32);

impl Selection {
    /// Error, position and force.
    pub const ERROR_POSITION_FORCE: Selection = Selection(1 << 1 | 1 << 3 | 1 << 8);

    /// The columns with these names; `None` if one has no such name.
    pub fn named<'a>(names: impl IntoIterator<Item = &'a str>) -> Option<Selection> {
        names.into_iter().try_fold(Selection(0), |so_far, name| {
            let at = COLUMNS.iter().position(|(column, _)| *column == name)?;
            Some(Selection(so_far.0 | 1 << at))
        })
    }

    /// Number of words.
    #[inline]
    pub const fn count(self) -> usize {
        (self.0 & ((1 << WORDS) - 1)).count_ones() as usize
    }

    /// No word.
    pub const fn is_empty(self) -> bool {
        self.count() == 0
    }

    /// Their numbers, ascending.
    #[inline]
    pub fn numbers(self) -> impl Iterator<Item = usize> {
        (0..WORDS).filter(move |number| self.0 >> number & 1 != 0)
    }

    /// Their values in `record`.
    #[inline]
    pub fn of(self, record: &TickRecord) -> impl Iterator<Item = u32> {
        let words = record.words();
        words.into_iter().enumerate().filter(move |(number, _)| self.0 >> number & 1 != 0).map(|(_, word)| word)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn columns_are_named_after_the_words_that_they_read() {
        let record = TickRecord { sequence: 9, error_ct: -7, force_n: 1.5, bus_v: 48.0, ..TickRecord::default() };
        let chosen = Selection::named(["tick", "error_ct", "force_n", "bus_v"]).unwrap();
        assert_eq!(chosen.count(), 4);
        let mut values = [0.0; 4];
        for ((value, number), word) in values.iter_mut().zip(chosen.numbers()).zip(chosen.of(&record)) {
            *value = COLUMNS[number].1.value(word);
        }
        assert_eq!(values, [9.0, -7.0, 1.5, 48.0]);
        assert_eq!(Selection::named(["error_ct", "speed"]), None);
        assert_eq!(Selection::named(["position_low_ct", "error_ct", "force_n"]), Some(Selection::ERROR_POSITION_FORCE));
        assert!(Selection(1 << 31).is_empty());
    }

    #[test]
    fn every_field_of_a_record_reaches_its_words() {
        let zero = TickRecord::default();
        let changed = [
            TickRecord { sequence: 1, ..zero },
            TickRecord { position: Position(1), ..zero },
            TickRecord { position: Position(1 << 40), ..zero },
            TickRecord { error_ct: 1, ..zero },
            TickRecord { proportional_n: 1.0, ..zero },
            TickRecord { integral_n: 1.0, ..zero },
            TickRecord { compensator_n: 1.0, ..zero },
            TickRecord { feedforward_n: 1.0, ..zero },
            TickRecord { force_n: 1.0, ..zero },
            TickRecord { friction_n: 1.0, ..zero },
            TickRecord { slope_n_per_m: 1.0, ..zero },
            TickRecord { iq_set_a: 1.0, ..zero },
            TickRecord { iq_a: 1.0, ..zero },
            TickRecord { bus_v: 1.0, ..zero },
            TickRecord { flags: 1, ..zero },
            TickRecord { tick_cycles: 1, ..zero },
            TickRecord { fault: Some(Fault::OverCurrent), ..zero },
            TickRecord { state: State::Fault, ..zero },
        ];
        for (i, a) in changed.iter().enumerate() {
            assert_ne!(a.words(), zero.words(), "change {i}");
            assert!(changed[i + 1..].iter().all(|b| a.words() != b.words()), "change {i} is not told apart");
        }
    }
}
