//! `cargo xtask demo`: the same moves with PID and with PID + NIASA, on the firmware's ELF.

use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use anyhow::{Context, Result, ensure};
use clap::Parser;
use servo_core::SERVO_HZ;
use servo_core::config::Compensator;
use servo_core::parameters::Settings;
use servo_core::position::Position;
use servo_core::settling::TOLERANCES_NM;
use servo_host_tests::experiment::{FIVE_MM_SLOW, Steps};
use servo_host_tests::tuning;
use servo_sim::Stage;
use servo_virtual_board::session::Session;
use servo_virtual_board::{Config, Elf, Snapshot, VirtualBoard};
use servoctl::demo_report::{ConfigTraces, DemoData, ForceTrace, MoveTrace, render};
use servoctl::settling::{self, BoardRun, ServoTick, SettlingExperiment};
use servoctl::table::{Conditions, settling_table};

/// Makes 5 mm moves with PID and with PID + NIASA on the virtual board and compares how they settle.
#[derive(Parser)]
struct Arguments {
    /// Moves per configuration.
    #[arg(long, default_value_t = 5, value_parser = clap::value_parser!(u64).range(1..=1000))]
    moves: u64,
    /// Stage file; the built-in stage if not given.
    #[arg(long)]
    stage: Option<PathBuf>,
    /// Seed of every random number.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Also write the results as JSON; `-` for standard output.
    #[arg(long)]
    json: Option<PathBuf>,
    /// Where to write the report.
    #[arg(long, default_value = "out/report.html")]
    report: PathBuf,
    /// The firmware; otherwise the variable SERVO_ELF says where it is.
    #[arg(long)]
    elf: Option<PathBuf>,
}

/// First experiment (9.1). PID creeps with a time constant of 2σ/k_I, about a second: less dwell would count the creep as noise in position.
const MOVE: Steps = Steps { dwell_s: 4.0, ..FIVE_MM_SLOW };
/// CPU clock of the board, for cycle counts.
const CYCLES_PER_US: f64 = 400.0;
/// Error traces: 1 s at 2 kHz.
const CAPTURE_SAMPLES: u32 = 2000;
const CAPTURE_EVERY_TICKS: u32 = 4;
/// How much of a settling force–displacement loop is drawn, s.
const LOOP_S: f64 = 0.5;
/// Log and progress are shown this often.
const CHUNK: Duration = Duration::from_millis(250);

fn main() -> Result<()> {
    let arguments = Arguments::parse();
    let stage = read_stage(arguments.stage.as_deref())?;
    let elf = Elf::find(arguments.elf.as_deref())?;
    let settings = tuning::settings(&stage, &tuning::STANDARD)?;
    let say = Say { json_on_stdout: arguments.json.as_deref() == Some(Path::new("-")) };

    let config = Config { stage, seed: arguments.seed, ..Config::default() };
    say.line(&format!("Booting {} on the virtual NUCLEO-H743ZI2", elf.path().display()));
    let started = Instant::now();
    let mut board = VirtualBoard::boot(&elf, &config)?;
    board.run_for(Duration::from_millis(100))?;
    say.log(&mut board)?;
    say.line("\nA new drive: parameters set, saved, fault reset");
    let mut session = Session::new(board);
    session.commission(&settings)?;
    say.log(&mut session.board)?;
    let ready = session.board.snapshot()?;

    let mut runs = Vec::new();
    for (name, compensator) in [("pid", Compensator::None), ("pid+niasa", Compensator::Niasa)] {
        say.line(&format!("\n{name}: {} moves of 5 mm at 1 m/s²", arguments.moves));
        runs.push(run(&ready, &settings, name, compensator, arguments.moves, &say)?);
    }

    let virtual_s: f64 = runs.iter().map(|r| r.virtual_s).sum();
    let told: Vec<String> =
        runs[0].told.iter().chain(runs[1].told.iter().filter(|t| !runs[0].told.contains(t))).cloned().collect();
    let board_run = BoardRun {
        target: "stm32h743zi".to_owned(),
        elf_sha256: elf.sha256().to_owned(),
        settling: SettlingExperiment::new(&TOLERANCES_NM, runs.iter().map(|r| r.config.clone()).collect()),
        servo_tick: ServoTick::new(
            SERVO_HZ,
            runs.iter().map(|r| r.ticks).sum(),
            runs.iter().map(|r| r.overruns).sum(),
            runs.iter().map(|r| r.longest_us).fold(0.0, f64::max),
        ),
        told,
    };
    let data = DemoData {
        conditions: conditions(&stage, &settings),
        seed: arguments.seed,
        command: command(&arguments),
        traces: runs.into_iter().map(|r| r.traces).collect(),
        run: board_run,
    };
    say.line("");
    say.line(&settling_table(&data.run.settling, &data.conditions).to_text());
    let wall_s = started.elapsed().as_secs_f64();
    say.line(&format!(
        "{virtual_s:.1} s of virtual time in {wall_s:.0} s ({:.1} s of wall time per virtual second)",
        wall_s / virtual_s
    ));

    if let Some(folder) = arguments.report.parent() {
        std::fs::create_dir_all(folder).with_context(|| format!("creating {}", folder.display()))?;
    }
    std::fs::write(&arguments.report, render(&data))
        .with_context(|| format!("writing {}", arguments.report.display()))?;
    say.line(&format!("Report: {}", arguments.report.display()));
    if let Some(path) = &arguments.json {
        let json = data.run.to_json()? + "\n";
        if say.json_on_stdout {
            print!("{json}");
        } else {
            std::fs::write(path, json).with_context(|| format!("writing {}", path.display()))?;
            say.line(&format!("JSON: {}", path.display()));
        }
    }
    Ok(())
}

/// The results of one configuration.
struct Run {
    config: settling::Config,
    traces: ConfigTraces,
    ticks: u64,
    overruns: u64,
    longest_us: f64,
    virtual_s: f64,
    told: Vec<String>,
}

fn run(
    ready: &Snapshot,
    settings: &Settings,
    name: &str,
    compensator: Compensator,
    moves: u64,
    say: &Say,
) -> Result<Run> {
    let mut session = Session::new(VirtualBoard::from_snapshot(ready)?);
    let from_ns = session.board.time_ns();
    session.enable(compensator)?;
    let limits = MOVE.limits(settings);
    let nm_per_ct = settings.encoder_count_m * 1e9;
    let (mut settling_ms, mut mean_squares, mut move_traces) = (Vec::new(), Vec::new(), Vec::new());
    let mut force = ForceTrace { displacement_nm: Vec::new(), force_n: Vec::new() };
    for index in 0..moves {
        session.board.redraw_friction(index)?;
        session.arm_capture(CAPTURE_SAMPLES, CAPTURE_EVERY_TICKS)?;
        let target = MOVE.target(Position(0), index, settings.encoder_count_m);
        session.move_to(target.0, limits)?;
        if index == 0 {
            session.board.start_trace()?;
        }
        let mut left = Duration::from_secs_f64(MOVE.dwell_s);
        while !left.is_zero() {
            session.board.run_for(CHUNK.min(left))?;
            left = left.saturating_sub(CHUNK);
            say.log(&mut session.board)?;
        }
        if index == 0 {
            force = loop_of(&session.board.take_trace()?, target.0 as f64 * settings.encoder_count_m);
        }
        let settled = session.settling()?;
        let row: Vec<Option<f64>> =
            (0..TOLERANCES_NM.len()).map(|i| settled.settled_after_s(i).map(|s| s * 1e3)).collect();
        let shown: Vec<String> = row.iter().map(|ms| ms.map_or("–".to_owned(), |ms| format!("{ms:.1}"))).collect();
        say.line(&format!("  move {}/{moves}: settled after {} ms (±3 … ±100 nm)", index + 1, shown.join(" / ")));
        settling_ms.push(row);
        mean_squares.extend(settled.noise_ct2.map(|ct2| f64::from(ct2) * nm_per_ct * nm_per_ct));
        move_traces.push(trace_of(&mut session, nm_per_ct)?);
    }
    // Exactly so many ticks in every run: what follows reads the counters once.
    let counters = session.status()?.counters;
    let noise_nm =
        (!mean_squares.is_empty()).then(|| (mean_squares.iter().sum::<f64>() / mean_squares.len() as f64).sqrt());
    session.board.check_told()?;
    let told = session.board.told()?.iter().map(ToString::to_string).collect();
    ensure!(session.status()?.fault.is_none(), "the drive ended in a fault");
    Ok(Run {
        config: settling::Config::new(name, &TOLERANCES_NM, &settling_ms, noise_nm),
        traces: ConfigTraces { name: name.to_owned(), moves: move_traces, force },
        ticks: u64::from(counters.ticks),
        overruns: u64::from(counters.overruns),
        longest_us: f64::from(counters.longest_tick_cycles) / CYCLES_PER_US,
        virtual_s: (session.board.time_ns() - from_ns) as f64 * 1e-9,
        told,
    })
}

/// Friction force over displacement from the target, from the end of the profile on: the truth, not the drive's estimate.
fn loop_of(trace: &[servo_virtual_board::TruthSample], target_m: f64) -> ForceTrace {
    let shown = &trace[..trace.len().min((LOOP_S * f64::from(SERVO_HZ)) as usize)];
    ForceTrace {
        displacement_nm: shown.iter().map(|t| (t.position_m - target_m) * 1e9).collect(),
        force_n: shown.iter().map(|t| t.friction_n).collect(),
    }
}

/// The drive's own capture of the last move.
fn trace_of(session: &mut Session, nm_per_ct: f64) -> Result<MoveTrace> {
    let samples = session.read_capture()?;
    let dt_s = f64::from(CAPTURE_EVERY_TICKS) / f64::from(SERVO_HZ);
    Ok(MoveTrace {
        time_s: (0..samples.len()).map(|i| i as f64 * dt_s).collect(),
        error_nm: samples.iter().map(|s| f64::from(s.error_ct) * nm_per_ct).collect(),
    })
}

fn read_stage(path: Option<&Path>) -> Result<Stage> {
    let Some(path) = path else { return Ok(Stage::default()) };
    let text = std::fs::read_to_string(path).with_context(|| format!("reading stage file {}", path.display()))?;
    Stage::from_toml(&text).with_context(|| format!("stage file {}", path.display()))
}

fn conditions(stage: &Stage, settings: &Settings) -> Conditions {
    let friction = &stage.friction;
    let spread = if friction.spread.is_some() { ", redrawn per move" } else { "" };
    Conditions {
        origin: "simulated (firmware on the virtual STM32H743)".to_owned(),
        step: format!("5 mm at 1 m/s², dwell {} s", MOVE.dwell_s),
        tuning: format!(
            "100 Hz / 45°, no feedforward; NIASA τ_d {} ms, σ̂ {:.2} N/µm, F̂_C {:.2} N",
            settings.niasa_time_constant_s * 1e3,
            settings.niasa_stiffness_n_per_m * 1e-6,
            settings.niasa_coulomb_n
        ),
        plant: format!(
            "{} kg, {} friction σ {:.2} N/µm, F_C {:.2} N{spread}",
            stage.mechanics.mass_kg,
            friction.model.name(),
            friction.stiffness_n_per_m * 1e-6,
            friction.coulomb_n
        ),
    }
}

fn command(arguments: &Arguments) -> String {
    let stage = arguments.stage.as_ref().map_or(String::new(), |path| format!(" --stage {}", path.display()));
    format!("cargo xtask demo --moves {} --seed {}{stage}", arguments.moves, arguments.seed)
}

/// What a person reads while it runs: on standard error if standard output is for the JSON.
struct Say {
    json_on_stdout: bool,
}

impl Say {
    fn line(&self, text: &str) {
        if self.json_on_stdout { eprintln!("{text}") } else { println!("{text}") }
    }

    fn log(&self, board: &mut VirtualBoard) -> Result<()> {
        for line in board.log()? {
            self.line(&format!("    {line}"));
        }
        Ok(())
    }
}
