//! Faults: numbered once, never reused.

/// Why the bridge was turned off. The number is part of the wire and log format; new faults get new numbers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[repr(u16)]
pub enum Fault {
    /// A phase current exceeded its limit in one sample.
    OverCurrent = 1,
    /// Bus voltage above its limit.
    BusOverVoltage = 2,
    /// Bus voltage below its limit while the bridge was on.
    BusUnderVoltage = 3,
    /// The power stage pulled the break input; the timer turned the bridge off by itself.
    BridgeFault = 4,
    /// Three encoder frames in a row missing, broken or marked wrong by the encoder.
    EncoderLost = 6,
    /// The position error exceeded its limit.
    FollowingError = 7,
    /// A servo tick took longer than its limit.
    TickOverrun = 8,
    /// No valid parameters are stored; the drive runs on defaults and will not be enabled.
    ParametersInvalid = 23,
}

impl Fault {
    /// All faults, in order of their numbers.
    pub const ALL: [Fault; 8] = [
        Fault::OverCurrent,
        Fault::BusOverVoltage,
        Fault::BusUnderVoltage,
        Fault::BridgeFault,
        Fault::EncoderLost,
        Fault::FollowingError,
        Fault::TickOverrun,
        Fault::ParametersInvalid,
    ];

    /// The number.
    pub const fn number(self) -> u16 {
        self as u16
    }

    /// CiA 402 error code (object 603F).
    pub const fn cia402_code(self) -> u16 {
        match self {
            Fault::OverCurrent => 0x2310,
            Fault::BusOverVoltage => 0x3210,
            Fault::BusUnderVoltage => 0x3220,
            Fault::BridgeFault => 0x5400,
            Fault::EncoderLost => 0x7300,
            Fault::FollowingError => 0x8611,
            Fault::TickOverrun => 0xff01,
            Fault::ParametersInvalid => 0x6310,
        }
    }

    /// Name and advice for a person.
    pub const fn explanation(self) -> &'static str {
        match self {
            Fault::OverCurrent => {
                "over-current: a phase current exceeded its limit; check motor wiring and current gains"
            }
            Fault::BusOverVoltage => "bus over-voltage: the supply is too high or a braking move pumped it up",
            Fault::BusUnderVoltage => "bus under-voltage: the supply sagged while the bridge was on",
            Fault::BridgeFault => "bridge fault: the power stage pulled the break input",
            Fault::EncoderLost => {
                "encoder lost: three frames in a row missing, broken or marked wrong; check cable and supply"
            }
            Fault::FollowingError => {
                "following error: the stage did not follow; check for an obstacle, gains and limits"
            }
            Fault::TickOverrun => {
                "tick overrun: a servo tick took too long; this is a defect of the firmware, report it"
            }
            Fault::ParametersInvalid => {
                "parameters invalid: none are stored that can be used; set what differs from the defaults, save, and reset the fault"
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The numbers are an ABI: this table may only grow.
    #[test]
    fn numbers_never_change() {
        let numbers = Fault::ALL.map(|f| (f.number(), f.cia402_code()));
        assert_eq!(
            numbers,
            [(1, 0x2310), (2, 0x3210), (3, 0x3220), (4, 0x5400), (6, 0x7300), (7, 0x8611), (8, 0xff01), (23, 0x6310)]
        );
    }
}
