//! Stages and steps in words, for captions.

use servo_sim::Stage;

use crate::settling::round_to;

/// A plant in words.
pub fn plant(stage: &Stage) -> String {
    format!(
        "{} kg, {} friction σ {:.2} N/µm, F_C {} N",
        stage.mechanics.mass_kg,
        stage.friction.model.name(),
        stage.friction.stiffness_n_per_m * 1e-6,
        round_to(stage.friction.coulomb_n, 4)
    )
}

/// A length in its natural unit.
pub fn length(m: f64) -> String {
    match m {
        m if m >= 1e-3 => format!("{} mm", round_to(m * 1e3, 6)),
        m if m >= 1e-6 => format!("{} µm", round_to(m * 1e6, 6)),
        m => format!("{} nm", round_to(m * 1e9, 6)),
    }
}
