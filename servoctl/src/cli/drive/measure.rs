//! `servoctl measure`: what the drive adds to force or velocity, and what answers.

use std::fmt::Write;
use std::path::PathBuf;
use std::process::ExitCode;

use anyhow::{Result, ensure};
use clap::ValueEnum;
use serde::Serialize;
use servo_core::SERVO_HZ;
use servo_core::measure::{self, Shape};
use servo_core::parameters::Settings;
use servo_core::state::State;
use servo_ident::frf::{self, Margins, Point, SecondOrder};

use super::super::interrupt;
use super::super::output::Json;
use super::super::progress::Progress;
use super::Link;
use super::record_file::{Head, write};
use crate::commission::sweep::{self, Bounds, Carrier, Tone};
use crate::commission::{Event, Failure, OnLine, Order, Session, from_first};
use crate::link::units;
use crate::table::{MISSING, Table, number};

/// Options of `measure`.
#[derive(Debug, clap::Subcommand)]
pub enum Options {
    /// Stepped sine: loop transmission, plant and closed loop at each amplitude, with their margins
    Loop(Loop),
    /// The identification profile, a decaying sine, recorded in every servo tick for `servoctl fit`
    Profile(Profile),
    /// A step of force or velocity and back, recorded in every servo tick
    Pulse(Pulse),
}

/// Where an excitation joins, and what ends it before harm is done.
#[derive(Debug, Clone, Copy, clap::Args)]
pub struct Limits {
    /// Where it joins the loop
    #[arg(long, value_enum, default_value_t = Node::Force)]
    node: Node,
    /// Ends it: distance from where the stage is now, up to 1 m [default: 1 mm, on a carrier 0.1 m]
    #[arg(long, value_parser = units::length)]
    travel: Option<f64>,
    /// Ends it: speed, up to 10 m/s
    #[arg(long, value_parser = units::speed, default_value = "100mm/s")]
    speed: f64,
    /// Ends it: measured current, A [default: nine tenths of the drive's limit]
    #[arg(long, value_name = "A")]
    current: Option<f64>,
}

/// Where an excitation joins the loop.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Node {
    /// What is asked of the motor; amplitudes in N
    Force,
    /// The velocity error; amplitudes in m/s
    Velocity,
}

/// Options of `measure loop`.
#[derive(Debug, clap::Args)]
pub struct Loop {
    /// Amplitudes, one sweep for each; N, at the velocity node m/s
    #[arg(long, value_delimiter = ',', required = true, value_name = "N,…")]
    amplitude: Vec<f64>,
    /// Frequencies in rising order, Hz, 0.1 to 3600 [default: those of --points from 20 to 2000 Hz]
    #[arg(long, value_delimiter = ',', value_name = "HZ,…", conflicts_with = "points")]
    frequency: Vec<f64>,
    /// Number of frequencies, 2 to 1000, from 20 to 2000 Hz in equal ratios
    #[arg(long, default_value_t = 28)]
    points: usize,
    /// On a slow move of this speed to and fro, which keeps friction sliding [default: at rest]
    #[arg(long, value_parser = units::speed, value_name = "SPEED")]
    carrier: Option<f64>,
    #[command(flatten)]
    limits: Limits,
    #[command(flatten)]
    json: Json,
}

/// Options of `measure profile`.
#[derive(Debug, clap::Args)]
pub struct Profile {
    /// Amplitude at the beginning; N, at the velocity node m/s
    #[arg(long, value_name = "N")]
    amplitude: f64,
    /// Frequency, Hz; the thesis has 8, 16 and 32
    #[arg(long, value_name = "HZ", default_value_t = 16.0)]
    frequency: f64,
    /// Number of periods
    #[arg(long, default_value_t = 8)]
    periods: u32,
    /// Amplitude at the end over that at the beginning
    #[arg(long, default_value_t = 0.7)]
    end_share: f64,
    #[command(flatten)]
    recorded: Recorded,
}

/// Options of `measure pulse`.
#[derive(Debug, clap::Args)]
pub struct Pulse {
    /// Height; N, at the velocity node m/s
    #[arg(long, value_name = "N", allow_negative_numbers = true)]
    amplitude: f64,
    /// Length
    #[arg(long, value_parser = units::time, default_value = "20ms")]
    length: f64,
    #[command(flatten)]
    recorded: Recorded,
}

/// What recorded excitations share.
#[derive(Debug, clap::Args)]
pub struct Recorded {
    #[command(flatten)]
    limits: Limits,
    /// The file: time, position and current, as `servoctl fit` reads them
    #[arg(short, long, value_name = "FILE.csv")]
    output: PathBuf,
    #[command(flatten)]
    json: Json,
}

/// Measures and prints or writes.
///
/// # Errors
/// Values out of range, a refusal, a limit that was met; those of the link.
pub fn run(link: &Link, options: &Options) -> Result<ExitCode> {
    let interrupted = interrupt::flag_saying("stopping; Ctrl-C again leaves the drive to itself")?;
    let mut connected = link.connect()?;
    if connected.is_virtual && connected.drive.status()?.state != State::OperationEnabled {
        eprintln!("enabling the virtual drive (a real one wants `servoctl enable`)");
        connected.drive.enable()?;
    }
    let (mut on_line, settings) = OnLine::new(connected.drive)?;
    let head = Head::new(on_line.drive(), &settings, 1, "excitation, time 0");
    let mut progress: Option<(Progress, u32)> = None;
    let mut said = |event: Event| {
        if let Event::Done(done, of) = event {
            let (bar, before) = progress.get_or_insert_with(|| (Progress::new("measuring", of.into(), "tones"), 0));
            bar.advance(u64::from(done - *before));
            *before = done;
        }
    };
    let silence_s = settings.command_timeout_s;
    let mut session = Session { link: &mut on_line, stop: interrupted, settings, silence_s, said: &mut said };
    let measured = match options {
        Options::Loop(options) => measure_loop(&mut session, options),
        Options::Profile(options) => {
            let shape = Shape::DecayingSine {
                amplitude: options.amplitude as f32,
                frequency_hz: options.frequency as f32,
                periods: options.periods,
                end_share: options.end_share as f32,
            };
            record(&mut session, shape, f64::from(options.periods) / options.frequency, &options.recorded, &head)
        }
        Options::Pulse(options) => {
            let shape = Shape::Pulse { amplitude: options.amplitude as f32, length_s: options.length as f32 };
            record(&mut session, shape, options.length, &options.recorded, &head)
        }
    };
    match measured {
        Ok(()) => Ok(ExitCode::SUCCESS),
        Err(error) => {
            // What ended it says more than a line that is dead.
            let _ = session.brake();
            match error.downcast_ref() {
                Some(Failure::Stopped) => Ok(ExitCode::from(interrupt::INTERRUPTED)),
                _ => Err(error),
            }
        }
    }
}

impl Limits {
    fn bounds(&self, settings: &Settings, travel_m: f64) -> Bounds {
        Bounds {
            node: match self.node {
                Node::Force => measure::Node::Force,
                Node::Velocity => measure::Node::Velocity,
            },
            travel_m: self.travel.unwrap_or(travel_m) as f32,
            speed_m_per_s: self.speed as f32,
            current_a: self.current.unwrap_or(0.9 * settings.current_limit_a) as f32,
        }
    }
}

/// What a sweep at one amplitude shows.
#[derive(Debug, Serialize)]
struct Response {
    /// Amplitude, N or m/s.
    amplitude: f64,
    /// Loop transmission.
    loop_transmission: Vec<Point>,
    /// Closed loop, 5.1.
    closed_loop: Vec<Point>,
    /// Position over force, m/N; empty at the velocity node.
    plant_m_per_n: Vec<Point>,
    /// `null` if the gain does not fall through 1.
    margins: Option<Margins>,
    /// The closed loop as one of second order (5.2); `null` if none is near.
    second_order: Option<SecondOrder>,
}

fn measure_loop(session: &mut Session, options: &Loop) -> Result<()> {
    let hz: Vec<f64> = if options.frequency.is_empty() {
        ensure!((2..=1000).contains(&options.points), "--points = {} is outside 2 to 1000", options.points);
        sweep::logarithmic([20.0, 2_000.0], options.points).collect()
    } else {
        options.frequency.clone()
    };
    let rising = hz.windows(2).all(|pair| pair[0] < pair[1]);
    ensure!(rising, "--frequency: {} is not in rising order", list(&hz));
    let travel_m = if options.carrier.is_some() { 0.1 } else { 1e-3 };
    let bounds = options.limits.bounds(&session.settings, travel_m);
    let mut carrier = options.carrier.map(|speed| Carrier::begin(session, speed)).transpose()?;
    let mut responses = Vec::new();
    let of = hz.len() * options.amplitude.len();
    for (index, amplitude) in options.amplitude.iter().enumerate() {
        let tones: Vec<Tone> = hz.iter().map(|hz| Tone { hz: *hz, amplitude: *amplitude }).collect();
        let readings = sweep::sweep(session, &tones, &bounds, carrier.as_mut(), (index * hz.len(), of))?;
        let loop_transmission: Vec<Point> = readings.iter().map(sweep::loop_transmission).collect();
        let closed_loop = frf::closed_loop(&loop_transmission);
        let count_m = session.settings.encoder_count_m;
        let at_force = bounds.node == measure::Node::Force;
        responses.push(Response {
            amplitude: *amplitude,
            plant_m_per_n: readings.iter().filter(|_| at_force).map(|r| sweep::plant(r, count_m)).collect(),
            margins: frf::margins(&loop_transmission).ok(),
            second_order: frf::second_order(&closed_loop).ok(),
            closed_loop,
            loop_transmission,
        });
    }
    options.json.write(&responses, || responses.iter().map(|response| response.to_text(options.limits.node)).collect())
}

fn list(values: &[f64]) -> String {
    values.iter().map(f64::to_string).collect::<Vec<_>>().join(", ")
}

impl Response {
    fn to_text(&self, node: Node) -> String {
        let unit = if node == Node::Force { "N" } else { "m/s" };
        let caption = format!("Loop at {} {unit}, measured by the drive", self.amplitude);
        let header = [
            "frequency / Hz",
            "loop / dB",
            "loop / °",
            "closed loop / dB",
            "closed loop / °",
            "plant / nm/N",
            "plant / °",
        ];
        let db = |p: &Point| number(20.0 * p.value.norm().log10(), 2);
        let deg = |p: &Point| number(p.value.arg().to_degrees(), 1);
        let rows = self.loop_transmission.iter().zip(&self.closed_loop).enumerate();
        let table = rows.fold(Table::new(caption, &header), |table, (i, (l, t))| {
            let plant = self.plant_m_per_n.get(i);
            let missing = || MISSING.to_owned();
            table.row([
                number(l.frequency_hz, 1),
                db(l),
                deg(l),
                db(t),
                deg(t),
                plant.map_or_else(missing, |p| number(p.value.norm() * 1e9, 2)),
                plant.map_or_else(missing, deg),
            ])
        });
        let mut text = table.to_text();
        match &self.margins {
            Some(margins) => {
                let gain_margin = margins.gain_margin_db.map_or_else(|| MISSING.to_owned(), |db| number(db, 1));
                let _ = writeln!(
                    text,
                    "crossover {} Hz, phase margin {}°, gain margin {gain_margin} dB, sensitivity peak {} at {} Hz",
                    number(margins.crossover_hz, 1),
                    number(margins.phase_margin_deg, 1),
                    number(margins.sensitivity_peak, 2),
                    number(margins.sensitivity_peak_hz, 0),
                );
            }
            None => text += "the gain does not fall through 1 at these frequencies\n",
        }
        if let Some(SecondOrder { natural_hz, damping, rms }) = &self.second_order {
            let _ = writeln!(
                text,
                "closed loop as of second order: {} Hz, damping {}, {} rms beside it",
                number(*natural_hz, 1),
                number(*damping, 3),
                number(*rms, 3)
            );
        }
        text + "\n"
    }
}

/// Plays an excitation that is recorded, and writes what `fit` needs.
fn record(session: &mut Session, shape: Shape, length_s: f64, options: &Recorded, head: &Head) -> Result<()> {
    ensure!(length_s.is_finite() && length_s > 0.0, "length = {length_s} s: it must be above 0");
    let bounds = options.limits.bounds(&session.settings, 1e-3);
    let order = Order::Excite(bounds.around(shape));
    let [position_ct, current_a] = session.signals(["position_low_ct", "iq_a"], &order, length_s, 1)?;
    session.complete()?;
    let times_s: Vec<f64> = (0..position_ct.len()).map(|tick| tick as f64 / f64::from(SERVO_HZ)).collect();
    let columns = [from_first(&position_ct).collect(), current_a];
    write(&options.output, head, &["position_ct", "current_a"], &times_s, &columns)?;
    let moved_ct = columns[0].iter().fold([0.0f64, 0.0], |[low, high], ct| [low.min(*ct), high.max(*ct)]);
    let moved_m = (moved_ct[1] - moved_ct[0]) * session.settings.encoder_count_m;
    let name = options.output.display().to_string();
    let told = serde_json::json!({ "file": name, "samples": times_s.len(), "moved_m": moved_m });
    options.json.write(&told, || {
        format!(
            "{name}: {} samples, the stage moved by {}; `servoctl fit choose {name} --mass KG --force-constant N/A`\n",
            times_s.len(),
            units::show_length(moved_m)
        )
    })
}
