//! The `[encoder]` table of a stage file: which keys belong to which kind.

use serde::{Deserialize, Serialize};

use super::{Limit, Mechanics, Misfit};

/// The position encoder.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Encoder {
    /// One count, m, at most 1e-3; the travel must fit into 2^32 of them. The signal period of sine and cosine is 2^16 of them.
    pub count_m: f64,
    /// White noise of a reading, m rms, 0 to 1e-3; that of converters comes on top.
    pub noise_m_rms: f64,
    /// Age of a reading, s, 0 to 250e-6; 0 if not given. With it, a drive that computes for longer than this one can be had.
    pub latency_s: f64,
    /// How it tells the position.
    pub kind: Kind,
}

/// The kinds of encoder.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Kind {
    /// Absolute, frames on a line.
    BissC {
        /// Zeros between idle and start bit of a frame (the encoder's processing time), 1 to 20.
        acknowledge_bits: u32,
    },
    /// Incremental, sine and cosine of 1 Vpp.
    SinCos(SinCos),
}

/// Sine and cosine at the converters: `cos = cos_offset + cos φ`, `sin = sin_offset + gain·sin(φ + phase)`, both times the amplitude.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct SinCos {
    /// Amplitude of the cosine as a share of half the converter's range, 0.01 to 1.
    pub amplitude: f64,
    /// Offset of the cosine as a share of the amplitude, −0.5 to 0.5; 0 if not given.
    pub cos_offset: f64,
    /// Offset of the sine as a share of the amplitude, −0.5 to 0.5; 0 if not given.
    pub sin_offset: f64,
    /// Amplitude of the sine as a share of that of the cosine, 0.5 to 2; 1 if not given.
    pub gain: f64,
    /// What the sine is ahead of its 90°, rad, −0.5 to 0.5; 0 if not given.
    pub phase_rad: f64,
    /// Half of the comparators' hysteresis, as a share of the signal period, 0 to 0.1; 0 if not given.
    pub hysteresis: f64,
    /// How much later the counter is read than the converters sample, s, −10e-6 to 10e-6; 0 if not given.
    pub counter_late_s: f64,
}

impl Encoder {
    /// Every value with its range.
    pub(super) fn limits(&self, mechanics: &Mechanics) -> Vec<Limit> {
        let finest_count_m = mechanics.travel_m / (u64::from(u32::MAX) - 1) as f64;
        let limit = |key, value, from, to| Limit { key, value, from, to };
        let mut limits = vec![
            limit("encoder.count_m", self.count_m, finest_count_m, 1e-3),
            limit("encoder.noise_m_rms", self.noise_m_rms, 0.0, 1e-3),
            limit("encoder.latency_s", self.latency_s, 0.0, 250e-6),
        ];
        match &self.kind {
            Kind::BissC { acknowledge_bits } => {
                limits.push(limit("encoder.acknowledge_bits", f64::from(*acknowledge_bits), 1.0, 20.0));
            }
            Kind::SinCos(signals) => limits.extend([
                limit("encoder.amplitude", signals.amplitude, 0.01, 1.0),
                limit("encoder.cos_offset", signals.cos_offset, -0.5, 0.5),
                limit("encoder.sin_offset", signals.sin_offset, -0.5, 0.5),
                limit("encoder.gain", signals.gain, 0.5, 2.0),
                limit("encoder.phase_rad", signals.phase_rad, -0.5, 0.5),
                limit("encoder.hysteresis", signals.hysteresis, 0.0, 0.1),
                limit("encoder.counter_late_s", signals.counter_late_s, -10e-6, 10e-6),
            ]),
        }
        limits
    }
}

/// The table as it is written.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct File {
    kind: Option<Name>,
    count_m: f64,
    noise_m_rms: f64,
    #[serde(default)]
    latency_s: f64,
    acknowledge_bits: Option<u32>,
    amplitude: Option<f64>,
    cos_offset: Option<f64>,
    sin_offset: Option<f64>,
    gain: Option<f64>,
    phase_rad: Option<f64>,
    hysteresis: Option<f64>,
    counter_late_s: Option<f64>,
}

/// The kinds as they are written.
#[derive(Clone, Copy, Deserialize)]
#[serde(rename_all = "kebab-case")]
enum Name {
    BissC,
    SinCos,
}

impl File {
    /// The encoder that the table describes; ranges are checked by [`Encoder::limits`]. BiSS-C if no kind is written.
    ///
    /// # Errors
    /// Keys that the kind lacks, and keys of the other kind.
    pub(super) fn resolve(self) -> Result<Encoder, Misfit> {
        let of_signals = [
            ("amplitude", self.amplitude),
            ("cos_offset", self.cos_offset),
            ("sin_offset", self.sin_offset),
            ("gain", self.gain),
            ("phase_rad", self.phase_rad),
            ("hysteresis", self.hysteresis),
            ("counter_late_s", self.counter_late_s),
        ];
        let missing = |key: &str, kind| Misfit::new("encoder", format!("missing field `{key}` of kind \"{kind}\""));
        let kind = match self.kind.unwrap_or(Name::BissC) {
            Name::BissC => {
                if let Some((key, _)) = of_signals.iter().find(|(_, value)| value.is_some()) {
                    return Err(Misfit::new(format!("encoder.{key}"), "only with kind = \"sin-cos\"".into()));
                }
                let acknowledge_bits = self.acknowledge_bits.ok_or_else(|| missing("acknowledge_bits", "biss-c"))?;
                Kind::BissC { acknowledge_bits }
            }
            Name::SinCos => {
                if self.acknowledge_bits.is_some() {
                    return Err(Misfit::new("encoder.acknowledge_bits", "only with kind = \"biss-c\"".into()));
                }
                Kind::SinCos(SinCos {
                    amplitude: self.amplitude.ok_or_else(|| missing("amplitude", "sin-cos"))?,
                    cos_offset: self.cos_offset.unwrap_or(0.0),
                    sin_offset: self.sin_offset.unwrap_or(0.0),
                    gain: self.gain.unwrap_or(1.0),
                    phase_rad: self.phase_rad.unwrap_or(0.0),
                    hysteresis: self.hysteresis.unwrap_or(0.0),
                    counter_late_s: self.counter_late_s.unwrap_or(0.0),
                })
            }
        };
        Ok(Encoder { count_m: self.count_m, noise_m_rms: self.noise_m_rms, latency_s: self.latency_s, kind })
    }
}
