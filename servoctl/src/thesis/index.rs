//! Figures and tables of the thesis in their order, and where their counterparts are.

use super::section::{Section, Shown, enumerate};

/// Number of figures in the thesis.
pub const FIGURES: u8 = 83;
/// Number of tables in the thesis.
pub const TABLES: u8 = 4;

/// What nothing can be computed for: figure and what it is.
const DRAWN: [(u8, &str); 4] = [
    (12, "a photograph of the stage"),
    (13, "a block diagram of feedforward compensation"),
    (14, "a block diagram of a friction observer"),
    (55, "a block diagram of NIASA"),
];

/// One line: neighbouring figures with the same fate.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Entry {
    /// For example `Figures 63 to 67`.
    pub name: String,
    /// Index of the section, or what it is instead.
    pub place: Result<usize, String>,
}

/// Where everything is, in the order of the thesis.
pub fn index(sections: &[Section]) -> Vec<Entry> {
    let place = |shown: Shown| {
        let drawn = DRAWN.iter().find(|(n, _)| shown == Shown::Figure(*n)).map(|d| d.1.to_owned());
        let found = sections.iter().position(|section| section.shows.contains(&shown));
        found.ok_or(drawn.unwrap_or("not computed in this run".to_owned()))
    };
    let mut entries = Vec::new();
    for (kind, count, shown) in
        [("Figure", FIGURES, Shown::Figure as fn(u8) -> Shown), ("Table", TABLES, Shown::Table as fn(u8) -> Shown)]
    {
        let numbers: Vec<u8> = (1..=count).collect();
        for run in numbers.chunk_by(|a, b| place(shown(*a)) == place(shown(*b))) {
            let plural = if run.len() > 1 { "s" } else { "" };
            entries.push(Entry { name: format!("{kind}{plural} {}", enumerate(run)), place: place(shown(run[0])) });
        }
    }
    entries
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn neighbours_in_one_section_share_a_line() {
        let mut section = Section::new("maps");
        section.shows = (34..=44).map(Shown::Figure).chain([Shown::Table(3)]).collect();
        let index = index(&[section]);
        let entry = |name: &str| index.iter().find(|e| e.name == name).map(|e| e.place.clone());
        assert_eq!(entry("Figures 34 to 44"), Some(Ok(0)));
        assert_eq!(entry("Table 3"), Some(Ok(0)));
        assert_eq!(entry("Figures 1 to 11"), Some(Err("not computed in this run".into())));
        assert_eq!(entry("Figure 12"), Some(Err("a photograph of the stage".into())));
    }
}
