//! How a move settled: what the drive measured itself, waited for and put into words.

use serde::Serialize;
use servo_core::SERVO_HZ;
use servo_core::settling::{NOISE_TICKS, Settling, TOLERANCES_NM};

use crate::link::units::show_length;
use crate::link::{Drive, Error};
use crate::table::{MISSING, Table};

/// PID alone creeps for a second; nobody waits longer for what has not settled by then.
const LONGEST_TICKS: u32 = 2 * SERVO_HZ;

/// The settling of one move, for a program.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Report {
    /// Tolerances, nm.
    pub tolerances_nm: Vec<u32>,
    /// Time from the end of the profile until the error stayed inside, ms; `null`: not within the time looked at.
    pub settled_after_ms: Vec<Option<f64>>,
    /// Time looked at after the end of the profile, ms.
    pub looked_at_ms: f64,
    /// How far the stage went past the target, nm.
    pub overshoot_nm: f64,
    /// Rms of the error over the last complete half second, nm.
    pub in_position_rms_nm: Option<f64>,
    /// Its largest minus its smallest value, nm.
    pub in_position_peak_to_peak_nm: Option<f64>,
}

impl Report {
    /// From what the drive knows.
    pub fn new(settling: &Settling, count_m: f64) -> Report {
        let nm_per_ct = count_m * 1e9;
        let times = (0..TOLERANCES_NM.len()).map(|index| settling.settled_after_s(index).map(|time_s| time_s * 1e3));
        let noise = settling.noise_ct2;
        Report {
            tolerances_nm: TOLERANCES_NM.to_vec(),
            settled_after_ms: times.collect(),
            looked_at_ms: f64::from(settling.ticks) / f64::from(SERVO_HZ) * 1e3,
            overshoot_nm: f64::from(settling.overshoot_ct) * nm_per_ct,
            in_position_rms_nm: noise.map(|ct2| f64::from(ct2).sqrt() * nm_per_ct),
            in_position_peak_to_peak_nm: noise.map(|_| f64::from(settling.noise_peak_to_peak_ct) * nm_per_ct),
        }
    }

    /// Whether a block of noise is known that began after the narrowest band was reached, or nobody waits longer.
    pub fn is_ready(settling: &Settling) -> bool {
        Report::is_quiet(settling) || settling.ticks >= LONGEST_TICKS
    }

    /// Whether a block of noise is known that began after the narrowest band was reached.
    pub fn is_quiet(settling: &Settling) -> bool {
        settling.ticks.saturating_sub(settling.settled_after_ticks[0]) >= 2 * NOISE_TICKS
    }

    /// Waits until the drive knows, at most two seconds of its own time after the end of the profile; `look` may end the wait.
    ///
    /// # Errors
    /// A fault; those of the link.
    pub fn wait(drive: &mut Drive, count_m: f64, mut look: impl FnMut() -> bool) -> Result<Report, Error> {
        loop {
            let settling = drive.settling()?;
            if Report::is_ready(&settling) || !look() {
                return Ok(Report::new(&settling, count_m));
            }
            if let Some(fault) = drive.status()?.fault {
                return Err(Error::Interrupted {
                    what: "settling",
                    why: format!("fault {}: {}", fault.number(), fault.explanation()),
                    help: "`servoctl faults` tells more",
                });
            }
        }
    }

    /// For a person. `caption` says which move it was.
    pub fn to_text(&self, caption: &str) -> String {
        let mut table = Table::new(caption, &["tolerance", "settled after"]);
        for (nm, after) in self.tolerances_nm.iter().zip(&self.settled_after_ms) {
            let after = after.map_or(MISSING.to_owned(), |ms| format!("{ms:.1} ms"));
            table = table.row([format!("±{nm} nm"), after]);
        }
        let length = |nm: f64| show_length(nm * 1e-9);
        let noise = match (self.in_position_rms_nm, self.in_position_peak_to_peak_nm) {
            (Some(rms), Some(peaks)) => format!("{rms:.2} nm rms, {peaks:.1} nm peak to peak"),
            _ => "not yet known".to_owned(),
        };
        let never = self.settled_after_ms.contains(&None);
        let note = if never { format!("{MISSING}: not within {:.0} ms\n", self.looked_at_ms) } else { String::new() };
        format!("{}{note}overshoot {}; in position {noise}\n", table.to_text(), length(self.overshoot_nm))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_report_has_the_drive_s_figures_in_a_person_s_units() {
        let settling = Settling {
            ticks: 8000,
            settled_after_ticks: [7900, 800, 400, 80, 8, 0],
            overshoot_ct: 100,
            noise_ct2: Some(100.0),
            noise_peak_to_peak_ct: 60,
        };
        let report = Report::new(&settling, 1e-10);
        assert_eq!(report.settled_after_ms, [None, Some(100.0), Some(50.0), Some(10.0), Some(1.0), Some(0.0)]);
        let text = report.to_text("5 mm");
        for part in
            ["±3 nm                   –", "±5 nm            100.0 ms", "–: not within 1000 ms", "overshoot 10.0 nm"]
        {
            assert!(text.contains(part), "{part} in\n{text}");
        }
        assert!(text.contains("in position 1.00 nm rms, 6.0 nm peak to peak"), "{text}");
    }
}
