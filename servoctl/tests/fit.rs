//! `servoctl fit` as a person types it: what it prints for a program, and what it refuses.

use std::fmt::Write;
use std::path::PathBuf;
use std::process::{Command, Output};

use serde_json::Value;
use servo_sim::friction::Dahl;
use servo_sim::random::{Noise, Purpose};
use tempfile::TempDir;

const SIGMA_N_PER_M: f64 = 8.66e6;
const COULOMB_N: f64 = 0.64;
const MASS_KG: f64 = 1.8;
const FORCE_CONSTANT_N_PER_A: f64 = 7.8;
const RATE_HZ: f64 = 8_000.0;

/// Rows of time, position, force and current.
type Rows = Vec<[f64; 4]>;

/// A second of a decaying sine of 1 µm at 8 Hz on Dahl's friction, with noise.
fn measured() -> Rows {
    let (mut friction, mut noise, mut before_m) =
        (Dahl::new(SIGMA_N_PER_M, COULOMB_N), Noise::new(1, Purpose::Encoder, 0), 0.0);
    let omega = std::f64::consts::TAU * 8.0;
    (0..8_000)
        .map(|i| {
            let t = f64::from(i) / RATE_HZ;
            let position_m = 1e-6 * libm::exp(-1.2 * t) * libm::sin(omega * t);
            let force_n = friction.advance(position_m - before_m);
            before_m = position_m;
            let current_a = (force_n - MASS_KG * omega * omega * position_m) / FORCE_CONSTANT_N_PER_A;
            let seen_m = position_m + 0.44e-9 * noise.normal();
            [t, seen_m, force_n + 2e-3 * noise.normal(), current_a + 3e-4 * noise.normal()]
        })
        .collect()
}

/// The rows in a file, with force or current.
struct File {
    directory: TempDir,
    path: PathBuf,
}

impl File {
    fn new(rows: &Rows, column: &str) -> File {
        let mut text = format!("time_s,position_m,{column}\n");
        let which = if column == "force_n" { 2 } else { 3 };
        for row in rows {
            writeln!(text, "{:.9},{:e},{:e}", row[0], row[1], row[which]).unwrap();
        }
        File::of(&text)
    }

    fn of(text: &str) -> File {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("measured.csv");
        std::fs::write(&path, text).unwrap();
        File { directory, path }
    }

    fn fit(&self, words: &str) -> Output {
        assert!(self.directory.path().exists());
        let mut words = words.split_whitespace();
        let mut command = Command::new(env!("CARGO_BIN_EXE_servoctl"));
        command.arg("fit").arg(words.next().unwrap()).arg(&self.path).args(words);
        command.output().unwrap()
    }

    fn json(&self, words: &str) -> Value {
        let output = self.fit(&format!("{words} --json -"));
        assert!(output.status.success(), "{words}: {}", String::from_utf8_lossy(&output.stderr));
        serde_json::from_slice(&output.stdout).unwrap()
    }

    /// Refused with exit code 1, the file's name and these words, and nothing for a program.
    fn refuses(&self, words: &str, part: &str) {
        let output = self.fit(&format!("{words} --json -"));
        let said = String::from_utf8_lossy(&output.stderr);
        assert_eq!((output.status.code(), output.stdout.len()), (Some(1), 0), "{words}: {said}");
        assert!(said.contains("measured.csv") && said.contains(part), "{words}: {said}, not {part}");
    }
}

fn near(value: &Value, expected: f64, share: f64) {
    let found = value.as_f64().unwrap_or(f64::NAN);
    assert!((found / expected - 1.0).abs() < share, "{found}, expected {expected}");
}

const CURRENT: &str = "--mass 1.8 --force-constant 7.8";

#[test]
fn dahl_gives_its_parameters_with_intervals_from_force_and_from_current() {
    for (file, words) in [
        (File::new(&measured(), "force_n"), "dahl".to_owned()),
        (File::new(&measured(), "current_a"), format!("dahl {CURRENT}")),
    ] {
        let fit = file.json(&words);
        near(&fit["sigma_n_per_m"], SIGMA_N_PER_M, 0.02);
        near(&fit["coulomb_n"], COULOMB_N, 0.02);
        for name in ["sigma_n_per_m", "coulomb_n"] {
            let [low, high] = [0, 1].map(|end| fit["ci95"][name][end].as_f64().unwrap());
            let value = fit[name].as_f64().unwrap();
            assert!(low < value && value < high, "{name}: {fit}");
        }
        assert_eq!(fit["samples"], 8_000);
        assert!(fit["mse_n2"].as_f64().unwrap() < 1e-4, "{fit}");
    }
}

#[test]
fn maxwell_gives_its_elements() {
    let fit = File::new(&measured(), "force_n").json("maxwell");
    let elements = fit["elements"].as_array().unwrap();
    let sum = |name: &str| elements.iter().map(|element| element[name].as_f64().unwrap()).sum::<f64>();
    assert!((0.5..0.7).contains(&sum("saturation_n")), "{fit}");
    assert!(sum("stiffness_n_per_m") > SIGMA_N_PER_M, "{fit}");
    assert!(fit["rms_n"].as_f64().unwrap() < 0.03 * COULOMB_N && fit["samples"].as_u64().unwrap() > 1_000, "{fit}");
}

#[test]
fn both_models_are_tried_and_the_simpler_one_is_chosen_where_it_does() {
    assert_eq!(File::new(&measured(), "force_n").json("choose")["model"], "dahl");
}

/// In one run, each the best of three: the machine may have other things to do.
#[test]
fn the_search_is_ten_times_faster_than_the_genetic_algorithm_and_no_worse() {
    let file = File::new(&measured(), "force_n");
    let runs = [(); 3].map(|()| file.json("dahl --genetic"));
    let best_ms = |name: &str| runs.iter().map(|run| run[name].as_f64().unwrap()).fold(f64::INFINITY, f64::min);
    let faster = best_ms("genetic_time_ms") / best_ms("time_ms");
    assert!(faster >= 10.0, "{faster} times");
    let [ours_n2, genetic_n2] =
        [&runs[0], &runs[0]["genetic"]].map(|fit| fit["mse_n2"].as_f64().unwrap_or_else(|| panic!("{}", runs[0])));
    assert!(0.0 < ours_n2 && ours_n2 <= genetic_n2, "{}", runs[0]);
    near(&runs[0]["genetic"]["coulomb_n"], COULOMB_N, 0.05);
}

/// 5 mm forth and back at 5 m/s², with Coulomb friction.
#[test]
fn a_move_tells_the_mass_and_checks_the_force_constant() {
    let (mut x, mut v, mut rows, mut noise) = (0.0, 0.0, Rows::new(), Noise::new(2, Purpose::PhaseAdc, 0));
    for i in 0..4_000 {
        let phase = match i % 2_000 {
            0..250 => 5.0,
            250..500 => -5.0,
            _ => 0.0,
        };
        let a = if i < 2_000 { phase } else { -phase };
        let friction_n = if v == 0.0 { 0.0 } else { COULOMB_N * f64::signum(v) };
        let current_a = (MASS_KG * a + friction_n) / FORCE_CONSTANT_N_PER_A + 3e-4 * noise.normal();
        rows.push([f64::from(i) / RATE_HZ, x + 0.44e-9 * noise.normal(), 0.0, current_a]);
        x += v / RATE_HZ;
        v += a / RATE_HZ;
        if v.abs() < 1e-9 {
            v = 0.0;
        }
    }
    let file = File::new(&rows, "current_a");
    let fit = file.json("move --force-constant 7.0 --mass 1.8");
    near(&fit["mass_kg"], MASS_KG * 7.0 / 7.8, 0.01);
    near(&fit["force_constant_n_per_a"], FORCE_CONSTANT_N_PER_A, 0.01);
    file.refuses("move --force-constant -7.8", "wrong sign");
    File::new(&measured(), "force_n").refuses("move --force-constant 7.8", "no column current_a");
}

/// An encoder that flickers between a few counts.
fn flicker(rows: &mut Rows) {
    for (i, row) in rows.iter_mut().enumerate() {
        row[1] = 61e-12 * (i * 7_919 % 5) as f64;
    }
}

#[test]
fn bad_data_are_refused_by_name_with_their_line() {
    let changed = |change: fn(&mut Rows)| {
        let mut rows = measured();
        change(&mut rows);
        rows
    };
    for (rows, part) in [
        (changed(|rows| rows.truncate(99)), "samples = 99 is too few: 100 or more are needed"),
        (changed(|rows| rows.iter_mut().for_each(|row| row[1] = 1e-6 * row[0])), "position_m has no reversal"),
        (changed(flicker), "no motion beyond its noise"),
        (changed(|rows| rows[1234][1] = f64::NAN), "line 1236: position_m = NaN is not a finite number"),
        (changed(|rows| rows[1234][0] = f64::INFINITY), "line 1236: time_s = inf is not a finite number"),
        (
            changed(|rows| drop(rows.drain(1000..1001))),
            "line 1002: time_s = 0.125125: a gap of 0.000250000 s before it, dropped samples",
        ),
        (changed(|rows| rows[4000][0] = rows[3990][0]), "line 4002: time_s = 0.49875 goes backwards"),
    ] {
        for (column, words) in [("force_n", ""), ("current_a", CURRENT)] {
            let file = File::new(&rows, column);
            for model in ["dahl", "maxwell", "choose"] {
                file.refuses(&format!("{model} {words}"), part);
            }
        }
    }
}

#[test]
fn a_saturated_current_and_a_wrong_sign_are_refused_by_name() {
    let mut rows = measured();
    rows.iter_mut().for_each(|row| row[3] = row[3].clamp(-0.06, 0.06));
    File::new(&rows, "current_a").refuses(&format!("dahl {CURRENT}"), "is saturated");
    let file = File::new(&measured(), "current_a");
    file.refuses("dahl --mass 1.8 --force-constant -7.8", "force-constant = -7.8 has the wrong sign");
    rows = measured();
    rows.iter_mut().for_each(|row| row[2] = -row[2]);
    File::new(&rows, "force_n").refuses("dahl", "has the wrong sign");
}

#[test]
fn what_is_typed_wrong_is_named() {
    let file = File::new(&measured(), "current_a");
    file.refuses("dahl", "needs --mass and --force-constant");
    file.refuses("dahl --mass 0 --force-constant 7.8", "mass = 0 is outside 0.001 to 10000");
    file.refuses(&format!("maxwell {CURRENT} --elements 13"), "elements = 13 is outside 1");
    File::of("time_s,position_m\n").refuses("dahl", "the header has no column force_n or current_a");
    File::of("time_s,position_m,force_n\n1,2 m,3\n").refuses("dahl", "line 2: position_m = `2 m` is not a number");
}
