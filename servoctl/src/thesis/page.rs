//! The page and its JSON, out of what [`super::run`] has computed.

use serde::Serialize;
use std::collections::BTreeMap;

use super::index::index;
use super::run::Computed;
use super::section::{Finding, Section};
use super::targets::Target;
use super::verdict::{Outcome, Verdict};
use crate::report::{Block, Link, Mark, Report, Statement};
use crate::reproduce::outcome::ORIGIN;

/// A comparison, with the number of its section.
#[derive(Debug, Clone, PartialEq)]
struct Row<'a> {
    target: Target,
    section: Option<usize>,
    finding: Option<&'a Finding>,
}

/// All targets in the order of the thesis, each with what was found, if anything was.
fn rows(sections: &[Section]) -> Vec<Row<'_>> {
    let found = |target: Target| {
        let in_section = |(i, section): (usize, &'_ Section)| {
            section.findings.iter().position(|finding| finding.target == target).map(|f| (i, f))
        };
        sections.iter().enumerate().find_map(in_section)
    };
    let row = |target: Target| {
        let place = found(target);
        Row { target, section: place.map(|p| p.0), finding: place.map(|(s, f)| &sections[s].findings[f]) }
    };
    Target::ALL.map(row).to_vec()
}

/// With the whole reason, or in brief.
fn statement(row: &Row, brief: bool) -> Statement {
    let printed = row.target.printed();
    let (found, verdict) = match row.finding {
        Some(finding) => (finding.ours.clone(), finding.verdict.clone()),
        None => (crate::table::MISSING.to_owned(), Verdict::not_computed()),
    };
    Statement {
        place: printed.section.to_owned(),
        section: row.section,
        quantity: printed.quantity.to_owned(),
        stated: printed.thesis.to_owned(),
        found,
        verdict: verdict.outcome.words().to_owned(),
        mark: match verdict.outcome {
            Outcome::Reproduced => Mark::Good,
            Outcome::Partly => Mark::Fair,
            Outcome::NotReproduced => Mark::Bad,
            Outcome::NotComputed => Mark::None,
        },
        why: if brief { verdict.brief() } else { verdict.why() },
    }
}

/// How many targets have each outcome, in words.
fn count_in_words(rows: &[Row]) -> String {
    let outcome = |row: &Row| row.finding.map_or(Outcome::NotComputed, |finding| finding.verdict.outcome);
    let all = [Outcome::Reproduced, Outcome::Partly, Outcome::NotReproduced, Outcome::NotComputed];
    let counts = all.map(|o| (rows.iter().filter(|row| outcome(row) == o).count(), o));
    let some = counts.iter().filter(|(count, _)| *count > 0).map(|(count, o)| format!("{count} {}", o.words()));
    some.collect::<Vec<_>>().join(", ")
}

/// The page as HTML.
pub fn render(computed: &Computed) -> String {
    let sections = &computed.sections;
    let rows = rows(sections);
    // The overview is the page's section 0.
    let on_page = |section: usize| section + 1;
    let mut report = Report::new(
        "The thesis beside the simulation",
        format!(
            "Every number that Bucci's thesis on the nonlinear integral action settling algorithm (NIASA) states, beside what this \
             drive does on a simulated stage: {} of {} statements {}. Nothing here was measured on a real stage.",
            rows.iter().filter(|row| row.finding.is_some()).count(),
            rows.len(),
            format_args!("were computed ({})", count_in_words(&rows)),
        ),
    );
    for missing in &computed.missing {
        report.paragraph(format!("Missing: {missing}."));
    }
    report.section("Every number at a glance").block(Block::Statements(
        rows.iter().map(|row| Statement { section: row.section.map(on_page), ..statement(row, true) }).collect(),
    ));
    for section in sections {
        report.section(&section.title);
        let own = section.findings.iter().map(|finding| {
            let row = Row { target: finding.target, section: None, finding: Some(finding) };
            statement(&row, false)
        });
        let own: Vec<Statement> = own.collect();
        if !own.is_empty() {
            report.block(Block::Statements(own));
        }
        for block in &section.blocks {
            report.block(block.clone());
        }
    }
    let links = index(sections).into_iter().map(|entry| match entry.place {
        Ok(section) => {
            Link { name: entry.name, place: sections[section].title.clone(), section: Some(on_page(section)) }
        }
        Err(instead) => Link { name: entry.name, place: instead, section: None },
    });
    report.section("Figures and tables of the thesis").block(Block::Links(links.collect()));
    report.section("To repeat this").facts([
        ("Command", computed.request.command()),
        ("Size", computed.request.size.in_words()),
        ("Seed", computed.request.seed.to_string()),
        ("Origin", ORIGIN.to_owned()),
        ("Stage", computed.request.stage_name.clone()),
        ("Version", env!("CARGO_PKG_VERSION").to_owned()),
    ]);
    report.render()
}

/// The comparisons as JSON, with everything that `servoctl reproduce` writes of each experiment.
#[derive(Debug, Serialize)]
pub struct Json<'a> {
    origin: &'static str,
    size: String,
    seed: u64,
    stage: &'a str,
    complete: bool,
    missing: &'a [String],
    rows: Vec<JsonRow>,
    experiments: &'a BTreeMap<String, serde_json::Value>,
}

/// A comparison.
#[derive(Debug, Serialize)]
struct JsonRow {
    section: &'static str,
    quantity: &'static str,
    thesis: &'static str,
    ours: Option<String>,
    verdict: Outcome,
    why: String,
}

/// The JSON of a run.
pub fn json(computed: &Computed) -> Json<'_> {
    let row = |row: &Row| {
        let printed = row.target.printed();
        let verdict = row.finding.map_or(Verdict::not_computed(), |finding| finding.verdict.clone());
        JsonRow {
            section: printed.section,
            quantity: printed.quantity,
            thesis: printed.thesis,
            ours: row.finding.map(|finding| finding.ours.clone()),
            verdict: verdict.outcome,
            why: verdict.why(),
        }
    };
    Json {
        origin: ORIGIN,
        size: computed.request.size.in_words(),
        seed: computed.request.seed,
        stage: &computed.request.stage_name,
        complete: computed.missing.is_empty(),
        missing: &computed.missing,
        rows: rows(&computed.sections).iter().map(row).collect(),
        experiments: &computed.experiments,
    }
}

/// The comparisons for a terminal: a line each.
pub fn text(computed: &Computed) -> String {
    let mut text = String::new();
    let rows = rows(&computed.sections);
    for row in &rows {
        let Statement { place, quantity, stated, found, verdict, why, .. } = statement(row, false);
        text += &format!("{verdict:<18} {place} {quantity}\n{:19}thesis  {stated}\n{:19}here    {found}\n", "", "");
        if row.finding.is_some_and(|finding| finding.verdict.outcome != Outcome::Reproduced) {
            text += &format!("{:19}why     {why}\n", "");
        }
    }
    text + &format!(
        "\n{} of {} statements: {}\n",
        rows.iter().filter(|r| r.finding.is_some()).count(),
        rows.len(),
        count_in_words(&rows)
    )
}

#[cfg(test)]
mod tests;
