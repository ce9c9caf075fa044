//! From branch to branch until the verdict, and what the motion says about settling.

use super::motion::{Branch, State};
use super::{Case, TheoryError};
use crate::theory::SETTLED;

/// At rest: the error, and what it can become by velocity and acceleration within τ_d, have shrunk to this share of the
/// smaller of r and x_c. Smaller motion is the same motion on a smaller scale, so it goes on shrinking.
const AT_REST: f64 = 1e-6;
/// Steady: the largest |e| of two successive groups of this many reversals differ by less than this share. (A growing or
/// dying oscillation is far from this except within about 1e-4 of the edge of stability, where growth itself dies out.)
const GROUP: usize = 50;
const STEADY: f64 = 1e-4;
/// Gone: the error is this many times as large as r, and as what friction can hold back.
const GONE: f64 = 1e6;
/// Most time steps. An oscillation that is not shrinking by then is a limit cycle without a period.
const MOST_STEPS: usize = 2_000_000;

/// What becomes of the error.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Verdict {
    /// It dies away.
    Settles,
    /// It oscillates for ever with a bounded amplitude.
    LimitCycle,
}

/// A place where the velocity changes its sign.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Reversal {
    /// Time (s).
    pub time_s: f64,
    /// Error, an extremum (m).
    pub error_m: f64,
    /// The plant's friction force, F_0 of the motion that follows (N).
    pub friction_n: f64,
    /// The model's friction force, F̂_0 of the motion that follows (N).
    pub model_friction_n: f64,
}

/// The solved motion.
#[derive(Debug, Clone, PartialEq)]
pub struct Response {
    /// Whether it settles.
    pub verdict: Verdict,
    /// Time after which |e| stays within 2 % of r (s); `None` in a limit cycle.
    pub settling_time_s: Option<f64>,
    /// Largest |e| after the error first reached zero, relative to r; 0 if it never does.
    pub peak_after_crossing: f64,
    /// All velocity reversals up to the verdict.
    pub reversals: Vec<Reversal>,
    /// Steps: time (s) and state.
    nodes: Vec<(f64, State)>,
}

impl Response {
    /// Time up to which the motion was solved (s).
    pub fn end_s(&self) -> f64 {
        self.nodes.last().map_or(0.0, |node| node.0)
    }

    /// Error at a time (m); beyond the solved motion, that at its end.
    ///
    /// Between two steps it is the fifth-order polynomial with their errors, velocities and accelerations.
    pub fn error_at_m(&self, time_s: f64) -> f64 {
        let after = self.nodes.partition_point(|node| node.0 <= time_s);
        match (self.nodes.get(after.wrapping_sub(1)), self.nodes.get(after)) {
            (Some(&from), Some(&to)) => between(from, to, time_s),
            (Some(only), None) | (None, Some(only)) => only.1[0],
            (None, None) => 0.0,
        }
    }

    /// (time in s, error in m) at `count` even intervals from 0 to `end_s`.
    pub fn sampled(&self, end_s: f64, count: usize) -> Vec<(f64, f64)> {
        let time_s = |i: usize| end_s * i as f64 / count.max(1) as f64;
        (0..=count).map(|i| (time_s(i), self.error_at_m(time_s(i)))).collect()
    }
}

/// Solves the motion from rest at e = r.
pub fn solve(case: &Case) -> Result<Response, TheoryError> {
    let start: State = [case.r_m, 0.0, 0.0];
    let rest_m = AT_REST * case.r_m.min(case.coulomb_n / case.sigma_n_per_m);
    let gone_m = GONE * (case.r_m + case.coulomb_n / case.kp_n_per_m + case.coulomb_n / case.sigma_n_per_m);
    let (rate_per_s, tau_d_s) = (case.fastest_rate_per_s(), 1.0 / case.inv_tau_d_per_s);

    let mut branch =
        Branch { direction: 1.0, start_error_m: case.r_m, friction_n: case.f0_n, model_friction_n: case.f0_model_n };
    let mut nodes = vec![(0.0, start)];
    let mut reversals: Vec<Reversal> = Vec::new();
    let (mut time_s, mut state, mut h_s) = (0.0, start, 1e-3 / rate_per_s);
    let verdict = loop {
        let step = branch.advance(case, state, h_s);
        (time_s, state, h_s) = (time_s + step.h_s, step.state, step.next_h_s);
        nodes.push((time_s, state));
        if step.reversal {
            branch = branch.next(case, state);
            let Branch { start_error_m: error_m, friction_n, model_friction_n, .. } = branch;
            reversals.push(Reversal { time_s, error_m, friction_n, model_friction_n });
            if is_steady(&reversals) {
                break Verdict::LimitCycle;
            }
        }
        let [e, v, a] = state;
        if e.abs().max(v.abs() * tau_d_s).max(a.abs() * tau_d_s / rate_per_s) < rest_m {
            break Verdict::Settles;
        }
        if e.abs() > gone_m {
            let (inv_tau_d_per_s, limit_per_s) = (case.inv_tau_d_per_s, case.kd_n_s_per_m / case.mass_kg);
            return Err(TheoryError::Unbounded { inv_tau_d_per_s, limit_per_s });
        }
        if nodes.len() > MOST_STEPS {
            if reversals.len() < 2 * GROUP || is_shrinking(&nodes) {
                return Err(TheoryError::TooLong { steps: MOST_STEPS, reached_s: time_s });
            }
            break Verdict::LimitCycle;
        }
    };
    let settling_time_s = if verdict == Verdict::Settles { settling_time_s(&nodes, SETTLED * case.r_m) } else { None };
    let peak_after_crossing = nodes.iter().skip_while(|n| n.1[0] > 0.0).fold(0.0f64, |p, n| p.max(n.1[0].abs()));
    Ok(Response { verdict, settling_time_s, peak_after_crossing: peak_after_crossing / case.r_m, reversals, nodes })
}

/// Whether the last two groups of reversals are equally large.
fn is_steady(reversals: &[Reversal]) -> bool {
    let Some(start) = reversals.len().checked_sub(2 * GROUP) else { return false };
    let largest = |group: &[Reversal]| group.iter().fold(0.0f64, |largest, r| largest.max(r.error_m.abs()));
    let (earlier, later) = reversals[start..].split_at(GROUP);
    let (earlier_m, later_m) = (largest(earlier), largest(later));
    (later_m - earlier_m).abs() < STEADY * earlier_m
}

/// Whether the largest |e| in the last quarter of the time is below that of the quarter before.
fn is_shrinking(nodes: &[(f64, State)]) -> bool {
    let end_s = nodes.last().map_or(0.0, |node| node.0);
    let largest = |from: f64, to: f64| {
        let inside = nodes.iter().filter(|node| (from * end_s..=to * end_s).contains(&node.0));
        inside.fold(0.0f64, |largest, node| largest.max(node.1[0].abs()))
    };
    largest(0.75, 1.0) < 0.99 * largest(0.5, 0.75)
}

/// Time after which |e| stays within the band (s); `None` if it is outside at the end.
///
/// The error has its extrema at reversals, which are nodes: from node to node it passes the edge of the band at most once.
fn settling_time_s(nodes: &[(f64, State)], band_m: f64) -> Option<f64> {
    let last_outside = nodes.iter().rposition(|node| node.1[0].abs() > band_m)?;
    let (from, to) = (nodes[last_outside], *nodes.get(last_outside + 1)?);
    let (mut low_s, mut high_s) = (from.0, to.0);
    for _ in 0..60 {
        let middle_s = 0.5 * (low_s + high_s);
        let outside = between(from, to, middle_s).abs() > band_m;
        *(if outside { &mut low_s } else { &mut high_s }) = middle_s;
    }
    Some(high_s)
}

/// The fifth-order polynomial through two nodes with their first two derivatives, at a time between them.
fn between(from: (f64, State), to: (f64, State), time_s: f64) -> f64 {
    let h = to.0 - from.0;
    let t = (time_s - from.0) / h;
    let ([e0, v0, a0], [e1, v1, a1]) = (from.1, to.1);
    let (v0, v1, a0, a1) = (v0 * h, v1 * h, a0 * h * h, a1 * h * h);
    // What the second-order polynomial from the first node leaves over at the second.
    let (e, v, a) = (e1 - e0 - v0 - 0.5 * a0, v1 - v0 - a0, a1 - a0);
    let cubic = 10.0 * e - 4.0 * v + 0.5 * a;
    let quartic = -15.0 * e + 7.0 * v - a;
    let quintic = 6.0 * e - 3.0 * v + 0.5 * a;
    e0 + t * (v0 + t * (0.5 * a0 + t * (cubic + t * (quartic + t * quintic))))
}
