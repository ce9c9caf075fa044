//! The power state machine of CiA 402 (IEC 61800-7-201): states, controlword, statusword, and one pure function from state and
//! inputs to the next state.

/// States by their CiA 402 names.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[repr(u8)]
pub enum State {
    /// Before the first tick.
    #[default]
    NotReadyToSwitchOn = 0,
    /// Waiting; bridge off.
    SwitchOnDisabled = 1,
    /// Supply wanted; bridge off.
    ReadyToSwitchOn = 2,
    /// Ready; bridge off.
    SwitchedOn = 3,
    /// Loops closed, bridge on.
    OperationEnabled = 4,
    /// Braking, or held at rest after it; loops closed, bridge on.
    QuickStopActive = 5,
    /// A fault was seen. The bridge is off, unless the fault is one that may brake first and the drive is set to do so.
    FaultReactionActive = 6,
    /// Latched until reset; bridge off.
    Fault = 7,
}

impl State {
    /// All states.
    pub const ALL: [State; 8] = [
        State::NotReadyToSwitchOn,
        State::SwitchOnDisabled,
        State::ReadyToSwitchOn,
        State::SwitchedOn,
        State::OperationEnabled,
        State::QuickStopActive,
        State::FaultReactionActive,
        State::Fault,
    ];

    /// The loops are closed, unless a fault reaction has opened them.
    #[inline]
    pub const fn has_torque(self) -> bool {
        matches!(self, State::OperationEnabled | State::QuickStopActive)
    }

    /// Bits 0 to 3, 5 and 6 of the statusword.
    pub const fn status_bits(self) -> u16 {
        match self {
            State::NotReadyToSwitchOn => 0x00,
            State::SwitchOnDisabled => 0x40,
            State::ReadyToSwitchOn => 0x21,
            State::SwitchedOn => 0x23,
            State::OperationEnabled => 0x27,
            State::QuickStopActive => 0x07,
            State::FaultReactionActive => 0x0f,
            State::Fault => 0x08,
        }
    }
}

impl core::fmt::Display for State {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str(match self {
            State::NotReadyToSwitchOn => "Not ready to switch on",
            State::SwitchOnDisabled => "Switch on disabled",
            State::ReadyToSwitchOn => "Ready to switch on",
            State::SwitchedOn => "Switched on",
            State::OperationEnabled => "Operation enabled",
            State::QuickStopActive => "Quick stop active",
            State::FaultReactionActive => "Fault reaction active",
            State::Fault => "Fault",
        })
    }
}

/// What the controlword asks of the state machine.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum Request {
    /// Bridge off, whatever it takes.
    #[default]
    DisableVoltage,
    /// Be ready to switch on.
    Shutdown,
    /// Be switched on; from Operation enabled: disable operation.
    SwitchOn,
    /// Close the loops.
    EnableOperation,
    /// Brake on the quick-stop ramp.
    QuickStop,
}

impl Request {
    /// All requests.
    pub const ALL: [Request; 5] =
        [Request::DisableVoltage, Request::Shutdown, Request::SwitchOn, Request::EnableOperation, Request::QuickStop];

    /// The request that leads one state nearer to Operation enabled.
    pub const fn towards_enabled(state: State) -> Request {
        match state {
            State::NotReadyToSwitchOn | State::SwitchOnDisabled => Request::Shutdown,
            State::ReadyToSwitchOn => Request::SwitchOn,
            _ => Request::EnableOperation,
        }
    }
}

/// The controlword (object 6040).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct ControlWord(pub u16);

impl ControlWord {
    /// Bits 0 to 3 as the standard's table of commands reads them.
    pub const fn request(self) -> Request {
        match self.0 & 0b1111 {
            bits if bits & 0b0010 == 0 => Request::DisableVoltage,
            bits if bits & 0b0100 == 0 => Request::QuickStop,
            bits if bits & 0b0001 == 0 => Request::Shutdown,
            bits if bits & 0b1000 == 0 => Request::SwitchOn,
            _ => Request::EnableOperation,
        }
    }

    /// Bit 7. A fault is acknowledged where it rises from one controlword to the next.
    pub const fn fault_reset(self) -> bool {
        self.0 & 1 << 7 != 0
    }

    /// Bit 8: brake and hold in Operation enabled.
    pub const fn halt(self) -> bool {
        self.0 & 1 << 8 != 0
    }
}

/// Bits of the statusword (object 6041) besides those of the state.
pub mod status {
    /// The bus voltage is within its limits.
    pub const VOLTAGE_ENABLED: u16 = 1 << 4;
    /// The encoder warns.
    pub const WARNING: u16 = 1 << 7;
    /// The drive obeys the controlword: always.
    pub const REMOTE: u16 = 1 << 9;
    /// Inside the position window for the window time, or at rest after a halt.
    pub const TARGET_REACHED: u16 = 1 << 10;
    /// A limit of force, voltage or rate acts.
    pub const INTERNAL_LIMIT: u16 = 1 << 11;
    /// The latched fault is a following error.
    pub const FOLLOWING_ERROR: u16 = 1 << 13;
}

/// What decides the next state.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Inputs {
    /// From the controlword.
    pub request: Request,
    /// A fault is present in this tick.
    pub fault: bool,
    /// The user acknowledged the fault in this tick.
    pub reset: bool,
    /// Position and supply are there, so that the loops may be closed.
    pub ready: bool,
    /// Nothing has to be braked before the bridge goes off: the motion is at rest, or no option asks for a ramp.
    pub released: bool,
    /// Quick stop ends in Quick stop active, from where Operation enabled can be asked for, and not in Switch on disabled (option codes 5
    /// and 6).
    pub stays_stopped: bool,
}

/// The state after this tick. Numbers are those of the transitions in the standard's figure.
#[inline]
pub const fn next(state: State, inputs: Inputs) -> State {
    use Request::*;
    use State::*;
    let Inputs { request, fault, reset, ready, released, stays_stopped } = inputs;
    match (state, request) {
        (Fault, _) if reset && !fault => SwitchOnDisabled, // 15
        (Fault, _) => Fault,
        (FaultReactionActive, _) if released => Fault, // 14
        (FaultReactionActive, _) => FaultReactionActive,
        _ if fault => FaultReactionActive,           // 13
        (NotReadyToSwitchOn, _) => SwitchOnDisabled, // 1

        (SwitchOnDisabled, Shutdown) => ReadyToSwitchOn, // 2
        (SwitchOnDisabled, _) => SwitchOnDisabled,

        (ReadyToSwitchOn, SwitchOn | EnableOperation) => SwitchedOn, // 3
        (ReadyToSwitchOn, DisableVoltage | QuickStop) => SwitchOnDisabled, // 7
        (ReadyToSwitchOn, Shutdown) => ReadyToSwitchOn,

        (SwitchedOn, EnableOperation) if ready => OperationEnabled, // 4
        (SwitchedOn, Shutdown) => ReadyToSwitchOn,                  // 6
        (SwitchedOn, DisableVoltage | QuickStop) => SwitchOnDisabled, // 10
        (SwitchedOn, SwitchOn | EnableOperation) => SwitchedOn,

        (OperationEnabled, SwitchOn) if released => SwitchedOn, // 5
        (OperationEnabled, Shutdown) if released => ReadyToSwitchOn, // 8
        (OperationEnabled, DisableVoltage) => SwitchOnDisabled, // 9
        (OperationEnabled, QuickStop) => QuickStopActive,       // 11
        (OperationEnabled, _) => OperationEnabled,

        (QuickStopActive, DisableVoltage) => SwitchOnDisabled, // 12
        (QuickStopActive, EnableOperation) if stays_stopped => OperationEnabled, // 16
        (QuickStopActive, _) if released && !stays_stopped => SwitchOnDisabled, // 12
        (QuickStopActive, _) => QuickStopActive,
    }
}

#[cfg(test)]
mod tests {
    extern crate std;
    use super::*;
    use std::vec::Vec;

    fn all_inputs() -> impl Iterator<Item = Inputs> {
        Request::ALL.into_iter().flat_map(|request| {
            (0..32).map(move |i| Inputs {
                request,
                fault: i & 1 != 0,
                reset: i & 2 != 0,
                ready: i & 4 != 0,
                released: i & 8 != 0,
                stays_stopped: i & 16 != 0,
            })
        })
    }

    /// The standard's figure as a list of arrows: from, to, and when. What no arrow leaves stays.
    type Arrow = (State, State, fn(&Inputs) -> bool);
    const ARROWS: &[Arrow] = {
        use Request::*;
        use State::*;
        &[
            (NotReadyToSwitchOn, SwitchOnDisabled, |i| !i.fault),
            (SwitchOnDisabled, ReadyToSwitchOn, |i| !i.fault && i.request == Shutdown),
            (ReadyToSwitchOn, SwitchedOn, |i| !i.fault && matches!(i.request, SwitchOn | EnableOperation)),
            (ReadyToSwitchOn, SwitchOnDisabled, |i| !i.fault && matches!(i.request, DisableVoltage | QuickStop)),
            (SwitchedOn, OperationEnabled, |i| !i.fault && i.request == EnableOperation && i.ready),
            (SwitchedOn, ReadyToSwitchOn, |i| !i.fault && i.request == Shutdown),
            (SwitchedOn, SwitchOnDisabled, |i| !i.fault && matches!(i.request, DisableVoltage | QuickStop)),
            (OperationEnabled, SwitchedOn, |i| !i.fault && i.request == SwitchOn && i.released),
            (OperationEnabled, ReadyToSwitchOn, |i| !i.fault && i.request == Shutdown && i.released),
            (OperationEnabled, SwitchOnDisabled, |i| !i.fault && i.request == DisableVoltage),
            (OperationEnabled, QuickStopActive, |i| !i.fault && i.request == QuickStop),
            (QuickStopActive, OperationEnabled, |i| !i.fault && i.request == EnableOperation && i.stays_stopped),
            (QuickStopActive, SwitchOnDisabled, |i| {
                !i.fault && (i.request == DisableVoltage || (i.released && !i.stays_stopped))
            }),
            (NotReadyToSwitchOn, FaultReactionActive, |i| i.fault),
            (SwitchOnDisabled, FaultReactionActive, |i| i.fault),
            (ReadyToSwitchOn, FaultReactionActive, |i| i.fault),
            (SwitchedOn, FaultReactionActive, |i| i.fault),
            (OperationEnabled, FaultReactionActive, |i| i.fault),
            (QuickStopActive, FaultReactionActive, |i| i.fault),
            (FaultReactionActive, Fault, |i| i.released),
            (Fault, SwitchOnDisabled, |i| i.reset && !i.fault),
        ]
    };

    #[test]
    fn every_state_with_every_input_follows_the_arrows_of_the_standard() {
        let mut pairs = 0;
        for state in State::ALL {
            for inputs in all_inputs() {
                let out: Vec<State> =
                    ARROWS.iter().filter(|(from, _, when)| *from == state && when(&inputs)).map(|a| a.1).collect();
                assert!(out.len() <= 1, "two arrows leave {state} with {inputs:?}: {out:?}");
                assert_eq!(next(state, inputs), out.first().copied().unwrap_or(state), "{state} with {inputs:?}");
                pairs += 1;
            }
        }
        assert_eq!(pairs, 8 * 160);
    }

    #[test]
    fn torque_is_entered_only_from_switched_on_with_everything_ready() {
        for state in State::ALL.into_iter().filter(|state| !state.has_torque()) {
            for inputs in all_inputs().filter(|inputs| next(state, *inputs).has_torque()) {
                assert!(state == State::SwitchedOn && inputs.request == Request::EnableOperation);
                assert!(inputs.ready && !inputs.fault);
            }
        }
    }

    #[test]
    fn a_controlword_held_after_a_fault_does_not_enable_again() {
        let held = Inputs { request: Request::EnableOperation, ready: true, released: true, ..Inputs::default() };
        let after_reset = next(State::Fault, Inputs { reset: true, ..held });
        assert_eq!((after_reset, next(after_reset, held)), (State::SwitchOnDisabled, State::SwitchOnDisabled));
    }

    #[test]
    fn climbing_takes_one_state_per_tick() {
        let mut state = State::NotReadyToSwitchOn;
        for expected in [
            State::SwitchOnDisabled,
            State::ReadyToSwitchOn,
            State::SwitchedOn,
            State::OperationEnabled,
            State::OperationEnabled,
        ] {
            state = next(state, Inputs { request: Request::towards_enabled(state), ready: true, ..Inputs::default() });
            assert_eq!(state, expected);
        }
    }

    /// Table of commands in the standard, with every bit that it leaves open.
    #[test]
    fn the_controlword_is_read_as_the_standard_says() {
        for (mask, bits, request) in [
            (0b0111, 0b0110, Request::Shutdown),
            (0b1111, 0b0111, Request::SwitchOn),
            (0b1111, 0b1111, Request::EnableOperation),
            (0b0010, 0b0000, Request::DisableVoltage),
            (0b0110, 0b0010, Request::QuickStop),
        ] {
            for word in (0..=u16::MAX).filter(|word| word & mask == bits) {
                assert_eq!(ControlWord(word).request(), request, "{word:#06x}");
            }
        }
    }

    /// Table of state codings: mask and value.
    #[test]
    fn the_statusword_tells_every_state_as_the_standard_says() {
        for (state, mask, value) in [
            (State::NotReadyToSwitchOn, 0x4f, 0x00),
            (State::SwitchOnDisabled, 0x4f, 0x40),
            (State::ReadyToSwitchOn, 0x6f, 0x21),
            (State::SwitchedOn, 0x6f, 0x23),
            (State::OperationEnabled, 0x6f, 0x27),
            (State::QuickStopActive, 0x6f, 0x07),
            (State::FaultReactionActive, 0x4f, 0x0f),
            (State::Fault, 0x4f, 0x08),
        ] {
            assert_eq!(state.status_bits() & mask, value, "{state}");
        }
    }
}
