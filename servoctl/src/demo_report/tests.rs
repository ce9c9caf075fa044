use super::*;
use crate::settling::{Config, ServoTick, TOLERANCES_NM};

fn data() -> DemoData {
    let error_nm = |tau_ms: f64| (0..4000).map(|i| 900.0 * (-f64::from(i) / 8.0 / tau_ms).exp()).collect::<Vec<f64>>();
    let config = |name: &str, tau_ms: f64| Config::from_errors(name, &TOLERANCES_NM, &[error_nm(tau_ms)], 8000.0);
    let traces = |name: &str, tau_ms: f64| ConfigTraces {
        name: name.into(),
        moves: vec![MoveTrace {
            time_s: (0..4000).map(|i| f64::from(i) / 8000.0).collect(),
            error_nm: error_nm(tau_ms),
        }],
        force: ForceTrace { displacement_nm: vec![0.0, 4e6, 5e6], force_n: vec![0.0, 0.6, 0.6] },
    };
    DemoData {
        run: BoardRun {
            target: "stm32h743zi".into(),
            elf_sha256: "abc123".into(),
            settling: SettlingExperiment::new(&TOLERANCES_NM, vec![config("pid", 40.0), config("pid+niasa", 10.0)]),
            servo_tick: ServoTick::new(8000, 96_000, 0, 12.5),
            told: vec![],
        },
        conditions: Conditions {
            origin: "simulated".into(),
            step: "5 mm".into(),
            tuning: "100 Hz".into(),
            plant: "Maxwell-slip".into(),
        },
        seed: 42,
        command: "cargo xtask demo --seed 42".into(),
        traces: vec![traces("pid", 40.0), traces("pid+niasa", 10.0)],
    }
}

#[test]
fn the_page_says_what_was_found_and_how_to_repeat_it() {
    // Numbers are bound to their units.
    let page = render(&data()).replace('\u{a0}', " ");
    for expected in [
        // 900 nm falls to 10 nm after ln 90 = 4.4998 time constants; the last sample outside lies before that.
        "pid settles to ±10 nm in 179.9 ms on average, pid+niasa in 44.9 ms: 75.1 % shorter.",
        "simulated · step 5 mm · tuning 100 Hz · plant Maxwell-slip · 1 move per configuration",
        "8000 Hz, 96000 ticks, 0 overruns",
        "12.50 µs = 10.0 % of the period",
        "displacement / mm",
        "abc123",
        "cargo xtask demo --seed 42",
    ] {
        assert!(page.contains(expected), "{expected}");
    }
    assert_eq!(page.matches("<svg").count(), 4);
    assert!(!page.contains("had not settled"));
}

#[test]
fn unsettled_moves_are_pointed_out_and_show_the_whole_dwell() {
    let mut data = data();
    let never = vec![vec![None; TOLERANCES_NM.len()]];
    data.run.settling.configs[0] = Config::new("pid", &TOLERANCES_NM, &never, None);
    let page = render(&data);
    assert!(page.contains("had not settled"));
    assert_eq!(finding(&data.run.settling), None);
    assert_eq!(error_plot(&data, ErrorScale::Narrow).x.range, Some((0.0, 500.0)));
}

#[test]
fn the_fine_plot_ends_soon_after_the_slowest_move_has_settled() {
    let data = data();
    let slowest = slowest_ms(&data.run.settling, 0).unwrap();
    // 900 nm to 3 nm takes ln 300 = 5.70 time constants of 40 ms.
    assert!((slowest - 228.1).abs() < 0.2);
    assert_eq!(error_plot(&data, ErrorScale::Narrow).x.range, Some((0.0, (slowest * 1.15).ceil())));
}

#[test]
fn a_run_without_traces_or_moves_still_renders() {
    let mut data = data();
    data.traces.clear();
    data.run.settling = SettlingExperiment::new(&TOLERANCES_NM, vec![]);
    assert!(render(&data).contains("</html>"));
}
