//! `servoctl theory`: one settling of chapter 7, without or with mass.

use super::output::Json;
use crate::table::{MISSING, Table, number};
use crate::theory::mass::{Response, Verdict};
use crate::theory::{Method, mass, massless};
use anyhow::{Result, ensure};
use serde::Serialize;

/// Most samples of a trace.
const MOST_SAMPLES: f64 = 100_000.0;

/// Which theory.
#[derive(Debug, clap::Subcommand)]
pub enum Options {
    /// Without inertia: equations 7.31 and 7.32 (corrected), as in figures 34 to 44
    ///
    /// Lengths are in characteristic lengths x_c = F_C/σ of the friction model, times in design time constants τ_d.
    /// The motion starts without friction force. Stable means: the equation's denominator is positive on the whole path
    /// from e0 to 0. Settled means: the error is 2 % of e0; with a perfect model that takes ln 50 = 3.912 τ_d.
    Massless(MasslessOptions),
    /// With mass and velocity reversals: equations 7.41 to 7.50 (corrected), as in figures 45 to 54
    ///
    /// The motion starts at rest at the distance r from the set-point. Settled means: the error stays within 2 % of r.
    /// The peak after crossing is the largest |error| after it first reached zero, as a share of r. Defaults are
    /// the system of section 7.6; F_C, 1/τ_d and r, which the thesis does not give, are chosen so that its claims hold.
    Mass(MassOptions),
}

/// Options of `theory massless`.
#[derive(Debug, clap::Args)]
pub struct MasslessOptions {
    /// Control method
    #[arg(long)]
    method: Method,
    /// Proportional gain k_P/σ, 0.001 to 1000
    #[arg(long, value_name = "K", allow_negative_numbers = true)]
    kp_ratio: f64,
    /// Initial error in x_c, 1e-6 to 10
    #[arg(long, value_name = "E", allow_negative_numbers = true)]
    e0: f64,
    /// Relative error of the plant's stiffness against the model's, −0.99 to 10
    #[arg(long, value_name = "D", allow_negative_numbers = true, default_value_t = 0.0)]
    delta: f64,
    #[command(flatten)]
    json: Json,
}

/// Options of `theory mass`.
#[derive(Debug, clap::Args)]
pub struct MassOptions {
    /// Control method
    #[arg(long)]
    method: Method,
    /// Moving mass in kg, 0.001 to 1000
    #[arg(long, value_name = "KG", allow_negative_numbers = true, default_value_t = 1.5)]
    mass: f64,
    /// Proportional gain k_P in N/m, 1 to 1e10
    #[arg(long, value_name = "N/M", allow_negative_numbers = true, default_value = "9e5")]
    kp: f64,
    /// Derivative gain k_D in N s/m, 0 to 1e7
    #[arg(long, value_name = "NS/M", allow_negative_numbers = true, default_value_t = 850.0)]
    kd: f64,
    /// The model's initial contact stiffness σ in N/m, 1 to 1e10
    #[arg(long, value_name = "N/M", allow_negative_numbers = true, default_value = "8.46e6")]
    sigma: f64,
    /// Coulomb friction F_C in N, 1e-6 to 1e4
    #[arg(long, value_name = "N", allow_negative_numbers = true, default_value_t = 0.6)]
    coulomb: f64,
    /// Inverse of the design time constant in 1/s, 0.001 to 1e5
    #[arg(long, value_name = "1/S", allow_negative_numbers = true, default_value_t = 240.0)]
    inv_tau_d: f64,
    /// Settling distance r in m, 1e-12 to 0.01
    #[arg(long, value_name = "M", allow_negative_numbers = true, default_value = "35.461e-9")]
    r: f64,
    /// Relative error of the plant's stiffness against the model's, −0.99 to 10
    #[arg(long, value_name = "D", allow_negative_numbers = true, default_value_t = 0.0)]
    delta: f64,
    /// The plant's friction force at the start in N, smaller than F_C
    #[arg(long, value_name = "N", allow_negative_numbers = true, default_value_t = 0.0)]
    f0: f64,
    /// The model's friction force at the start in N, smaller than F_C
    #[arg(long, value_name = "N", allow_negative_numbers = true, default_value_t = 0.0)]
    f0_model: f64,
    /// Length of the trace in the JSON in ms [default: 20 τ_d or a quarter more than the settling time; 100 τ_d in a limit cycle]
    #[arg(long, value_name = "MS", allow_negative_numbers = true)]
    duration_ms: Option<f64>,
    #[command(flatten)]
    json: Json,
}

/// Computes and prints.
///
/// # Errors
/// A value out of range, or a motion without verdict.
pub fn run(options: &Options) -> Result<()> {
    match options {
        Options::Massless(options) => run_massless(options),
        Options::Mass(options) => run_mass(options),
    }
}

fn run_massless(options: &MasslessOptions) -> Result<()> {
    let &MasslessOptions { method, kp_ratio, e0, delta, .. } = options;
    let case = massless::Case { method, kp_ratio, e0_xc: e0, delta };
    let settling = case.settle()?;
    options.json.write(&settling, || {
        let caption = format!(
            "{} without inertia (7.31, 7.32 corrected): k_P = {kp_ratio} σ, e0 = {e0} x_c, δ = {delta}",
            method.name()
        );
        let optional = |value: Option<f64>, decimals, unit| {
            value.map_or(MISSING.to_owned(), |v| format!("{} {unit}", number(v, decimals)))
        };
        Table::new(caption, &["quantity", "value"])
            .row(["stable", if settling.stable { "yes" } else { "no" }])
            .row(["smallest denominator on the path".to_owned(), format!("{} σ", number(case.least_denominator(), 4))])
            .row(["settling time to 2 % of e0".to_owned(), optional(settling.settling_time_tau, 3, "τ_d")])
            .row(["change against δ = 0".to_owned(), optional(settling.change_percent, 1, "%")])
            .to_text()
    })
}

/// The JSON of `theory mass`.
#[derive(Serialize)]
struct MassJson {
    verdict: Verdict,
    settling_time_ms: Option<f64>,
    peak_after_crossing: f64,
    time_ms: Vec<f64>,
    error_m: Vec<f64>,
}

fn run_mass(options: &MassOptions) -> Result<()> {
    let case = mass::Case {
        method: options.method,
        mass_kg: options.mass,
        kp_n_per_m: options.kp,
        kd_n_s_per_m: options.kd,
        sigma_n_per_m: options.sigma,
        coulomb_n: options.coulomb,
        inv_tau_d_per_s: options.inv_tau_d,
        r_m: options.r,
        delta: options.delta,
        f0_n: options.f0,
        f0_model_n: options.f0_model,
    };
    if let Some(ms) = options.duration_ms {
        ensure!((1e-3..=1e6).contains(&ms), "duration-ms = {ms} is outside 0.001 to 1000000 ms");
    }
    let response = case.respond()?;
    let trace = trace(&case, &response, options.duration_ms);
    let settling_time_ms = response.settling_time_s.map(|s| s * 1e3);
    let json = MassJson {
        verdict: response.verdict,
        settling_time_ms,
        peak_after_crossing: response.peak_after_crossing,
        time_ms: trace.iter().map(|point| point.0 * 1e3).collect(),
        error_m: trace.iter().map(|point| point.1).collect(),
    };
    options.json.write(&json, || {
        let verdict = match response.verdict {
            Verdict::Settles => "settles",
            Verdict::LimitCycle => "limit cycle",
        };
        let settling = settling_time_ms.map_or(MISSING.to_owned(), |ms| format!("{} ms", number(ms, 3)));
        let caption = format!(
            "{} with mass (7.41 to 7.50 corrected): m = {} kg, k_P = {} N/m, k_D = {} N s/m, σ = {} N/m, F_C = {} N, \
             1/τ_d = {} 1/s, r = {} nm, δ = {}",
            case.method.name(),
            case.mass_kg,
            case.kp_n_per_m,
            case.kd_n_s_per_m,
            case.sigma_n_per_m,
            case.coulomb_n,
            case.inv_tau_d_per_s,
            number(case.r_m * 1e9, 3),
            case.delta
        );
        Table::new(caption, &["quantity", "value"])
            .row(["verdict", verdict])
            .row(["settling time to 2 % of r", &settling])
            .row(["peak after crossing", &format!("{} % of r", number(100.0 * response.peak_after_crossing, 2))])
            .row(["velocity reversals up to the verdict", &response.reversals.len().to_string()])
            .to_text()
    })
}

/// Evenly spaced (time in s, error in m), dense enough for the fastest oscillation.
fn trace(case: &mass::Case, response: &Response, duration_ms: Option<f64>) -> Vec<(f64, f64)> {
    let tau_d_s = 1.0 / case.inv_tau_d_per_s;
    let default_s = match (response.verdict, response.settling_time_s) {
        (Verdict::Settles, settling_s) => (20.0 * tau_d_s).max(1.25 * settling_s.unwrap_or(0.0)),
        (Verdict::LimitCycle, _) => 100.0 * tau_d_s,
    };
    let end_s = duration_ms.map_or(default_s, |ms| ms * 1e-3).min(response.end_s());
    let interval_s = (tau_d_s / 50.0).min(case.shortest_period_s() / 20.0);
    response.sampled(end_s, (end_s / interval_s).ceil().clamp(1.0, MOST_SAMPLES) as usize)
}
