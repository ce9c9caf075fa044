//! The plant from outside: energy, travel, time, sensors, repeatability.

use std::f64::consts::TAU;

use proptest::prelude::*;
use servo_sim::{BridgeState, Plant, SUBSTEP_MAX_NS, Stage, adc};

/// A bridge that puts `q_v` on the q axis at the plant's present position.
fn q_voltage(plant: &Plant, q_v: f64) -> BridgeState {
    let Stage { motor, amplifier, .. } = plant.stage();
    let angle = TAU * (plant.position_m() + motor.commutation_offset_m) / motor.magnet_pitch_m;
    let duty = [0.0, TAU / 3.0, -TAU / 3.0].map(|phase| 0.5 - q_v / amplifier.bus_v * libm::sin(angle - phase));
    BridgeState { duty, enabled: true, dead_time_s: 0.0 }
}

/// The position in a frame of the built-in stage (12 acknowledge bits), m.
fn frame_position_m(line: u64) -> f64 {
    ((line >> 16 & 0xffff_ffff) as f64 - f64::from(1u32 << 31)) * 61.03515625e-12
}

#[test]
fn positive_q_voltage_moves_the_stage_to_positive_positions() {
    for (q_v, sign) in [(2.0, 1.0), (-2.0, -1.0)] {
        let mut plant = Plant::new(&Stage::default(), 1);
        for _ in 0..800 {
            let bridge = q_voltage(&plant, q_v);
            plant.advance(25_000, &bridge);
        }
        assert!(plant.position_m() * sign > 100e-6 && plant.velocity_m_per_s() * sign > 0.0);
        assert!(plant.force_n() * sign > 0.0 && plant.friction_n() * sign > 0.6, "friction opposes motion");
    }
}

#[test]
fn the_energy_put_in_is_found_again() {
    let mut stage = Stage::default();
    stage.mechanics.viscous_n_s_per_m = 3.0;
    let mut plant = Plant::new(&stage, 1);
    let (mut electrical_j, mut copper_j, mut friction_j, mut drag_j) = (0.0, 0.0, 0.0, 0.0);
    for step in 0..40_000 {
        let q_v = if step / 10_000 % 2 == 0 { 3.0 } else { -2.5 };
        let (bridge, before) = (q_voltage(&plant, q_v), plant.clone());
        plant.advance(SUBSTEP_MAX_NS, &bridge);
        let dt_s = SUBSTEP_MAX_NS as f64 * 1e-9;
        for k in 0..3 {
            let mean_a = 0.5 * (before.currents_a()[k] + plant.currents_a()[k]);
            electrical_j += 48.0 * bridge.duty[k] * mean_a * dt_s;
            copper_j += 3.0 * mean_a * mean_a * dt_s;
        }
        let moved_m = plant.position_m() - before.position_m();
        friction_j += 0.5 * (before.friction_n() + plant.friction_n()) * moved_m;
        drag_j += 3.0 * moved_m * moved_m / dt_s;
    }
    let magnetic_j: f64 = plant.currents_a().iter().map(|current_a| 0.5 * 1.5e-3 * current_a * current_a).sum();
    let kinetic_j = 0.5 * 1.8 * plant.velocity_m_per_s() * plant.velocity_m_per_s();
    let found_j = copper_j + friction_j + drag_j + magnetic_j + kinetic_j;
    assert!(electrical_j > 0.5 && friction_j > 0.005 && drag_j > 0.005, "{electrical_j} {friction_j} {drag_j}");
    assert!((found_j / electrical_j - 1.0).abs() < 1e-4, "{electrical_j} J put in, {found_j} J found");
}

#[test]
fn the_hard_stops_hold() {
    for q_v in [12.0, -12.0] {
        let mut plant = Plant::new(&Stage::default(), 1);
        for _ in 0..40_000 {
            let bridge = q_voltage(&plant, q_v);
            plant.advance(25_000, &bridge);
            assert!(plant.position_m().abs() <= 0.05);
        }
        assert_eq!((plant.position_m(), plant.velocity_m_per_s()), (0.05f64.copysign(q_v), 0.0));
        for _ in 0..4_000 {
            let bridge = q_voltage(&plant, -q_v);
            plant.advance(25_000, &bridge);
        }
        assert!(plant.position_m().abs() < 0.049, "and let go");
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn an_interval_may_be_divided_at_will(cuts_ns in prop::collection::vec(0u64..60_000, 1..12), q_v in -6.0..6.0) {
        let mut moving = Plant::new(&Stage::default(), 1);
        for _ in 0..20 {
            let bridge = q_voltage(&moving, q_v);
            moving.advance(25_000, &bridge);
        }
        let bridge = BridgeState { dead_time_s: 0.5e-6, ..q_voltage(&moving, -0.5 * q_v) };
        let (mut whole, mut parts) = (moving.clone(), moving);
        whole.advance(cuts_ns.iter().sum(), &bridge);
        for cut_ns in cuts_ns {
            parts.advance(cut_ns, &bridge);
        }
        let off_m = parts.position_m() - whole.position_m();
        let off_m_per_s = parts.velocity_m_per_s() - whole.velocity_m_per_s();
        prop_assert!(off_m.abs() < 1e-9 && off_m_per_s.abs() < 1e-5, "{} m, {} m/s", off_m, off_m_per_s);
        for (a, b) in parts.currents_a().into_iter().zip(whole.currents_a()) {
            prop_assert!((a - b).abs() < 2e-3, "{} A, {} A", a, b);
        }
    }
}

#[test]
fn no_time_changes_nothing() {
    let mut plant = Plant::new(&Stage::default(), 1);
    plant.advance(1_000_000, &q_voltage(&plant.clone(), 3.0));
    let before = plant.clone();
    plant.advance(0, &q_voltage(&before, -3.0));
    assert_eq!(plant, before);
}

#[test]
fn a_frame_carries_the_position_with_the_stated_noise() {
    let mut plant = Plant::new(&Stage::default(), 5);
    for _ in 0..400 {
        let bridge = q_voltage(&plant, 2.0);
        plant.advance(25_000, &bridge);
    }
    let n = 20_000;
    let errors_m: Vec<f64> = (0..n).map(|_| frame_position_m(plant.encoder_frame()) - plant.position_m()).collect();
    let mean_m = errors_m.iter().sum::<f64>() / f64::from(n);
    let rms_m = libm::sqrt(errors_m.iter().map(|error_m| error_m * error_m).sum::<f64>() / f64::from(n));
    // Five standard errors; quantisation adds 18 pm rms to the 440 pm.
    assert!(mean_m.abs() < 5.0 * 0.44e-9 / libm::sqrt(f64::from(n)), "{mean_m} m");
    assert!((rms_m / 0.44036e-9 - 1.0).abs() < 5.0 / libm::sqrt(2.0 * f64::from(n)), "{rms_m} m");
}

#[test]
fn a_late_encoder_reads_where_the_plant_was() {
    let mut stage = Stage::default();
    (stage.encoder.noise_m_rms, stage.encoder.latency_s) = (0.0, 100e-6);
    let mut plant = Plant::new(&stage, 1);
    let bridge = q_voltage(&plant, 6.0);
    // Under way with the electrical time constant behind it: the acceleration is constant to a few percent.
    plant.advance(5_000_000, &bridge);
    let was_m = plant.position_m();
    plant.advance(100_000, &bridge);
    let read_m = frame_position_m(plant.encoder_frame());
    let moved_m = plant.position_m() - was_m;
    assert!(moved_m > 1e-6 && (read_m - was_m).abs() < 1e-3 * moved_m, "{moved_m} {}", read_m - was_m);
}

#[test]
fn sine_and_cosine_carry_the_position_and_the_counter_the_period() {
    let stage = Stage::from_toml(include_str!("../stages/sin-cos.toml")).unwrap();
    let mut plant = Plant::new(&stage, 5);
    let start = plant.encoder_signals().unwrap();
    assert_eq!(start.edges, 0);
    for _ in 0..4_000 {
        let bridge = q_voltage(&plant, 2.0);
        plant.advance(25_000, &bridge);
        let reading = plant.encoder_signals().unwrap();
        let periods = plant.position_m() / 4e-6;
        // In the middle of a quarter at most an eighth off, and what offsets, phase and hysteresis make.
        assert!(((reading.edges as f64 + 0.5) / 4.0 - periods).abs() < 0.15, "{} edges at {periods}", reading.edges);
        // A coarse arctangent, without corrections: 2 %, 2 % and 2° are less than a 50th of a period.
        let [sin, cos] = reading.pins.map(|pin| pin - 0.5);
        let turns = libm::atan2(sin, cos) / TAU - periods;
        assert!((turns - libm::round(turns)).abs() < 0.02, "{turns} at {periods}");
    }
    assert!(plant.position_m() > 1e-3);
    assert_eq!(Plant::new(&Stage::default(), 5).encoder_signals(), None);
}

#[test]
fn the_converters_read_what_is_there() {
    let mut stage = Stage::default();
    stage.adc.noise_lsb_rms = 0.0;
    let mut plant = Plant::new(&stage, 1);
    assert_eq!(plant.phase_codes(), [32_768; 2]);
    assert_eq!(plant.bus_adc(), 0.6);
    assert!((plant.temperature_adc() - 0.8 / 3.3).abs() < 1e-15, "30 °C is 0.8 V");
    plant.advance(1_000_000, &q_voltage(&plant.clone(), 3.0));
    let [a, b, _] = plant.currents_a();
    assert_eq!(plant.phase_codes(), [a, b].map(|current_a| adc::code(0.5 + current_a / 20.0)));
    assert!(b > 0.1 && plant.phase_codes()[1] > 33_000, "positive current, code above the middle");
}

#[test]
fn the_friction_of_a_move_depends_on_seed_and_move_only() {
    /// Friction (which tells σ and F_C) over the first micrometres of a virgin stage, and a frame (which tells the noise).
    fn start(stage: &Stage, seed: u64, moves: &[u64]) -> (Vec<f64>, u64) {
        let mut plant = Plant::new(stage, seed);
        for index in moves {
            plant.encoder_frame();
            plant.redraw_friction(*index);
        }
        let frame = plant.encoder_frame();
        let friction_n = (0..100).map(|_| {
            plant.advance(25_000, &q_voltage(&plant.clone(), 2.0));
            plant.friction_n()
        });
        (friction_n.collect(), frame)
    }
    let mut stage = Stage::default();
    assert_eq!(start(&stage, 1, &[3]), start(&stage, 1, &[7, 2, 3]));
    for other in [start(&stage, 1, &[4]), start(&stage, 2, &[3])] {
        let (friction_n, frame) = start(&stage, 1, &[3]);
        assert!(friction_n != other.0 && frame != other.1);
    }
    stage.friction.spread = None;
    assert_eq!(start(&stage, 1, &[3]).0, start(&stage, 2, &[4]).0, "without a spread every move is nominal");
}

#[test]
fn friction_is_distributed_as_the_stage_file_says() {
    let mut plant = Plant::new(&Stage::default(), 11);
    for _ in 0..2_000 {
        let bridge = q_voltage(&plant, 2.0); // saturate: the friction force is F_C from here on
        plant.advance(25_000, &bridge);
    }
    let n = 20_000;
    let drawn_n: Vec<f64> = (0..n)
        .map(|index| {
            plant.redraw_friction(index);
            plant.friction_n()
        })
        .collect();
    assert!(drawn_n.iter().all(|coulomb_n| (0.3 - 1e-12..=1.1 + 1e-12).contains(coulomb_n)));
    // Clipping at −1.89 and +2.56 standard deviations: 2.9 % and 0.5 % of the draws, the mean moves by +1.5 mN.
    let share = |limit_n: f64| {
        drawn_n.iter().filter(|coulomb_n| (**coulomb_n - limit_n).abs() < 1e-9).count() as f64 / n as f64
    };
    assert!(
        (share(0.3) - 0.0294).abs() < 0.006 && (share(1.1) - 0.0053).abs() < 0.003,
        "{} {}",
        share(0.3),
        share(1.1)
    );
    let mean_n = drawn_n.iter().sum::<f64>() / n as f64;
    assert!((mean_n - 0.6415).abs() < 5.0 * 0.18 / libm::sqrt(n as f64), "{mean_n}");
}

#[test]
fn a_stored_plant_continues_with_the_same_bits() {
    let mut plant = Plant::new(&Stage::default(), 9);
    plant.redraw_friction(2);
    let live = |plant: &mut Plant| {
        let mut seen = Vec::new();
        for _ in 0..200 {
            let bridge = q_voltage(plant, 1.0);
            plant.advance(25_001, &bridge);
            seen.push((
                plant.encoder_frame(),
                plant.phase_codes(),
                plant.bus_adc().to_bits(),
                plant.position_m().to_bits(),
            ));
        }
        seen
    };
    live(&mut plant);
    let bytes = postcard::to_stdvec(&plant).unwrap();
    let mut stored: Plant = postcard::from_bytes(&bytes).unwrap();
    assert_eq!(stored, plant);
    assert_eq!(live(&mut stored), live(&mut plant));
    assert_eq!(stored, plant);
}

#[test]
fn the_bits_of_a_run_never_change() {
    let mut plant = Plant::new(&Stage::default(), 1);
    plant.redraw_friction(0);
    for period in 0..40_000u32 {
        let bridge =
            BridgeState { dead_time_s: 0.5e-6, ..q_voltage(&plant, if period / 4_000 % 2 == 0 { 1.5 } else { -1.5 }) };
        plant.advance(25_000, &bridge);
    }
    plant.advance(1_000_000, &BridgeState::OFF);
    let state = (plant.position_m(), plant.velocity_m_per_s(), plant.friction_n());
    assert_eq!(state, (0.0015765980632685707, -0.019312721354340312, -0.38887061217863705));
    assert_eq!((plant.phase_codes(), plant.encoder_frame()), ([32_768, 32_767], 0xc002_818a_2643_de00));
}
