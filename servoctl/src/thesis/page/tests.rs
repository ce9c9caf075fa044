use super::*;
use crate::thesis::run::{Nobody, Observer, Request, Size, run};
use std::sync::LazyLock;
use std::sync::atomic::AtomicBool;

/// Everything, with one move per configuration.
static TINY: LazyLock<Computed> = LazyLock::new(|| run(Request::new(Size::Moves(1), 1), &Nobody).unwrap());

/// Ended before it began.
fn ended() -> Computed {
    static STOP: AtomicBool = AtomicBool::new(true);
    struct Ended;
    impl Observer for Ended {
        fn begin(&self, _: &str, _: u64, _: &str) -> Box<dyn Fn(u64) + Sync> {
            Box::new(|_| ())
        }
        fn stop(&self) -> &AtomicBool {
            &STOP
        }
    }
    run(Request::new(Size::Moves(1), 1), &Ended).unwrap()
}

/// HTML written by maud is XML but for the doctype and the void element `meta`.
fn parsed(page: &str) -> String {
    let body = page.strip_prefix("<!DOCTYPE html>").unwrap();
    let mut parts = body.split("<meta");
    let first = parts.next().unwrap().to_owned();
    parts.fold(first, |all, part| all + "<meta" + &part.replacen('>', "/>", 1))
}

/// Text as it stands in HTML.
fn escaped(text: &str) -> String {
    crate::typeset::typeset(text).into_string()
}

#[test]
fn every_target_is_there_with_both_numbers() {
    let page = render(&TINY);
    let found: Vec<&Finding> = TINY.sections.iter().flat_map(|section| &section.findings).collect();
    for target in Target::ALL {
        let printed = target.printed();
        let findings: Vec<_> = found.iter().filter(|finding| finding.target == target).collect();
        assert_eq!(findings.len(), 1, "{}", printed.quantity);
        assert!(
            !findings[0].ours.is_empty() && findings[0].verdict.outcome != Outcome::NotComputed,
            "{}",
            printed.quantity
        );
        for text in [printed.thesis, &findings[0].ours] {
            // At a glance, and in its section.
            assert!(page.matches(&escaped(text)).count() >= 2, "{text}");
        }
    }
}

#[test]
fn every_figure_and_table_of_the_thesis_is_there_or_is_a_drawing() {
    let lost = index(&TINY.sections).into_iter().filter(|entry| entry.place == Err("not computed in this run".into()));
    let lost: Vec<String> = lost.map(|entry| entry.name).collect();
    assert_eq!(lost, [""; 0]);
}

#[test]
fn the_page_is_well_formed_and_needs_nothing_from_elsewhere() {
    let page = render(&TINY);
    roxmltree::Document::parse(&parsed(&page)).unwrap();
    let own = page.replace("http://www.w3.org/2000/svg", "");
    for foreign in ["http:", "https:", "<script", "<link", "@import", "url(", "src="] {
        assert!(!own.contains(foreign), "{foreign} in the page");
    }
}

#[test]
fn every_link_leads_somewhere() {
    let page = render(&TINY);
    for target in page.split("href=\"#").skip(1).filter_map(|rest| rest.split('"').next()) {
        assert!(page.contains(&format!("<section id=\"{target}\">")), "{target}");
    }
}

#[test]
fn every_settling_result_stands_under_its_conditions_which_are_said_once() {
    let settling = |section: &&crate::thesis::section::Section| {
        ["4 ", "8.1, 11", "9."].iter().any(|n| section.title.starts_with(n))
    };
    let mut sections = 0;
    for section in TINY.sections.iter().filter(settling) {
        let Some(Block::Facts(facts)) = section.blocks.first() else {
            panic!("{}: {:?}", section.title, section.blocks.first())
        };
        let names: Vec<&str> = facts.iter().map(|fact| fact.0.as_str()).collect();
        assert_eq!(names, ["Origin", "Step", "Tuning", "Plant", "Moves"], "{}", section.title);
        assert!(facts[0].1.starts_with("simulated") && facts[3].1.contains("F_C"), "{facts:?}");
        for block in &section.blocks {
            if let Block::Figure { caption, .. } | Block::Table(crate::table::Table { caption, .. }) = block {
                assert!(!caption.contains("plant") && !caption.contains("simulated"), "{}: {caption}", section.title);
            }
        }
        sections += 1;
    }
    assert_eq!(sections, 7);
}

#[test]
fn ended_before_it_began_it_says_what_is_missing() {
    let computed = ended();
    let page = render(&computed);
    roxmltree::Document::parse(&parsed(&page)).unwrap();
    assert!(page.contains("Missing: 9.1 first experiment: the run was ended before."));
    assert!(computed.sections.is_empty() && page.contains("not computed"));
    for printed in Target::ALL.map(Target::printed) {
        assert!(page.contains(&escaped(printed.thesis)), "{}", printed.thesis);
    }
    assert!(text(&computed).ends_with(&format!("0 of {0} statements: {0} not computed\n", Target::ALL.len())));
}

#[test]
fn json_has_a_row_for_every_target_and_the_experiments() {
    let value = serde_json::to_value(json(&TINY)).unwrap();
    let rows = value["rows"].as_array().unwrap();
    assert_eq!(rows.len(), Target::ALL.len());
    assert!(rows.iter().all(|row| row["thesis"].is_string() && row["ours"].is_string()));
    assert_eq!(value["experiments"]["exp1"]["moves"], 1);
    assert_eq!(value["complete"], true);
}
