//! Broken hardware, with the loop closed: each fault is seen in time, the bridge is off, and the drive says why.

mod common;

use std::num::NonZeroU64;
use std::time::Duration;

use common::{enabled, five_mm, status};
use servo_core::black_box::BEFORE_TICKS;
use servo_core::fault::Fault;
use servo_core::record::flags;
use servo_core::state::State;
use servo_protocol::black_box::BlackBox;
use servo_protocol::frame::{MAX_FRAME, encode};
use servo_protocol::message::{Reply, Request};
use servo_virtual_board::{AdcFault, Analog, Config, EncoderFault, Lasting, Link, VirtualBoard};

/// Number of the parameter `command_timeout_s`.
const COMMAND_TIMEOUT: u16 = 0x0602;
const PWM_PERIOD_NS: u64 = 25_000;
const SERVO_PERIOD_NS: u64 = 125_000;

/// A board in mid-move, at some 60 mm/s.
fn moving() -> (VirtualBoard, Link) {
    let (mut board, mut link) = enabled();
    assert!(matches!(link.request(&mut board, &five_mm()).unwrap(), Reply::Done { .. }));
    board.run_for(Duration::from_millis(60)).unwrap();
    assert!(board.bridge_enabled().unwrap());
    (board, link)
}

/// Time until the bridge is off, to a microsecond, at most `limit_ns`.
fn time_to_off_ns(board: &mut VirtualBoard, limit_ns: u64) -> Option<u64> {
    let start_ns = board.time_ns();
    while board.time_ns() - start_ns < limit_ns {
        board.run_for(Duration::from_micros(1)).unwrap();
        if !board.bridge_enabled().unwrap() {
            return Some(board.time_ns() - start_ns);
        }
    }
    None
}

fn assert_latched(board: &mut VirtualBoard, link: &mut Link, fault: Fault) {
    board.run_for(Duration::from_millis(20)).unwrap();
    let status = status(board, link);
    assert_eq!((status.state, status.fault), (State::Fault, Some(fault)));
    assert!(!board.bridge_enabled().unwrap());
    let log = board.log().unwrap();
    assert!(common::logged(&log, "fault"), "{log:#?}");
    common::assert_in_black_box(board, link, fault);
    board.check_told().unwrap();
}

/// What breaks a frame, and what the third one in a row is called.
const FRAME_FAULTS: [(EncoderFault, Fault); 5] = [
    (EncoderFault::Corrupted { mask: 1 << 35 }, Fault::EncoderChecksum),
    (EncoderFault::Missing, Fault::EncoderLost),
    (EncoderFault::Shorted, Fault::EncoderLost),
    (EncoderFault::Shifted { bits: 20 }, Fault::EncoderLost),
    (EncoderFault::Marked, Fault::EncoderErrorBit),
];

#[test]
fn the_third_unusable_frame_in_a_row_turns_the_bridge_off() {
    for (fault, name) in FRAME_FAULTS {
        let (mut board, mut link) = moving();
        board.inject_encoder_fault(fault, Lasting::Forever).unwrap();
        let off_ns = time_to_off_ns(&mut board, 5 * SERVO_PERIOD_NS);
        assert!(off_ns.is_some(), "{fault:?}");
        assert_eq!(board.encoder_frames().unwrap().1, 3, "{fault:?}");
        assert_latched(&mut board, &mut link, name);
    }
}

#[test]
fn two_unusable_frames_are_counted_and_survived() {
    for (fault, _) in FRAME_FAULTS {
        let (mut board, mut link) = moving();
        board.inject_encoder_fault(fault, Lasting::Frames(2)).unwrap();
        board.run_for(Duration::from_millis(100)).unwrap();
        let status = status(&mut board, &mut link);
        assert_eq!((status.state, status.fault), (State::OperationEnabled, None), "{fault:?}");
        assert_eq!(status.counters.bad_frames, 2, "{fault:?}");
        board.check_told().unwrap();
    }
}

/// The acknowledge bits absorb the delay of the line: only what is lost at the end of the frame counts.
#[test]
fn a_line_one_bit_slower_is_no_fault() {
    let (mut board, mut link) = moving();
    board.inject_encoder_fault(EncoderFault::Shifted { bits: 1 }, Lasting::Forever).unwrap();
    board.run_for(Duration::from_millis(20)).unwrap();
    let status = status(&mut board, &mut link);
    assert_eq!((status.state, status.counters.bad_frames), (State::OperationEnabled, 0));
    board.check_told().unwrap();
}

#[test]
fn an_encoder_that_repeats_itself_is_frozen_within_three_frames() {
    let (mut board, mut link) = moving();
    board.inject_encoder_fault(EncoderFault::Stuck, Lasting::Forever).unwrap();
    assert!(time_to_off_ns(&mut board, 4 * SERVO_PERIOD_NS).is_some());
    assert!(board.encoder_frames().unwrap().1 <= 3);
    assert_latched(&mut board, &mut link, Fault::EncoderFrozen);
}

#[test]
fn an_encoder_that_jumps_turns_the_bridge_off_in_the_tick_of_the_first_such_frame() {
    // By 2 µm, and to somewhere else.
    for counts in [32_768, -32_768, i32::MAX] {
        let (mut board, mut link) = moving();
        board.inject_encoder_fault(EncoderFault::Displaced { counts }, Lasting::Forever).unwrap();
        assert!(time_to_off_ns(&mut board, 2 * SERVO_PERIOD_NS).is_some(), "{counts}");
        assert_eq!(board.encoder_frames().unwrap().1, 1, "{counts}");
        assert_latched(&mut board, &mut link, Fault::EncoderJump);
    }
}

#[test]
fn an_over_current_turns_the_bridge_off_within_two_pwm_periods() {
    for code in [0, u16::MAX] {
        let (mut board, mut link) = moving();
        board.set_adc_fault(Analog::PhaseB, Some(AdcFault::Stuck { code })).unwrap();
        let off_ns = time_to_off_ns(&mut board, SERVO_PERIOD_NS);
        assert!(off_ns.is_some_and(|off_ns| off_ns <= 2 * PWM_PERIOD_NS), "{off_ns:?}");
        board.set_adc_fault(Analog::PhaseB, None).unwrap();
        assert_latched(&mut board, &mut link, Fault::OverCurrent);
    }
}

#[test]
fn the_power_stage_turns_the_bridge_off_by_itself_and_the_drive_can_be_enabled_again() {
    let (mut board, mut link) = moving();
    board.set_bridge_fault(true).unwrap();
    // The break input is filtered, and needs no instruction.
    assert!(time_to_off_ns(&mut board, 10_000).unwrap() <= 1_000);
    assert_latched(&mut board, &mut link, Fault::BridgeFault);

    let refused = link.request(&mut board, &Request::Enable).unwrap();
    assert!(matches!(refused, Reply::Refused(_)), "{refused:?}");
    board.set_bridge_fault(false).unwrap();
    board.run_for(Duration::from_millis(1)).unwrap();
    for request in [Request::ResetFault, Request::Enable] {
        assert!(matches!(link.request(&mut board, &request).unwrap(), Reply::Done { .. }), "{request:?}");
        // A status is of one tick, which is up to two visits of the telemetry task (10 ms) ago.
        board.run_for(Duration::from_millis(12)).unwrap();
    }
    assert_eq!(status(&mut board, &mut link).state, State::OperationEnabled);
    assert!(board.bridge_enabled().unwrap());
    board.check_told().unwrap();
}

#[test]
fn a_bus_voltage_out_of_its_limits_turns_the_bridge_off() {
    type Break = fn(&mut VirtualBoard);
    let breaks: [(&str, Break, Fault); 4] = [
        ("surge", |board| board.with_plant(|plant| plant.set_bus_v(62.0)).unwrap(), Fault::BusOverVoltage),
        ("sag", |board| board.with_plant(|plant| plant.set_bus_v(22.0)).unwrap(), Fault::BusUnderVoltage),
        (
            "converter at its upper end",
            |board| board.set_adc_fault(Analog::Bus, Some(AdcFault::Stuck { code: u16::MAX })).unwrap(),
            Fault::BusOverVoltage,
        ),
        ("wire off", |board| board.set_adc_fault(Analog::Bus, Some(AdcFault::Open)).unwrap(), Fault::BusUnderVoltage),
    ];
    for (what, break_it, fault) in breaks {
        let (mut board, mut link) = moving();
        break_it(&mut board);
        // The conversion is read one servo period after its start, and every sixteenth is the temperature's.
        let off_ns = time_to_off_ns(&mut board, 5 * SERVO_PERIOD_NS);
        assert!(off_ns.is_some_and(|off_ns| off_ns <= 3 * SERVO_PERIOD_NS), "{what} {off_ns:?}");
        assert_latched(&mut board, &mut link, fault);
    }
}

#[test]
fn a_reset_in_mid_move_turns_the_bridge_off_at_once() {
    let (mut board, mut link) = moving();
    let last = status(&mut board, &mut link).counters.ticks;
    board.reset().unwrap();
    assert!(!board.bridge_enabled().unwrap());
    board.run_for(common::BOOT).unwrap();
    let status = status(&mut board, &mut link);
    assert_eq!((status.state, status.fault), (State::SwitchOnDisabled, None));
    assert!(common::logged(&board.log().unwrap(), "reset by"), "the cause is in the log");
    // The ticks up to the reset, in motion to the last one.
    let words = common::black_box(&mut board, &mut link);
    let black_box = BlackBox(&words[..]);
    assert!(black_box.is_intact());
    let newest = black_box.entries().last().unwrap();
    let moving = u32::from(flags::MOVING | flags::BRIDGE_ON);
    assert!(newest.sequence() > last && newest.fault_number() == 0, "{newest:?}");
    assert_eq!(newest.record()[14] & moving, moving, "{newest:?}");
    assert!(black_box.replay().unwrap() > BEFORE_TICKS);
    board.check_told().unwrap();
}

#[test]
fn noise_on_the_line_is_dropped_and_counted_and_the_move_goes_on() {
    let (mut board, mut link) = moving();
    board.send(b"\x05hello\x00").unwrap();
    board.send(&[0xA5; 2000]).unwrap();
    board.send(&[0]).unwrap();
    // 2008 bytes at 3 Mbit/s, and then some.
    board.run_for(Duration::from_millis(25)).unwrap();
    assert_eq!(status(&mut board, &mut link).bad_requests, 2);

    board.set_serial_errors(1_000_000, 0, 1).unwrap();
    assert!(link.request(&mut board, &Request::Identity).is_err(), "every byte is noise");
    board.set_serial_errors(0, 0, 1).unwrap();
    board.send(&[0]).unwrap();
    let status = status(&mut board, &mut link);
    assert_eq!((status.state, status.fault), (State::OperationEnabled, None));
    assert!(status.bad_requests > 2, "{}", status.bad_requests);
    board.run_for(Duration::from_millis(300)).unwrap();
    let at_m = board.plant().unwrap().position_m();
    assert!((at_m - 5e-3).abs() < 1e-6, "{at_m} m");
    board.check_told().unwrap();
}

#[test]
fn current_sensors_that_break_off_or_stop_turn_the_bridge_off_one_alone_as_well() {
    // Off, a signal reads as the lower end; stopped, as no current or the last one, without even noise, for 80 ticks and one.
    let silent = AdcFault::Stuck { code: 32_768 };
    let (broken_off, stopped) = ((2 * PWM_PERIOD_NS, Fault::OverCurrent), (83 * SERVO_PERIOD_NS, Fault::CurrentFrozen));
    let both = &[Analog::PhaseA, Analog::PhaseB][..];
    for (signals, fault, (within_ns, name)) in [
        (both, AdcFault::Open, broken_off),
        (&both[..1], AdcFault::Open, broken_off),
        (both, silent, stopped),
        (&both[..1], silent, stopped),
        (&both[1..], AdcFault::Frozen, stopped),
    ] {
        let (mut board, mut link) = enabled();
        for signal in signals {
            board.set_adc_fault(*signal, Some(fault)).unwrap();
        }
        let start_ns = board.time_ns();
        while board.bridge_enabled().unwrap() && board.time_ns() - start_ns < within_ns {
            board.run_for(Duration::from_micros(5)).unwrap();
        }
        assert!(!board.bridge_enabled().unwrap(), "{signals:?} {fault:?}");
        for signal in signals {
            board.set_adc_fault(*signal, None).unwrap();
        }
        assert_latched(&mut board, &mut link, name);
    }
}

#[test]
fn a_hot_power_stage_turns_the_bridge_off() {
    let (mut board, mut link) = moving();
    // 131 °C of -50 to 280 °C; one conversion in sixteen is the temperature's, and one tick in four looks at it.
    board.set_adc_fault(Analog::Temperature, Some(AdcFault::Stuck { code: 35_945 })).unwrap();
    assert!(time_to_off_ns(&mut board, 25 * SERVO_PERIOD_NS).is_some());
    assert_latched(&mut board, &mut link, Fault::OverTemperature);
}

/// At an input without a pull-up it reads as cold as the converter can.
#[test]
fn a_temperature_sensor_whose_wire_is_off_turns_the_bridge_off() {
    let (mut board, mut link) = moving();
    board.set_adc_fault(Analog::Temperature, Some(AdcFault::Open)).unwrap();
    assert!(time_to_off_ns(&mut board, 25 * SERVO_PERIOD_NS).is_some());
    assert_latched(&mut board, &mut link, Fault::TemperatureSensor);
}

#[test]
fn a_silent_host_turns_the_bridge_off_and_one_that_asks_does_not() {
    let (mut board, mut link) = (common::board(), Link::new());
    let timeout = Request::SetParameters([(COMMAND_TIMEOUT, 0.05)].into_iter().collect());
    for request in [timeout, Request::Enable] {
        assert!(matches!(link.request(&mut board, &request).unwrap(), Reply::Done { .. }), "{request:?}");
    }
    board.run_for(Duration::from_millis(5)).unwrap();
    assert!(board.bridge_enabled().unwrap());
    // Whatever the host asks, it is there.
    for _ in 0..6 {
        board.run_for(Duration::from_millis(30)).unwrap();
        assert_eq!(status(&mut board, &mut link).fault, None);
    }
    // And whatever it asks again, because the reply was lost on the way.
    let mut stop = [0; MAX_FRAME];
    let length = encode(1, &Request::Stop, &mut stop).unwrap();
    for _ in 0..6 {
        board.send(&stop[..length]).unwrap();
        board.run_for(Duration::from_millis(30)).unwrap();
        assert!(board.bridge_enabled().unwrap());
    }
    board.run_for(Duration::from_millis(60)).unwrap();
    assert_latched(&mut board, &mut link, Fault::CommandTimeout);
}

#[test]
fn a_processor_too_slow_for_the_tick_is_an_overrun() {
    let config = Config { instructions_per_second: NonZeroU64::new(40_000_000).unwrap(), ..common::config() };
    let mut board = VirtualBoard::boot(&common::elf(), &config).unwrap();
    board.run_for(6 * common::BOOT).unwrap();
    let mut link = Link::new();
    assert!(matches!(link.request(&mut board, &Request::Enable).unwrap(), Reply::Done { .. }));
    board.run_for(Duration::from_millis(20)).unwrap();
    let status = status(&mut board, &mut link);
    assert_eq!((status.state, status.fault), (State::Fault, Some(Fault::TickOverrun)));
    assert!(status.counters.overruns > 0 && !board.bridge_enabled().unwrap());
    common::assert_in_black_box(&mut board, &mut link, Fault::TickOverrun);
}

/// `b .`: hangs whoever runs into it, and with it all tasks, which take turns.
const HANG: u16 = 0xE7FE;
/// `udf #0`: a processor fault.
const UNDEFINED: u16 = 0xDE00;
/// The interrupt of the PWM period, of which nothing else in the board is more urgent.
const INTERRUPT: &str = "TIM1_UP";
/// What housekeeping calls ten times a second.
const CALLED_BY_A_TASK: &str = "stack_free_bytes";

/// Runs until the processor is reset, at most `limit`; when.
fn time_of_reset_ns(board: &mut VirtualBoard, limit: Duration) -> u64 {
    let end_ns = board.time_ns() + limit.as_nanos() as u64;
    while board.resets().unwrap() == 0 {
        assert!(board.time_ns() < end_ns, "no reset");
        board.run_for(Duration::from_millis(1)).unwrap();
    }
    board.time_ns()
}

#[test]
fn a_task_that_hangs_turns_the_bridge_off_and_then_the_watchdog_starts_the_firmware_anew() {
    let (mut board, mut link) = moving();
    let address = board.elf().address(CALLED_BY_A_TASK).unwrap() & !1;
    let feeds = board.counts().unwrap().feeds;
    board.run_for(Duration::from_millis(40)).unwrap();
    assert!(board.counts().unwrap().feeds > feeds + 3, "fed while all is well");

    let healthy = board.patch(address, HANG).unwrap();
    let start_ns = board.time_ns();
    while board.bridge_enabled().unwrap() && board.time_ns() - start_ns < 300_000_000 {
        board.run_for(Duration::from_millis(1)).unwrap();
    }
    // At most 100 ms until the task runs into it, and 100 ms of patience.
    let off_ns = board.time_ns();
    assert!(off_ns - start_ns < 205_000_000, "{} ns", off_ns - start_ns);
    assert_eq!(board.resets().unwrap(), 0, "the bridge does not wait for the watchdog");
    // Fed every 8 ms until then, it waits for 50 ms.
    let waited_ns = time_of_reset_ns(&mut board, Duration::from_millis(60)) - off_ns;
    assert!((41_000_000..52_000_000).contains(&waited_ns), "{waited_ns} ns");

    board.patch(address, healthy).unwrap();
    board.run_for(common::BOOT).unwrap();
    let after = status(&mut board, &mut link);
    assert_eq!((after.state, after.fault), (State::Fault, Some(Fault::WatchdogReset)));
    let words = common::black_box(&mut board, &mut link);
    let black_box = BlackBox(&words[..]);
    let newest = black_box.entries().last().unwrap();
    assert_eq!(newest.fault_number(), Fault::TaskHung.number(), "the black box is that of the run before");
    assert!(black_box.is_intact());
    board.check_told().unwrap();
    assert!(matches!(link.request(&mut board, &Request::Enable).unwrap(), Reply::Refused(_)));
    assert!(matches!(link.request(&mut board, &Request::ResetFault).unwrap(), Reply::Done { .. }));
    assert!(matches!(link.request(&mut board, &Request::Enable).unwrap(), Reply::Done { .. }));
}

/// Whatever hangs, with interrupts and all: nothing of the firmware works any more, the watchdog does.
#[test]
fn a_processor_that_hangs_altogether_is_reset_by_the_watchdog() {
    let (mut board, mut link) = moving();
    let start_ns = board.time_ns();
    // In RAM, from where the next start brings it back.
    let interrupt = board.elf().address(INTERRUPT).unwrap() & !3;
    board.write_memory(interrupt, u32::from(HANG) << 16 | u32::from(HANG)).unwrap();
    let waited_ns = time_of_reset_ns(&mut board, Duration::from_millis(60)) - start_ns;
    assert!((41_000_000..52_000_000).contains(&waited_ns), "{waited_ns} ns");
    assert!(!board.bridge_enabled().unwrap());
    board.run_for(common::BOOT).unwrap();
    let after = status(&mut board, &mut link);
    assert_eq!((after.state, after.fault), (State::Fault, Some(Fault::WatchdogReset)));
}

#[test]
fn a_processor_fault_turns_the_bridge_off_and_is_told_after_the_reset() {
    let (mut board, mut link) = moving();
    let address = board.elf().address(CALLED_BY_A_TASK).unwrap() & !1;
    let healthy = board.patch(address, UNDEFINED).unwrap();
    let start_ns = board.time_ns();
    while board.resets().unwrap() == 0 && board.time_ns() - start_ns < 150_000_000 {
        board.run_for(Duration::from_millis(1)).unwrap();
    }
    assert_eq!(board.resets().unwrap(), 1);
    assert!(!board.bridge_enabled().unwrap());
    board.patch(address, healthy).unwrap();
    board.run_for(common::BOOT).unwrap();
    assert!(common::logged(&board.log().unwrap(), "hard fault"));
    let after = status(&mut board, &mut link);
    assert_eq!((after.state, after.fault), (State::Fault, Some(Fault::Panic)));
    assert!(matches!(link.request(&mut board, &Request::Enable).unwrap(), Reply::Refused(_)));
    assert!(matches!(link.request(&mut board, &Request::ResetFault).unwrap(), Reply::Done { .. }));
    assert!(matches!(link.request(&mut board, &Request::Enable).unwrap(), Reply::Done { .. }));
}

#[test]
fn a_stack_that_comes_near_its_end_turns_the_bridge_off() {
    let (mut board, mut link) = moving();
    let end = board.elf().address("_stack_end").unwrap();
    board.write_memory(end + 1024, 1).unwrap();
    board.run_for(Duration::from_millis(110)).unwrap();
    assert_latched(&mut board, &mut link, Fault::StackLow);
}
