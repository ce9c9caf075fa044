//! No torque on parameters that nobody has stored, none while they are being stored, and no save while there is torque.

use servo_core::axis::Axis;
use servo_core::config::Config;
use servo_core::drive::Command;
use servo_core::fault::Fault;
use servo_core::parameters::Settings;
use servo_core::refusal::Refusal;
use servo_core::state::State;
use servo_host_tests::Bench;
use servo_sim::Stage;

fn bench() -> Bench {
    Bench::new(&Stage::default(), &Settings::default(), 1).unwrap()
}

#[test]
fn a_drive_without_stored_parameters_is_in_a_fault_until_some_are_stored() {
    let mut bench = bench();
    bench.axis = Axis::uncommissioned(Config::new(&Settings::default()).unwrap());
    bench.run(5, |output| assert!(!output.bridge.enabled));
    assert_eq!(
        (bench.axis.drive().state(), bench.axis.drive().fault()),
        (State::Fault, Some(Fault::ParametersInvalid))
    );
    assert_eq!(bench.command(Command::Enable), Err(Refusal::WrongState(State::Fault)));
    assert_eq!(bench.command(Command::ResetFault), Err(Refusal::FaultPersists(Fault::ParametersInvalid)));

    // A save that fails changes nothing.
    assert_eq!(bench.command(Command::BeginSave), Ok(()));
    assert_eq!(bench.command(Command::EndSave { stored: false }), Ok(()));
    assert_eq!(bench.command(Command::ResetFault), Err(Refusal::FaultPersists(Fault::ParametersInvalid)));

    assert_eq!(bench.command(Command::BeginSave), Ok(()));
    assert_eq!(bench.command(Command::EndSave { stored: true }), Ok(()));
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
    bench.command(Command::EndSave { stored: true }).unwrap();
    bench.enable().unwrap();
}
