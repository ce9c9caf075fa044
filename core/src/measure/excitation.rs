//! An excitation as the tick plays it, and what it finds.

use super::{Bounds, Complex, Correlator, DecayingSine, Exceeded, Motion, Pulse, Tone};
use crate::SERVO_HZ;
use crate::position::Position;
use crate::refusal::{Field, Refusal};

/// Where an excitation joins the loop.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Node {
    /// What is asked of the motor, N.
    #[default]
    Force,
    /// The velocity error that the velocity loop acts on, m/s.
    Velocity,
}

/// The course of an excitation, in plain numbers; amplitudes in N at [`Node::Force`], in m/s at [`Node::Velocity`].
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Shape {
    /// One frequency of a stepped sine, see [`Tone::new`].
    Tone {
        /// Amplitude.
        amplitude: f32,
        /// Frequency, Hz.
        frequency_hz: f32,
        /// Length of the measured part, s.
        measure_s: f32,
        /// Length of what comes before it, s.
        lead_s: f32,
    },
    /// The identification profile, see [`DecayingSine::new`].
    DecayingSine {
        /// Amplitude at the beginning.
        amplitude: f32,
        /// Frequency, Hz.
        frequency_hz: f32,
        /// Number of periods.
        periods: u32,
        /// Amplitude at the end over that at the beginning.
        end_share: f32,
    },
    /// A step and back.
    Pulse {
        /// Height.
        amplitude: f32,
        /// Length, s, up to a minute.
        length_s: f32,
    },
}

/// What is asked for: course, place and limits.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Request {
    /// The course.
    pub shape: Shape,
    /// Where it joins the loop.
    pub node: Node,
    /// Largest distance from where the stage is at the beginning, m, 0 to 1.
    pub travel_m: f32,
    /// Largest speed, m/s, 0 to 10.
    pub speed_m_per_s: f32,
    /// Largest measured current, A, 0 to 1000.
    pub current_a: f32,
}

/// A course that is checked and ready to be played.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
enum Wave {
    Tone(Tone),
    DecayingSine(DecayingSine),
    Pulse(Pulse),
}

/// A request that is checked and ready to be played.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Order {
    wave: Wave,
    node: Node,
    bounds: Bounds,
    frequency_hz: f64,
}

impl Order {
    /// Checks a request for encoder counts of `count_m`. Not for the tick: it computes sine and cosine.
    ///
    /// # Errors
    /// The value that is out of range.
    pub fn new(request: &Request, count_m: f64) -> Result<Order, Refusal> {
        let mut tone_hz = 0.0;
        let wave = match request.shape {
            Shape::Tone { amplitude, frequency_hz, measure_s, lead_s } => {
                let tone = Tone::new(amplitude, frequency_hz, measure_s, lead_s)?;
                tone_hz = tone.frequency_hz();
                Wave::Tone(tone)
            }
            Shape::DecayingSine { amplitude, frequency_hz, periods, end_share } => {
                Wave::DecayingSine(DecayingSine::new(amplitude, frequency_hz, periods, end_share)?)
            }
            Shape::Pulse { amplitude, length_s } => {
                Refusal::check(Field::Amplitude, f64::from(amplitude), f64::from(f32::MIN), f64::from(f32::MAX))?;
                let length_s = Refusal::check(Field::Duration, f64::from(length_s), 0.0, 60.0)?;
                Wave::Pulse(Pulse { amplitude, ticks: libm::round(length_s * f64::from(SERVO_HZ)) as u32 })
            }
        };
        let travel_m = Refusal::check(Field::Travel, f64::from(request.travel_m), 0.0, 1.0)?;
        let speed = Refusal::check(Field::Velocity, f64::from(request.speed_m_per_s), 0.0, 10.0)?;
        Refusal::check(Field::Current, f64::from(request.current_a), 0.0, 1e3)?;
        let bounds = Bounds {
            travel_ct: (travel_m / count_m) as u32,
            speed_ct_per_tick: (speed / count_m / f64::from(SERVO_HZ)) as u32,
            current_a: request.current_a,
        };
        Ok(Order { wave, node: request.node, bounds, frequency_hz: tone_hz })
    }
}

/// Where an excitation stands.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Progress {
    /// None was ordered.
    #[default]
    Idle,
    /// It acts.
    Running,
    /// Played to its end.
    Complete,
    /// The drive ended it at a limit.
    Exceeded(Exceeded),
    /// A stop, a fault or the end of torque ended it.
    Aborted,
}

/// What a tone has found, up to now.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Reading {
    /// Where it stands.
    pub progress: Progress,
    /// Its frequency, Hz; 0 if it is no tone.
    pub frequency_hz: f64,
    /// Ticks measured.
    pub samples: u32,
    /// Position against the set-point, counts: a slow move does not show.
    pub position_ct: Complex,
    /// What comes to the node, N or m/s.
    pub before: Complex,
    /// What leaves it: the excitation added; at [`Node::Force`] after the force limit.
    pub after: Complex,
}

/// What joins the loop in a tick.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Added {
    /// At [`Node::Force`], N.
    pub force_n: f32,
    /// At [`Node::Velocity`], m/s.
    pub velocity_m_per_s: f32,
}

/// The excitation under way, or the last one.
#[derive(Clone, Copy, Debug, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Excitation {
    order: Option<Order>,
    progress: Progress,
    start: Position,
    reference: Option<Complex>,
    correlator: Correlator,
}

impl Excitation {
    /// Begins at `start`, in place of one under way.
    pub fn begin(&mut self, order: &Order, start: Position) {
        *self = Excitation { order: Some(*order), progress: Progress::Running, start, ..Excitation::default() };
    }

    /// Ends one under way.
    #[inline]
    pub fn abort(&mut self) {
        if self.is_running() {
            self.progress = Progress::Aborted;
        }
    }

    /// Whether it acts.
    #[inline]
    pub fn is_running(&self) -> bool {
        self.progress == Progress::Running
    }

    /// The place of the one under way.
    pub fn node(&self) -> Node {
        self.order.map_or(Node::Force, |order| order.node)
    }

    /// What joins in this tick: nothing if it is over, or `position`, the way `step_ct` since the last tick or the current say that it has
    /// to be.
    pub fn advance(&mut self, position: Position, step_ct: i32, iq_a: f32) -> Added {
        self.reference = None;
        let Some(order) = self.order.as_mut() else { return Added::default() };
        let motion = Motion { start: self.start, position, step_ct, iq_a };
        if let Some(exceeded) = order.bounds.exceeded(&motion) {
            self.progress = Progress::Exceeded(exceeded);
            return Added::default();
        }
        let value = match &mut order.wave {
            Wave::Tone(tone) => tone.advance().map(|part| {
                self.reference = part.reference;
                part.value
            }),
            Wave::DecayingSine(sine) => sine.advance(),
            Wave::Pulse(pulse) => pulse.advance(),
        };
        let Some(value) = value else {
            self.progress = Progress::Complete;
            return Added::default();
        };
        match order.node {
            Node::Force => Added { force_n: value, velocity_m_per_s: 0.0 },
            Node::Velocity => Added { force_n: 0.0, velocity_m_per_s: value },
        }
    }

    /// Takes in what this tick gave: the position error, and what came to the node and left it.
    pub fn take(&mut self, error_ct: i32, before: f32, after: f32) {
        self.correlator.add(self.reference, [-(error_ct as f32), before, after]);
    }

    /// What it has found.
    pub fn reading(&self) -> Reading {
        let [position_ct, before, after] = self.correlator.amplitudes();
        Reading {
            progress: self.progress,
            frequency_hz: self.order.map_or(0.0, |order| order.frequency_hz),
            samples: self.correlator.samples(),
            position_ct,
            before,
            after,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const COUNT_M: f64 = 4e-6 / 65536.0;
    const PULSE: Request = Request {
        shape: Shape::Pulse { amplitude: 1.5, length_s: 0.001 },
        node: Node::Force,
        travel_m: 1e-6,
        speed_m_per_s: 0.01,
        current_a: 1.0,
    };

    fn begun(request: &Request) -> Excitation {
        let mut excitation = Excitation::default();
        excitation.begin(&Order::new(request, COUNT_M).unwrap(), Position(1_000));
        excitation
    }

    #[test]
    fn a_pulse_acts_for_its_length_and_is_complete() {
        let mut excitation = begun(&PULSE);
        for _ in 0..8 {
            assert_eq!(excitation.advance(Position(1_000), 0, 0.0), Added { force_n: 1.5, velocity_m_per_s: 0.0 });
            assert!(excitation.is_running());
        }
        assert_eq!(excitation.advance(Position(1_000), 0, 0.0), Added::default());
        assert_eq!(excitation.reading().progress, Progress::Complete);
    }

    #[test]
    fn each_limit_ends_it_at_once_by_name() {
        // 1 µm are 16,384 counts, 0.01 m/s 20,480 counts in a tick.
        for (position_ct, step_ct, iq_a, expected) in [
            (17_385, 0, 0.0, Exceeded::Travel),
            (-15_385, 0, 0.0, Exceeded::Travel),
            (1_000, -20_481, 0.0, Exceeded::Speed),
            (1_000, 0, -1.1, Exceeded::Current),
        ] {
            let mut excitation = begun(&PULSE);
            assert_eq!(excitation.advance(Position(position_ct), step_ct, iq_a), Added::default());
            assert_eq!(excitation.reading().progress, Progress::Exceeded(expected));
        }
    }

    #[test]
    fn what_is_out_of_range_is_named() {
        let pulse = |amplitude, length_s| Request { shape: Shape::Pulse { amplitude, length_s }, ..PULSE };
        for (request, field) in [
            (pulse(f32::NAN, 0.1), Field::Amplitude),
            (pulse(1.0, 61.0), Field::Duration),
            (Request { travel_m: -1.0, ..PULSE }, Field::Travel),
            (Request { speed_m_per_s: 11.0, ..PULSE }, Field::Velocity),
            (Request { current_a: f32::INFINITY, ..PULSE }, Field::Current),
        ] {
            let refused = Order::new(&request, COUNT_M);
            assert!(matches!(refused, Err(Refusal::OutOfRange { field: named, .. }) if named == field), "{refused:?}");
        }
    }
}
