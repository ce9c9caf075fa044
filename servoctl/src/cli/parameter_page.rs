//! The page of parameters, from the table in core.

use std::fmt::Write;

use servo_core::image::{OLDEST_SCHEMA, SCHEMA};
use servo_core::parameters::{Access, GROUPS, Parameter, TABLE};

use crate::link::units::show_number;

const PARAMETERS_HEAD: &str = "\
# Parameters

Made by `cargo xtask docs` from the table in [`core/src/parameters.rs`](../core/src/parameters.rs); a test compares the two.

Values are numbers in SI units. A value outside its range is refused with name, value and range, and so is one that does not go with the
others (`bus_min_v` above `bus_max_v`). *Access*: **always** means that a change is taken at any time, without a bump in force;
**bridge off** that it is refused while the drive has torque.
";

/// `docs/parameters.md`.
pub fn parameters() -> String {
    let mut page = PARAMETERS_HEAD.to_string();
    let _ = write!(
        page,
        "\nThe ids are the wire's and the stored images': never reused. This table is schema {SCHEMA}; images of schema {OLDEST_SCHEMA} are \
         still read, and what was not yet in them takes its default. How parameters are stored, and what a new drive needs before it can be \
         enabled: [commissioning.md](commissioning.md).\n"
    );
    for (upper, title) in GROUPS {
        let _ = write!(
            page,
            "\n## {title}\n\n| id | name | unit | lowest | highest | default | access | |\n|---|---|---|---:|---:|---:|---|---|\n"
        );
        for row in TABLE.iter().filter(|row| row.id >> 8 == upper) {
            let Parameter { id, name, unit, doc, .. } = row;
            let access = match row.access {
                Access::Always => "always",
                Access::BridgeOff => "bridge off",
            };
            let [min, max, default] = [row.min, row.max, row.default].map(show_number);
            let _ = writeln!(page, "| {id:#06x} | `{name}` | {unit} | {min} | {max} | {default} | {access} | {doc} |");
        }
    }
    page
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_parameter_is_on_the_page_once() {
        let page = parameters();
        for row in TABLE {
            assert_eq!(page.matches(&format!("| {:#06x} | `{}` |", row.id, row.name)).count(), 1, "{}", row.name);
        }
    }

    #[test]
    fn the_committed_page_is_current() {
        let file = concat!(env!("CARGO_MANIFEST_DIR"), "/../docs/parameters.md");
        let committed = std::fs::read_to_string(file).unwrap_or_default();
        assert!(committed == parameters(), "run `cargo xtask docs` and commit docs/parameters.md");
    }
}
