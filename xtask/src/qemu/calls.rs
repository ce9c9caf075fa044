//! What the plug-in wrote: every call of a counted function, in order.

use std::collections::BTreeMap;

use anyhow::{Context, Result, bail, ensure};

use serde_json::{Value, json};

use super::image::Image;

/// Functions of this prefix say what kind of tick the calls before them belong to.
const CLASS: &str = "class_";

/// Functions of this prefix check the counting itself.
const CALIBRATION: &str = "calibrate_";

/// The kind of tick that is meant where none is named.
const USUAL: &str = "on";

/// One call.
#[derive(Debug, PartialEq)]
pub struct Call {
    /// The function.
    pub function: String,
    /// Instructions executed from its entry to its return.
    pub instructions: u64,
}

/// Reads the plug-in's file.
///
/// # Errors
/// When it is cut off, a call did not return, or a line is not what the plug-in writes.
pub fn parse(log: &str) -> Result<Vec<Call>> {
    let mut calls = Vec::new();
    let mut lines = log.lines();
    for line in &mut lines {
        match line.split_once(' ') {
            Some(("open", function)) => bail!("a call of {function} did not return"),
            Some((function, count)) => {
                let instructions = count.parse().with_context(|| format!("not a count: {line:?}"))?;
                calls.push(Call { function: function.to_string(), instructions });
            }
            None if line == "end" => {
                ensure!(lines.next().is_none(), "lines after the end");
                return Ok(calls);
            }
            None => bail!("not a count: {line:?}"),
        }
    }
    bail!("cut off after {} calls", calls.len())
}

/// Whether the counts of known code are right, in images that have such code: a function without branches takes as many
/// instructions as it has, and a loop takes the same whole number more for each pass.
///
/// # Errors
/// When they are not.
pub fn check_calibration(calls: &[Call], image: &Image) -> Result<()> {
    let counts = |name: &str| -> Vec<u64> {
        calls.iter().filter(|call| call.function == name).map(|call| call.instructions).collect()
    };
    let Some(straight) = image.region("calibrate_straight") else { return Ok(()) };
    ensure!(
        counts(&straight.name) == [straight.instructions],
        "calibration: a function of {} instructions without branches counts as {:?}",
        straight.instructions,
        counts(&straight.name)
    );
    // 1,000, 2,000 and 4,000 passes.
    let passes = counts("calibrate_loop");
    let [a, b, c] = passes[..] else { bail!("calibration: {} loops instead of 3", passes.len()) };
    let per_pass = b.saturating_sub(a) / 1_000;
    ensure!(
        per_pass > 0 && b == a + 1_000 * per_pass && c == b + 2_000 * per_pass,
        "calibration: loops of 1,000, 2,000 and 4,000 passes count as {passes:?}"
    );
    Ok(())
}

/// Counts of each function, by kind of tick: `function` for ticks in which the drive only controls, `function/kind` for others.
#[derive(Debug, Default)]
pub struct Counts(BTreeMap<String, Count>);

/// Counts of one function.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Count {
    /// Number of calls.
    pub calls: u64,
    /// Fewest instructions.
    pub min: u64,
    /// Most instructions.
    pub max: u64,
    sum: u64,
}

impl Count {
    /// Instructions per call.
    pub fn mean(&self) -> f64 {
        self.sum as f64 / self.calls as f64
    }

    /// Most minus fewest.
    pub fn spread(&self) -> u64 {
        self.max - self.min
    }

    fn with(self, instructions: u64) -> Count {
        Count {
            calls: self.calls + 1,
            min: self.min.min(instructions),
            max: self.max.max(instructions),
            sum: self.sum + instructions,
        }
    }
}

impl Counts {
    /// Takes in the calls of one image. Calls before the first tick are not counted.
    pub fn add(&mut self, calls: &[Call]) {
        let mut tick: Vec<&Call> = Vec::new();
        for call in calls.iter().filter(|call| !call.function.starts_with(CALIBRATION)) {
            let Some(class) = call.function.strip_prefix(CLASS) else {
                tick.push(call);
                continue;
            };
            for Call { function, instructions } in tick.drain(..) {
                let key = if class == USUAL { function.clone() } else { format!("{function}/{class}") };
                let none = Count { calls: 0, min: u64::MAX, max: 0, sum: 0 };
                let count = self.0.entry(key).or_insert(none);
                *count = count.with(*instructions);
            }
        }
    }

    /// All counts, by `function` or `function/kind`.
    pub fn to_json(&self) -> Value {
        let one = |(name, count): (&String, &Count)| {
            let value = json!({
                "calls": count.calls,
                "min_instructions": count.min,
                "mean_instructions": count.mean(),
                "max_instructions": count.max,
            });
            (name.clone(), value)
        };
        Value::Object(self.0.iter().map(one).collect())
    }

    /// Counts of `function` or `function/kind`.
    ///
    /// # Errors
    /// When there was no such call.
    pub fn get(&self, key: &str) -> Result<Count> {
        self.0.get(key).copied().with_context(|| {
            let known: Vec<_> = self.0.keys().map(String::as_str).collect();
            format!("nothing was counted as {key}; there are {}", known.join(", "))
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::qemu::image::Region;

    const LOG: &str = "a 10\nb 5\nb 6\nclass_on 8\na 20\nb 9\nclass_off 8\na 12\nclass_on 8\nend\n";

    #[test]
    fn calls_are_counted_by_kind_of_tick() {
        let mut counts = Counts::default();
        counts.add(&parse(LOG).unwrap());
        let a = counts.get("a").unwrap();
        assert_eq!((a.calls, a.min, a.max, a.spread(), a.mean()), (2, 10, 12, 2, 11.0));
        let off = counts.get("b/off").unwrap();
        assert_eq!((off.calls, off.min, off.max), (1, 9, 9));
        let as_json = json!({"calls": 2, "min_instructions": 10, "mean_instructions": 11.0, "max_instructions": 12});
        assert_eq!(counts.to_json()["a"], as_json);
        let missing = counts.get("c").unwrap_err().to_string();
        assert_eq!(missing, "nothing was counted as c; there are a, a/off, b, b/off");
    }

    #[test]
    fn an_incomplete_log_is_refused() {
        let cases = [
            ("", "cut off after 0 calls"),
            ("a 10\n", "cut off after 1 calls"),
            ("a 10\nopen b\nend\n", "a call of b did not return"),
            ("a ten\nend\n", "not a count: \"a ten\""),
            ("end\na 10\n", "lines after the end"),
        ];
        for (log, expected) in cases {
            assert_eq!(parse(log).unwrap_err().to_string(), expected, "{log:?}");
        }
    }

    #[test]
    fn wrong_counting_is_noticed() {
        let straight = Region { name: "calibrate_straight".to_string(), address: 0, instructions: 15 };
        let image = Image { name: String::new(), path: Default::default(), regions: vec![straight] };
        let check = |straight, loops: [u64; 3]| {
            let loops = loops.map(|count| format!("calibrate_loop {count}\n")).concat();
            check_calibration(&parse(&format!("calibrate_straight {straight}\n{loops}end\n")).unwrap(), &image)
        };
        assert!(check(15, [4_011, 8_011, 16_011]).is_ok());
        assert!(check(16, [4_011, 8_011, 16_011]).is_err());
        assert!(check(15, [4_011, 8_012, 16_013]).is_err());
        assert!(check(15, [4_011, 4_011, 4_011]).is_err());
    }
}
