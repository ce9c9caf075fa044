//! Every input that the fuzzer found worth keeping, and every hand-made one, with any compiler.

use std::path::Path;

use servo_fuzz::TARGETS;

#[test]
fn the_corpus_and_the_seeds_pass() {
    for target in TARGETS {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("corpus").join(target.name);
        let mut files: Vec<_> = std::fs::read_dir(&folder).unwrap().map(|entry| entry.unwrap().path()).collect();
        files.sort();
        assert!(files.len() >= 5, "{}: only {} inputs", target.name, files.len());
        for file in files {
            // A panic names the test only: say first which input it was.
            println!("{}", file.display());
            (target.check)(&std::fs::read(&file).unwrap());
        }
        (target.seeds)().iter().for_each(|seed| (target.check)(seed));
    }
}

#[test]
fn short_inputs_pass() {
    for target in TARGETS {
        (target.check)(&[]);
        for byte in 0..=255 {
            (target.check)(&[byte]);
            (target.check)(&[byte; 8]);
            (target.check)(&[byte; 70]);
        }
    }
}
