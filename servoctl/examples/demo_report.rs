//! Renders the demo page from made-up traces, to look at its layout: `cargo run -p servoctl --example demo_report`.
//! The numbers mean nothing. The page, a picture and the JSON land beside the example's binary.

use servoctl::demo_report::{ConfigTraces, DemoData, ForceTrace, MoveTrace, render, settling_plot};
use servoctl::settling::{BoardRun, Config, ServoTick, SettlingExperiment, TOLERANCES_NM};
use servoctl::table::{Conditions, settling_table};
use std::f64::consts::TAU;

const SAMPLE_RATE_HZ: f64 = 8000.0;
const DWELL_S: f64 = 2.0;
const MOVES: u32 = 5;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let data = made_up();
    let folder = std::env::current_exe()?.parent().map(std::path::Path::to_path_buf).unwrap_or_default();
    let page = render(&data);
    std::fs::write(folder.join("demo_report.html"), &page)?;
    std::fs::write(folder.join("demo_report.json"), data.run.to_json()?)?;
    std::fs::write(folder.join("settling.svg"), settling_plot(&data.run.settling).svg_file())?;
    println!("{}", settling_table(&data.run.settling, &data.conditions).to_text());
    println!("{} bytes in {}", page.len(), folder.join("demo_report.html").display());
    Ok(())
}

fn made_up() -> DemoData {
    let kinds = [("pid", 1900.0, 0.085), ("pid+niasa", 1700.0, 0.018)];
    let traces: Vec<ConfigTraces> =
        kinds.iter().map(|&(name, start_nm, tau_s)| config(name, start_nm, tau_s)).collect();
    let configs = traces.iter().map(|c| {
        let dwells: Vec<Vec<f64>> = c.moves.iter().map(dwell).collect();
        Config::from_errors(&c.name, &TOLERANCES_NM, &dwells, SAMPLE_RATE_HZ)
    });
    let settling = SettlingExperiment::new(&TOLERANCES_NM, configs.collect());
    DemoData {
        run: BoardRun {
            target: "stm32h743zi".into(),
            elf_sha256: "5f1d".repeat(16),
            settling,
            servo_tick: ServoTick::new(8000, 123_456, 0, 11.5625),
            told: vec!["ADC12 CCR written while an ADC is enabled <made up>".into()],
        },
        conditions: Conditions {
            origin: "made up, neither simulated nor measured".into(),
            step: "5 mm at 1 m/s²".into(),
            tuning: "100 Hz / 45°, no feedforward".into(),
            plant: "Maxwell-slip friction (12 elements), 1.8 kg".into(),
        },
        seed: 1,
        command: "cargo xtask demo --moves 5 --seed 1".into(),
        traces,
    }
}

/// Damped oscillation, then a creeping exponential, with noise; 20 ms of the profile before.
fn config(name: &str, start_nm: f64, tau_s: f64) -> ConfigTraces {
    let moves = (0..MOVES).map(|k| {
        let scale = 1.0 + 0.15 * (f64::from(k) - 2.0);
        let time_s: Vec<f64> =
            (-160..(DWELL_S * SAMPLE_RATE_HZ) as i32).map(|i| f64::from(i) / SAMPLE_RATE_HZ).collect();
        let error_nm = time_s.iter().enumerate().map(|(i, &t)| {
            let noise_nm = 1.5 * (((i as f64 + 0.1 * f64::from(k)) * 12.9898).sin() * 43_758.545).fract() * 0.6;
            let after_s = t.max(0.0);
            let ringing_nm = start_nm * (-after_s / 0.006).exp() * (TAU * 120.0 * t + f64::from(k)).cos();
            let creep_nm = 600.0 * scale * (-after_s / (tau_s * scale)).exp();
            if t < 0.0 { 9000.0 * t / 0.02 + ringing_nm + creep_nm } else { ringing_nm + creep_nm + noise_nm }
        });
        MoveTrace { error_nm: error_nm.collect(), time_s }
    });
    let angle = (0..4000).map(|i| f64::from(i) / 4000.0 * 3.0 * TAU);
    let reach_nm = |a: f64| start_nm * 0.4 * (-a / 9.0).exp();
    let force = ForceTrace {
        displacement_nm: angle.clone().map(|a| reach_nm(a) * a.cos()).collect(),
        force_n: angle.map(|a| 0.6 * (reach_nm(a) / 400.0).tanh() * (a + 0.6).cos()).collect(),
    };
    ConfigTraces { name: name.into(), moves: moves.collect(), force }
}

fn dwell(trace: &MoveTrace) -> Vec<f64> {
    trace.time_s.iter().zip(&trace.error_nm).filter(|(t, _)| **t >= 0.0).map(|(_, e)| *e).collect()
}
