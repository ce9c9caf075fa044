//! Files of recorded signals: a head that says what it is, raw numbers, and lengths in metres beside them.

use std::fmt::Write;
use std::path::Path;

use anyhow::{Context, Result, ensure};
use servo_core::SERVO_HZ;
use servo_core::fingerprint::Fingerprint;
use servo_core::parameters::{Settings, TABLE};
use servo_core::record::{COLUMNS, Selection};

use crate::link::Drive;

/// The lines in front of the columns, and what makes metres of counts.
pub struct Head {
    text: String,
    count_m: f64,
}

impl Head {
    /// What the file was recorded with.
    pub fn new(drive: &Drive, settings: &Settings, every_ticks: u32, trigger: &str) -> Head {
        let identity = drive.identity();
        let [major, minor, patch] = identity.firmware;
        let simulated = if identity.is_virtual() { ", simulated" } else { "" };
        let text = format!(
            "# servoctl {}, firmware {major}.{minor}.{patch} (program {:016x}) on {}{simulated}\n# parameters {:016x}\n\
             # rate {} Hz\n# trigger: {trigger}\n# units: by the ends of the names; a count is {:e} m\n",
            env!("CARGO_PKG_VERSION"),
            identity.program,
            identity.board,
            parameter_hash(settings),
            f64::from(SERVO_HZ) / f64::from(every_ticks.max(1)),
            settings.encoder_count_m,
        );
        Head { text, count_m: settings.encoder_count_m }
    }
}

/// Fingerprint of parameters by ids and bits.
pub fn parameter_hash(settings: &Settings) -> u64 {
    let of = |so_far: Fingerprint, row: &servo_core::parameters::Parameter| {
        so_far.with(&row.id.to_le_bytes()).with(&row.get(settings).to_bits().to_le_bytes())
    };
    TABLE.iter().fold(Fingerprint::default(), of).0
}

/// The columns with these names.
///
/// # Errors
/// Names the ones there are.
pub fn selection(names: &[String]) -> Result<Selection> {
    let selection = Selection::named(names.iter().map(String::as_str));
    let selection = selection.filter(|selection| !selection.is_empty());
    selection.with_context(|| {
        let known = COLUMNS.map(|(name, _)| name).join(", ");
        format!("signals {}: there are {known}", names.join(","))
    })
}

/// Writes the file: time, the columns, and every column of counts once more in metres.
///
/// # Errors
/// A file that cannot be written.
pub fn write(file: &Path, head: &Head, names: &[&str], times_s: &[f64], columns: &[Vec<f64>]) -> Result<()> {
    ensure!(columns.iter().all(|column| column.len() == times_s.len()), "the columns differ in length");
    let in_m: Vec<Option<String>> = names
        .iter()
        .map(|name| name.strip_suffix("_ct").map(|name| format!("{}_m", name.trim_end_matches("_low"))))
        .collect();
    let mut text = head.text.clone() + "time_s";
    for name in names.iter().copied().chain(in_m.iter().flatten().map(String::as_str)) {
        let _ = write!(text, ",{name}");
    }
    text.push('\n');
    for (row, time_s) in times_s.iter().enumerate() {
        let _ = write!(text, "{time_s}");
        for column in columns {
            let _ = write!(text, ",{}", column[row]);
        }
        for (column, _) in columns.iter().zip(&in_m).filter(|(_, name)| name.is_some()) {
            let _ = write!(text, ",{:.12}", column[row] * head.count_m);
        }
        text.push('\n');
    }
    std::fs::write(file, text).with_context(|| format!("writing {}", file.display()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn counts_are_written_once_more_in_metres() {
        let file = tempfile::NamedTempFile::new().unwrap();
        let head = Head { text: "# head\n".to_owned(), count_m: 1e-9 };
        let columns = [vec![-3.0, 4.0], vec![0.5, 0.25]];
        write(file.path(), &head, &["position_low_ct", "force_n"], &[-0.1, 0.0], &columns).unwrap();
        let text = std::fs::read_to_string(file.path()).unwrap();
        let expected =
            "# head\ntime_s,position_low_ct,force_n,position_m\n-0.1,-3,0.5,-0.000000003000\n0,4,0.25,0.000000004000\n";
        assert_eq!(text, expected);
    }

    #[test]
    fn an_unknown_signal_is_answered_with_the_known_ones() {
        let error = selection(&["speed".to_owned()]).unwrap_err().to_string();
        assert!(error.contains("signals speed: there are tick, position_low_ct"), "{error}");
    }
}
