//! Campaigns: the same numbers for any number of threads and parts; what is left of one that was ended.

use std::io::{BufRead, BufReader};
use std::process::{Command, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};

use servo_sim::Stage;
use servoctl::reproduce::campaign::{Passes, Shard, Watch};
use servoctl::reproduce::experiments::{Experiment, Plan, Request};
use servoctl::reproduce::outcome::Outcome;
use servoctl::reproduce::shard::{MergeError, ShardFile, merge};

/// Three passes, the last of them of three moves.
fn plan() -> Plan {
    let mass_errors_percent = vec![1.0];
    Request { experiment: Experiment::Exp2, moves: 23, seed: 7, mass_errors_percent, stage: Stage::default() }
        .plan()
        .unwrap()
}

fn part(plan: &Plan, number: u64, of: u64) -> (String, ShardFile) {
    let shard = Shard { number, of };
    let file = ShardFile::new(plan, shard, plan.campaign.run(shard, Watch::NOBODY).unwrap());
    assert!(file.complete);
    // As a file has it.
    (format!("part {number}"), serde_json::from_str(&serde_json::to_string(&file).unwrap()).unwrap())
}

fn json(plan: &Plan, passes: &Passes) -> String {
    serde_json::to_string(&Outcome::new(plan, passes)).unwrap()
}

#[test]
fn threads_and_parts_do_not_show_in_the_result() {
    let plan = plan();
    let whole = plan.campaign.run(Shard::ALL, Watch::NOBODY).unwrap();
    assert_eq!(whole.values().map(|cases| cases[0].len()).collect::<Vec<_>>(), [10, 10, 3]);
    for threads in [1, 3] {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let same = pool.install(|| plan.campaign.run(Shard::ALL, Watch::NOBODY)).unwrap();
        assert_eq!(same, whole, "{threads} threads");
    }
    // In any order.
    let (request, _, joined) = merge(vec![part(&plan, 2, 2), part(&plan, 1, 2)]).unwrap();
    assert_eq!(request, plan.request);
    assert_eq!(json(&request.plan().unwrap(), &joined), json(&plan, &whole));
    assert!(json(&plan, &whole).contains(r#""complete":true"#));
}

#[test]
fn each_of_several_comparisons_says_in_json_what_it_is_a_part_of() {
    let plan = Request { moves: 1, mass_errors_percent: vec![-1.0, 1.0], ..plan().request }.plan().unwrap();
    let passes = plan.campaign.run(Shard::ALL, Watch::NOBODY).unwrap();
    let whole = serde_json::to_value(Outcome::new(&plan, &passes)).unwrap();
    let runs = whole["runs"].as_array().unwrap();
    assert_eq!(runs.len(), 2);
    for run in runs {
        for key in ["experiment", "thesis_section", "origin", "seed", "moves_requested", "complete"] {
            assert!(!run[key].is_null() && run[key] == whole[key], "{key}");
        }
        assert!(run["configs"].is_array() && run["reduction_percent"].is_array() && run["plant"].is_object());
    }
}

#[test]
fn parts_that_do_not_make_a_whole_are_refused() {
    let plan = plan();
    let parts = [part(&plan, 1, 2), part(&plan, 2, 2)];
    let refusal = |files: &[&(String, ShardFile)]| merge(files.iter().map(|f| (*f).clone()).collect()).unwrap_err();

    assert_eq!(refusal(&[]), MergeError::Nothing);
    assert_eq!(refusal(&[&parts[0]]), MergeError::Missing { count: 1, of: 3, first: 1, shard: 2, parts: 2 });
    assert_eq!(refusal(&[&parts[0], &parts[0]]), MergeError::Twice { file: "part 1".into(), pass: 0 });
    let mut other = parts[1].clone();
    other.1.request.seed = 8;
    assert!(matches!(refusal(&[&parts[0], &other]), MergeError::Different { .. }));
    let mut older = parts[1].clone();
    older.1.cases = "0".into();
    assert!(matches!(refusal(&[&parts[0], &older]), MergeError::Different { .. }));
    let mut foreign = parts[1].clone();
    foreign.1.format = "something else".into();
    assert!(matches!(refusal(&[&parts[0], &foreign]), MergeError::Format { .. }));
}

#[test]
fn ended_early_it_keeps_the_passes_that_every_configuration_has_finished() {
    let plan = plan();
    let stop = AtomicBool::new(false);
    // On one thread the cases of a pass come one after the other: the fourth of nine is the first of the second pass.
    let done = std::sync::atomic::AtomicUsize::new(0);
    let finished = |_| stop.store(done.fetch_add(1, Ordering::Relaxed) + 1 >= 4, Ordering::Relaxed);
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    let watch = Watch { stop: &stop, finished: &finished };
    let passes = pool.install(|| plan.campaign.run(Shard::ALL, watch)).unwrap();
    assert_eq!(passes.keys().copied().collect::<Vec<_>>(), [0]);
    let outcome = Outcome::new(&plan, &passes);
    assert!(!outcome.complete && outcome.runs[0].settling.moves == 10);
    assert!(outcome.to_text().contains("Not complete: 10 of 23 moves"));
}

/// What is finished is written all the same.
#[cfg(unix)]
#[test]
fn a_computation_that_ctrl_c_ended_is_no_success_for_a_batch_system() {
    let directory = tempfile::tempdir().unwrap();
    let (json, page) = (directory.path().join("found.json"), directory.path().join("thesis.html"));
    for words in [&["reproduce", "all", "--moves", "1"][..], &["report", "--moves", "1", "--output"]] {
        let mut command = Command::new(env!("CARGO_BIN_EXE_servoctl"));
        command.args(words).args((words[0] == "report").then_some(&page)).arg("--json").arg(&json);
        let mut child = command.stdout(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap();
        let mut said = BufReader::new(child.stderr.take().unwrap());
        // Whoever begins to say what it does listens for Ctrl-C.
        assert!(said.read_line(&mut String::new()).unwrap() > 0);
        assert!(Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap().success());
        let rest = said.lines().map(Result::unwrap).collect::<Vec<_>>().join("\n");
        assert_eq!(child.wait().unwrap().code(), Some(130), "{words:?}: {rest}");
        let found: serde_json::Value = serde_json::from_slice(&std::fs::read(&json).unwrap()).unwrap();
        assert_eq!(found["complete"], false, "{words:?}: {found}");
    }
    assert!(page.exists());
}

#[test]
fn a_shard_is_written_as_i_of_n() {
    assert_eq!("2/8".parse(), Ok(Shard { number: 2, of: 8 }));
    for wrong in ["", "2", "0/8", "9/8", "1/0", "a/b", "-1/2", "1/2/3"] {
        assert!(wrong.parse::<Shard>().is_err(), "{wrong}");
    }
}

#[test]
fn named_configurations_are_compared_with_the_baseline_and_nothing_else_is_computed() {
    let names = |plan: &Plan, cases: &[usize]| -> Vec<String> {
        cases.iter().map(|case| plan.campaign.cases[*case].name.clone()).collect()
    };
    let both = Request { mass_errors_percent: vec![-1.0, 1.0], ..plan().request }.plan().unwrap();
    let only = both.clone().only(&["pid+niasa-7.55".into()]).unwrap();
    assert_eq!((both.campaign.cases.len(), only.campaign.cases.len()), (6, 4));
    for (comparison, whole) in only.comparisons.iter().zip(&both.comparisons) {
        assert_eq!(names(&only, &comparison.cases), ["pid", "pid+niasa-7.55"]);
        assert_eq!(only.campaign.cases[comparison.cases[1]], both.campaign.cases[whole.cases[2]]);
    }
    let unknown = both.only(&["pid+nisa".into()]).unwrap_err();
    assert_eq!(unknown, "configs: pid+nisa is not one of pid, pid+niasa, pid+niasa-7.55");
}
