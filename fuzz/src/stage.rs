//! The stage file.

use servo_sim::{BridgeState, Plant, Stage};

/// Reads the bytes as a stage file, and lets a stage that was accepted stand for a moment.
///
/// # Panics
/// Where a refusal names no line of the text, or an accepted stage gives a position that is no number.
pub fn check(bytes: &[u8]) {
    let Ok(text) = std::str::from_utf8(bytes) else { return };
    match Stage::from_toml(text) {
        Err(error) => {
            let message = error.to_string();
            let line = message.strip_prefix("line ").and_then(|rest| rest.split(':').next()?.parse::<usize>().ok());
            let lines = text.matches('\n').count() + 1;
            assert!(line.is_some_and(|line| (1..=lines).contains(&line)), "{message}");
        }
        Ok(stage) => {
            let mut plant = Plant::new(&stage, 1);
            plant.redraw_friction(0);
            plant.advance(25_000, &BridgeState::OFF);
            plant.encoder_frame();
            assert!(plant.position_m().is_finite() && plant.velocity_m_per_s().is_finite(), "{stage:?}");
        }
    }
}

/// The stage files of the project.
pub fn seeds() -> Vec<Vec<u8>> {
    let files = [
        include_str!("../../sim/stages/als130h.toml"),
        include_str!("../../sim/stages/gms-table-4.toml"),
        include_str!("../../sim/stages/light-stiff.toml"),
        include_str!("../../sim/stages/sin-cos.toml"),
    ];
    // Without comments: they are most of the bytes and nothing of the format.
    let bare = |text: &str| {
        let lines = text.lines().map(|line| line.split('#').next().unwrap_or("").trim());
        lines.filter(|line| !line.is_empty()).collect::<Vec<_>>().join("\n").into_bytes()
    };
    files.iter().map(|text| bare(text)).collect()
}
