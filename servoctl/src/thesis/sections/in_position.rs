//! In-position noise (9.3, table 3).

use super::settling::{NIASA, PID, conditions, display_name};
use crate::reproduce::outcome::Run;
use crate::table::{MISSING, Table, number};
use crate::thesis::section::Section;
use crate::thesis::targets::Target;
use crate::thesis::verdict::Check;

/// Table 3 (nm rms): PID and NIASA, for each tuning.
pub const THESIS_NM: [[f64; 2]; 2] = [[0.48, 0.50], [0.49, 0.48]];

/// How far from table 3 counts as reproduced (nm): well below a difference that anybody would notice in position.
const WITHIN_NM: f64 = 0.2;

/// The section: a run per tuning, as in table 3.
pub fn section(runs: &[&Run]) -> Section {
    let moves = runs.first().map_or(0, |run| run.settling.moves);
    let caption = "error in position, nm rms: in the last 500 ms of the dwell, and in the 500 ms from settling to the finest tolerance, where \
         the rest of the creep is in it";
    let shown = |value: Option<f64>| value.map_or(MISSING.to_owned(), |nm| number(nm, 2));
    let mut checks = Vec::new();
    let mut table =
        Table::new(caption, &["configuration", "thesis", "last 500 ms", "from settling on", "settled moves"]);
    for (run, thesis_nm) in runs.iter().zip(THESIS_NM) {
        for (i, config) in run.configs.iter().enumerate() {
            let name = format!("{}: {}", run.name, display_name(&config.settling.name));
            let thesis_nm = thesis_nm.get(i);
            let settled = moves - config.settling.unsettled.first().copied().unwrap_or(0);
            if let Some(nm) = thesis_nm {
                let range = (nm - WITHIN_NM, nm + WITHIN_NM);
                checks.push(Check::within(&name, config.settling.in_position_rms_nm, range, 2, "nm"));
            }
            table = table.row([
                name,
                shown(thesis_nm.copied()),
                shown(config.settling.in_position_rms_nm),
                shown(config.after_settling_rms_nm),
                format!("{settled} of {moves}"),
            ]);
        }
    }
    let of = |run: &&Run| {
        [PID, NIASA].map(|c| shown(run.configs.get(c).and_then(|c| c.settling.in_position_rms_nm))).join(", ")
    };
    let ours = runs.iter().map(of).collect::<Vec<_>>().join("; ");
    Section::new("9.3 Noise in position")
        .finding(Target::InPosition, ours, &checks)
        .conditions(conditions(runs))
        .table(&[3], table)
}
