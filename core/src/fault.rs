//! Faults: one table. Numbers are given once and never reused; `docs/faults.md` is made from it.

/// What the drive does when it sees a fault.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Reaction {
    /// Bridge off in the tick that sees it.
    Off,
    /// The same, unless `fault_reaction_option` asks to brake first: position, current and supply can still be trusted.
    MayBrake,
}

macro_rules! faults {
    ($($number:literal $name:ident $code:literal $reaction:ident $detection:literal, $title:literal, $cause:literal, $advice:literal;)+) => {
        /// Why the bridge was turned off. The number is part of the wire and log format; new faults get new numbers.
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        #[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
        #[cfg_attr(feature = "defmt", derive(defmt::Format))]
        #[repr(u16)]
        pub enum Fault {
            $(#[doc = $cause] $name = $number,)+
        }

        impl Fault {
            /// All faults, in order of their declaration, which is that of the wire.
            pub const ALL: &'static [Fault] = &[$(Fault::$name,)+];

            /// CiA 402 error code (object 603F); 0xff.. where the standard has none.
            pub const fn cia402_code(self) -> u16 {
                match self { $(Fault::$name => $code,)+ }
            }

            /// What the drive does.
            #[inline]
            pub const fn reaction(self) -> Reaction {
                match self { $(Fault::$name => Reaction::$reaction,)+ }
            }

            /// How long after its cause it is seen.
            pub const fn detection(self) -> &'static str {
                match self { $(Fault::$name => $detection,)+ }
            }

            /// Name for a person.
            pub const fn title(self) -> &'static str {
                match self { $(Fault::$name => $title,)+ }
            }

            /// What it means.
            pub const fn cause(self) -> &'static str {
                match self { $(Fault::$name => $cause,)+ }
            }

            /// What to do about it.
            pub const fn advice(self) -> &'static str {
                match self { $(Fault::$name => $advice,)+ }
            }

            /// Name, meaning and advice for a person.
            pub const fn explanation(self) -> &'static str {
                match self { $(Fault::$name => concat!($title, ": ", $cause, " ", $advice),)+ }
            }
        }
    };
}

// Order is the wire format.
faults! {
    1 OverCurrent 0x2310 Off "1 PWM period", "over-current",
        "A phase current exceeded its limit in one sample.", "Check motor wiring and current gains.";
    2 BusOverVoltage 0x3210 Off "1 sample of the bus, one per tick", "bus over-voltage",
        "The bus voltage is above its limit.", "The supply is too high, or a braking move pumped it up.";
    3 BusUnderVoltage 0x3220 Off "1 sample of the bus, one per tick", "bus under-voltage",
        "The bus voltage sagged below its limit while the bridge was on.", "Check the supply and its wiring.";
    4 BridgeFault 0x5400 Off "0 (hardware), told in the next tick", "bridge fault",
        "The power stage pulled the break input; the timer turned the bridge off by itself.",
        "Look at the power stage's own fault indication.";
    6 EncoderLost 0x7300 Off "3 frames", "encoder lost",
        "Three encoder frames in a row were unusable, the third because nothing came.", "Check cable and supply of the encoder.";
    7 FollowingError 0x8611 Off "1 tick", "following error",
        "The position error exceeded its limit.", "Check for an obstacle, gains and limits.";
    8 TickOverrun 0xff01 Off "1 tick", "tick overrun",
        "A servo tick took longer than its limit.", "This is a defect of the firmware: report it.";
    23 ParametersInvalid 0x6310 Off "at start", "parameters invalid",
        "No valid parameters are stored; the drive runs on defaults and will not be enabled.",
        "Set what differs from the defaults, save, and reset the fault.";
    5 OverTemperature 0x4310 MayBrake "16 ticks and 4", "over-temperature",
        "The power stage is hotter than its limit.", "Let it cool; check heat sink and load.";
    9 EncoderChecksum 0x7300 Off "3 frames", "encoder checksum",
        "Three encoder frames in a row were unusable, the third by its checksum.", "Check shielding and termination of the encoder line.";
    10 EncoderErrorBit 0x7300 Off "3 frames", "encoder error bit",
        "Three encoder frames in a row were unusable, the third because the encoder marks its position as wrong.",
        "Clean scale and reading head; check their alignment.";
    11 EncoderFrozen 0x7300 Off "1 to 3 repeated frames in motion, encoder_frozen_ticks at rest", "encoder frozen",
        "The encoder repeats one reading to the count.", "The encoder has hung: cycle its supply.";
    12 EncoderJump 0x7300 Off "1 frame, also after lost ones", "encoder jump",
        "The speed changed by more from tick to tick than the motor can make it.", "Clean the scale; after a collision, look for damage.";
    14 MotorOverload 0x2350 MayBrake "4 ticks, after the thermal model", "motor overload (i²t)",
        "The mean square of the current is above that of the continuous current.", "Less load, slower moves or longer pauses.";
    15 Overspeed 0x8400 Off "up to 6 ticks", "overspeed",
        "The stage is faster than its limit.", "Check limit, gains and commutation.";
    16 Runaway 0x8500 Off "up to 8 ticks", "runaway",
        "The stage departs from its set-point faster than its limit.", "Check commutation and gains; look for an external force.";
    17 WrongCommutation 0x7122 Off "12 to 16 ticks, with the force above commutation_check_n", "acceleration against the force",
        "For three windows of 4 ticks the stage moved and accelerated against a force that is too large for friction.",
        "Commutation or encoder direction is wrong, or something stronger pushes: align the motor anew.";
    18 PositionLimit 0x8612 Off "4 ticks", "position limit",
        "The stage is further outside of its travel than the margin.", "Move it back by hand; check travel and origin.";
    19 CommandTimeout 0x7500 MayBrake "4 ticks after command_timeout_s", "command time-out",
        "Nothing came from the host for longer than its limit while the bridge was on.", "Check the host and its line.";
    20 TaskHung 0x6010 Off "1 tick after 100 ms", "task hung",
        "A task of the firmware did not check in for 100 ms; the watchdog is no longer fed.",
        "This is a defect of the firmware: report it with the black box.";
    21 StackLow 0xff02 Off "up to 100 ms", "stack low",
        "The stack has come within 2 KiB of its end.", "This is a defect of the firmware: report it.";
    22 Panic 0x6100 Off "0, told after the reset", "panic",
        "The firmware ended in a panic or a processor fault and started again.", "Report the message in the log with the black box.";
    24 WatchdogReset 0x6010 Off "50 ms (watchdog), told after the reset", "watchdog reset",
        "The watchdog restarted the processor.", "This is a defect of the firmware: report it with the black box.";
    26 CurrentFrozen 0x5400 Off "encoder_frozen_ticks and 1: 10 ms", "current reading frozen",
        "A phase current reads the same to the last bit, without even noise: its sensor or converter has stopped.", "Check the current sensors and their supply.";
    13 EncoderSignal 0x7300 Off "3 samples", "encoder signal",
        "For three samples in a row sine and cosine left their amplitude window, or their counter did not agree with them.",
        "Clean scale and reading head; check their distance, cable and supply.";
    25 Alignment 0x7122 Off "1 tick after the cause; up to 7 s after the start", "alignment",
        "The motor's electrical zero was not found.", "Enabling is refused with the reason: see there.";
    27 TemperatureSensor 0x7300 MayBrake "16 ticks and 4", "temperature sensor",
        "With the bridge on, the temperature read as it does without a sensor.", "Check the temperature sensor and its wire.";
}

impl Fault {
    /// The number.
    #[inline]
    pub const fn number(self) -> u16 {
        self as u16
    }

    /// The fault of a number.
    pub fn by_number(number: u16) -> Option<Fault> {
        Fault::ALL.iter().copied().find(|fault| fault.number() == number)
    }
}

#[cfg(test)]
mod tests {
    extern crate std;
    use super::*;
    use std::collections::BTreeSet;

    /// The numbers are an ABI: this table may only grow.
    #[test]
    fn numbers_never_change() {
        let expected = [
            (1, 0x2310),
            (2, 0x3210),
            (3, 0x3220),
            (4, 0x5400),
            (6, 0x7300),
            (7, 0x8611),
            (8, 0xff01),
            (23, 0x6310),
            (5, 0x4310),
            (9, 0x7300),
            (10, 0x7300),
            (11, 0x7300),
            (12, 0x7300),
            (14, 0x2350),
            (15, 0x8400),
            (16, 0x8500),
            (17, 0x7122),
            (18, 0x8612),
            (19, 0x7500),
            (20, 0x6010),
            (21, 0xff02),
            (22, 0x6100),
            (24, 0x6010),
            (26, 0x5400),
            (13, 0x7300),
            (25, 0x7122),
            (27, 0x7300),
        ];
        assert_eq!(Fault::ALL.len(), expected.len());
        for (fault, (number, code)) in Fault::ALL.iter().zip(expected) {
            assert_eq!((fault.number(), fault.cia402_code()), (number, code), "{fault:?}");
        }
    }

    #[test]
    fn no_number_or_name_is_used_twice_and_none_is_zero() {
        let numbers: BTreeSet<u16> = Fault::ALL.iter().map(|fault| fault.number()).collect();
        let titles: BTreeSet<&str> = Fault::ALL.iter().map(|fault| fault.title()).collect();
        assert_eq!((numbers.len(), titles.len()), (Fault::ALL.len(), Fault::ALL.len()));
        assert!(!numbers.contains(&0));
        assert!(numbers.iter().all(|number| Fault::by_number(*number).is_some_and(|f| f.number() == *number)));
        assert_eq!(Fault::by_number(28), None);
    }

    #[test]
    fn what_makes_position_current_or_supply_doubtful_never_brakes_first() {
        let brakes: std::vec::Vec<_> = Fault::ALL.iter().filter(|f| f.reaction() == Reaction::MayBrake).collect();
        let harmless = [Fault::OverTemperature, Fault::MotorOverload, Fault::CommandTimeout, Fault::TemperatureSensor];
        assert!(brakes.into_iter().eq(&harmless), "{harmless:?}");
    }
}
