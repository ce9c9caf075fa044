//! The page of faults, limits and states, from the tables in core.

use std::fmt::Write;

use servo_core::fault::{Fault, Reaction};
use servo_core::record::flags;
use servo_core::state::State;

/// `docs/faults.md`.
pub fn faults() -> String {
    let mut text = String::from(
        "# Faults, limits, states\n\n\
        Written by `cargo xtask docs` from [`core/src/fault.rs`](../core/src/fault.rs), [`record.rs`](../core/src/record.rs) and \
        [`state.rs`](../core/src/state.rs); a test holds it current.\n\n\
        ## Faults\n\n\
        The number is an ABI: never reused. *Seen after* counts from the first sample that shows the cause. The \
        bridge is off in the output of the tick that sees the fault; where it says *may brake*, the parameter `fault_reaction_option` can \
        ask for a ramp to rest first (state Fault reaction active), which any other fault cuts short. The first fault is kept \
        until it is acknowledged, in state Fault and not before; while its cause lasts, acknowledging is refused.\n\n\
        The black box keeps 512 ticks from before the first fault and 64 after it, each with what the drive was told and what it did, \
        also over a reset that is not a loss of supply, until the bridge is next turned on. The host reads it and runs the ticks again \
        ([`black_box.rs`](../core/src/black_box.rs)): the same version of this software gives the same records, to the last bit.\n\n\
        Which test provokes which fault, on the host and on the emulated board: [`SAFETY.md`](../SAFETY.md).\n\n\
        | no. | CiA 402 | fault | seen after | bridge | what happened | what to do |\n|---|---|---|---|---|---|---|\n",
    );
    let mut faults = Fault::ALL.to_vec();
    faults.sort_by_key(|fault| fault.number());
    for fault in faults {
        let bridge = match fault.reaction() {
            Reaction::Off => "off",
            Reaction::MayBrake => "off, may brake",
        };
        let _ = writeln!(
            text,
            "| {} | {:04X} | {} | {} | {bridge} | {} | {} |",
            fault.number(),
            fault.cia402_code(),
            fault.title(),
            fault.detection(),
            fault.cause(),
            fault.advice()
        );
    }
    text += "\n## Limits\n\n\
        A limit that acts is no fault: it is a bit in every tick record, and bit 11 of the statusword; `servoctl status` names it.\n\n\
        | bit | limit | meaning |\n|---|---|---|\n";
    for (bit, name, meaning) in flags::LIMITS {
        let _ = writeln!(text, "| {} | {name} | {meaning} |", bit.trailing_zeros());
    }
    text += "\n## States\n\n\
        The bridge can be on in Operation enabled, in Quick stop active, and, with a fault that may brake and the option to do so, in Fault \
        reaction active: the states in which CiA 402 has the drive function on.\n\n\
        | no. | state | statusword & 6Fh | bridge |\n|---|---|---|---|\n";
    for state in State::ALL {
        let bridge = match state {
            State::OperationEnabled | State::QuickStopActive => "on",
            State::FaultReactionActive => "off, or on while braking",
            _ => "off",
        };
        let _ = writeln!(text, "| {} | {state} | {:02X}h | {bridge} |", state as u8, state.status_bits());
    }
    text
}
