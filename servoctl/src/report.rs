//! One self-contained HTML page: sections of text, facts, figures and tables, with a contents list.
//!
//! No scripts, no fonts or pictures from elsewhere. Everything given as text is escaped; figures are drawn here from
//! their data, so nothing foreign gets into the page unescaped.

use crate::plot::{self, Plot};
use crate::table::Table;
use crate::typeset::typeset;
use maud::{DOCTYPE, Markup, PreEscaped, html};

const STYLE: &str = include_str!("report/style.css");

/// Columns from which on a table is set smaller, so that all of them are seen at once where there is room.
const DENSE: usize = 8;

/// A page in the making. Content goes to the section opened last; content before the first section stands under the summary.
#[derive(Debug, Clone, PartialEq)]
pub struct Report {
    title: String,
    summary: String,
    sections: Vec<Section>,
}

#[derive(Debug, Clone, PartialEq)]
struct Section {
    title: String,
    blocks: Vec<Block>,
}

/// One piece of content.
#[derive(Debug, Clone, PartialEq)]
pub enum Block {
    /// A paragraph.
    Paragraph(String),
    /// Names with their values.
    Facts(Vec<(String, String)>),
    /// Lines as a program wrote them.
    List(Vec<String>),
    /// A numbered figure of one or more panels.
    Figure {
        /// They stand side by side where there is room, below each other on a phone.
        panels: Vec<Plot>,
        /// What is seen, and under which conditions.
        caption: String,
    },
    /// A numbered table.
    Table(Table),
    /// Statements of somebody else beside ours; cards on a phone.
    Statements(Vec<Statement>),
    /// Lines, each of which may lead to a section.
    Links(Vec<Link>),
}

/// A statement of somebody else, what was found, and what is to be thought of it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Statement {
    /// Where it is stated.
    pub place: String,
    /// Number of the section of the page that it leads to, counted from 0; `None` for no link.
    pub section: Option<usize>,
    /// What it is about.
    pub quantity: String,
    /// What was stated.
    pub stated: String,
    /// What was found.
    pub found: String,
    /// The verdict in a word or two.
    pub verdict: String,
    /// Its colour.
    pub mark: Mark,
    /// The reason; may be empty.
    pub why: String,
}

/// Colour of a verdict.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Mark {
    /// It holds.
    Good,
    /// It holds in part.
    Fair,
    /// It does not hold.
    Bad,
    /// Nothing is known.
    None,
}

/// A line of an index.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Link {
    /// What is looked up.
    pub name: String,
    /// Where it is.
    pub place: String,
    /// Number of the section that the place is, counted from 0; `None` for no link.
    pub section: Option<usize>,
}

impl Report {
    /// A page with a title and the sentences that say what was found, from what.
    pub fn new(title: impl Into<String>, summary: impl Into<String>) -> Self {
        let opening = Section { title: String::new(), blocks: Vec::new() };
        Self { title: title.into(), summary: summary.into(), sections: vec![opening] }
    }

    /// Opens a section; it appears in the contents list.
    pub fn section(&mut self, title: impl Into<String>) -> &mut Self {
        self.sections.push(Section { title: title.into(), blocks: Vec::new() });
        self
    }

    /// Adds a paragraph.
    pub fn paragraph(&mut self, text: impl Into<String>) -> &mut Self {
        self.block(Block::Paragraph(text.into()))
    }

    /// Adds a list of names with their values.
    pub fn facts<N: Into<String>, V: Into<String>>(&mut self, facts: impl IntoIterator<Item = (N, V)>) -> &mut Self {
        self.block(Block::Facts(facts.into_iter().map(|(name, value)| (name.into(), value.into())).collect()))
    }

    /// Adds a list of lines as a program wrote them.
    pub fn list<S: Into<String>>(&mut self, lines: impl IntoIterator<Item = S>) -> &mut Self {
        self.block(Block::List(lines.into_iter().map(Into::into).collect()))
    }

    /// Adds a numbered figure; its panels stand side by side where there is room, below each other on a phone.
    pub fn figure(&mut self, panels: impl Into<Vec<Plot>>, caption: impl Into<String>) -> &mut Self {
        self.block(Block::Figure { panels: panels.into(), caption: caption.into() })
    }

    /// Adds a numbered table.
    pub fn table(&mut self, table: Table) -> &mut Self {
        self.block(Block::Table(table))
    }

    /// The page. The same content gives the same bytes.
    pub fn render(&self) -> String {
        let mut numbers = Numbers::default();
        let titled: Vec<(String, &Section)> =
            self.sections.iter().skip(1).enumerate().map(|(i, s)| (anchor(i), s)).collect();
        html! {
            (DOCTYPE)
            html lang="en" {
                head {
                    meta charset="utf-8";
                    meta name="viewport" content="width=device-width, initial-scale=1";
                    meta name="color-scheme" content="light dark";
                    title { (self.title) }
                    style { (PreEscaped(plot::STYLE)) (PreEscaped(STYLE)) }
                }
                body {
                    header {
                        h1 { (self.title) }
                        p.summary { (typeset(&self.summary)) }
                    }
                    @if titled.len() > 1 {
                        nav aria-label="Contents" {
                            ul { @for (id, section) in &titled { li { a href={ "#" (id) } { (section.title) } } } }
                        }
                    }
                    main {
                        @for block in self.sections.iter().take(1).flat_map(|s| &s.blocks) { (numbers.block(block)) }
                        @for (id, section) in &titled {
                            section id=(id) {
                                h2 { (section.title) }
                                @for block in &section.blocks { (numbers.block(block)) }
                            }
                        }
                    }
                }
            }
        }
        .into_string()
    }

    /// Adds any piece of content.
    pub fn block(&mut self, block: Block) -> &mut Self {
        if let Some(section) = self.sections.last_mut() {
            section.blocks.push(block);
        }
        self
    }
}

/// Counts figures and tables over the page.
#[derive(Default)]
struct Numbers {
    figures: usize,
    tables: usize,
}

impl Numbers {
    fn block(&mut self, block: &Block) -> Markup {
        match block {
            Block::Paragraph(text) => html! { p { (typeset(text)) } },
            Block::Facts(facts) => {
                html! { dl { @for (name, value) in facts { div { dt { (typeset(name)) } dd { (typeset(value)) } } } } }
            }
            Block::List(lines) => html! { ul.lines-of-text { @for line in lines { li { (line) } } } },
            Block::Figure { panels, caption } => {
                self.figures += 1;
                html! {
                    figure.wide[panels.len() > 1] {
                        div.panels { @for panel in panels { (PreEscaped(panel.svg())) } }
                        figcaption { b { "Figure " (self.figures) "." } " " (typeset(caption)) }
                    }
                }
            }
            Block::Statements(statements) => html_statements(statements),
            Block::Links(links) => {
                html! { dl.links { @for l in links { div { dt { (l.name) } dd { (linked(&l.place, l.section)) } } } } }
            }
            Block::Table(table) => {
                self.tables += 1;
                html! {
                    figure.wide {
                        figcaption { b { "Table " (self.tables) "." } " " (typeset(&table.caption)) }
                        div.scroll { (html_table(table)) }
                    }
                }
            }
        }
    }
}

/// Name of a section, by its number from 0.
fn anchor(section: usize) -> String {
    format!("s{}", section + 1)
}

/// Text that leads to a section, if there is one.
fn linked(text: &str, section: Option<usize>) -> Markup {
    html! { @match section { Some(s) => { a href={ "#" (anchor(s)) } { (text) } }, None => { (text) } } }
}

fn html_statements(statements: &[Statement]) -> Markup {
    html! {
        table.statements {
            thead { tr { @for title in ["", "quantity", "thesis", "here", "verdict"] { th scope="col" { (title) } } } }
            tbody {
                @for s in statements {
                    tr.told[!s.why.is_empty()] {
                        td.place { (linked(&s.place, s.section)) }
                        td.quantity { (typeset(&s.quantity)) }
                        td.stated data-label="thesis" { (typeset(&s.stated)) }
                        td data-label="here" { (typeset(&s.found)) }
                        td { b class=(s.mark.class()) { (s.verdict) } }
                    }
                    @if !s.why.is_empty() { tr.why { td {} td colspan="4" { (typeset(&s.why)) } } }
                }
            }
        }
    }
}

impl Mark {
    fn class(self) -> &'static str {
        match self {
            Mark::Good => "mark good",
            Mark::Fair => "mark fair",
            Mark::Bad => "mark bad",
            Mark::None => "mark none",
        }
    }
}

fn html_table(table: &Table) -> Markup {
    let class = |column: usize| (column >= table.text_columns).then_some("n");
    html! {
        table.dense[table.header.len() >= DENSE] {
            thead { tr { @for (c, title) in table.header.iter().enumerate() { th class=[class(c)] scope="col" { (typeset(title)) } } } }
            tbody {
                @for row in &table.rows {
                    tr { @for c in 0..table.header.len() { td class=[class(c)] { (typeset(table.cell(row, c))) } } }
                }
            }
        }
    }
}

#[cfg(test)]
mod tests;
