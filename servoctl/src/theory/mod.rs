//! Chapter 7 of the thesis, with appendices C and D, as pure functions: how a position error settles against Dahl
//! friction when the friction model is wrong by a factor.
//!
//! - [`massless`]: inertia neglected (section 7.5), in characteristic lengths and design time constants
//! - [`mass`]: the stage with its mass, through any number of velocity reversals (section 7.6), in SI units
//! - [`figures`]: the data of figures 34 to 44 (maps) and 45 to 54 (curves), and their pictures
//!
//! The friction model has the stiffness σ; the plant has σ(1 + δ) (7.27). F_C is the same for both.

pub mod figures;
pub mod mass;
pub mod massless;

/// How the friction model enters the control law.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum Method {
    /// Friction observer: the modelled friction force is added to the control signal (section 7.2).
    Observer,
    /// Integral gain scheduled by the slope of the modelled friction (section 7.3).
    Niasa,
}

impl Method {
    /// Name for tables and legends.
    pub fn name(self) -> &'static str {
        match self {
            Method::Observer => "observer",
            Method::Niasa => "NIASA",
        }
    }
}

/// A settled error is smaller than this fraction of the initial one: 2 % (section 7.5).
pub const SETTLED: f64 = 0.02;

/// Why a case cannot be computed.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum TheoryError {
    /// A value outside of what the theory, or its numerical solution, covers.
    #[error("{name} = {value} is outside {range}")]
    OutOfRange {
        /// Name of the value, as the command line has it.
        name: &'static str,
        /// The value given.
        value: f64,
        /// What is allowed, with unit.
        range: String,
    },
    /// The oscillation has outgrown all friction: the loop is unstable even as a free mass.
    #[error(
        "the error grows without bound: inv-tau-d = {inv_tau_d_per_s} is outside 0 to kd/mass = {limit_per_s} 1/s, \
         where the loop is stable as a free mass"
    )]
    Unbounded {
        /// 1/τ_d as given (1/s).
        inv_tau_d_per_s: f64,
        /// Routh's limit k_D / m (1/s).
        limit_per_s: f64,
    },
    /// Fast and slow motion are too far apart for the solution in time.
    #[error("no verdict after {steps} time steps ({reached_s} s): mass, stiffness and inv-tau-d are too far apart")]
    TooLong {
        /// Steps taken.
        steps: usize,
        /// Time reached (s).
        reached_s: f64,
    },
}

/// Refuses what is not in `low..=high`, NaN included.
fn check(name: &'static str, value: f64, (low, high): (f64, f64), unit: &str) -> Result<(), TheoryError> {
    if (low..=high).contains(&value) {
        return Ok(());
    }
    let short = |v: f64| if v != 0.0 && (v.abs() < 1e-3 || v.abs() >= 1e5) { format!("{v:e}") } else { v.to_string() };
    let unit = if unit.is_empty() { String::new() } else { format!(" {unit}") };
    Err(TheoryError::OutOfRange { name, value, range: format!("{} to {}{unit}", short(low), short(high)) })
}
