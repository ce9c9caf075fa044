//! What the thesis says of the compensators (chapters 4, 7 and 11), held against one comparison of all of them.

use serde::Serialize;

use super::outcome::{ConfigOutcome, Run};
use crate::table::{Table, number};

/// A sentence of the thesis, and what was found.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Claim {
    /// Section of the thesis.
    pub thesis_section: &'static str,
    /// What it says.
    pub claim: &'static str,
    /// Whether the numbers agree; `None` where the thesis only asks.
    pub holds: Option<bool>,
    /// The numbers.
    pub found: String,
}

/// Index of a tolerance in [`crate::settling::TOLERANCES_NM`].
const FINEST: usize = 0;
const TEN_NM: usize = 2;

/// The claims on a comparison as `reproduce compensators` makes it; those whose configurations are missing are left away.
pub fn of(run: &Run) -> Vec<Claim> {
    let of = |name: &str| run.configs.iter().find(|config| config.settling.name == name);
    let mut claims = Vec::new();
    let Some(pid) = of("pid") else { return claims };
    let mut add = |thesis_section, claim, holds, found| claims.push(Claim { thesis_section, claim, holds, found });
    if let Some(feedforward) = of("feedforward") {
        let rms_nm = [pid, feedforward].map(|c| c.tracking_rms_nm.unwrap_or(f64::INFINITY));
        let found = format!("rms error while moving {} nm, PID {} nm", number(rms_nm[1], 0), number(rms_nm[0], 0));
        add("4.2.1", "feedforward of a friction model lowers the tracking error", Some(rms_nm[1] < rms_nm[0]), found);
        let changes: Vec<f64> = feedforward.reduction_percent.iter().flatten().copied().collect();
        let largest = changes.iter().fold(0.0f64, |largest, c| largest.max(c.abs()));
        let found = format!("mean settling times change by at most {} %", number(largest, 1));
        add("4.2.1", "and has little or no effect on settling", Some(largest < 15.0), found);
    }
    for name in ["lugre-observer", "dahl-observer"] {
        if let Some(observer) = of(name) {
            let slower = |t: usize| match (mean_ms(observer, t), mean_ms(pid, t)) {
                (Some(observer), Some(pid)) => observer > pid,
                (None, _) => true,
                (_, None) => false,
            };
            let holds = observer.settling.unsettled[FINEST] > pid.settling.unsettled[FINEST] || slower(FINEST);
            let found = format!("{name}: {}, PID {}", settling(observer, FINEST), settling(pid, FINEST));
            add("4.2.2", "a friction observer converges to zero error slowly, if at all", Some(holds), found);
        }
    }
    for name in ["lugre-observer-scaled", "dahl-observer-scaled"] {
        if let Some((observer, niasa)) = of(name).zip(of("niasa")) {
            // Where NIASA has no mean there is nothing to be slower than.
            let slower = |t: usize| match (mean_ms(observer, t), mean_ms(niasa, t)) {
                (Some(observer), Some(niasa)) => observer > niasa,
                (None, Some(_)) => true,
                (_, None) => false,
            };
            let fewer = |t: usize| niasa.settling.unsettled[t] < observer.settling.unsettled[t];
            let holds =
                (0..niasa.settling.mean_ms.len()).all(|t| slower(t) || (mean_ms(niasa, t).is_some() && fewer(t)));
            let found = format!("{name}: {}, NIASA {}", settling(observer, TEN_NM), settling(niasa, TEN_NM));
            add(
                "4.2.2",
                "also with as much of the model as settles best, it settles more slowly than NIASA",
                Some(holds),
                found,
            );
        }
    }
    if let Some(scheduled) = of("scheduled-pd") {
        let nm = scheduled.steady_error_nm.unwrap_or(f64::INFINITY);
        let found = format!("{} nm rms stay; {}", number(nm, 1), settling(scheduled, FINEST));
        add("4.2.3", "scheduled PD leaves an error in steady state", Some(nm > 3.0), found);
    }
    let Some(niasa) = of("niasa") else { return claims };
    let faster = |t: usize| mean_ms(niasa, t).zip(mean_ms(pid, t)).is_some_and(|(niasa, pid)| niasa < pid);
    let everywhere = (0..niasa.settling.mean_ms.len()).all(faster) && niasa.settling.unsettled.iter().all(|n| *n == 0);
    let found = format!("{}, PID {}", settling(niasa, TEN_NM), settling(pid, TEN_NM));
    add("4.2.4, 7", "scheduled integral action settles faster, to zero error", Some(everywhere), found);
    if let Some(observer) = of("disturbance-observer") {
        let found = format!("{}, NIASA {}", settling(observer, TEN_NM), settling(niasa, TEN_NM));
        add("4.2.1", "(a disturbance observer: mentioned only)", None, found);
    }
    if let Some(maxwell) = of("niasa-maxwell") {
        let found = format!("{}, on Dahl {}", settling(maxwell, TEN_NM), settling(niasa, TEN_NM));
        add("11", "would the slope of a better friction model help NIASA?", None, found);
    }
    claims
}

fn mean_ms(config: &ConfigOutcome, tolerance: usize) -> Option<f64> {
    config.settling.mean_ms[tolerance]
}

/// Settling to one tolerance in words.
fn settling(config: &ConfigOutcome, tolerance: usize) -> String {
    let tolerance_nm = crate::settling::TOLERANCES_NM[tolerance];
    let moves = config.settling.settling_ms.len();
    let unsettled = config.settling.unsettled[tolerance];
    let mean = mean_ms(config, tolerance).map(|ms| format!("{} ms to ±{tolerance_nm} nm", number(ms, 1)));
    match mean {
        Some(mean) if unsettled == 0 => mean,
        Some(mean) => format!("{unsettled} of {moves} do not settle, the others in {mean}"),
        None => format!("none of {moves} settles to ±{tolerance_nm} nm"),
    }
}

/// The claims for a terminal.
pub fn table(claims: &[Claim]) -> Table {
    let header = ["section", "thesis", "holds", "simulated"];
    let table =
        Table { text_columns: 4, ..Table::new("What the thesis says, and what was found (simulated)", &header) };
    claims.iter().fold(table, |table, claim| {
        let holds = match claim.holds {
            Some(true) => "yes",
            Some(false) => "no",
            None => "asked",
        };
        table.row([claim.thesis_section, claim.claim, holds, &claim.found])
    })
}
