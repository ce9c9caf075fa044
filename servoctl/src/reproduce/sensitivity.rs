//! How NIASA's settling depends on each of its parameters (8.1), on a stage that is not what the model says (7.4), and on the model
//! whose slope it takes (11).

use servo_core::compensator::Compensator;
use servo_core::parameters::Settings;
use servo_core::refusal::Refusal;
use servo_host_tests::experiment::Steps;
use servo_host_tests::tuning::{self, STANDARD};
use servo_sim::stage::{Friction, FrictionModel};

use super::experiments::{FIVE_MM_SLOW, Plan, appendix_e, with};
use crate::settling::{TOLERANCES_NM, round_to};

/// Time after each profile, s: NIASA needs a tenth of it, PID alone at ±3 nm sometimes more.
const DWELL_S: f64 = 2.0;

/// Stiffness and Coulomb friction of the stages at the corners, as shares of the nominal ones: the range of 25 trials in 7.4
/// (4.17 to 16.79 N/µm for a mean of 8.46), and that of F_C in the built-in stage file (0.3 to 1.1 N for 0.64).
const CORNERS: ([f64; 3], [f64; 3]) = ([4.17 / 8.46, 1.0, 16.79 / 8.46], [0.3 / 0.64, 1.0, 1.1 / 0.64]);

/// A form of NIASA: its name, and what it makes of settings.
type Form = (&'static str, fn(Settings) -> Settings);

/// The thesis' two forms.
const FORMS: [Form; 2] = [("App. E", appendix_e), ("7.55", |s| s)];

/// What the names of the comparisons on table 4's curve begin with.
pub const ON_TABLE_4: &str = "table 4";

/// One value of a parameter: in words, what it makes of the settings, and its factor on the nominal one.
type Value = (String, fn(Settings, f64) -> Settings, f64);

/// One parameter: name of the comparison, and its values.
type Variation = (&'static str, Vec<Value>);

/// Factors on a parameter with their names.
fn factors(what: &str, unit: &str, nominal: f64, factors: &[f64], change: fn(Settings, f64) -> Settings) -> Vec<Value> {
    factors.iter().map(|f| (format!("{what} {} {unit}", round_to(nominal * f, 3)), change, *f)).collect()
}

/// The comparisons: a parameter each, all of its values beside PID; then stage by stage.
///
/// # Errors
/// A stage that the drive's parameters cannot describe.
pub fn plan(plan: &mut Plan) -> Result<(), Refusal> {
    let steps = Steps { dwell_s: DWELL_S, ..FIVE_MM_SLOW };
    let stage = plan.request.stage;
    let settings = tuning::settings(&stage, &STANDARD)?;
    let s = &settings;
    let variations: [Variation; 5] = [
        (
            "σ̂",
            factors("σ̂", "N/µm", s.niasa_stiffness_n_per_m * 1e-6, &[0.25, 0.5, 1.0, 2.0, 4.0], |s, f| Settings {
                niasa_stiffness_n_per_m: f * s.niasa_stiffness_n_per_m,
                ..s
            }),
        ),
        (
            "F̂_C",
            factors("F̂_C", "N", s.niasa_coulomb_n, &[0.25, 0.5, 1.0, 2.0, 4.0], |s, f| Settings {
                niasa_coulomb_n: f * s.niasa_coulomb_n,
                ..s
            }),
        ),
        (
            "τ_d",
            factors("τ_d", "ms", s.niasa_time_constant_s * 1e3, &[0.2, 0.5, 1.0, 2.0, 5.0], |s, f| Settings {
                niasa_time_constant_s: f * s.niasa_time_constant_s,
                ..s
            }),
        ),
        (
            "rate limit",
            factors("limit", "mN", s.niasa_rate_limit_n * 1e3, &[0.1, 0.3, 1.0, 3.0, 1e3], |s, f| Settings {
                niasa_rate_limit_n: f * s.niasa_rate_limit_n,
                ..s
            }),
        ),
        (
            "hysteresis",
            factors("hysteresis", "nm", s.niasa_hysteresis_m * 1e9, &[0.0, 0.25, 0.5, 1.0, 2.0, 5.0], |s, f| {
                Settings { niasa_hysteresis_m: f * s.niasa_hysteresis_m, ..s }
            }),
        ),
    ];
    for (form, of) in FORMS {
        for (what, values) in &variations {
            let mut cases = vec![plan.case("pid", stage, settings, steps, &TOLERANCES_NM)];
            for (name, change, factor) in values {
                let niasa = of(with(change(settings, *factor), Compensator::Niasa));
                cases.push(plan.case(name, stage, niasa, steps, &TOLERANCES_NM));
            }
            plan.compare(&format!("{what}, {form}"), STANDARD, None, &cases);
        }
    }
    // The drive stays as it is; the stage becomes another. Without spread: it is the corner that is looked at.
    for stiffness in CORNERS.0 {
        for coulomb in CORNERS.1 {
            let mut corner = stage;
            corner.friction.spread = None;
            corner.friction.stiffness_n_per_m *= stiffness;
            corner.friction.coulomb_n *= coulomb;
            corner.friction.static_n = corner.friction.static_n.map(|static_n| static_n * coulomb);
            let niasa = with(settings, Compensator::Niasa);
            let cases = [("pid", settings), ("pid+niasa", appendix_e(niasa)), ("pid+niasa-7.55", niasa)]
                .map(|(name, settings)| plan.case(name, corner, settings, steps, &TOLERANCES_NM));
            let name = format!("δ {:+.2}, F_C {:.2} N", stiffness - 1.0, corner.friction.coulomb_n);
            plan.compare(&name, STANDARD, None, &cases);
        }
    }
    slopes(plan, steps, &settings);
    Ok(())
}

/// Chapter 11's question: on a stage whose curve is not Dahl's, what does the slope of a model bring that follows it? The stage has
/// the curve of table 4 with its own σ and F_C; NIASA has them as a careful person gives them, and as they are.
fn slopes(plan: &mut Plan, steps: Steps, settings: &Settings) {
    let mut stage = plan.request.stage;
    if !stage.friction.model.has_spring() {
        return;
    }
    stage.friction = Friction {
        model: FrictionModel::Gms,
        listed: None,
        static_n: None,
        shape: None,
        attraction_n_per_s: None,
        damping_n_s_per_m: 0.0,
        ..stage.friction
    };
    let true_to = |s: Settings| Settings {
        niasa_stiffness_n_per_m: stage.friction.stiffness_n_per_m,
        niasa_coulomb_n: stage.friction.coulomb_n,
        ..s
    };
    let dahl = with(*settings, Compensator::Niasa);
    let slip = with(*settings, Compensator::NiasaMaxwell);
    let table_4 = Settings { niasa_elements: 1.0, ..slip };
    for (form, of) in FORMS {
        let variants = [
            ("dahl", dahl),
            ("maxwell-like-dahl", slip),
            ("maxwell-table-4", table_4),
            ("dahl-true", true_to(dahl)),
            ("maxwell-table-4-true", true_to(table_4)),
        ];
        let mut cases = vec![plan.case("pid", stage, *settings, steps, &TOLERANCES_NM)];
        cases.extend(variants.map(|(name, s)| plan.case(name, stage, of(s), steps, &TOLERANCES_NM)));
        plan.compare(&format!("{ON_TABLE_4}, {form}"), STANDARD, None, &cases);
    }
}
