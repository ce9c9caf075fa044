//! Fingerprints of a run: of everything that went in and everything that came out.

use core::fmt;

use servo_core::axis::ServoOutput;
use servo_core::current::Bridge;
use servo_core::drive::Outcome;
use servo_core::fingerprint::Fingerprint;
use servo_core::refusal::Refusal;

use crate::recording::TICK_BYTES;

/// Two fingerprints, so that a difference says on which side it began.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Digest {
    /// Of the recording: changes with the simulated stage as well.
    pub inputs: Fingerprint,
    /// Of records, compare values, answers and captured samples.
    pub outputs: Fingerprint,
}

impl Digest {
    /// Takes in a tick of the recording.
    pub fn input(&mut self, bytes: &[u8; TICK_BYTES]) {
        for word in bytes.as_chunks().0 {
            self.inputs = self.inputs.with_words(&[u32::from_le_bytes(*word)]);
        }
    }

    /// Takes in what a servo period gave.
    pub fn servo(&mut self, output: &ServoOutput) {
        self.outputs = self.outputs.with_words(&output.record.words());
        self.period(output.bridge);
        if let Some(outcome) = &output.outcome {
            self.outcome(outcome);
        }
        if let Some(sample) = &output.sample {
            self.outputs = self.outputs.with_words(&[sample.at]).with_words(&sample.words);
        }
    }

    /// Takes in what any other period gave.
    pub fn period(&mut self, bridge: Bridge) {
        let [a, b, c] = bridge.compare.map(u32::from);
        self.outputs = self.outputs.with_words(&[a, b, c, u32::from(bridge.enabled)]);
    }

    fn outcome(&mut self, outcome: &Outcome) {
        self.outputs = self.outputs.with_words(&[u32::from(outcome.is_ok())]);
        if let Err(Refusal::OutOfRange { value, min, max, .. }) = outcome {
            for bits in [value, min, max].map(|x| x.to_bits()) {
                self.outputs = self.outputs.with_words(&[bits as u32, (bits >> 32) as u32]);
            }
        }
    }
}

/// The text of `golden.txt`.
impl fmt::Display for Digest {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "inputs  {:016x}", self.inputs.0)?;
        writeln!(f, "outputs {:016x}", self.outputs.0)
    }
}
