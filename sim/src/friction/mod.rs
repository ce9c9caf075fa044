//! Rate-independent friction: a force that remembers where the stage has been.

mod dahl;
mod maxwell_slip;

pub use dahl::Dahl;
pub use maxwell_slip::{MAX_ELEMENTS, MaxwellSlip};

use serde::{Deserialize, Serialize};

use crate::stage::{self, FrictionModel};

/// The friction of the stage, one variant per model.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[expect(clippy::large_enum_variant, reason = "there is one in a plant, and it is stepped in the innermost loop")]
pub enum Friction {
    /// Non-local memory; what a stage does.
    MaxwellSlip(MaxwellSlip),
    /// Local memory; for comparison.
    Dahl(Dahl),
}

impl Friction {
    /// Virgin friction (force 0 N) of the model, stiffness and Coulomb level in the stage file.
    pub fn new(stage: &stage::Friction) -> Friction {
        match stage.model {
            FrictionModel::MaxwellSlip => {
                Friction::MaxwellSlip(MaxwellSlip::new(stage.elements, stage.stiffness_n_per_m, stage.coulomb_n))
            }
            FrictionModel::Dahl => Friction::Dahl(Dahl::new(stage.stiffness_n_per_m, stage.coulomb_n)),
        }
    }

    /// Moves the contact by `dx_m` in `dt_s`, at constant velocity, and returns the force that opposes positive motion, N.
    ///
    /// A `dt_s` of 0 leaves away what depends on the rate; in these two models nothing does.
    #[inline]
    pub fn advance(&mut self, dx_m: f64, _dt_s: f64) -> f64 {
        match self {
            Friction::MaxwellSlip(model) => model.advance(dx_m),
            Friction::Dahl(model) => model.advance(dx_m),
        }
    }

    /// [`Friction::advance`] for a mass that a force of `stopping_n` would bring to rest by the end of the step.
    ///
    /// A model without a spring needs to know: up to its level it stops the mass and holds it. The others do not.
    #[inline]
    pub fn resist(&mut self, dx_m: f64, dt_s: f64, _stopping_n: f64) -> f64 {
        self.advance(dx_m, dt_s)
    }

    /// The force that opposes positive motion, N.
    pub fn force_n(&self) -> f64 {
        match self {
            Friction::MaxwellSlip(model) => model.force_n(),
            Friction::Dahl(model) => model.force_n(),
        }
    }

    /// The energy in the springs, J: what can be had back from the work done against friction.
    pub fn stored_j(&self) -> f64 {
        match self {
            Friction::MaxwellSlip(model) => model.stored_j(),
            Friction::Dahl(model) => model.stored_j(),
        }
    }

    /// Changes Dahl's σ (N/m) and F_C (N), both positive; the force keeps its fraction of F_C, and with it the memory.
    pub fn set(&mut self, stiffness_n_per_m: f64, coulomb_n: f64) {
        match self {
            Friction::MaxwellSlip(model) => model.set(stiffness_n_per_m, coulomb_n),
            Friction::Dahl(model) => model.set(stiffness_n_per_m, coulomb_n),
        }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    const STIFFNESS_N_PER_M: f64 = 8.66e6;
    const COULOMB_N: f64 = 0.64;

    fn both() -> [Friction; 2] {
        [
            Friction::MaxwellSlip(MaxwellSlip::new(12, STIFFNESS_N_PER_M, COULOMB_N)),
            Friction::Dahl(Dahl::new(STIFFNESS_N_PER_M, COULOMB_N)),
        ]
    }

    /// Moves by `nanometres` in steps of 1 nm; the work done against friction, J.
    fn travel(friction: &mut Friction, nanometres: i32) -> f64 {
        let dx_m = 1e-9 * f64::from(nanometres.signum());
        (0..nanometres.abs())
            .map(|_| {
                let before_n = friction.force_n();
                0.5 * (before_n + friction.advance(dx_m, 1e-6)) * dx_m
            })
            .sum()
    }

    proptest! {
        #[test]
        fn friction_gives_back_no_more_than_it_has_stored(legs_nm in prop::collection::vec(-300i32..300, 1..20)) {
            for mut friction in both() {
                for leg_nm in &legs_nm {
                    let before_j = friction.stored_j();
                    let work_j = travel(&mut friction, *leg_nm);
                    // The stiffest spring holds 2e-8 J.
                    prop_assert!(work_j - (friction.stored_j() - before_j) >= -1e-13);
                }
            }
        }

        #[test]
        fn a_closed_path_costs_energy(mut legs_nm in prop::collection::vec(-300i32..300, 1..8)) {
            legs_nm.push(-legs_nm.iter().sum::<i32>());
            let [mut slip, _] = both();
            travel(&mut slip, 20);
            let mut round_j = || legs_nm.iter().map(|leg_nm| travel(&mut slip, *leg_nm)).sum::<f64>();
            round_j(); // from the second round on, the force is periodic and nothing is stored
            prop_assert!(round_j() >= -1e-18);
        }

        #[test]
        fn the_force_stays_within_coulomb(steps_m in prop::collection::vec(-1e-6..1e-6, 1..50), redrawn in (1e6..2e7, 0.1..2.0)) {
            for mut friction in both() {
                for dx_m in &steps_m {
                    prop_assert!(friction.advance(*dx_m, 1e-6).abs() <= COULOMB_N * (1.0 + 1e-14));
                }
                let before_n = friction.force_n();
                friction.set(redrawn.0, redrawn.1);
                prop_assert!((friction.force_n() / redrawn.1 - before_n / COULOMB_N).abs() < 1e-12);
                for dx_m in &steps_m {
                    prop_assert!(friction.advance(*dx_m, 1e-6).abs() <= redrawn.1 * (1.0 + 1e-14));
                }
            }
        }
    }

    #[test]
    fn no_motion_changes_no_force() {
        for mut friction in both() {
            let force_n = friction.advance(7e-9, 1e-6);
            assert_eq!(friction.advance(0.0, 1e-6), force_n);
            assert_eq!(friction.force_n(), force_n);
        }
    }

    #[test]
    fn both_models_start_with_twice_sigma_after_a_saturated_reversal_and_with_their_own_virgin_stiffness() {
        for (mut friction, virgin) in both().into_iter().zip([2.0, 1.0]) {
            assert!((friction.advance(1e-12, 1e-6) / (virgin * STIFFNESS_N_PER_M * 1e-12) - 1.0).abs() < 1e-4);
            friction.advance(1e-3, 1e-6);
            let drop_n = friction.force_n() - friction.advance(-1e-12, 1e-6);
            assert!((drop_n / (2.0 * STIFFNESS_N_PER_M * 1e-12) - 1.0).abs() < 1e-4);
        }
    }

    #[test]
    fn nanometre_jitter_wears_out_dahl_but_not_maxwell_slip() {
        let [mut slip, mut dahl] = both();
        for (friction, kept) in [(&mut slip, 1.0..=1.0), (&mut dahl, 0.0..=0.5)] {
            let start_n = friction.advance(100e-9, 1e-6);
            for _ in 0..1_000 {
                friction.advance(-0.5e-9, 1e-6);
                friction.advance(0.5e-9, 1e-6);
            }
            let ratio = friction.force_n() / start_n;
            assert!(kept.contains(&((ratio * 1e9).round() * 1e-9)), "{ratio}");
        }
    }
}
