//! What the drive saw, one [`Tick`] after the other, as bytes.

use servo_core::PERIODS_PER_TICK;
use servo_core::axis::ServoSample;
use servo_core::current::PhaseCodes;

/// PWM periods of a tick that are not its servo period.
pub const PERIODS_BETWEEN: usize = PERIODS_PER_TICK as usize - 1;

/// Length of a tick in a recording, bytes.
pub const TICK_BYTES: usize = 24 + 4 * PERIODS_BETWEEN;

/// Raw values of five PWM periods.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Tick {
    /// The servo period.
    pub sample: ServoSample,
    /// The periods after it.
    pub phases: [PhaseCodes; PERIODS_BETWEEN],
}

impl Tick {
    /// As bytes, little-endian: frame, phases, bus, temperature, cycles, signals, then the phases of the other periods.
    pub fn to_bytes(&self) -> [u8; TICK_BYTES] {
        let s = &self.sample;
        let mut bytes = [0; TICK_BYTES];
        bytes[0..8].copy_from_slice(&s.frame.to_le_bytes());
        bytes[8..12].copy_from_slice(&phases_to_bytes(s.phases));
        bytes[12..14].copy_from_slice(&s.bus_code.to_le_bytes());
        bytes[14..16].copy_from_slice(&s.temperature_code.to_le_bytes());
        bytes[16..20].copy_from_slice(&s.last_tick_cycles.to_le_bytes());
        bytes[20..24].copy_from_slice(&s.signals.to_le_bytes());
        for (to, phases) in bytes[24..].as_chunks_mut().0.iter_mut().zip(self.phases) {
            *to = phases_to_bytes(phases);
        }
        bytes
    }

    /// The inverse of [`Tick::to_bytes`].
    pub fn from_bytes(bytes: &[u8; TICK_BYTES]) -> Tick {
        let [f0, f1, f2, f3, f4, f5, f6, f7, p0, p1, p2, p3, b0, b1, t0, t1, c0, c1, c2, c3, s0, s1, s2, s3, rest @ ..] =
            *bytes;
        let (rest, _) = rest.as_chunks();
        Tick {
            sample: ServoSample {
                phases: phases_from_bytes([p0, p1, p2, p3]),
                frame: u64::from_le_bytes([f0, f1, f2, f3, f4, f5, f6, f7]),
                bus_code: u16::from_le_bytes([b0, b1]),
                temperature_code: u16::from_le_bytes([t0, t1]),
                signals: u32::from_le_bytes([s0, s1, s2, s3]),
                last_tick_cycles: u32::from_le_bytes([c0, c1, c2, c3]),
            },
            phases: core::array::from_fn(|i| phases_from_bytes(rest[i])),
        }
    }
}

fn phases_to_bytes(phases: PhaseCodes) -> [u8; 4] {
    let ([a0, a1], [b0, b1]) = (phases.a.to_le_bytes(), phases.b.to_le_bytes());
    [a0, a1, b0, b1]
}

fn phases_from_bytes([a0, a1, b0, b1]: [u8; 4]) -> PhaseCodes {
    PhaseCodes { a: u16::from_le_bytes([a0, a1]), b: u16::from_le_bytes([b0, b1]) }
}
