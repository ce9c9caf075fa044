//! The committed budget of instruction counts.

use std::fmt::Write;

use anyhow::{Context, Result, ensure};

use super::calls::Counts;
use crate::version::Version;

/// A count may exceed its budget by this share.
const TOLERANCE: f64 = 0.02;

/// One function's budget, instructions.
#[derive(Clone, Debug, PartialEq)]
struct Row {
    /// `function` or `function/kind`, see [`Counts`].
    name: String,
    mean: f64,
    /// Most minus fewest.
    spread: u64,
    /// What no call may exceed.
    cap: Option<u64>,
}

/// What `budget.toml` says.
#[derive(Clone, Debug, PartialEq)]
pub struct Budget {
    /// The compiler that it was measured with. Another one makes other code: then only the caps hold.
    rustc: Version,
    rows: Vec<Row>,
}

impl Budget {
    /// Reads `budget.toml`: `rustc`, then a table per row with `mean`, `spread` and possibly `cap`.
    ///
    /// # Errors
    /// When it is no TOML, or something is missing.
    pub fn parse(text: &str) -> Result<Budget> {
        let tables: toml::Table = text.parse()?;
        let rustc = tables.get("rustc").and_then(|text| Version::find(text.as_str()?));
        let rustc = rustc.context("rustc is missing or no version")?;
        let mut rows = Vec::new();
        for name in text.lines().filter_map(heading) {
            let table = tables.get(name).with_context(|| format!("{name} is no table"))?;
            let number = |key: &str| -> Option<f64> {
                let value = table.get(key)?;
                value.as_float().or_else(|| value.as_integer().map(|integer| integer as f64))
            };
            let needed = |key: &str| number(key).with_context(|| format!("{name} has no {key}"));
            let cap = number("cap").map(|cap| cap as u64);
            rows.push(Row { name: name.to_string(), mean: needed("mean")?, spread: needed("spread")? as u64, cap });
        }
        ensure!(!rows.is_empty(), "no budget at all");
        Ok(Budget { rustc, rows })
    }

    /// The same rows with what was measured.
    ///
    /// # Errors
    /// When something in the budget was not measured.
    pub fn measured(&self, counts: &Counts, rustc: Version) -> Result<Budget> {
        let row = |row: &Row| {
            let count = counts.get(&row.name)?;
            let mean = (count.mean() * 10.0).round() / 10.0;
            Ok(Row { mean, spread: count.spread(), ..row.clone() })
        };
        Ok(Budget { rustc, rows: self.rows.iter().map(row).collect::<Result<_>>()? })
    }

    /// `text`, a `budget.toml` with the same rows, with this budget's numbers. Comments and caps stay.
    pub fn rewrite(&self, text: &str) -> String {
        let mut row = None;
        let mut rewritten = String::new();
        for line in text.lines() {
            if let Some(name) = heading(line) {
                row = self.rows.iter().find(|row| row.name == name);
            }
            let key = line.split('=').next().unwrap_or_default().trim();
            let _ = match (row, key) {
                (None, "rustc") => writeln!(rewritten, "rustc = \"{}\"", self.rustc),
                (Some(row), "mean") => writeln!(rewritten, "mean = {:.1}", row.mean),
                (Some(row), "spread") => writeln!(rewritten, "spread = {}", row.spread),
                _ => writeln!(rewritten, "{line}"),
            };
        }
        rewritten
    }

    /// A table of measured and agreed numbers, and a line for everything that is too much.
    ///
    /// # Errors
    /// When something in the budget was not measured.
    pub fn compare(&self, counts: &Counts, rustc: Version) -> Result<(String, Vec<String>)> {
        let comparable = rustc == self.rustc;
        let mut table = format!(
            "{:<22} {:>6} {:>6} {:>8} {:>6}   {:>8} {:>8} {:>6}\n",
            "instructions", "calls", "min", "mean", "max", "budget:", "max−min", "cap"
        );
        let mut exceeded = Vec::new();
        for Row { name, mean, spread, cap } in &self.rows {
            let count = counts.get(name)?;
            let shown_cap = cap.map_or(String::new(), |cap| cap.to_string());
            let _ = writeln!(
                table,
                "{name:<22} {:>6} {:>6} {:>8.1} {:>6}   {mean:>8.1} {spread:>8} {shown_cap:>6}",
                count.calls,
                count.min,
                count.mean(),
                count.max,
            );
            // The committed mean has one decimal.
            if comparable && count.mean() > mean * (1.0 + TOLERANCE) + 0.05 {
                exceeded.push(format!("{name}: mean {:.1}, budget {mean:.1}", count.mean()));
            }
            if comparable && count.spread() as f64 > *spread as f64 * (1.0 + TOLERANCE) {
                exceeded.push(format!("{name}: max−min {}, budget {spread}", count.spread()));
            }
            if let Some(cap) = cap.filter(|cap| count.max > *cap) {
                exceeded.push(format!("{name}: at most {}, cap {cap}", count.max));
            }
        }
        if !comparable {
            let _ = writeln!(table, "Compiled by rustc {rustc}, the budget by {}: only the caps hold.", self.rustc);
        }
        Ok((table, exceeded))
    }
}

/// The name in a line `["name"]`.
fn heading(line: &str) -> Option<&str> {
    line.trim().strip_prefix("[\"")?.strip_suffix("\"]")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::qemu::calls;

    const RUSTC: Version = Version::new(1, 96);
    const TEXT: &str = "# why\nrustc = \"1.96.0\"\n[\"a\"]\nmean = 11.0\nspread = 2\ncap = 12 # required\n\n[\"b/off\"]\nmean = 9\nspread = 0\n";

    fn counts(log: &str) -> Counts {
        let mut counts = Counts::default();
        counts.add(&calls::parse(log).unwrap());
        counts
    }

    fn exceeded(log: &str, rustc: Version) -> Vec<String> {
        Budget::parse(TEXT).unwrap().compare(&counts(log), rustc).unwrap().1
    }

    #[test]
    fn what_is_too_much_is_said_with_numbers() {
        let cases: [(&str, &[&str]); 5] = [
            ("a 10\na 12\nclass_on 1\nb 9\nclass_off 1\nend\n", &[]),
            ("a 8\na 8\nclass_on 1\nb 9\nclass_off 1\nend\n", &[]),
            ("a 12\na 12\nclass_on 1\nb 9\nclass_off 1\nend\n", &["a: mean 12.0, budget 11.0"]),
            ("a 9\na 12\nclass_on 1\nb 9\nclass_off 1\nend\n", &["a: max−min 3, budget 2"]),
            (
                "a 10\na 10\na 10\na 13\nclass_on 1\nb 10\nclass_off 1\nend\n",
                &["a: max−min 3, budget 2", "a: at most 13, cap 12", "b/off: mean 10.0, budget 9.0"],
            ),
        ];
        for (log, expected) in cases {
            assert_eq!(exceeded(log, RUSTC), expected, "{log}");
        }
    }

    #[test]
    fn with_another_compiler_only_caps_hold() {
        let log = "a 10\na 13\nclass_on 1\nb 10\nclass_off 1\nend\n";
        assert_eq!(exceeded(log, Version::new(1, 97)), ["a: at most 13, cap 12"]);
    }

    #[test]
    fn a_budget_without_its_count_is_an_error() {
        let budget = Budget::parse(TEXT).unwrap();
        assert!(budget.compare(&counts("a 1\nclass_on 1\nend\n"), RUSTC).unwrap_err().to_string().contains("b/off"));
    }

    #[test]
    fn a_broken_budget_is_refused() {
        let cases = [
            ("", "rustc is missing or no version"),
            ("rustc = \"1.96.0\"", "no budget at all"),
            ("rustc = \"1.96.0\"\n[\"a\"]\nmean = 1\n", "a has no spread"),
        ];
        for (text, expected) in cases {
            assert_eq!(Budget::parse(text).unwrap_err().to_string(), expected);
        }
        assert!(Budget::parse("mean = ").is_err());
    }

    #[test]
    fn blessing_changes_the_numbers_and_nothing_else() {
        let counts = counts("a 7\na 8\nclass_on 1\nb 5\nclass_off 1\nend\n");
        let blessed = Budget::parse(TEXT).unwrap().measured(&counts, Version::new(1, 97)).unwrap();
        let text = blessed.rewrite(TEXT);
        assert_eq!(
            text,
            TEXT.replace("1.96", "1.97").replace("11.0", "7.5").replace("= 2", "= 1").replace("mean = 9", "mean = 5.0")
        );
        assert_eq!(Budget::parse(&text).unwrap(), blessed);
    }
}
