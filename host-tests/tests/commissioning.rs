//! No torque on parameters that nobody has stored, none while they are being stored, and no save while there is torque.

use servo_core::drive::{Command, Outcome};
use servo_core::fault::Fault;
use servo_core::monitor::signals;
use servo_core::parameters::Settings;
use servo_core::refusal::Refusal;
use servo_core::state::State;
use servo_host_tests::Bench;
use servo_sim::Stage;

fn bench() -> Bench {
    Bench::new(&Stage::default(), &Settings { commutation_identity: 0.0, ..Settings::default() }, 1).unwrap()
}

#[test]
fn a_drive_without_stored_parameters_is_in_a_fault_until_some_are_stored() {
    let mut bench = bench();
    let mut unstored = |command: Option<Command>| -> Option<Outcome> {
        let output = bench.tick_with(command, |sample| sample.signals |= signals::PARAMETERS_INVALID);
        assert!(!output.bridge.enabled);
        assert!(output.record.fault == Some(Fault::ParametersInvalid), "{:?}", output.record);
        output.outcome
    };
    unstored(None);
    unstored(None);
    let refused = Some(Err(Refusal::FaultPersists(Fault::ParametersInvalid)));
    assert_eq!(unstored(Some(Command::Enable)), Some(Err(Refusal::WrongState(State::Fault))));
    assert_eq!(unstored(Some(Command::ResetFault)), refused);
    // A save that fails changes nothing; one that succeeds ends the signal.
    assert_eq!(unstored(Some(Command::BeginSave)), Some(Ok(())));
    assert_eq!(unstored(Some(Command::EndSave)), Some(Ok(())));
    assert_eq!(unstored(Some(Command::ResetFault)), refused);

    bench.run(5, |output| assert!(!output.bridge.enabled));
    assert_eq!(bench.axis.drive().state(), State::Fault, "it is the user who acknowledges");
    assert_eq!(bench.command(Command::ResetFault), Ok(()));
    bench.enable().unwrap();
}

#[test]
fn saving_is_refused_from_the_tick_of_the_enable_command_to_that_of_disable() {
    let mut bench = bench();
    bench.run(5, |_| ());
    bench.command(Command::Enable).unwrap();
    for _ in 0..6 {
        assert!(matches!(bench.command(Command::BeginSave), Err(Refusal::WrongState(_))));
    }
    assert_eq!(bench.axis.drive().state(), State::OperationEnabled, "refusing costs nothing");
    bench.command(Command::Disable).unwrap();
    assert_eq!(bench.command(Command::BeginSave), Ok(()));
}

#[test]
fn enabling_is_refused_until_the_save_has_ended() {
    let mut bench = bench();
    bench.run(5, |_| ());
    bench.command(Command::BeginSave).unwrap();
    for _ in 0..3 {
        assert_eq!(bench.command(Command::Enable), Err(Refusal::Saving));
        bench.run(100, |output| assert!(!output.bridge.enabled));
    }
    bench.command(Command::EndSave).unwrap();
    bench.enable().unwrap();
}
