//! Parallel spring-slider elements whose saturated reversal is Dahl's exponential.

use serde::{Deserialize, Serialize};

use super::elements::Element;

/// The most elements a model can have.
pub const MAX_ELEMENTS: usize = 32;

/// Maxwell-slip friction: `F = Σ F_i`, each element `F_i ← clip(F_i + k_i dx, ±F_i,sat)`.
///
/// It remembers every reversal that a larger one has not wiped out. From rest it follows `F_C (1 − e^(−2σx/F_C))`, and
/// therefore, by Masing's rule, `F_C (1 − 2 e^(−σx/F_C))` after a reversal at saturation: Dahl's curve. Small motions
/// see the stiffness 2σ.
///
/// # Choice of the elements
/// With `q` the slope of the virgin curve relative to 2σ, element `i` of `N` carries the range of slopes from
/// `((N−i+1)/N)²` down to `((N−i)/N)²`: its stiffness is the difference and its saturation the force that the
/// exponential gains in this range. The broken line is then tangent to the exponential wherever `q` is one of these
/// slopes, lies outside it in between, has exactly the stiffness 2σ at first and exactly F_C at last. Slopes that are
/// equally spaced in √q make the largest deviation the same in every segment, `F_C / (2 N²)`: 0.35 % of F_C for twelve
/// elements, twice that after a reversal. Equal stiffnesses would give 3 %.
///
/// # Piece by piece
/// Until an element begins to slide, or those that slide turn back, all of them together are one spring. The elements are therefore
/// clipped only where such a piece of the path ends; a step within it costs no more than one element would.
///
/// # Source
/// Equation A.4 (corrected: as printed the elements have no memory).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct MaxwellSlip {
    elements: usize,
    coulomb_n: f64,
    stiffness_n_per_m: [f64; MAX_ELEMENTS],
    saturation_n: [f64; MAX_ELEMENTS],
    /// Forces of the elements where the present piece began.
    force_n: [f64; MAX_ELEMENTS],
    piece: Piece,
}

/// A piece of the path on which the force is a straight line over the displacement.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
struct Piece {
    /// Displacement since it began, m.
    moved_m: f64,
    /// Force where it began, N.
    force_n: f64,
    /// Stiffness of the elements that stick, N/m.
    stiffness_n_per_m: f64,
    /// Where the next element begins to slide, forwards and backwards, m.
    reach_m: [f64; 2],
    /// Direction in which the other elements slide, 1 or −1, and 0 if none does: in the other one the piece ends at once.
    sliding: f64,
}

impl MaxwellSlip {
    /// A contact without force. `elements` is limited to `1..=MAX_ELEMENTS`; the other arguments must be positive.
    pub fn new(elements: usize, stiffness_n_per_m: f64, coulomb_n: f64) -> MaxwellSlip {
        let mut model = MaxwellSlip {
            elements: elements.clamp(1, MAX_ELEMENTS),
            coulomb_n,
            stiffness_n_per_m: [0.0; MAX_ELEMENTS],
            saturation_n: [0.0; MAX_ELEMENTS],
            force_n: [0.0; MAX_ELEMENTS],
            piece: Piece::EMPTY,
        };
        model.set(stiffness_n_per_m, coulomb_n);
        model
    }

    /// Moves the contact by `dx_m` and returns the force that opposes positive motion, N.
    #[inline]
    pub fn advance(&mut self, dx_m: f64) -> f64 {
        let moved_m = self.piece.moved_m + dx_m;
        let [forwards_m, backwards_m] = self.piece.reach_m;
        if moved_m > forwards_m || moved_m < backwards_m || self.piece.sliding * dx_m < 0.0 {
            self.end_piece(dx_m);
        } else {
            self.piece.moved_m = moved_m;
        }
        self.force_n()
    }

    /// The elements, stiffest slope of the curve first.
    pub fn elements(&self) -> impl Iterator<Item = Element> {
        (0..self.elements)
            .map(|i| Element { stiffness_n_per_m: self.stiffness_n_per_m[i], saturation_n: self.saturation_n[i] })
    }

    /// The force that opposes positive motion, N.
    #[inline]
    pub fn force_n(&self) -> f64 {
        self.piece.force_n + self.piece.stiffness_n_per_m * self.piece.moved_m
    }

    /// The energy in the springs, `Σ F_i² / 2 k_i`, J.
    pub fn stored_j(&self) -> f64 {
        let stored_j = |i: usize| {
            let force_n = self.element_n(i);
            0.5 * force_n * force_n / self.stiffness_n_per_m[i]
        };
        (0..self.elements).map(stored_j).sum()
    }

    /// Changes Dahl's σ (N/m) and F_C (N), both positive; every element keeps its fraction of saturation.
    pub fn set(&mut self, stiffness_n_per_m: f64, coulomb_n: f64) {
        self.end_piece(0.0);
        let scale = coulomb_n / self.coulomb_n;
        let slope = |i: usize| {
            let root = (self.elements - i) as f64 / self.elements as f64;
            root * root
        };
        for i in 0..self.elements {
            let (from, to) = (slope(i), slope(i + 1));
            self.stiffness_n_per_m[i] = 2.0 * stiffness_n_per_m * (from - to);
            self.saturation_n[i] = coulomb_n * (share_below(from) - share_below(to));
            self.force_n[i] *= scale;
        }
        self.coulomb_n = coulomb_n;
        self.end_piece(0.0);
    }

    /// The force of an element, N.
    fn element_n(&self, i: usize) -> f64 {
        clip(self.force_n[i] + self.stiffness_n_per_m[i] * self.piece.moved_m, self.saturation_n[i])
    }

    /// Moves by `dx_m` out of the present piece: every element as the equation says. There the next piece begins.
    #[cold]
    #[inline(never)]
    fn end_piece(&mut self, dx_m: f64) {
        let mut next = Piece::EMPTY;
        for i in 0..self.elements {
            let (stiffness_n_per_m, saturation_n) = (self.stiffness_n_per_m[i], self.saturation_n[i]);
            let force_n = clip(self.element_n(i) + stiffness_n_per_m * dx_m, saturation_n);
            if dx_m > 0.0 && force_n == saturation_n || dx_m < 0.0 && force_n == -saturation_n {
                next.sliding = dx_m.signum();
            } else {
                next.stiffness_n_per_m += stiffness_n_per_m;
                next.reach_m[0] = next.reach_m[0].min((saturation_n - force_n) / stiffness_n_per_m);
                next.reach_m[1] = next.reach_m[1].max((-saturation_n - force_n) / stiffness_n_per_m);
            }
            next.force_n += force_n;
            self.force_n[i] = force_n;
        }
        self.piece = next;
    }
}

impl Piece {
    const EMPTY: Piece = Piece {
        moved_m: 0.0,
        force_n: 0.0,
        stiffness_n_per_m: 0.0,
        // Beyond any travel; an infinite number cannot be stored as JSON.
        reach_m: [f64::MAX, f64::MIN],
        sliding: 0.0,
    };
}

fn clip(force_n: f64, saturation_n: f64) -> f64 {
    force_n.max(-saturation_n).min(saturation_n)
}

/// `q (1 − ln q)`: the share of F_C that elements breaking where the exponential's relative slope is below `q` carry.
fn share_below(slope: f64) -> f64 {
    if slope > 0.0 { slope * (1.0 - libm::log(slope)) } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::{Noise, Purpose};

    const STIFFNESS_N_PER_M: f64 = 8.66e6;
    const COULOMB_N: f64 = 0.64;

    fn saturated() -> MaxwellSlip {
        let mut model = MaxwellSlip::new(12, STIFFNESS_N_PER_M, COULOMB_N);
        model.advance(1e-3);
        model
    }

    #[test]
    fn stiffness_is_two_sigma_and_saturation_is_coulomb_for_any_number_of_elements() {
        for elements in 1..=MAX_ELEMENTS {
            let model = MaxwellSlip::new(elements, STIFFNESS_N_PER_M, COULOMB_N);
            let stiffness: f64 = model.stiffness_n_per_m.iter().sum();
            assert!((stiffness / (2.0 * STIFFNESS_N_PER_M) - 1.0).abs() < 1e-14, "{elements} elements: {stiffness}");
            for direction in [1.0, -1.0] {
                let force_n = model.clone().advance(direction * 1e-3);
                assert!((force_n / (direction * COULOMB_N) - 1.0).abs() < 1e-14, "{elements} elements: {force_n}");
            }
        }
    }

    #[test]
    fn a_saturated_reversal_is_dahls_exponential_within_one_part_in_elements_squared() {
        for elements in [4, 8, 12, 16, 32] {
            let mut model = MaxwellSlip::new(elements, STIFFNESS_N_PER_M, COULOMB_N);
            model.advance(-1e-3);
            let (step_m, mut worst) = (0.02e-9, 0.0f64);
            for i in 1..50_000 {
                let dahl = 1.0 - 2.0 * libm::exp(-STIFFNESS_N_PER_M * step_m * f64::from(i) / COULOMB_N);
                let outside = model.advance(step_m) / COULOMB_N - dahl;
                assert!(outside > -1e-9, "tangents lie outside a concave curve");
                worst = worst.max(outside);
            }
            let bound = 1.0 / (elements * elements) as f64;
            assert!((0.9 * bound..=bound).contains(&worst), "{elements} elements: {worst}, bound {bound}");
        }
    }

    #[test]
    fn twelve_elements_deviate_from_dahl_by_less_than_five_millinewton() {
        let mut model = saturated();
        let worst_n = (1..10_000).fold(0.0f64, |worst_n, i| {
            let dahl_n = COULOMB_N * (2.0 * libm::exp(-STIFFNESS_N_PER_M * 0.1e-9 * f64::from(i) / COULOMB_N) - 1.0);
            worst_n.max((model.advance(-0.1e-9) - dahl_n).abs())
        });
        assert!((4.0e-3..4.5e-3).contains(&worst_n), "{worst_n} N");
    }

    /// Creep with jitter, reversals, long strokes and new parameters, against the equation itself.
    #[test]
    fn piece_by_piece_is_every_element_in_every_step() {
        let mut model = MaxwellSlip::new(12, STIFFNESS_N_PER_M, COULOMB_N);
        let mut plain_n = [0.0; 12];
        let mut noise = Noise::new(1, Purpose::Friction, 0);
        for step in 0..200_000 {
            if step % 10_000 == 0 {
                let coulomb_n = COULOMB_N * (1.0 + 0.2 * noise.normal()).max(0.3);
                plain_n.iter_mut().for_each(|n| *n *= coulomb_n / model.coulomb_n);
                model.set(STIFFNESS_N_PER_M * (1.0 + 0.2 * noise.normal()).max(0.3), coulomb_n);
            }
            let dx_m = [1e-11, 1e-9, 1e-7][step / 100 % 3] * (noise.normal() + [0.3, -0.3][step / 1_000 % 2]);
            let force_n = model.advance(dx_m);
            for (plain_n, element) in plain_n.iter_mut().zip(model.elements()) {
                *plain_n = clip(*plain_n + element.stiffness_n_per_m * dx_m, element.saturation_n);
            }
            let expected_n: f64 = plain_n.iter().sum();
            assert!((force_n - expected_n).abs() < 1e-12, "step {step}: {force_n} N, {expected_n} N");
        }
    }

    #[test]
    fn an_inner_loop_closes_and_is_forgotten() {
        // Reversal points in nm: down the outer branch to −60, up to −30, down to −45, up again.
        let go = |model: &mut MaxwellSlip, nanometres: f64| model.advance(nanometres * 1e-9);
        let mut looped = saturated();
        go(&mut looped, -60.0);
        let at_minus_30_n = go(&mut looped, 30.0);
        go(&mut looped, -15.0);
        let closed_n = go(&mut looped, 15.0);
        assert!((closed_n - at_minus_30_n).abs() < 1e-15, "the loop closes where it began");

        let mut direct = saturated();
        go(&mut direct, -60.0);
        go(&mut direct, 30.0);
        for nanometres in [10.0, 100.0, -500.0, 3.0] {
            let difference_n = go(&mut looped, nanometres) - go(&mut direct, nanometres);
            assert!(difference_n.abs() < 1e-15, "afterwards the path is as if the loop had not been");
        }
    }

    #[test]
    fn a_reversal_repeats_the_virgin_curve_at_twice_the_scale() {
        for (turn_m, distance_m) in [(1e-3, 5e-9), (1e-3, 100e-9), (40e-9, 30e-9), (40e-9, 79e-9)] {
            let mut model = MaxwellSlip::new(12, STIFFNESS_N_PER_M, COULOMB_N);
            let virgin_n = model.clone().advance(0.5 * distance_m);
            let turn_n = model.advance(turn_m);
            let back_n = model.advance(-distance_m);
            assert!((turn_n - back_n - 2.0 * virgin_n).abs() < 1e-14, "turned at {turn_m} m, back by {distance_m} m");
        }
    }

    #[test]
    fn a_step_may_be_of_any_length_in_one_direction() {
        let (mut once, mut often) = (saturated(), saturated());
        once.advance(-37e-9);
        for _ in 0..37 {
            often.advance(-1e-9);
        }
        assert!((once.force_n() - often.force_n()).abs() < 1e-14);
    }
}
