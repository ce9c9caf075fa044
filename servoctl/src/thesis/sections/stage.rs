//! The stage (3.2) and the motion profiles (fig. 11, ch. 9).

use servo_core::SERVO_HZ;
use servo_core::position::Position;
use servo_core::profile::{Limits, Profile};
use servo_host_tests::experiment::Steps;
use servo_sim::Stage;

use crate::plot::{Axis, Plot, Series};
use crate::reproduce::experiments::{FIFTY_NM, FIVE_MM_FAST, FIVE_MM_SLOW, FIVE_UM};
use crate::table::{Table, number};
use crate::thesis::section::Section;
use crate::thesis::targets::Target;
use crate::thesis::verdict::Check;

/// A profile as the drive makes it.
struct Made {
    /// Duration (ms).
    duration_ms: f64,
    /// Largest speed (m/s).
    peak_m_per_s: f64,
    /// Per servo period: time (ms), displacement (m), speed (m/s), acceleration (m/s²).
    course: Vec<[f64; 4]>,
}

/// Steps, and what the thesis says of them: duration (ms) and largest speed (m/s).
const PROFILES: [(&str, Steps, f64, f64); 4] = [
    ("5 mm at 1 m/s²", FIVE_MM_SLOW, 143.0, 0.07),
    ("5 mm at 10 m/s²", FIVE_MM_FAST, 46.0, 0.2235),
    ("5 µm at 0.1 m/s²", FIVE_UM, 15.0, 698e-6),
    ("50 nm at 1 mm/s²", FIFTY_NM, 15.0, 6.98e-6),
];

/// How far the thesis' rounded durations may lie from the triangle's 2√(s/a) (ms), and its speeds from √(s·a) (%).
const ROUNDED_MS: f64 = 2.0;
const ROUNDED_PERCENT: f64 = 2.0;

/// The section.
pub fn section(stage: &Stage) -> Section {
    let made: Vec<Made> = PROFILES.iter().map(|(_, steps, ..)| make(steps, stage.encoder.count_m)).collect();
    let mut checks = Vec::new();
    let mut table = Table::new(
        "Motion profiles as the drive makes them",
        &["step", "thesis / ms", "here / ms", "thesis, peak / mm/s", "here, peak / mm/s"],
    );
    for ((name, _, thesis_ms, thesis_m_per_s), made) in PROFILES.iter().zip(&made) {
        let range_ms = (thesis_ms - ROUNDED_MS, thesis_ms + ROUNDED_MS);
        checks.push(Check::within(name, Some(made.duration_ms), range_ms, 1, "ms"));
        let off = 100.0 * (made.peak_m_per_s / thesis_m_per_s - 1.0);
        let limits = (-ROUNDED_PERCENT, ROUNDED_PERCENT);
        checks.push(Check::within(&format!("{name}, peak speed against the thesis'"), Some(off), limits, 1, "%"));
        let mm_per_s = |m_per_s: f64| {
            number(
                m_per_s * 1e3,
                if m_per_s < 1e-4 {
                    5
                } else if m_per_s < 0.01 {
                    3
                } else {
                    1
                },
            )
        };
        table = table.row([
            (*name).to_owned(),
            number(*thesis_ms, 0),
            number(made.duration_ms, 1),
            mm_per_s(*thesis_m_per_s),
            mm_per_s(made.peak_m_per_s),
        ]);
    }
    let ours = made.iter().map(|m| number(m.duration_ms, 1)).collect::<Vec<_>>().join(", ");
    let speeds = format!(
        "{ours} ms; {} mm/s at 1 m/s², {} mm/s at 10 m/s², {} µm/s for 5 µm",
        number(made[0].peak_m_per_s * 1e3, 1),
        number(made[1].peak_m_per_s * 1e3, 1),
        number(made[2].peak_m_per_s * 1e6, 0)
    );
    Section::new("3.2 The stage, and how it is asked to move")
        .finding(Target::Stage, stage_in_words(stage), &stage_checks(stage))
        .finding(Target::Profiles, speeds, &checks)
        .table(&[], table)
        .figure(
            &[11],
            panels(&made[0]),
            "displacement, velocity and acceleration of a 5 mm step at 1 m/s², as the drive makes it.",
        )
}

fn stage_in_words(stage: &Stage) -> String {
    format!(
        "{} mm, {} kg, {} pm, {} kHz",
        number(stage.mechanics.travel_m * 1e3, 0),
        number(stage.mechanics.mass_kg, 1),
        number(stage.encoder.count_m * 1e12, 1),
        number(f64::from(SERVO_HZ) * 1e-3, 0)
    )
}

fn stage_checks(stage: &Stage) -> [Check; 4] {
    [
        Check::within("travel", Some(stage.mechanics.travel_m * 1e3), (99.5, 100.5), 1, "mm"),
        Check::within("moving mass", Some(stage.mechanics.mass_kg), (1.75, 1.85), 2, "kg"),
        Check::within("resolution", Some(stage.encoder.count_m * 1e12), (60.5, 61.5), 1, "pm"),
        Check::within("servo rate", Some(f64::from(SERVO_HZ) * 1e-3), (8.0, 8.0), 0, "kHz"),
    ]
}

fn make(steps: &Steps, count_m: f64) -> Made {
    let target = Position((steps.step_m / count_m).round() as i64);
    let acceleration_m_per_s2 = steps.acceleration_m_per_s2 as f32;
    let limits = Limits { velocity_m_per_s: 1.0, acceleration_m_per_s2, jerk_m_per_s3: None };
    let mut profile = Profile::between(Position(0), target, limits, count_m);
    let duration_ms = 1e3 * profile.duration_s();
    let mut course = Vec::new();
    while !profile.is_done() {
        let setpoint = profile.advance();
        let time_ms = (course.len() + 1) as f64 / f64::from(SERVO_HZ) * 1e3;
        let velocity = f64::from(setpoint.velocity_m_per_s);
        course.push([
            time_ms,
            setpoint.position.0 as f64 * count_m,
            velocity,
            f64::from(setpoint.acceleration_m_per_s2),
        ]);
    }
    let peak_m_per_s = course.iter().fold(0.0f64, |peak, point| peak.max(point[2]));
    Made { duration_ms, peak_m_per_s, course }
}

fn panels(made: &Made) -> Vec<Plot> {
    let panel = |column: usize, title: &str, per_unit: f64| {
        let points = made.course.iter().map(move |point| (point[0], point[column] * per_unit));
        let mut plot = Plot::new(format!("Profile: {title}"), Axis::linear("time / ms"), Axis::linear(title));
        plot.height = 260.0;
        plot.series(Series::new("", 0).line(points))
    };
    vec![panel(1, "displacement / mm", 1e3), panel(2, "velocity / mm/s", 1e3), panel(3, "acceleration / m/s²", 1.0)]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::thesis::verdict::Outcome;

    #[test]
    fn a_profile_is_a_triangle_of_two_root_s_over_a() {
        for (_, steps, ..) in PROFILES {
            let made = make(&steps, 61.035_156_25e-12);
            let ideal_ms = 2e3 * (steps.step_m / steps.acceleration_m_per_s2).sqrt();
            // A count of 61 pm is a thousandth of 50 nm; a period is 0.125 ms.
            assert!((made.duration_ms - ideal_ms).abs() < 0.13, "{} {ideal_ms}", made.duration_ms);
            let ideal_m_per_s = (steps.step_m * steps.acceleration_m_per_s2).sqrt();
            assert!((made.peak_m_per_s / ideal_m_per_s - 1.0).abs() < 0.02);
        }
    }

    #[test]
    fn another_stage_is_not_said_to_be_that_of_the_thesis() {
        assert_eq!(section(&Stage::default()).findings[0].verdict.outcome, Outcome::Reproduced);
        let mut stage = Stage::default();
        stage.mechanics.mass_kg = 5.0;
        let finding = section(&stage).findings[0].clone();
        assert_eq!(finding.verdict.outcome, Outcome::Partly);
        assert!(
            finding.verdict.why().starts_with("Not: moving mass 5.00 kg (outside 1.75 to 1.85)"),
            "{}",
            finding.verdict.why()
        );
    }
}
