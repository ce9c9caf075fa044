//! Settling without inertia: equations 7.31 and 7.32 (both corrected), section 7.5 and figures 34 to 44.
//!
//! Lengths are in characteristic lengths x_c = F_C/σ (7.28), times in design time constants τ_d, k = k_P/σ (7.30).
//! With the displacement X = e0 − e, from X = 0 at t = 0 without force, the error follows
//!
//! ```text
//! observer   ė = −k e / [(1+δ) exp(−X(1+δ)) − exp(−X) + k]
//! NIASA      ė = −(exp(−X) + k) e / [(1+δ) exp(−X(1+δ)) + k]
//! ```
//!
//! As printed, the thesis has the factor (1 + δ) outside of the whole denominator; it belongs to the plant's exponential.
//! Only so do the unstable regions of figures 34 to 41 appear.
//!
//! The right-hand side depends on X alone, so time is an integral over displacement and nothing needs to be stepped.

use super::{Method, SETTLED, TheoryError, check};
use libm::{exp, expm1, log, log1p};

/// One settling without inertia.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Case {
    /// Control method.
    pub method: Method,
    /// k_P/σ, 0.001 to 1000.
    pub kp_ratio: f64,
    /// Initial error, and with it the distance to go, in x_c; 1e-6 to 10. The thesis looks at e0 ≤ 1.
    pub e0_xc: f64,
    /// Relative error δ of the plant's stiffness against the model's; −0.99 to 10. The thesis looks at −0.5 to 1.
    pub delta: f64,
}

/// What becomes of a [`Case`].
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
pub struct Settling {
    /// The denominator is positive on the whole path from e = e0 to e = 0, so the error always decreases.
    pub stable: bool,
    /// Time until the error is 2 % of e0 (in τ_d); `None` if unstable.
    pub settling_time_tau: Option<f64>,
    /// Change of that time against δ = 0, where it is ln 50 for both methods (%); `None` if unstable.
    pub change_percent: Option<f64>,
}

impl Case {
    /// Stability and settling time.
    ///
    /// # Errors
    /// [`TheoryError::OutOfRange`] naming the field.
    pub fn settle(&self) -> Result<Settling, TheoryError> {
        self.check()?;
        if self.least_denominator() <= 0.0 {
            return Ok(Settling { stable: false, settling_time_tau: None, change_percent: None });
        }
        let nominal_tau = -log(SETTLED);
        let settling_time_tau = self.time_tau(nominal_tau);
        let change_percent = 100.0 * (settling_time_tau / nominal_tau - 1.0);
        Ok(Settling { stable: true, settling_time_tau: Some(settling_time_tau), change_percent: Some(change_percent) })
    }

    /// Smallest value of the denominator on the path 0 ≤ X ≤ e0 (in σ). Not positive: unstable.
    ///
    /// NIASA's denominator is always positive. The observer's has one stationary point, at X* = 2 ln(1+δ)/δ. For δ > 0
    /// that is a minimum: a second unstable zone where k is below what the model takes away there (k ≤ 0.097 at
    /// δ = 1, e0 = 1). For δ < 0 it is a maximum, and the smallest value is the first, k + δ.
    pub fn least_denominator(&self) -> f64 {
        let stationary_xc = if self.delta == 0.0 { 2.0 } else { 2.0 * log1p(self.delta) / self.delta };
        let least_at_xc = match self.method {
            Method::Niasa => self.e0_xc,
            Method::Observer if self.delta < 0.0 => 0.0,
            Method::Observer => stationary_xc.min(self.e0_xc),
        };
        self.denominator(least_at_xc)
    }

    /// Error over time: (t in τ_d, e in x_c), closely and evenly spaced in ln e, until `end_tau` or e = e0·1e-9.
    ///
    /// Where the denominator reaches zero the course ends: the error jumps there. With δ ≤ −k the observer has none.
    ///
    /// # Errors
    /// [`TheoryError::OutOfRange`] naming the field.
    pub fn course(&self, end_tau: f64) -> Result<Vec<(f64, f64)>, TheoryError> {
        self.check()?;
        check("end-tau", end_tau, (0.0, 1e6), "τ_d")?;
        const STEP: f64 = 0.02;
        let mut points = Vec::new();
        let mut time_tau = 0.0;
        for step in 0..=(-log(1e-9) / STEP) as usize {
            let decay = step as f64 * STEP;
            if self.denominator(self.displacement_xc(decay)) <= 0.0 {
                break;
            }
            points.push((time_tau, self.e0_xc * exp(-decay)));
            if time_tau >= end_tau {
                break;
            }
            time_tau += self.panel(decay, decay + STEP);
        }
        Ok(points)
    }

    fn check(&self) -> Result<(), TheoryError> {
        check("kp-ratio", self.kp_ratio, (1e-3, 1e3), "")?;
        check("e0", self.e0_xc, (1e-6, 10.0), "x_c")?;
        check("delta", self.delta, (-0.99, 10.0), "")
    }

    /// Time until ln(e0/e) has reached `decay` (in τ_d); at the ends of the ranges to 1e-6, for the thesis' to 1e-14.
    fn time_tau(&self, decay: f64) -> f64 {
        const PANELS: u32 = 64;
        let edge = |i: u32| decay * f64::from(i) / f64::from(PANELS);
        (0..PANELS).map(|i| self.panel(edge(i), edge(i + 1))).sum()
    }

    /// ∫ dt/d(ln(e0/e)) over one short panel, by Gauss and Legendre's rule with five nodes.
    fn panel(&self, from: f64, to: f64) -> f64 {
        const NODES: [(f64, f64); 5] = [
            (-0.906_179_845_938_664, 0.236_926_885_056_189_1),
            (-0.538_469_310_105_683_1, 0.478_628_670_499_366_5),
            (0.0, 0.568_888_888_888_888_9),
            (0.538_469_310_105_683_1, 0.478_628_670_499_366_5),
            (0.906_179_845_938_664, 0.236_926_885_056_189_1),
        ];
        let (middle, half) = (0.5 * (from + to), 0.5 * (to - from));
        half * NODES.iter().map(|(at, weight)| weight * self.slowness(middle + half * at)).sum::<f64>()
    }

    /// −e/(ė τ_d) where ln(e0/e) is `decay`: 1 with a perfect model.
    fn slowness(&self, decay: f64) -> f64 {
        let x_xc = self.displacement_xc(decay);
        let gain = match self.method {
            Method::Observer => self.kp_ratio,
            Method::Niasa => exp(-x_xc) + self.kp_ratio,
        };
        self.denominator(x_xc) / gain
    }

    /// X = e0 − e where ln(e0/e) is `decay`.
    fn displacement_xc(&self, decay: f64) -> f64 {
        -self.e0_xc * expm1(-decay)
    }

    fn denominator(&self, x_xc: f64) -> f64 {
        let softer = 1.0 + self.delta;
        let plant = softer * exp(-x_xc * softer);
        match self.method {
            Method::Observer => plant - exp(-x_xc) + self.kp_ratio,
            Method::Niasa => plant + self.kp_ratio,
        }
    }
}
