use super::*;
use crate::plot::{Axis, Series};

fn page() -> String {
    let mut report = Report::new("Title <1> & \"2\"", "Simulated & summed up.");
    report.paragraph("Before the first section.");
    report.section("First <section>").paragraph("a < b && c > d").facts([("seed & salt", "<1>")]);
    report.figure(
        [Plot::new("p", Axis::linear("x"), Axis::linear("y"))
            .series(Series::new("<svg>", 0).line([(0.0, 0.0), (1.0, 1.0)]))],
        "A caption with <b>tags</b>",
    );
    report.section("Second").list(["<script>alert(1)</script>"]);
    report.table(Table::new("caption & conditions", &["name", "value / <unit>"]).row(["<x>", "1"]).row(["short"]));
    report.table(Table::new("another", &["name"]));
    report.render()
}

#[test]
fn text_is_escaped_everywhere() {
    let page = page();
    for raw in ["<1>", "<section>", "a < b", "<b>tags", "<script", "<unit>", "<x>", "<svg>"] {
        assert!(!page.contains(raw), "{raw} stands unescaped in the page");
    }
    assert!(page.contains("&lt;script&gt;alert(1)&lt;/script&gt;"));
    assert!(page.contains("<title>Title &lt;1&gt; &amp;"));
}

#[test]
fn the_page_needs_nothing_from_elsewhere() {
    let page = page().replace("http://www.w3.org/2000/svg", "");
    for foreign in ["http:", "https:", "<script", "<link", "@import", "url(", "src="] {
        assert!(!page.contains(foreign), "{foreign} in the page");
    }
}

#[test]
fn contents_list_every_section_and_link_to_it() {
    let page = page();
    assert!(page.contains(r##"<a href="#s1">First &lt;section&gt;</a>"##) && page.contains(r#"<section id="s1">"#));
    assert!(page.contains(r##"<a href="#s2">Second</a>"##) && page.contains(r#"<section id="s2">"#));
}

#[test]
fn figures_and_tables_are_numbered_over_the_page() {
    let page = page();
    for label in ["Figure 1.", "Table 1.", "Table 2."] {
        assert_eq!(page.matches(label).count(), 1, "{label}");
    }
}

#[test]
fn a_short_row_is_filled_up() {
    assert!(page().contains(r#"<tr><td>short</td><td class="n"></td></tr>"#));
}

#[test]
fn the_page_is_well_formed() {
    // HTML written by maud is XML but for the doctype, the void `meta` and attributes without a value (there are none).
    let page = page();
    let body = page.strip_prefix("<!DOCTYPE html>").unwrap();
    let closed = body.split("<meta").collect::<Vec<_>>();
    let closed: String = closed
        .iter()
        .enumerate()
        .map(|(i, part)| if i == 0 { (*part).to_owned() } else { format!("<meta{}", part.replacen('>', "/>", 1)) })
        .collect();
    roxmltree::Document::parse(&closed).unwrap();
}

#[test]
fn the_same_content_is_the_same_bytes() {
    assert_eq!(page(), page());
}
