//! Maxwell-slip friction (A.3 to A.5) from one velocity reversal of the measured position to the next.

use super::reversal::Branch;
use crate::position::Position;

/// The most elements a model can have. Every step computes all of them: its time does not depend on their number.
pub const MAX_ELEMENTS: usize = 12;

/// Spring-slider elements in parallel; those beyond the last one are 0.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Elements {
    /// Stiffness of each element k_i, N/m, at least 0.
    pub stiffness_n_per_m: [f32; MAX_ELEMENTS],
    /// Force at which each slides F_i^sat, N, at least 0.
    pub saturation_n: [f32; MAX_ELEMENTS],
}

/// The published fit.
///
/// # Source
/// Table 4; its F_i^sat add up to 0.4301 N.
pub const GMS_TABLE_4: Elements = Elements {
    stiffness_n_per_m: [
        6.5408e6, 1.0210e6, 1.6261e6, 0.4352e6, 1.5016e6, 0.6951e6, 0.0605e6, 0.0162e6, 0.0, 0.0, 0.0, 0.0,
    ],
    saturation_n: [0.0036, 0.0156, 0.0290, 0.0165, 0.0675, 0.0546, 0.0203, 0.2230, 0.0, 0.0, 0.0, 0.0],
};

impl Elements {
    /// `count` elements (limited to `1..=MAX_ELEMENTS`) whose reversal at saturation is that of a Dahl model with σ (N/m) and
    /// F_C (N), both positive: `F_C (1 − 2 e^(−σx/F_C))`, within `F_C/count²`.
    ///
    /// By Masing's rule the virgin curve is then `F_C (1 − e^(−2σx/F_C))`. The broken line of the elements touches it where its
    /// slope is `2σ r²` with r = 1, (count−1)/count, …, 0; two neighbouring tangents meet where an element starts to slide.
    pub fn like_dahl(count: usize, stiffness_n_per_m: f32, coulomb_n: f32) -> Self {
        let count = count.clamp(1, MAX_ELEMENTS);
        let length_m = coulomb_n / (2.0 * stiffness_n_per_m);
        let mut elements = Elements { stiffness_n_per_m: [0.0; MAX_ELEMENTS], saturation_n: [0.0; MAX_ELEMENTS] };
        let slots = elements.stiffness_n_per_m.iter_mut().zip(&mut elements.saturation_n);
        for (i, (stiffness, saturation)) in slots.take(count).enumerate() {
            let root = |left: usize| left as f32 / count as f32;
            let (upper, lower) = (root(count - i), root(count - i - 1));
            let (upper, lower) = (upper * upper, lower * lower);
            // A tangent of relative slope q leaves the force axis at 1 − q (1 − ln q).
            let axis = |q: f32| if q > 0.0 { 1.0 - q * (1.0 - libm::logf(q)) } else { 1.0 };
            let corner_m = length_m * (axis(lower) - axis(upper)) / (upper - lower);
            *stiffness = 2.0 * stiffness_n_per_m * (upper - lower);
            *saturation = *stiffness * corner_m;
        }
        elements
    }

    /// The same curve with another σ (N/m, half of all stiffness) and F_C (N), both positive.
    pub fn scaled(&self, stiffness_n_per_m: f32, coulomb_n: f32) -> Self {
        let stiffer = 2.0 * stiffness_n_per_m / self.total_stiffness_n_per_m();
        let stronger = coulomb_n / self.coulomb_n();
        Elements {
            stiffness_n_per_m: self.stiffness_n_per_m.map(|k| k * stiffer),
            saturation_n: self.saturation_n.map(|f| f * stronger),
        }
    }

    fn iter(&self) -> impl Iterator<Item = Element> {
        let pairs = self.stiffness_n_per_m.iter().zip(&self.saturation_n);
        pairs.map(|(stiffness, saturation)| Element { stiffness_n_per_m: *stiffness, saturation_n: *saturation })
    }

    /// Stiffness of all elements together, N/m: small motions see it, and half of it is the σ of a Dahl model.
    pub fn total_stiffness_n_per_m(&self) -> f32 {
        self.stiffness_n_per_m.iter().sum()
    }

    /// The level of Coulomb friction `F_C = Σ F_i^sat`, N (A.5).
    pub fn coulomb_n(&self) -> f32 {
        self.saturation_n.iter().sum()
    }
}

/// Parameters, in the units of the tick.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Coefficients {
    /// Stiffnesses and saturations.
    pub elements: Elements,
    /// Length of an encoder count, m.
    pub count_m: f32,
    /// How far the position must come back from its extreme to count as a velocity reversal, counts.
    pub hysteresis_ct: i32,
}

/// The model's memory: what each element held at the last reversal, and how far the axis has come since.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct MaxwellSlip {
    branch: Branch,
    /// Forces of the elements where it began, in the direction of the branch, N.
    anchor_n: [f32; MAX_ELEMENTS],
    force_n: f32,
    slope_n_per_m: f32,
}

impl MaxwellSlip {
    /// Relaxed (no friction force in any element) at `position`.
    pub fn relaxed(position: Position) -> Self {
        MaxwellSlip {
            branch: Branch::starting_at(position),
            anchor_n: [0.0; MAX_ELEMENTS],
            force_n: 0.0,
            slope_n_per_m: 0.0,
        }
    }

    /// Modelled friction force F̂, N, within ±F_C.
    #[inline]
    pub fn force_n(&self) -> f32 {
        self.force_n
    }

    /// Modelled slope dF̂/dx in the direction of motion: the stiffness of the elements that stick, N/m, within `0..=Σk_i`.
    #[inline]
    pub fn slope_n_per_m(&self) -> f32 {
        self.slope_n_per_m
    }

    /// Takes the measured position of this tick.
    ///
    /// `s F_i = min(s F_i0 + k_i s (x − x_0), F_i^sat)` in the direction of motion `s = ±1`, with place and forces of the last
    /// reversal `x_0`, `F_i0`; `x` is the extreme reached since (see `reversal`). What the elements remember of earlier reversals is
    /// what they held there.
    ///
    /// # Source
    /// (A.3), (A.4) corrected (the elements have memory).
    #[inline]
    pub fn update(&mut self, k: &Coefficients, position: Position) {
        if let Some(travelled_ct) = self.branch.follow(position, k.hysteresis_ct) {
            let travelled_m = travelled_ct as f32 * k.count_m;
            for (held_n, element) in self.anchor_n.iter_mut().zip(k.elements.iter()) {
                *held_n = -element.stretched(*held_n, travelled_m).0;
            }
        }
        let travel_m = self.branch.travel_ct() as f32 * k.count_m;
        let (mut force_n, mut slope_n_per_m) = (0.0, 0.0);
        for (held_n, element) in self.anchor_n.iter().zip(k.elements.iter()) {
            let (element_n, element_n_per_m) = element.stretched(*held_n, travel_m);
            force_n += element_n;
            slope_n_per_m += element_n_per_m;
        }
        self.force_n = self.branch.direction() * force_n;
        self.slope_n_per_m = slope_n_per_m;
    }
}

/// A spring and its slider.
struct Element {
    stiffness_n_per_m: f32,
    saturation_n: f32,
}

impl Element {
    /// Force (N) and slope (N/m) after `travel_m` ≥ 0 in one direction from where the element held `held_n`.
    // Selections by hand: `max` and `min` of `f32` cost three times as many instructions.
    #[inline(always)]
    fn stretched(&self, held_n: f32, travel_m: f32) -> (f32, f32) {
        // New coefficients may have less room than an element holds.
        let held_n = if held_n > -self.saturation_n { held_n } else { -self.saturation_n };
        let tried_n = held_n + self.stiffness_n_per_m * travel_m;
        if tried_n < self.saturation_n { (tried_n, self.stiffness_n_per_m) } else { (self.saturation_n, 0.0) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::friction::dahl::{self, Dahl};
    use proptest::prelude::*;

    const COUNT_M: f64 = 4e-6 / 65536.0;

    fn coefficients(elements: Elements, hysteresis_ct: i32) -> Coefficients {
        Coefficients { elements, count_m: COUNT_M as f32, hysteresis_ct }
    }

    fn at(k: &Coefficients, path: &[i64]) -> MaxwellSlip {
        let mut model = MaxwellSlip::relaxed(Position(0));
        path.iter().for_each(|position| model.update(k, Position(*position)));
        model
    }

    #[test]
    fn table_4_adds_up() {
        assert!((GMS_TABLE_4.coulomb_n() - 0.4301).abs() < 1e-6);
        assert!((GMS_TABLE_4.total_stiffness_n_per_m() / 11.8965e6 - 1.0).abs() < 1e-6);
        let scaled = GMS_TABLE_4.scaled(4e6, 0.6);
        assert!((scaled.total_stiffness_n_per_m() / 8e6 - 1.0).abs() < 1e-6);
        assert!((scaled.coulomb_n() / 0.6 - 1.0).abs() < 1e-6);
    }

    #[test]
    fn force_and_slope_of_table_4_break_element_by_element() {
        let k = coefficients(GMS_TABLE_4, 0);
        for count in [1, 8, 10, 100, 250, 1_000, 100_000, 300_000] {
            let model = at(&k, &[0, count]);
            let x = count as f64 * COUNT_M;
            let list = || GMS_TABLE_4.stiffness_n_per_m.iter().zip(&GMS_TABLE_4.saturation_n);
            let force: f64 = list().map(|(k, f)| (f64::from(*k) * x).min(f64::from(*f))).sum();
            let slope: f64 =
                list().filter(|(k, f)| f64::from(**k) * x < f64::from(**f)).map(|(k, _)| f64::from(*k)).sum();
            assert!(
                (f64::from(model.force_n()) - force).abs() < 1e-7
                    && (f64::from(model.slope_n_per_m()) - slope).abs() < 2.0
            );
        }
        // 0.55 nm are nine counts, 13.8 µm are 225 534.
        assert!(at(&k, &[0, 9]).slope_n_per_m() > 1e7 && at(&k, &[0, 10]).slope_n_per_m() < 6e6);
        assert!(at(&k, &[0, 225_000]).slope_n_per_m() == 0.0162e6 && at(&k, &[0, 226_000]).slope_n_per_m() == 0.0);
    }

    #[test]
    fn a_saturated_reversal_is_dahls_within_one_part_in_elements_squared() {
        for count in [6, 12] {
            let k = coefficients(Elements::like_dahl(count, 4e6, 0.6), 0);
            assert!((k.elements.total_stiffness_n_per_m() / 8e6 - 1.0).abs() < 1e-6);
            assert!((k.elements.coulomb_n() / 0.6 - 1.0).abs() < 1e-6);
            let dahl_k = dahl::Coefficients {
                stiffness_n_per_m: 4e6,
                coulomb_n: 0.6,
                exponent_per_ct: (4e6 / 0.6 * COUNT_M) as f32,
                hysteresis_ct: 0,
            };
            let (mut slip, mut dahl) = (at(&k, &[-1_000_000]), Dahl::relaxed(Position(0)));
            dahl.update(&dahl_k, Position(-1_000_000));
            let mut worst = 0.0f32;
            for position in (-1_000_000..-900_000).step_by(10) {
                slip.update(&k, Position(position));
                dahl.update(&dahl_k, Position(position));
                worst = worst.max((slip.force_n() - dahl.force_n()).abs());
            }
            let bound = 0.6 / (count * count) as f32;
            assert!((0.9 * bound..=1.001 * bound).contains(&worst), "{count} elements: {worst} N, {bound} N");
        }
    }

    #[test]
    fn all_elements_stick_right_after_a_reversal_and_none_far_behind_it() {
        let k = coefficients(Elements::like_dahl(12, 4e6, 0.6), 0);
        assert_eq!(at(&k, &[1_000_000]).slope_n_per_m(), 0.0);
        assert!((at(&k, &[1_000_000]).force_n() - 0.6).abs() < 1e-6);
        assert!((at(&k, &[1_000_000, 999_999]).slope_n_per_m() / 8e6 - 1.0).abs() < 1e-6);
    }

    #[test]
    fn an_inner_loop_closes_and_is_forgotten() {
        let k = coefficients(Elements::like_dahl(12, 4e6, 0.6), 0);
        let outer = [100_000, 99_000, 99_500];
        let inner = [100_000, 99_000, 99_500, 99_250, 99_500];
        assert!((at(&k, &outer).force_n() - at(&k, &inner).force_n()).abs() < 1e-6);
        let [outer, inner] = [&outer[..], &inner[..]].map(|path| {
            let mut model = at(&k, path);
            model.update(&k, Position(99_600));
            (model.force_n(), model.slope_n_per_m())
        });
        assert!((outer.0 - inner.0).abs() < 1e-6 && outer.1 == inner.1, "as if the loop had not been");
    }

    #[test]
    fn noise_below_the_hysteresis_is_no_reversal() {
        let k = coefficients(GMS_TABLE_4, 16);
        let mut model = at(&k, &[5_000]);
        let (force, slope) = (model.force_n(), model.slope_n_per_m());
        for offset in [-1, -16, -3, 0, -9] {
            model.update(&k, Position(5_000 + offset));
            assert_eq!((model.force_n(), model.slope_n_per_m()), (force, slope));
        }
        model.update(&k, Position(5_000 - 17));
        assert!(model.slope_n_per_m() > slope);
    }

    proptest! {
        #[test]
        fn force_and_slope_keep_their_bounds_on_any_path_even_when_the_elements_change(
            path in proptest::collection::vec(-2_000_000_000i64..2_000_000_000, 1..200), change in 0usize..200,
        ) {
            let mut k = coefficients(Elements::like_dahl(12, 4e6, 0.6), 16);
            let mut model = MaxwellSlip::relaxed(Position(0));
            for (i, position) in path.into_iter().enumerate() {
                if i == change {
                    k = coefficients(GMS_TABLE_4, 16);
                }
                model.update(&k, Position(position));
                prop_assert!(model.force_n().abs() <= k.elements.coulomb_n() * 1.000_001);
                prop_assert!((0.0..=k.elements.total_stiffness_n_per_m()).contains(&model.slope_n_per_m()));
            }
        }
    }
}
