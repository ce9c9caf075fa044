//! Stepped sine: tones one after the other, at rest or on a slow move, and what they show.

use servo_core::measure::{self, Node, Reading, Request, Shape};
use servo_core::profile::Limits;
use servo_ident::frf::{Complex64, Point};

use super::Failure;
use super::link::{Order, Session};

/// A tone is measured for so many periods, but within these times, s; before it comes a lead, s.
const TONE_PERIODS: f64 = 8.0;
const TONE_S: [f64; 2] = [0.08, 0.2];
const LEAD_S: f64 = 0.06;
/// Time between two tones, s: that of a request and its answer.
const PAUSE_S: f64 = 0.1;
/// Acceleration of a carrying move, m/s², and the speed of the way to its beginning, m/s.
const CARRIER_M_PER_S2: f32 = 0.5;
const WAY_M_PER_S: f32 = 0.1;
/// The part of the travel that a carrying move goes to and fro in, as a share of half of it.
const CARRIER_SHARE: f64 = 0.6;

/// Where an excitation joins the loop, and its limits.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bounds {
    /// Where it joins.
    pub node: Node,
    /// Largest distance from where the stage is at the beginning, m.
    pub travel_m: f32,
    /// Largest speed, m/s.
    pub speed_m_per_s: f32,
    /// Largest measured current, A.
    pub current_a: f32,
}

impl Bounds {
    /// An excitation within them.
    pub fn around(&self, shape: Shape) -> Request {
        let Bounds { node, travel_m, speed_m_per_s, current_a } = *self;
        Request { shape, node, travel_m, speed_m_per_s, current_a }
    }
}

/// A frequency of a sweep.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tone {
    /// Frequency, Hz.
    pub hz: f64,
    /// Amplitude, N at the force node, m/s at the velocity node.
    pub amplitude: f64,
}

impl Tone {
    fn shape(self) -> Shape {
        let measure_s = (TONE_PERIODS / self.hz).clamp(TONE_S[0], TONE_S[1]).max(1.0 / self.hz) as f32;
        Shape::Tone { amplitude: self.amplitude as f32, frequency_hz: self.hz as f32, measure_s, lead_s: LEAD_S as f32 }
    }
}

/// A slow move to and fro that keeps friction sliding.
#[derive(Clone, Copy, Debug)]
pub struct Carrier {
    limits: Limits,
    middle_m: f64,
    target_m: f64,
}

impl Carrier {
    /// Goes to one end of the middle part of the travel; the first tone sets off from there at `speed_m_per_s`.
    ///
    /// # Errors
    /// The drive's refusal, a fault.
    pub fn begin(session: &mut Session, speed_m_per_s: f64) -> Result<Carrier, Failure> {
        let (low_m, high_m) = (session.settings.travel_min_m, session.settings.travel_max_m);
        let limits = Limits {
            velocity_m_per_s: speed_m_per_s as f32,
            acceleration_m_per_s2: CARRIER_M_PER_S2,
            jerk_m_per_s3: None,
        };
        let (middle_m, reach_m) = (0.5 * (high_m + low_m), CARRIER_SHARE * 0.5 * (high_m - low_m));
        session.move_to(middle_m - reach_m, Limits { velocity_m_per_s: WAY_M_PER_S, ..limits })?;
        Ok(Carrier { limits, middle_m, target_m: middle_m - reach_m })
    }

    /// Turns round where the end is nearer than the next tone takes.
    fn carry(&mut self, session: &mut Session) -> Result<(), Failure> {
        let left_m = (self.target_m - session.look()?.position_m).abs();
        let tone_m = (TONE_S[1] + LEAD_S + PAUSE_S) * f64::from(self.limits.velocity_m_per_s);
        if left_m < 2.0 * tone_m {
            session.rest()?;
            self.target_m = 2.0 * self.middle_m - self.target_m;
            session.link.order(&Order::Move { target_m: self.target_m, limits: self.limits })?;
            session.wait(0.2)?;
        }
        Ok(())
    }
}

/// Plays the tones, on a slow move if there is one, and ends at rest. They are parts of `of`, `before` of which are done.
///
/// # Errors
/// The drive's refusal, a fault, an excitation that met its limits.
pub fn sweep(
    session: &mut Session,
    tones: &[Tone],
    bounds: &Bounds,
    mut carrier: Option<&mut Carrier>,
    (before, of): (usize, usize),
) -> Result<Vec<Reading>, Failure> {
    let mut readings = Vec::new();
    for (index, tone) in tones.iter().enumerate() {
        session.done(before + index, of);
        if let Some(carrier) = &mut carrier {
            carrier.carry(session)?;
        }
        readings.push(session.measure(&bounds.around(tone.shape()))?);
    }
    if carrier.is_some() {
        session.link.order(&Order::Stop)?;
        session.rest()?;
    }
    Ok(readings)
}

/// The loop transmission at a tone, from either node.
pub fn loop_transmission(reading: &Reading) -> Point {
    let value = -complex(reading.before) / complex(reading.after);
    Point { frequency_hz: reading.frequency_hz, value }
}

/// The plant at a tone at the force node, position over force, m/N.
pub fn plant(reading: &Reading, count_m: f64) -> Point {
    let value = complex(reading.position_ct) / complex(reading.after) * count_m;
    Point { frequency_hz: reading.frequency_hz, value }
}

fn complex(value: measure::Complex) -> Complex64 {
    Complex64::new(value.re, value.im)
}

/// `count` frequencies from the first to the last, in equal ratios.
pub fn logarithmic([first, last]: [f64; 2], count: usize) -> impl Iterator<Item = f64> {
    (0..count).map(move |i| first * libm::pow(last / first, i as f64 / (count.max(2) - 1) as f64))
}
