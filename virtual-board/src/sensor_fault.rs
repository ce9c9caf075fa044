//! Faults of what the converters and the counter see.

/// The code of half the converters' range.
const MID_CODE: i32 = 32_768;

/// A fault of an analogue signal.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum AdcFault {
    /// The converter answers this code whatever the pin carries.
    Stuck {
        /// 16-bit code.
        code: u16,
    },
    /// The signal stays at the value it had when the fault began.
    Frozen,
    /// The wire is off: the amplifier's pull-down holds the input at 0 V.
    Open,
    /// What is left of the signal's swing about mid-range.
    Faded {
        /// Of what it should be.
        percent: u8,
    },
}

/// A fault of the comparators that count an encoder's quarter periods.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CounterFault {
    /// Both comparators stay as they are.
    Stopped,
    /// Once, so many edges are seen that there were not.
    Invented {
        /// Up or down.
        edges: i64,
    },
}

impl AdcFault {
    /// What the converter sees in place of `code`; `before` is what it saw last.
    pub(crate) fn apply(self, code: u16, before: u16) -> u16 {
        match self {
            Self::Stuck { code } => code,
            Self::Frozen => before,
            Self::Open => 0,
            Self::Faded { percent } => (MID_CODE + (i32::from(code) - MID_CODE) * i32::from(percent) / 100) as u16,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_fault_does_what_it_says() {
        for (fault, code, seen) in [
            (AdcFault::Stuck { code: 7 }, 40_000, 7),
            (AdcFault::Frozen, 40_000, 123),
            (AdcFault::Open, 40_000, 0),
            (AdcFault::Faded { percent: 50 }, 65_535, 49_151),
            (AdcFault::Faded { percent: 50 }, 0, 16_384),
            (AdcFault::Faded { percent: 0 }, 65_535, 32_768),
        ] {
            assert_eq!(fault.apply(code, 123), seen, "{fault:?}");
        }
    }
}
