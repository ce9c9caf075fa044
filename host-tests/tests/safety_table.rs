//! The table of `SAFETY.md` names every fault, and only tests that exist.

use std::collections::BTreeSet;
use std::path::Path;

use servo_core::fault::Fault;

/// A row: numbers of the faults, and what it says of tests on the host and on the emulated board.
struct Row {
    numbers: Vec<u16>,
    tests: [String; 2],
}

fn workspace(path: &str) -> std::path::PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..").join(path)
}

fn rows() -> Vec<Row> {
    let text = std::fs::read_to_string(workspace("SAFETY.md")).unwrap();
    text.lines()
        .filter_map(|line| {
            let cells: Vec<&str> = line.strip_prefix('|')?.split('|').map(str::trim).collect();
            let [numbers, _, _, host, board, _] = cells[..] else { return None };
            let numbers: Vec<u16> = numbers.split(", ").map(str::parse).collect::<Result<_, _>>().ok()?;
            Some(Row { numbers, tests: [host.to_owned(), board.to_owned()] })
        })
        .collect()
}

/// The words between backticks: files, each followed by the beginnings of tests in it.
fn named(cell: &str) -> Vec<(String, String)> {
    let mut file = "";
    let mut tests = Vec::new();
    for word in cell.split('`').skip(1).step_by(2) {
        if word.ends_with(".rs") {
            file = word;
        } else {
            tests.push((file.to_owned(), word.trim_end_matches('…').to_owned()));
        }
    }
    tests
}

#[test]
fn every_fault_is_in_the_table_once() {
    let rows = rows();
    let numbers: Vec<u16> = rows.iter().flat_map(|row| row.numbers.clone()).collect();
    let expected: BTreeSet<u16> = Fault::ALL.iter().map(|fault| fault.number()).collect();
    assert_eq!(numbers.len(), expected.len());
    assert_eq!(numbers.into_iter().collect::<BTreeSet<_>>(), expected);
}

#[test]
fn every_test_in_the_table_exists_and_what_has_none_says_why() {
    for row in rows() {
        for (cell, directory) in row.tests.iter().zip(["host-tests/tests", "virtual-board/tests"]) {
            let tests = named(cell);
            let excused = directory.starts_with("virtual") && cell.starts_with("none: ");
            assert!(excused || !tests.is_empty(), "{:?}: {cell}", row.numbers);
            for (file, test) in tests {
                let path = workspace(directory).join(&file);
                let source = std::fs::read_to_string(&path).unwrap_or_else(|error| panic!("{file}: {error}"));
                assert!(source.contains(&format!("#[test]\nfn {test}")), "{:?}: {file} {test}", row.numbers);
            }
        }
    }
}
