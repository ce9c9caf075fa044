//! The power state machine of CiA 402: one pure function over states and inputs.

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
    /// Loops closed, bridge on: the only state with torque.
    OperationEnabled = 4,
    /// A fault was seen in this tick; bridge already off.
    FaultReactionActive = 6,
    /// Latched until reset; bridge off.
    Fault = 7,
}

impl State {
    /// All states.
    pub const ALL: [State; 7] = [
        State::NotReadyToSwitchOn,
        State::SwitchOnDisabled,
        State::ReadyToSwitchOn,
        State::SwitchedOn,
        State::OperationEnabled,
        State::FaultReactionActive,
        State::Fault,
    ];

    /// The bridge may be on.
    #[inline]
    pub const fn has_torque(self) -> bool {
        matches!(self, State::OperationEnabled)
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
            State::FaultReactionActive => "Fault reaction active",
            State::Fault => "Fault",
        })
    }
}

/// What decides the next state.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Inputs {
    /// Operation is wanted (one state is climbed per tick).
    pub enable: bool,
    /// A fault is present in this tick.
    pub fault: bool,
    /// The user acknowledged the fault in this tick.
    pub reset: bool,
}

/// The state after this tick.
pub const fn next(state: State, inputs: Inputs) -> State {
    use State::*;
    match (state, inputs) {
        (Fault, Inputs { reset: true, fault: false, .. }) => SwitchOnDisabled,
        (Fault, _) => Fault,
        (FaultReactionActive, _) => Fault,
        (_, Inputs { fault: true, .. }) => FaultReactionActive,
        (NotReadyToSwitchOn, _) => SwitchOnDisabled,
        (_, Inputs { enable: false, .. }) => SwitchOnDisabled,
        (SwitchOnDisabled, _) => ReadyToSwitchOn,
        (ReadyToSwitchOn, _) => SwitchedOn,
        (SwitchedOn, _) => OperationEnabled,
        (OperationEnabled, _) => OperationEnabled,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn all_inputs() -> impl Iterator<Item = Inputs> {
        (0..8).map(|i| Inputs { enable: i & 1 != 0, fault: i & 2 != 0, reset: i & 4 != 0 })
    }

    #[test]
    fn torque_needs_enable_no_fault_and_a_state_below_it() {
        for state in State::ALL {
            for inputs in all_inputs() {
                if next(state, inputs).has_torque() {
                    assert!(inputs.enable && !inputs.fault);
                    assert!(matches!(state, State::SwitchedOn | State::OperationEnabled));
                }
            }
        }
    }

    #[test]
    fn a_fault_takes_every_state_to_fault_within_two_ticks() {
        for state in State::ALL {
            let fault = Inputs { fault: true, ..Inputs::default() };
            assert_eq!(next(next(state, fault), fault), State::Fault);
        }
    }

    #[test]
    fn only_a_reset_without_fault_leaves_fault_and_never_into_torque() {
        for inputs in all_inputs() {
            let expected = if inputs.reset && !inputs.fault { State::SwitchOnDisabled } else { State::Fault };
            assert_eq!(next(State::Fault, inputs), expected);
        }
    }

    #[test]
    fn enabling_climbs_one_state_per_tick() {
        let enable = Inputs { enable: true, ..Inputs::default() };
        let mut state = State::NotReadyToSwitchOn;
        for expected in [
            State::SwitchOnDisabled,
            State::ReadyToSwitchOn,
            State::SwitchedOn,
            State::OperationEnabled,
            State::OperationEnabled,
        ] {
            state = next(state, enable);
            assert_eq!(state, expected);
        }
        assert_eq!(next(state, Inputs::default()), State::SwitchOnDisabled);
    }
}
