//! The error dynamics (7.47 to 7.50, corrected) from one velocity reversal to the next.

use super::{Case, Method};
use libm::{cbrt, exp, sqrt};

/// Longest step (in time constants of the fastest motion) and allowed error of a step relative to the state.
const LONGEST_STEP: f64 = 0.1;
const TOLERANCE: f64 = 1e-11;

/// Position error e, ė and ë (m, m/s, m/s²).
pub type State = [f64; 3];

/// Motion in one direction: where it began, and the two friction forces there.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Branch {
    /// Sign of the stage's velocity ẋ = −ė: 1 or −1.
    pub direction: f64,
    /// Error where the motion began, e_0 (m).
    pub start_error_m: f64,
    /// The plant's friction force there, F_0 (N).
    pub friction_n: f64,
    /// The model's friction force there, F̂_0 (N).
    pub model_friction_n: f64,
}

impl Branch {
    /// Friction forces of plant and model at an error (N): 7.45, 7.46 and 7.37, 7.38.
    pub fn forces_n(&self, case: &Case, error_m: f64) -> (f64, f64) {
        let limit_n = self.direction * case.coulomb_n;
        let force_n = |start_n: f64, sigma| limit_n - (limit_n - start_n) * self.remaining(case, sigma, error_m);
        (force_n(self.friction_n, case.plant_sigma_n_per_m()), force_n(self.model_friction_n, case.sigma_n_per_m))
    }

    /// Slopes dF/dx of plant and model at an error (N/m): 7.39 and 7.40, corrected by the missing factor σ.
    pub fn slopes_n_per_m(&self, case: &Case, error_m: f64) -> (f64, f64) {
        let slope = |start_n: f64, sigma| {
            (1.0 - self.direction * start_n / case.coulomb_n) * sigma * self.remaining(case, sigma, error_m)
        };
        (slope(self.friction_n, case.plant_sigma_n_per_m()), slope(self.model_friction_n, case.sigma_n_per_m))
    }

    /// exp(−σ |x − x_0| / F_C).
    fn remaining(&self, case: &Case, sigma_n_per_m: f64, error_m: f64) -> f64 {
        exp(-sigma_n_per_m * self.direction * (self.start_error_m - error_m) / case.coulomb_n)
    }

    /// Time derivative of the state.
    fn derivative(&self, case: &Case, [e, v, a]: State) -> State {
        let (plant, model) = self.slopes_n_per_m(case, e);
        let (stiffness, integral) = match case.method {
            Method::Observer => (plant - model + case.kp_n_per_m, case.inv_tau_d_per_s * case.kp_n_per_m),
            Method::Niasa => (plant + case.kp_n_per_m, case.inv_tau_d_per_s * (model + case.kp_n_per_m)),
        };
        [v, a, -(case.kd_n_s_per_m * a + stiffness * v + integral * e) / case.mass_kg]
    }

    /// The branch that begins at `state` where ė = 0: away from there in the direction of acceleration, or of jerk
    /// where there is no acceleration.
    pub fn next(&self, case: &Case, state: State) -> Branch {
        let (friction_n, model_friction_n) = self.forces_n(case, state[0]);
        let [_, _, jerk] = self.derivative(case, state);
        let towards = if state[2] != 0.0 { state[2] } else { jerk };
        let direction = if towards > 0.0 { -1.0 } else { 1.0 };
        Branch { direction, start_error_m: state[0], friction_n, model_friction_n }
    }

    /// One step of Dormand and Prince's fifth-order method: the new state and the difference to the fourth order.
    fn step(&self, case: &Case, from: State, h_s: f64) -> (State, State) {
        let mut k = [[0.0; 3]; 7];
        k[0] = self.derivative(case, from);
        for stage in 1..7 {
            k[stage] = self.derivative(case, combine(from, h_s, &k[..stage], A[stage - 1]));
        }
        (combine(from, h_s, &k, A[5]), combine([0.0; 3], h_s, &k, &ERROR))
    }

    /// Moves on by one step, of at most `h_s`; ends on the velocity reversal if there is one.
    ///
    /// Velocity may pass through zero twice within a step only if acceleration changes its sign: then the extremum is
    /// looked at too, so that no pair of reversals is stepped over.
    pub fn advance(&self, case: &Case, from: State, longest_s: f64) -> Advance {
        let rate = case.fastest_rate_per_s();
        let speed = |state: &State| -self.direction * state[1];
        let gain = |state: &State| -self.direction * state[2];
        // All three as lengths: what they amount to within a time constant of the fastest motion.
        let length_m = |[e, v, a]: State| e.abs().max(v.abs() / rate).max(a.abs() / (rate * rate));
        let size_m = length_m(from);
        let mut h_s = longest_s.min(LONGEST_STEP / rate);
        loop {
            let (to, error) = self.step(case, from, h_s);
            let excess = length_m(error) / (TOLERANCE * size_m);
            let turns_at_once = speed(&from) <= 0.0 && speed(&to) <= 0.0;
            if (excess > 1.0 || turns_at_once) && h_s > 1e-9 / rate {
                h_s *= if turns_at_once { 0.25 } else { (0.9 * libm::pow(excess, -0.2)).clamp(0.2, 0.9) };
                continue;
            }
            let next_h_s = h_s * (0.9 * libm::pow(excess.max(1e-9), -0.2)).clamp(0.5, 4.0);
            let at = |share: f64| self.step(case, from, share * h_s).0;
            let slowest = if gain(&from) < 0.0 && gain(&to) > 0.0 { last(|share| gain(&at(share)) < 0.0) } else { 1.0 };
            if speed(&at(slowest)) > 0.0 {
                return Advance { h_s, state: to, next_h_s, reversal: false };
            }
            let share = slowest * last(|share| speed(&at(slowest * share)) > 0.0);
            let [e, _, a] = at(share);
            return Advance { h_s: share * h_s, state: [e, 0.0, a], next_h_s, reversal: true };
        }
    }
}

/// What one step led to.
#[derive(Debug, Clone, Copy)]
pub struct Advance {
    /// Length of the step (s).
    pub h_s: f64,
    /// State at its end.
    pub state: State,
    /// Length to try next (s).
    pub next_h_s: f64,
    /// Velocity is zero there and changes its sign.
    pub reversal: bool,
}

/// A rate that no motion of the case exceeds by much (1/s): spring, damper and integrator each acting on the mass alone.
pub fn fastest_rate_per_s(case: &Case) -> f64 {
    // A reversal at saturation doubles the slope.
    let slope = 2.0 * case.plant_sigma_n_per_m() + 2.0 * case.sigma_n_per_m;
    let spring = sqrt((slope + case.kp_n_per_m) / case.mass_kg);
    let damper = case.kd_n_s_per_m / case.mass_kg;
    let integrator = cbrt(case.inv_tau_d_per_s * (slope + case.kp_n_per_m) / case.mass_kg);
    spring.max(damper).max(integrator)
}

/// The last share of 0 ..= 1 up to which `holds`, by bisection; it holds at 0 and not at 1.
fn last(holds: impl Fn(f64) -> bool) -> f64 {
    let (mut low, mut high) = (0.0, 1.0);
    for _ in 0..52 {
        let middle = 0.5 * (low + high);
        *(if holds(middle) { &mut low } else { &mut high }) = middle;
    }
    high
}

/// `from + h Σ weights k`.
fn combine(from: State, h_s: f64, k: &[State], weights: &[f64]) -> State {
    let mut sum = from;
    for (k, weight) in k.iter().zip(weights) {
        for i in 0..3 {
            sum[i] += h_s * weight * k[i];
        }
    }
    sum
}

/// Dormand and Prince's coefficients (1980): rows of the stages, the last of which is the fifth-order result.
const A: [&[f64]; 6] = [
    &[1.0 / 5.0],
    &[3.0 / 40.0, 9.0 / 40.0],
    &[44.0 / 45.0, -56.0 / 15.0, 32.0 / 9.0],
    &[19372.0 / 6561.0, -25360.0 / 2187.0, 64448.0 / 6561.0, -212.0 / 729.0],
    &[9017.0 / 3168.0, -355.0 / 33.0, 46732.0 / 5247.0, 49.0 / 176.0, -5103.0 / 18656.0],
    &[35.0 / 384.0, 0.0, 500.0 / 1113.0, 125.0 / 192.0, -2187.0 / 6784.0, 11.0 / 84.0],
];
/// Fifth minus fourth order.
const ERROR: [f64; 7] =
    [71.0 / 57600.0, 0.0, -71.0 / 16695.0, 71.0 / 1920.0, -17253.0 / 339200.0, 22.0 / 525.0, -1.0 / 40.0];

#[cfg(test)]
mod tests {
    use super::*;

    const START: Branch = Branch { direction: 1.0, start_error_m: 35.461e-9, friction_n: 0.0, model_friction_n: 0.0 };

    /// A step that the tolerance allows.
    const STEP_S: f64 = 1e-5;

    /// A speed that dips to `least` in the middle of a step, under the jerk of the restoring force.
    fn dip(case: &Case, least_m_per_s: f64) -> State {
        let half_s = 0.5 * STEP_S;
        let jerk = START.derivative(case, [case.r_m, 0.0, 0.0])[2];
        [case.r_m, 0.5 * jerk * half_s * half_s - least_m_per_s, -jerk * half_s]
    }

    #[test]
    fn a_pair_of_reversals_within_one_step_is_seen() {
        let case = Case::thesis(Method::Niasa, 0.0);
        let from = dip(&case, -1e-11);
        assert!(from[1] < 0.0 && START.step(&case, from, STEP_S).0[1] < 0.0, "the ends alone show none");
        let step = START.advance(&case, from, STEP_S);
        assert!(step.reversal && step.h_s < 0.5 * STEP_S && step.state[1] == 0.0, "{step:?}");
        let back = START.next(&case, step.state);
        assert_eq!(back.direction, -1.0);
        let mut step = Advance { reversal: false, ..step };
        while !step.reversal {
            step = back.advance(&case, step.state, STEP_S);
            assert!(step.h_s < STEP_S, "{step:?}");
        }
        assert_eq!(back.next(&case, step.state).direction, 1.0);
    }

    #[test]
    fn a_dip_that_does_not_reach_zero_is_no_reversal() {
        let case = Case::thesis(Method::Niasa, 0.0);
        let step = START.advance(&case, dip(&case, 1e-11), STEP_S);
        assert!(!step.reversal && step.h_s == STEP_S, "{step:?}");
    }

    #[test]
    fn slopes_are_the_derivatives_of_forces_in_both_directions() {
        let case = Case::thesis(Method::Observer, 0.3);
        for direction in [1.0, -1.0] {
            let branch = Branch { direction, friction_n: 0.1, model_friction_n: -0.2, ..START };
            let at_m = START.start_error_m - direction * 20e-9;
            let h_m = 1e-13;
            let (before, after) = (branch.forces_n(&case, at_m + h_m), branch.forces_n(&case, at_m - h_m));
            let (plant, model) = branch.slopes_n_per_m(&case, at_m);
            assert!(((after.0 - before.0) / (2.0 * h_m) / plant - 1.0).abs() < 1e-6, "{direction}");
            assert!(((after.1 - before.1) / (2.0 * h_m) / model - 1.0).abs() < 1e-6, "{direction}");
        }
    }
}
