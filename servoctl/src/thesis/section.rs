//! A section of the page: what the thesis says, what we found, and the pictures of it.

use super::targets::Target;
use super::verdict::{Check, Verdict, judge};
use crate::plot::Plot;
use crate::report::Block;
use crate::table::Table;

/// Our side of a target.
#[derive(Debug, Clone, PartialEq)]
pub struct Finding {
    /// What it answers.
    pub target: Target,
    /// Our numbers, in the units of the thesis.
    pub ours: String,
    /// How the two compare.
    pub verdict: Verdict,
}

/// Something numbered in the thesis.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Shown {
    /// A figure.
    Figure(u8),
    /// A table.
    Table(u8),
}

/// One section, as plain data.
#[derive(Debug, Clone, PartialEq)]
pub struct Section {
    /// Title, beginning with the thesis' section number.
    pub title: String,
    /// Comparisons with the thesis, shown first.
    pub findings: Vec<Finding>,
    /// Text, figures and tables, in their order.
    pub blocks: Vec<Block>,
    /// Figures and tables of the thesis that have their counterpart here.
    pub shows: Vec<Shown>,
}

impl Section {
    /// A section without content.
    pub fn new(title: impl Into<String>) -> Section {
        Section { title: title.into(), findings: Vec::new(), blocks: Vec::new(), shows: Vec::new() }
    }

    /// Adds a comparison, judged by its checks.
    #[must_use]
    pub fn finding(self, target: Target, ours: impl Into<String>, checks: &[Check]) -> Section {
        self.judged(target, ours, judge(checks))
    }

    /// Adds a comparison with a verdict that is more than its checks.
    #[must_use]
    pub fn judged(mut self, target: Target, ours: impl Into<String>, verdict: Verdict) -> Section {
        self.findings.push(Finding { target, ours: ours.into(), verdict });
        self
    }

    /// Adds the conditions of everything that follows in the section, by name: captions do not repeat them.
    #[must_use]
    pub fn conditions<V: Into<String>>(mut self, conditions: impl IntoIterator<Item = (&'static str, V)>) -> Section {
        let named = conditions.into_iter().map(|(name, value)| (name.to_owned(), value.into()));
        self.blocks.push(Block::Facts(named.collect()));
        self
    }

    /// Adds a paragraph.
    #[must_use]
    pub fn text(mut self, text: impl Into<String>) -> Section {
        self.blocks.push(Block::Paragraph(text.into()));
        self
    }

    /// Adds the counterpart of figures of the thesis; the caption begins with their numbers. With no number, a figure of ours.
    #[must_use]
    pub fn figure(mut self, numbers: &[u8], panels: impl Into<Vec<Plot>>, caption: impl Into<String>) -> Section {
        self.shows.extend(numbers.iter().map(|n| Shown::Figure(*n)));
        let caption = captioned("figure", numbers, caption.into());
        self.blocks.push(Block::Figure { panels: panels.into(), caption });
        self
    }

    /// Adds a table, the counterpart of tables of the thesis or, with no number, of ours.
    #[must_use]
    pub fn table(mut self, numbers: &[u8], mut table: Table) -> Section {
        self.shows.extend(numbers.iter().map(|n| Shown::Table(*n)));
        table.caption = captioned("table", numbers, table.caption);
        self.blocks.push(Block::Table(table));
        self
    }
}

/// A caption behind `Thesis figures 63 and 64: `; without numbers the caption itself, with a capital.
fn captioned(kind: &str, numbers: &[u8], caption: String) -> String {
    let plural = if numbers.len() > 1 { "s" } else { "" };
    if !numbers.is_empty() {
        return format!("Thesis {kind}{plural} {}: {caption}", enumerate(numbers));
    }
    // A letter with an index is a symbol, not the beginning of a word.
    let mut rest = caption.chars();
    match rest.next() {
        Some(first) if rest.as_str().starts_with(char::is_lowercase) => first.to_uppercase().chain(rest).collect(),
        _ => caption,
    }
}

/// Numbers in words: `3`, `63 and 64`, `45 to 54`, `2, 4 and 9`.
pub fn enumerate(numbers: &[u8]) -> String {
    match numbers {
        [] => String::new(),
        [one] => one.to_string(),
        [first, .., last] if numbers.len() > 2 && numbers.windows(2).all(|w| w[1] == w[0] + 1) => {
            format!("{first} to {last}")
        }
        [before @ .., last] => {
            format!("{} and {last}", before.iter().map(u8::to_string).collect::<Vec<_>>().join(", "))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_listed_as_a_person_would() {
        assert_eq!(enumerate(&[3]), "3");
        assert_eq!(enumerate(&[63, 64]), "63 and 64");
        assert_eq!(enumerate(&[45, 46, 47]), "45 to 47");
        assert_eq!(enumerate(&[2, 4, 9]), "2, 4 and 9");
    }

    #[test]
    fn a_caption_begins_with_the_thesis_number() {
        let section = Section::new("x").table(&[3], Table::new("noise", &[])).figure(&[], [], "ours");
        assert_eq!(section.shows, [Shown::Table(3)]);
        assert!(matches!(&section.blocks[0], Block::Table(t) if t.caption == "Thesis table 3: noise"));
        assert!(matches!(&section.blocks[1], Block::Figure { caption, .. } if caption == "Ours"));
        assert_eq!(captioned("table", &[], "σ and F_C".into()), "σ and F_C");
    }
}
