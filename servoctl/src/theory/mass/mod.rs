//! Settling with mass: equations 7.33 to 7.50 and appendix D (corrected), section 7.6 and figures 45 to 54.
//!
//! With the set-point constant, the position error e = r − x follows, from one velocity reversal to the next,
//!
//! ```text
//! observer   m e''' + k_D ë + (dF/dx − dF̂/dx + k_P) ė + (k_P / τ_d) e = 0
//! NIASA      m e''' + k_D ë + (dF/dx + k_P) ė + (1/τ_d)(dF̂/dx + k_P) e = 0
//! dF/dx = (F_C ∓ F_0)/F_C · σ(1+δ) exp(∓σ(1+δ)/F_C · (e_0 − e))    for motion in ± direction, dF̂/dx with σ and F̂_0
//! ```
//!
//! Corrected against the printed text: the orders of the derivatives, the factor σ in the slopes, `(1/τ_d)(… + k_P)` in
//! appendix D, and F_0 and F̂_0 apart: through each reversal plant and model carry their own friction force.
//!
//! The motion begins at rest, e = r, ė = ë = 0, as in appendix D: control and friction are in balance at first.

mod motion;
mod response;

use super::{Method, TheoryError, check};
pub use response::{Response, Reversal, Verdict};

/// One settling with mass, in SI units.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Case {
    /// Control method.
    pub method: Method,
    /// Moving mass m (kg), 0.001 to 1000.
    pub mass_kg: f64,
    /// Proportional gain k_P (N/m), 1 to 1e10.
    pub kp_n_per_m: f64,
    /// Derivative gain k_D (N s/m), 0 to 1e7.
    pub kd_n_s_per_m: f64,
    /// The model's initial contact stiffness σ (N/m), 1 to 1e10.
    pub sigma_n_per_m: f64,
    /// Coulomb friction F_C of plant and model (N), 1e-6 to 1e4.
    pub coulomb_n: f64,
    /// Inverse of the design time constant, 1/τ_d (1/s), 0.001 to 1e5.
    pub inv_tau_d_per_s: f64,
    /// Settling distance r: the initial error (m), 1e-12 to 0.01.
    pub r_m: f64,
    /// Relative error δ of the plant's stiffness against the model's, −0.99 to 10.
    pub delta: f64,
    /// The plant's friction force at the start, F_0 (N), smaller than F_C.
    pub f0_n: f64,
    /// The model's friction force at the start, F̂_0 (N), smaller than F_C.
    pub f0_model_n: f64,
}

impl Case {
    /// The system of section 7.6: m = 1.5 kg, k_P = 9e5 N/m and k_D = 850 N s/m from the text, σ = 8.46 N/µm from
    /// section 7.4. What the text leaves open is chosen so that all of its claims hold: F_C = 0.6 N, 1/τ_d = 240 1/s,
    /// r = x_c/2 = 35.461 nm, F_0 = F̂_0 = 0. (The 100 1/s of chapter 8 cannot show figures 50 to 54.)
    pub fn thesis(method: Method, delta: f64) -> Case {
        Case {
            method,
            mass_kg: 1.5,
            kp_n_per_m: 9e5,
            kd_n_s_per_m: 850.0,
            sigma_n_per_m: 8.46e6,
            coulomb_n: 0.6,
            inv_tau_d_per_s: 240.0,
            r_m: 35.461e-9,
            delta,
            f0_n: 0.0,
            f0_model_n: 0.0,
        }
    }

    /// Solves the motion until it has settled or its oscillation is steady.
    ///
    /// # Errors
    /// [`TheoryError::OutOfRange`] naming the field; [`TheoryError::Unbounded`] where the loop is unstable even as a
    /// free mass and the error outgrows friction; [`TheoryError::TooLong`] after two million steps.
    pub fn respond(&self) -> Result<Response, TheoryError> {
        self.check()?;
        response::solve(self)
    }

    /// The plant's stiffness σ(1 + δ) (N/m), 7.27.
    pub fn plant_sigma_n_per_m(&self) -> f64 {
        self.sigma_n_per_m * (1.0 + self.delta)
    }

    /// The same settling without inertia; e0 is r in characteristic lengths of the model.
    pub fn massless(&self) -> super::massless::Case {
        super::massless::Case {
            method: self.method,
            kp_ratio: self.kp_n_per_m / self.sigma_n_per_m,
            e0_xc: self.r_m * self.sigma_n_per_m / self.coulomb_n,
            delta: self.delta,
        }
    }

    /// Period of the fastest oscillation (s), a bound: the mass on the springs of friction, observer and k_P together.
    pub fn shortest_period_s(&self) -> f64 {
        std::f64::consts::TAU / self.fastest_rate_per_s()
    }

    fn fastest_rate_per_s(&self) -> f64 {
        motion::fastest_rate_per_s(self)
    }

    fn check(&self) -> Result<(), TheoryError> {
        check("mass", self.mass_kg, (1e-3, 1e3), "kg")?;
        check("kp", self.kp_n_per_m, (1.0, 1e10), "N/m")?;
        check("kd", self.kd_n_s_per_m, (0.0, 1e7), "N s/m")?;
        check("sigma", self.sigma_n_per_m, (1.0, 1e10), "N/m")?;
        check("coulomb", self.coulomb_n, (1e-6, 1e4), "N")?;
        check("inv-tau-d", self.inv_tau_d_per_s, (1e-3, 1e5), "1/s")?;
        check("r", self.r_m, (1e-12, 1e-2), "m")?;
        check("delta", self.delta, (-0.99, 10.0), "")?;
        let below_coulomb_n = 0.999 * self.coulomb_n;
        check("f0", self.f0_n, (-below_coulomb_n, below_coulomb_n), "N")?;
        check("f0-model", self.f0_model_n, (-below_coulomb_n, below_coulomb_n), "N")
    }
}
