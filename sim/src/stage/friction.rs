//! The `[friction]` table of a stage file: which keys belong to which model, and what they may say.

use serde::{Deserialize, Serialize};

use super::{Limit, Mechanics, Misfit};
use crate::friction::{Element, Elements, Level, MAX_ELEMENTS, MAX_LISTED};
use crate::plant::SUBSTEP_MAX_NS;

/// The friction of the guides. Viscous friction (σ2) is `mechanics.viscous_n_s_per_m`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Friction {
    /// The model of the truth.
    pub model: FrictionModel,
    /// Elements of the Maxwell-slip model, 1 to 32; 12 if not given.
    pub elements: usize,
    /// Dahl's stiffness σ, σ0 of LuGre, half of all elements' stiffness of GMS: N/m, at least 1, at most what the internal
    /// step resolves (a tenth of a radian of the resonance). 0 for the models without a spring.
    pub stiffness_n_per_m: f64,
    /// Coulomb level F_C, N, 1e-6 to 1e4.
    pub coulomb_n: f64,
    /// Level of static friction F_s, N, from F_C to 1e4; F_C if not given. Stribeck, LuGre and GMS.
    pub static_n: Option<f64>,
    /// Stribeck velocity V_s, m/s, 1e-9 to 10; 1 mm/s if not given.
    pub stribeck_m_per_s: Option<f64>,
    /// Shape factor δ of the Stribeck curve, 0.1 to 10; 1 if not given.
    pub stribeck_shape: Option<f64>,
    /// Damping of the bristles or elements σ1, N s/m, 0 to a tenth of what one internal step takes to stop the mass. LuGre
    /// and GMS.
    pub damping_n_s_per_m: f64,
    /// Shape factor: Dahl's i, 0 to 10, 1 if not given; or GMS's n, 1 to 10, with which GMS is the hidden-state law (2.9).
    pub shape: Option<f64>,
    /// Attraction parameter C of GMS, N/s, 1e-6 to 1e12; sliding elements are at their share at once if not given.
    pub attraction_n_per_s: Option<f64>,
    /// Elements of GMS. σ and F_C scale them; [`Friction::scaled_elements`] is what the plant has.
    pub listed: Option<Elements>,
    /// How σ and F_C vary from move to move; not at all if not given.
    pub spread: Option<Spread>,
}

/// The friction models to choose from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum FrictionModel {
    /// Parallel elements with non-local memory, chosen to follow Dahl's curve.
    MaxwellSlip,
    /// Dahl's differential equation, with local memory.
    Dahl,
    /// Generalised Maxwell slip: any elements, Stribeck effect, damping.
    Gms,
    /// Bristles: local memory, Stribeck effect, damping.
    #[serde(rename = "lugre")]
    LuGre,
    /// A level that depends on the velocity; no spring.
    Stribeck,
    /// A constant level; no spring.
    Coulomb,
}

/// Normal distributions around the nominal values, clipped, drawn once per move.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Spread {
    /// Standard deviation of σ, N/m, 0 to the nominal value.
    pub stiffness_std_n_per_m: f64,
    /// Smallest σ, N/m, 1 to the nominal value.
    pub stiffness_min_n_per_m: f64,
    /// Largest σ, N/m, from the nominal value to what the internal step resolves.
    pub stiffness_max_n_per_m: f64,
    /// Standard deviation of F_C, N, 0 to the nominal value.
    pub coulomb_std_n: f64,
    /// Smallest F_C, N, 1e-6 to the nominal value.
    pub coulomb_min_n: f64,
    /// Largest F_C, N, from the nominal value to 1e4.
    pub coulomb_max_n: f64,
}

impl Friction {
    /// The level of sliding friction `s(v)` (2.4).
    pub fn level(&self) -> Level {
        match self.static_n {
            None => Level::constant(self.coulomb_n),
            Some(static_n) => Level {
                coulomb_n: self.coulomb_n,
                static_n,
                stribeck_m_per_s: self.stribeck_m_per_s.unwrap_or(1e-3),
                stribeck_shape: self.stribeck_shape.unwrap_or(1.0),
            },
        }
    }

    /// The elements of GMS with `Σ k_i = 2σ` and `Σ F_i^sat = F_C`, those of table 4 if none are listed.
    pub fn scaled_elements(&self) -> Elements {
        let elements = self.listed.unwrap_or_else(Elements::table_4);
        let stiffer = 2.0 * self.stiffness_n_per_m / elements.stiffness_n_per_m();
        elements.scaled(stiffer, self.coulomb_n / elements.coulomb_n())
    }

    /// Every value that the model has, with its range.
    pub(super) fn limits(&self, mechanics: &Mechanics) -> Vec<Limit> {
        // The resonance turns by sqrt(2 σ / m) times the internal step, in radians.
        let substep_s = SUBSTEP_MAX_NS as f64 * 1e-9;
        let stiffest_n_per_m = 0.5 * mechanics.mass_kg * (0.1 / substep_s) * (0.1 / substep_s);
        let strongest_n_s_per_m = 0.1 * mechanics.mass_kg / substep_s;
        let limit = |key, value, from, to| Limit { key, value, from, to };
        let mut limits = vec![limit("friction.elements", self.elements as f64, 1.0, MAX_ELEMENTS as f64)];
        if self.model.has_spring() {
            limits.push(limit("friction.stiffness_n_per_m", self.stiffness_n_per_m, 1.0, stiffest_n_per_m));
        }
        limits.extend([
            limit("friction.coulomb_n", self.coulomb_n, 1e-6, 1e4),
            limit("friction.damping_n_s_per_m", self.damping_n_s_per_m, 0.0, strongest_n_s_per_m),
        ]);
        let least_shape = if self.model == FrictionModel::Gms { 1.0 } else { 0.0 };
        let optional = [
            ("friction.static_n", self.static_n, self.coulomb_n, 1e4),
            ("friction.stribeck_m_per_s", self.stribeck_m_per_s, 1e-9, 10.0),
            ("friction.stribeck_shape", self.stribeck_shape, 0.1, 10.0),
            ("friction.shape", self.shape, least_shape, 10.0),
            ("friction.attraction_n_per_s", self.attraction_n_per_s, 1e-6, 1e12),
        ];
        limits.extend(optional.iter().filter_map(|(key, value, from, to)| Some(limit(key, (*value)?, *from, *to))));
        if let Some(spread) = &self.spread {
            let (stiffness, coulomb) = (self.stiffness_n_per_m, self.coulomb_n);
            limits.extend([
                limit("friction.spread.stiffness_std_n_per_m", spread.stiffness_std_n_per_m, 0.0, stiffness),
                limit("friction.spread.stiffness_min_n_per_m", spread.stiffness_min_n_per_m, 1.0, stiffness),
                limit(
                    "friction.spread.stiffness_max_n_per_m",
                    spread.stiffness_max_n_per_m,
                    stiffness,
                    stiffest_n_per_m,
                ),
                limit("friction.spread.coulomb_std_n", spread.coulomb_std_n, 0.0, coulomb),
                limit("friction.spread.coulomb_min_n", spread.coulomb_min_n, 1e-6, coulomb),
                limit("friction.spread.coulomb_max_n", spread.coulomb_max_n, coulomb, 1e4),
            ]);
        }
        limits
    }
}

impl FrictionModel {
    /// Whether small motions meet a stiffness.
    pub fn has_spring(self) -> bool {
        !matches!(self, FrictionModel::Stribeck | FrictionModel::Coulomb)
    }

    /// The name in a stage file.
    pub fn name(self) -> &'static str {
        match self {
            FrictionModel::MaxwellSlip => "maxwell-slip",
            FrictionModel::Dahl => "dahl",
            FrictionModel::Gms => "gms",
            FrictionModel::LuGre => "lugre",
            FrictionModel::Stribeck => "stribeck",
            FrictionModel::Coulomb => "coulomb",
        }
    }

    /// The keys beside `model` that must and that may stand in the table.
    fn keys(self) -> (&'static [&'static str], &'static [&'static str]) {
        match self {
            FrictionModel::MaxwellSlip => (&["stiffness_n_per_m", "coulomb_n"], &["elements", "spread"]),
            FrictionModel::Dahl => (&["stiffness_n_per_m", "coulomb_n"], &["shape", "spread"]),
            FrictionModel::Gms => (
                &[],
                &[
                    "preset",
                    "element_stiffness_n_per_m",
                    "element_saturation_n",
                    "stiffness_n_per_m",
                    "coulomb_n",
                    "static_n",
                    "stribeck_m_per_s",
                    "stribeck_shape",
                    "damping_n_s_per_m",
                    "shape",
                    "attraction_n_per_s",
                    "spread",
                ],
            ),
            FrictionModel::LuGre => (
                &["stiffness_n_per_m", "coulomb_n"],
                &["static_n", "stribeck_m_per_s", "stribeck_shape", "damping_n_s_per_m", "spread"],
            ),
            FrictionModel::Stribeck => (&["coulomb_n", "static_n", "stribeck_m_per_s"], &["stribeck_shape"]),
            FrictionModel::Coulomb => (&["coulomb_n"], &[]),
        }
    }
}

/// The table as it is written.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct File {
    model: FrictionModel,
    preset: Option<Preset>,
    elements: Option<usize>,
    stiffness_n_per_m: Option<f64>,
    coulomb_n: Option<f64>,
    static_n: Option<f64>,
    stribeck_m_per_s: Option<f64>,
    stribeck_shape: Option<f64>,
    damping_n_s_per_m: Option<f64>,
    shape: Option<f64>,
    attraction_n_per_s: Option<f64>,
    element_stiffness_n_per_m: Option<Vec<f64>>,
    element_saturation_n: Option<Vec<f64>>,
    spread: Option<Spread>,
}

/// Elements that need not be written down.
#[derive(Clone, Copy, Deserialize)]
enum Preset {
    #[serde(rename = "table-4")]
    Table4,
}

impl File {
    /// The friction that the table describes; ranges are checked by [`Friction::limits`].
    ///
    /// # Errors
    /// Keys that the model lacks, keys that it does not have, and lists of elements that do not fit each other.
    pub(super) fn resolve(self) -> Result<Friction, Misfit> {
        let (must, may) = self.model.keys();
        let given = self.given();
        if let Some(key) = must.iter().find(|key| !given.contains(key)) {
            return Err(Misfit::new("friction", format!("missing field `{key}` of model \"{}\"", self.model.name())));
        }
        if let Some(key) = given.iter().find(|key| !must.contains(key) && !may.contains(key)) {
            let has: Vec<_> = must.iter().chain(may).map(|key| format!("`{key}`")).collect();
            let message = format!("no parameter of model \"{}\", which has {}", self.model.name(), has.join(", "));
            return Err(Misfit::new(format!("friction.{key}"), message));
        }
        if self.model == FrictionModel::Gms && self.shape.is_some() && self.attraction_n_per_s.is_some() {
            return Err(Misfit::new("friction.attraction_n_per_s", "either this or `shape`".into()));
        }
        let listed = if self.model == FrictionModel::Gms { Some(self.listed()?) } else { None };
        let stiffness = listed.map_or(0.0, |elements| 0.5 * elements.stiffness_n_per_m());
        let coulomb = listed.map_or(0.0, |elements| elements.coulomb_n());
        Ok(Friction {
            model: self.model,
            elements: self.elements.unwrap_or(12),
            stiffness_n_per_m: self.stiffness_n_per_m.unwrap_or(stiffness),
            coulomb_n: self.coulomb_n.unwrap_or(coulomb),
            static_n: self.static_n,
            stribeck_m_per_s: self.stribeck_m_per_s,
            stribeck_shape: self.stribeck_shape,
            damping_n_s_per_m: self.damping_n_s_per_m.unwrap_or(0.0),
            shape: self.shape,
            attraction_n_per_s: self.attraction_n_per_s,
            listed,
            spread: self.spread,
        })
    }

    /// The keys that are written, beside `model`.
    fn given(&self) -> Vec<&'static str> {
        let keys = [
            ("preset", self.preset.is_some()),
            ("elements", self.elements.is_some()),
            ("stiffness_n_per_m", self.stiffness_n_per_m.is_some()),
            ("coulomb_n", self.coulomb_n.is_some()),
            ("static_n", self.static_n.is_some()),
            ("stribeck_m_per_s", self.stribeck_m_per_s.is_some()),
            ("stribeck_shape", self.stribeck_shape.is_some()),
            ("damping_n_s_per_m", self.damping_n_s_per_m.is_some()),
            ("shape", self.shape.is_some()),
            ("attraction_n_per_s", self.attraction_n_per_s.is_some()),
            ("element_stiffness_n_per_m", self.element_stiffness_n_per_m.is_some()),
            ("element_saturation_n", self.element_saturation_n.is_some()),
            ("spread", self.spread.is_some()),
        ];
        keys.into_iter().filter_map(|(key, given)| given.then_some(key)).collect()
    }

    /// The elements of GMS: those of the preset or of the two lists.
    fn listed(&self) -> Result<Elements, Misfit> {
        let misfit = |key: &str, message: String| Err(Misfit::new(format!("friction.{key}"), message));
        let (stiffness, saturation) = (&self.element_stiffness_n_per_m, &self.element_saturation_n);
        let (stiffness, saturation) = match (self.preset, stiffness, saturation) {
            (Some(Preset::Table4), None, None) => return Ok(Elements::table_4()),
            (None, Some(stiffness), Some(saturation)) => (stiffness, saturation),
            (Some(_), _, _) => return misfit("preset", "either a preset or lists of elements".into()),
            (None, _, _) => {
                let message = "needs `preset`, or `element_stiffness_n_per_m` and `element_saturation_n`";
                return Err(Misfit::new("friction", format!("model \"gms\" {message}")));
            }
        };
        if saturation.len() != stiffness.len() {
            let message = format!("{} values for {} stiffnesses", saturation.len(), stiffness.len());
            return misfit("element_saturation_n", message);
        }
        for (key, values, most) in
            [("element_stiffness_n_per_m", stiffness, 1e9), ("element_saturation_n", saturation, 1e4)]
        {
            if let Some((i, value)) = values.iter().enumerate().find(|(_, value)| !(1e-6..=most).contains(*value)) {
                return misfit(&format!("{key}[{i}]"), format!("{value:?} is outside 1e-6 to {most:?}"));
            }
        }
        let pairs = stiffness.iter().zip(saturation);
        let list: Vec<_> = pairs.map(|(k, f)| Element { stiffness_n_per_m: *k, saturation_n: *f }).collect();
        Elements::new(&list).map_or_else(
            || misfit("element_stiffness_n_per_m", format!("{} values are outside 1 to {MAX_LISTED}", list.len())),
            Ok,
        )
    }
}
