//! CiA 402 on the drive: controlwords, statuswords, options, and nothing that jumps.

use servo_core::config::Config;
use servo_core::drive::Command;
use servo_core::parameters::Settings;
use servo_core::position::Position;
use servo_core::profile::Limits;
use servo_core::refusal::Refusal;
use servo_core::state::{ControlWord, State, status};
use servo_host_tests::{Bench, tuning};
use servo_sim::Stage;

const DISABLE_VOLTAGE: u16 = 0x00;
const QUICK_STOP: u16 = 0x02;
const SHUTDOWN: u16 = 0x06;
const SWITCH_ON: u16 = 0x07;
const ENABLE: u16 = 0x0f;
const HALT: u16 = 0x100;
const RESET: u16 = 0x80;

const FIVE_MM: Position = Position(81_920_000);
const SLOW: Limits = Limits { velocity_m_per_s: 0.5, acceleration_m_per_s2: 1.0, jerk_m_per_s3: None };
/// 1 % of the force that 10 A make.
const ONE_PERCENT_N: f32 = 0.78;

fn settings() -> Settings {
    tuning::settings(&Stage::default(), &tuning::STANDARD).unwrap()
}

fn bench_with(settings: &Settings) -> Bench {
    let mut bench = Bench::new(&Stage::default(), settings, 5).unwrap();
    bench.run(5, |_| ());
    bench
}

/// Writes a controlword; the state after that tick.
fn write(bench: &mut Bench, word: u16) -> State {
    bench.command(Command::Control(ControlWord(word))).unwrap();
    bench.axis.drive().state()
}

/// At 62 mm/s in the middle of a move.
fn moving_with(settings: &Settings) -> Bench {
    let mut bench = bench_with(settings);
    for word in [SHUTDOWN, SWITCH_ON, ENABLE] {
        write(&mut bench, word);
    }
    bench.run(800, |_| ());
    bench.command(Command::Move { target: FIVE_MM, limits: SLOW }).unwrap();
    bench.run(500, |_| ());
    bench
}

/// Ticks until the state is another one, at most `most`, and which.
fn until_other(bench: &mut Bench, most: u32) -> (u32, State) {
    let from = bench.axis.drive().state();
    for ticks in 1..=most {
        bench.run(1, |_| ());
        let state = bench.axis.drive().state();
        if state != from {
            return (ticks, state);
        }
    }
    (most, from)
}

#[test]
fn a_master_walks_up_and_down_through_the_states() {
    let mut bench = bench_with(&settings());
    for (word, state) in [
        (SHUTDOWN, State::ReadyToSwitchOn),
        (SWITCH_ON, State::SwitchedOn),
        (SHUTDOWN, State::ReadyToSwitchOn),
        (SWITCH_ON, State::SwitchedOn),
        (ENABLE, State::OperationEnabled),
        (SWITCH_ON, State::SwitchedOn),
        (ENABLE, State::OperationEnabled),
        (SHUTDOWN, State::ReadyToSwitchOn),
        (SWITCH_ON, State::SwitchedOn),
        (ENABLE, State::OperationEnabled),
        (DISABLE_VOLTAGE, State::SwitchOnDisabled),
        (ENABLE, State::SwitchOnDisabled),
        (SWITCH_ON, State::SwitchOnDisabled),
    ] {
        assert_eq!(write(&mut bench, word), state, "{word:#x}");
        bench.run(20, |output| assert_eq!(output.bridge.enabled, state.has_torque()));
        assert_eq!(bench.axis.drive().state(), state, "{word:#x}, later");
    }
}

#[test]
fn a_fault_is_reset_by_the_rising_edge_of_bit_7_and_by_nothing_else() {
    let mut bench = bench_with(&settings());
    for held in [0, RESET] {
        write(&mut bench, held);
        bench.tick_with(None, |s| s.bus_code = u16::MAX);
        bench.run(3, |_| ());
        assert_eq!(bench.axis.drive().state(), State::Fault);
        assert_eq!(write(&mut bench, held | SHUTDOWN), State::Fault, "no edge");
        assert_eq!(write(&mut bench, 0), State::Fault);
        assert_eq!(write(&mut bench, RESET | ENABLE), State::SwitchOnDisabled, "the edge");
        bench.run(10, |output| assert!(!output.bridge.enabled, "and no more than that"));
    }
}

#[test]
fn enable_is_refused_without_position_or_supply_whoever_asks() {
    let mut bench = bench_with(&settings());
    write(&mut bench, SHUTDOWN);
    write(&mut bench, SWITCH_ON);
    for _ in 0..5 {
        bench.tick_with(None, |s| s.frame = u64::MAX);
    }
    let enable = Some(Command::Control(ControlWord(ENABLE)));
    assert_eq!(bench.tick_with(enable, |s| s.frame = u64::MAX).outcome, Some(Err(Refusal::NoPosition)));
    let answer = bench.tick_with(enable, |s| s.bus_code = 0).outcome.unwrap();
    assert!(matches!(answer, Err(Refusal::OutOfRange { .. })), "{answer:?}");
    // The encoder is lost in the very ticks in which the drive climbs: it does not arrive.
    bench.run(5, |_| ());
    bench.command(Command::Control(ControlWord(DISABLE_VOLTAGE))).unwrap();
    bench.run(2, |_| ());
    bench.command(Command::Enable).unwrap();
    for _ in 0..20 {
        assert!(!bench.tick_with(None, |s| s.bus_code = 0).bridge.enabled);
    }
    bench.run(20, |output| assert!(!output.bridge.enabled, "nor later, unasked"));
}

#[test]
fn quick_stop_does_what_its_option_says() {
    // Option, ticks from 62 mm/s to the next state (ramp, then 20 ms to come to rest), which one.
    for (option, ticks, after) in [
        (1.0, 180..195, State::SwitchOnDisabled),
        (2.0, 172..185, State::SwitchOnDisabled),
        (5.0, 400..401, State::QuickStopActive),
        (6.0, 400..401, State::QuickStopActive),
    ] {
        let mut bench = moving_with(&Settings { quick_stop_option: option, ..settings() });
        let from_m = bench.plant.position_m();
        assert_eq!(write(&mut bench, QUICK_STOP), State::QuickStopActive);
        let (took, state) = until_other(&mut bench, 400);
        assert!(ticks.contains(&took) && state == after, "option {option}: {took} ticks to {state}");
        let gone_m = bench.plant.position_m() - from_m;
        // v²/2a and what the loop lags behind.
        assert!((0.02e-3..0.3e-3).contains(&gone_m), "option {option}: {gone_m}");
        assert!(bench.plant.velocity_m_per_s().abs() < 1e-3);
        if after == State::QuickStopActive {
            assert_eq!(write(&mut bench, ENABLE), State::OperationEnabled);
            bench.command(Command::Move { target: FIVE_MM, limits: SLOW }).unwrap();
        }
    }
    let mut bench = moving_with(&Settings { quick_stop_option: 0.0, ..settings() });
    assert!(!bench.tick(Some(Command::Control(ControlWord(QUICK_STOP)))).bridge.enabled);
}

/// Transition 16 belongs to the options that hold the stage: with the others a quick stop runs to its end.
#[test]
fn a_master_that_takes_a_quick_stop_back_in_the_middle_does_not_enable_again_unless_the_option_holds() {
    for (option, then, after) in [
        (2.0, State::QuickStopActive, State::SwitchOnDisabled),
        (6.0, State::OperationEnabled, State::OperationEnabled),
    ] {
        let mut bench = moving_with(&Settings { quick_stop_option: option, ..settings() });
        write(&mut bench, QUICK_STOP);
        bench.run(5, |_| ());
        assert_eq!(write(&mut bench, ENABLE), then, "option {option}");
        bench.run(400, |_| ());
        assert_eq!(bench.axis.drive().state(), after, "option {option}");
    }
}

#[test]
fn disable_operation_brakes_first_if_told_so_and_disable_voltage_never() {
    for (option, most) in [(0.0, 1), (1.0, 195)] {
        for (word, after) in [(SWITCH_ON, State::SwitchedOn), (SHUTDOWN, State::ReadyToSwitchOn)] {
            let mut bench = moving_with(&Settings { disable_option: option, ..settings() });
            let mut ticks = 1;
            if write(&mut bench, word) == State::OperationEnabled {
                ticks += until_other(&mut bench, 400).0;
                assert!(bench.plant.velocity_m_per_s().abs() < 1e-3);
            }
            assert_eq!(bench.axis.drive().state(), after, "option {option}, {word:#x}");
            assert!(ticks <= most && (option == 0.0) == (ticks == 1), "option {option}: {ticks}");
        }
        let mut bench = moving_with(&Settings { disable_option: option, ..settings() });
        assert_eq!(write(&mut bench, DISABLE_VOLTAGE), State::SwitchOnDisabled);
    }
}

#[test]
fn halt_holds_in_operation_enabled_and_refuses_moves_until_it_ends() {
    for option in [1.0, 2.0] {
        let mut bench = moving_with(&Settings { halt_option: option, ..settings() });
        assert_eq!(write(&mut bench, ENABLE | HALT), State::OperationEnabled);
        bench.run(4_000, |_| ());
        let (velocity_m_per_s, at_m) = (bench.plant.velocity_m_per_s(), bench.plant.position_m());
        assert!(velocity_m_per_s.abs() < 1e-5 && at_m < 3e-3, "{velocity_m_per_s} m/s at {at_m} m");
        let go = Command::Move { target: FIVE_MM, limits: SLOW };
        assert_eq!(bench.command(go), Err(Refusal::Halted));
        write(&mut bench, ENABLE);
        bench.command(go).unwrap();
        bench.run(8_000, |_| ());
        assert!((bench.plant.position_m() - 5e-3).abs() < 1e-7);
    }
}

#[test]
fn target_reached_means_inside_the_window_for_the_window_time() {
    let settings = Settings { position_window_m: 100e-9, position_window_s: 0.02, ..settings() };
    let mut bench = moving_with(&settings);
    let window_ct = (100e-9 / settings.encoder_count_m) as u32;
    let mut inside = 0;
    let mut reached = 0;
    for _ in 0..16_000 {
        let record = bench.tick(None).record;
        let moving = record.flags & servo_core::record::flags::MOVING != 0;
        inside = if !moving && record.error_ct.unsigned_abs() <= window_ct { inside + 1 } else { 0 };
        let word = bench.axis.drive().status_word(&record);
        assert_eq!(word & status::TARGET_REACHED != 0, inside >= 160, "{inside} ticks inside");
        reached += u32::from(inside >= 160);
    }
    assert!(reached > 4_000, "the window was reached: {reached}");
    bench.command(Command::Move { target: Position(0), limits: SLOW }).unwrap();
    let record = bench.tick(None).record;
    assert_eq!(bench.axis.drive().status_word(&record) & status::TARGET_REACHED, 0);
}

#[test]
fn the_statusword_tells_voltage_and_following_error() {
    let mut bench = moving_with(&settings());
    let record = bench.tick(None).record;
    assert_eq!(bench.axis.drive().status_word(&record), 0x27 | status::VOLTAGE_ENABLED | status::REMOTE);
    let tight = Settings { following_error_max_m: 1e-7, ..settings() };
    let config = Config::new(&tight).unwrap();
    let record = bench.tick(Some(Command::Configure { config, needs_bridge_off: false })).record;
    let word = bench.axis.drive().status_word(&record);
    assert_eq!(word & (status::FOLLOWING_ERROR | 0x4f), status::FOLLOWING_ERROR | 0x0f);
    let record = bench.tick_with(None, |s| s.bus_code = 0).record;
    assert_eq!(bench.axis.drive().status_word(&record) & status::VOLTAGE_ENABLED, 0);
}

#[test]
fn enabling_steps_the_force_by_less_than_a_hundredth_at_rest_and_under_a_load() {
    for load_n in [0.0, 0.4, -0.4] {
        let mut bench = bench_with(&settings());
        bench.plant.set_external_force_n(load_n);
        bench.run(800, |_| ());
        let from_m = bench.plant.position_m();
        let mut last_n = 0.0;
        bench.command(Command::Enable).unwrap();
        bench.run(200, |output| {
            assert!((output.record.force_n - last_n).abs() < ONE_PERCENT_N, "{load_n}: {:?}", output.record);
            last_n = output.record.force_n;
        });
        assert!((bench.plant.position_m() - from_m).abs() < 5e-9, "{load_n}");
    }
}
