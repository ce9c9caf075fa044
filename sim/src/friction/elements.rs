//! Lists of spring-slider elements, and the published one.

use serde::{Deserialize, Serialize};

/// The most elements a list can have.
pub const MAX_LISTED: usize = 12;

/// A spring that slides at a certain force.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Element {
    /// Stiffness k_i, N/m, above 0.
    pub stiffness_n_per_m: f64,
    /// Saturation F_i^sat, N, above 0; may be infinite.
    pub saturation_n: f64,
}

const NONE: Element = Element { stiffness_n_per_m: 0.0, saturation_n: 0.0 };

/// One to [`MAX_LISTED`] elements in parallel.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Elements {
    count: usize,
    list: [Element; MAX_LISTED],
}

impl Elements {
    /// The elements of `list`; nothing if it is empty or longer than [`MAX_LISTED`].
    pub fn new(list: &[Element]) -> Option<Elements> {
        let mut elements = Elements { count: list.len(), list: [NONE; MAX_LISTED] };
        elements.list.get_mut(..list.len())?.copy_from_slice(list);
        (!list.is_empty()).then_some(elements)
    }

    /// [`GMS_TABLE_4`].
    pub fn table_4() -> Elements {
        let mut elements = Elements { count: GMS_TABLE_4.len(), list: [NONE; MAX_LISTED] };
        elements.list[..GMS_TABLE_4.len()].copy_from_slice(&GMS_TABLE_4);
        elements
    }

    /// The elements.
    pub fn as_slice(&self) -> &[Element] {
        self.list.get(..self.count).unwrap_or(&self.list)
    }

    /// All of them in motion: `Σ k_i`, N/m. Dahl's σ for the same reversal at saturation is half of it.
    pub fn stiffness_n_per_m(&self) -> f64 {
        self.as_slice().iter().map(|element| element.stiffness_n_per_m).sum()
    }

    /// The level of Coulomb friction `F_C = Σ F_i^sat`, N (A.5).
    pub fn coulomb_n(&self) -> f64 {
        self.as_slice().iter().map(|element| element.saturation_n).sum()
    }

    /// Every stiffness and every saturation times a factor.
    pub fn scaled(mut self, stiffness: f64, saturation: f64) -> Elements {
        for element in &mut self.list {
            element.stiffness_n_per_m *= stiffness;
            element.saturation_n *= saturation;
        }
        self
    }
}

/// The eight elements of the thesis' fit.
///
/// # Source
/// Table 4. Their saturations add up to 0.4301 N; 0.4302 N is printed.
pub const GMS_TABLE_4: [Element; 8] = [
    Element { stiffness_n_per_m: 6.5408e6, saturation_n: 0.0036 },
    Element { stiffness_n_per_m: 1.0210e6, saturation_n: 0.0156 },
    Element { stiffness_n_per_m: 1.6261e6, saturation_n: 0.0290 },
    Element { stiffness_n_per_m: 0.4352e6, saturation_n: 0.0165 },
    Element { stiffness_n_per_m: 1.5016e6, saturation_n: 0.0675 },
    Element { stiffness_n_per_m: 0.6951e6, saturation_n: 0.0546 },
    Element { stiffness_n_per_m: 0.0605e6, saturation_n: 0.0203 },
    Element { stiffness_n_per_m: 0.0162e6, saturation_n: 0.2230 },
];

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn table_4_adds_up_and_its_elements_saturate_where_the_errata_say() {
        let elements = Elements::table_4();
        assert_eq!(Elements::new(&GMS_TABLE_4), Some(elements));
        assert!((elements.coulomb_n() - 0.4301).abs() < 1e-12, "{} N", elements.coulomb_n());
        assert!((elements.stiffness_n_per_m() - 11.8965e6).abs() < 1e-3, "{} N/m", elements.stiffness_n_per_m());
        let reach_m = |element: &Element| element.saturation_n / element.stiffness_n_per_m;
        assert!((reach_m(&GMS_TABLE_4[0]) - 0.55e-9).abs() < 0.005e-9);
        assert!((reach_m(&GMS_TABLE_4[7]) - 13.8e-6).abs() < 0.05e-6);
    }

    #[test]
    fn a_list_has_one_to_twelve_elements() {
        let element = GMS_TABLE_4[0];
        assert_eq!(Elements::new(&[]), None);
        assert_eq!(Elements::new(&[element; 13]), None);
        assert_eq!(Elements::new(&[element; 3]).unwrap().as_slice(), [element; 3]);
    }
}
