//! The carriage: mass, friction and encoder, moved by a force.

use serde::{Deserialize, Serialize};

use crate::encoder::{self, sincos};
use crate::friction::Friction;
use crate::random::{BEFORE_FIRST_MOVE, Noise, Purpose};
use crate::stage::Stage;
use crate::stage::encoder::{Kind, SinCos};

/// The mechanical half of the plant: a mass between hard stops on friction guides, and the encoder that looks at it.
///
/// [`crate::Plant`] drives it with a motor on a bridge. Alone it is the fast plant: whoever has a force uses
/// [`Carriage::advance`] and gets the same friction, the same noise and the same frames at a fraction of the cost.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Carriage {
    stage: Stage,
    seed: u64,
    motion: Motion,
    /// Force from outside on the mass, N.
    external_n: f64,
    friction: Friction,
    /// σ (N/m) and F_C (N) of the move.
    drawn: [f64; 2],
    encoder_noise: Noise,
    sincos_noise: Noise,
    /// 1, or −1 if the encoder counts backwards.
    encoder_direction: f64,
    /// Edges that the comparators of sine and cosine have counted.
    edges: i64,
}

/// Where the mass is and how it moves: few enough numbers to stay in registers over the internal steps of a period.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
struct Motion {
    position_m: f64,
    velocity_m_per_s: f64,
    /// In the last step.
    acceleration_m_per_s2: f64,
    /// Displacement that the friction has not been told of: its force is taken in the middle of a step.
    untold_m: f64,
    /// The time it took.
    untold_s: f64,
}

impl Carriage {
    /// At rest in mid-travel, friction virgin and nominal until [`Carriage::redraw_friction`].
    pub fn new(stage: &Stage, seed: u64) -> Carriage {
        Carriage {
            stage: *stage,
            seed,
            motion: Motion::default(),
            external_n: 0.0,
            friction: Friction::new(&stage.friction),
            drawn: [stage.friction.stiffness_n_per_m, stage.friction.coulomb_n],
            encoder_noise: Noise::new(seed, Purpose::Encoder, BEFORE_FIRST_MOVE),
            sincos_noise: Noise::new(seed, Purpose::SinCosAdc, BEFORE_FIRST_MOVE),
            edges: 0,
            encoder_direction: 1.0,
        }
    }

    /// Begins a move: draws its σ and F_C, and restarts the encoder's noise, from (seed, `move_index`) and nothing else.
    ///
    /// Two configurations therefore meet the same friction and the same noise in the same move, in whatever order or
    /// thread the moves are run. The friction force keeps its fraction of F_C. Without `friction.spread` in the stage file
    /// σ and F_C stay nominal.
    pub fn redraw_friction(&mut self, move_index: u64) {
        let noise = |purpose| Noise::new(self.seed, purpose, move_index);
        let nominal = &self.stage.friction;
        if let Some(spread) = &nominal.spread {
            let mut draw = noise(Purpose::Friction);
            let stiffness_n_per_m = nominal.stiffness_n_per_m + spread.stiffness_std_n_per_m * draw.normal();
            let coulomb_n = nominal.coulomb_n + spread.coulomb_std_n * draw.normal();
            self.drawn = [
                stiffness_n_per_m.max(spread.stiffness_min_n_per_m).min(spread.stiffness_max_n_per_m),
                coulomb_n.max(spread.coulomb_min_n).min(spread.coulomb_max_n),
            ];
            self.friction.set(self.drawn[0], self.drawn[1]);
        }
        self.encoder_noise = noise(Purpose::Encoder);
        self.sincos_noise = noise(Purpose::SinCosAdc);
    }

    /// Advances by `steps` internal steps under a force that goes from `from_n` to `to_n` in a straight line.
    ///
    /// Steps of 12.5 µs move a settling built-in stage by less than 0.1 nm against steps of half that length (a test).
    #[inline]
    pub fn advance(&mut self, step: &Step, steps: u32, from_n: f64, to_n: f64) {
        let rise_n = (to_n - from_n) / f64::from(steps);
        let mut force_n = from_n + 0.5 * rise_n + self.external_n;
        let mut motion = self.motion;
        for _ in 0..steps {
            motion.drift(step);
            motion.kick(step, &mut self.friction, force_n);
            motion.drift(step);
            force_n += rise_n;
        }
        self.motion = motion;
    }

    /// Moves for half a step with the present velocity; a hard stop takes the velocity away.
    #[inline]
    pub fn drift(&mut self, step: &Step) {
        self.motion.drift(step);
    }

    /// Changes the velocity by a whole step of `force_n` and of the friction where the carriage is now: between two
    /// [`Carriage::drift`]s, a step of second order.
    #[inline]
    pub fn kick(&mut self, step: &Step, force_n: f64) {
        self.motion.kick(step, &mut self.friction, force_n + self.external_n);
    }

    /// What the encoder tells of the position a latency ago, with the noise of one reading, as 64 bits: the line bits of a BiSS-C
    /// frame, first bit in bit 63, or [`sincos::Reading::bits`].
    #[inline]
    pub fn encoder_frame(&mut self) -> u64 {
        let count_m = self.stage.encoder.count_m;
        match self.stage.encoder.kind {
            Kind::BissC { acknowledge_bits } => {
                encoder::frame(encoder::counts(self.seen_m(), count_m), false, false, acknowledge_bits)
            }
            Kind::SinCos(signals) => self.sincos(&signals).bits(),
        }
    }

    /// Sine and cosine at the converters and what the counter says; nothing if the encoder is of another kind.
    pub fn encoder_signals(&mut self) -> Option<sincos::Reading> {
        match self.stage.encoder.kind {
            Kind::BissC { .. } => None,
            Kind::SinCos(signals) => Some(self.sincos(&signals)),
        }
    }

    fn sincos(&mut self, signals: &SinCos) -> sincos::Reading {
        let period_m = self.stage.encoder.count_m * sincos::PERIOD_CT;
        let periods = self.seen_m() / period_m;
        let counted =
            periods + signals.counter_late_s * self.encoder_direction * self.motion.velocity_m_per_s / period_m;
        self.edges = sincos::count(signals, self.edges, counted);
        let pins = sincos::pins(signals, periods, self.stage.adc.noise_lsb_rms, &mut self.sincos_noise);
        sincos::Reading { pins, edges: self.edges }
    }

    /// Position a latency ago, with the noise of one reading, m.
    #[inline]
    fn seen_m(&mut self) -> f64 {
        let scale = &self.stage.encoder;
        let ago_s = scale.latency_s;
        let motion = &self.motion;
        let seen_m = motion.position_m - ago_s * (motion.velocity_m_per_s - 0.5 * ago_s * motion.acceleration_m_per_s2);
        self.encoder_direction * seen_m + scale.noise_m_rms * self.encoder_noise.normal()
    }

    /// The stage file's values.
    pub fn stage(&self) -> &Stage {
        &self.stage
    }

    /// From now on the supply has this voltage, V.
    pub(crate) fn set_bus_v(&mut self, bus_v: f64) {
        self.stage.amplifier.bus_v = bus_v;
    }

    /// The seed of every stream.
    pub fn seed(&self) -> u64 {
        self.seed
    }

    /// True position, m, 0 in mid-travel.
    #[inline]
    pub fn position_m(&self) -> f64 {
        self.motion.position_m
    }

    /// True velocity, m/s.
    #[inline]
    pub fn velocity_m_per_s(&self) -> f64 {
        self.motion.velocity_m_per_s
    }

    /// Turns the encoder's direction: it counts down where the motor's positive force leads.
    pub fn reverse_encoder(&mut self) {
        self.encoder_direction = -self.encoder_direction;
    }

    /// Gives the carriage a velocity, m/s: a push that takes no time.
    pub fn set_velocity(&mut self, velocity_m_per_s: f64) {
        self.motion.velocity_m_per_s = velocity_m_per_s;
    }

    /// From now on something pushes the carriage with this force, N.
    pub fn set_external_force_n(&mut self, external_n: f64) {
        self.external_n = external_n;
    }

    /// Dahl's σ (N/m) and F_C (N) of the present move: the truth that an identification looks for.
    pub fn drawn_friction(&self) -> [f64; 2] {
        self.drawn
    }

    /// Force of the rolling friction, N; positive opposes positive motion.
    pub fn friction_n(&self) -> f64 {
        self.friction.force_n()
    }
}

impl Motion {
    #[inline]
    fn drift(&mut self, step: &Step) {
        let mut moved_m = self.velocity_m_per_s * step.half_s;
        if (self.position_m + moved_m).abs() > step.end_m {
            (moved_m, self.velocity_m_per_s) = against_the_end(step.end_m, moved_m, self.position_m);
        }
        self.position_m += moved_m;
        self.untold_m += moved_m;
        self.untold_s += step.half_s;
    }

    #[inline]
    fn kick(&mut self, step: &Step, friction: &mut Friction, force_n: f64) {
        let (dx_m, dt_s) = (std::mem::take(&mut self.untold_m), std::mem::take(&mut self.untold_s));
        let stopping_n = force_n + step.n_s_per_m * self.velocity_m_per_s;
        let friction_n = friction.resist(dx_m, dt_s, stopping_n);
        let before_m_per_s = self.velocity_m_per_s;
        self.velocity_m_per_s = step.glide * before_m_per_s + step.m_per_n_s * (force_n - friction_n);
        self.acceleration_m_per_s2 = step.per_s * (self.velocity_m_per_s - before_m_per_s);
    }
}

/// Displacement as far as the hard stop, m, and the velocity there. A function of its own, so that the velocity of a carriage that is
/// elsewhere does not wait for the comparison.
#[cold]
fn against_the_end(end_m: f64, moved_m: f64, position_m: f64) -> (f64, f64) {
    (end_m.copysign(moved_m) - position_m, 0.0)
}

/// What is the same in every internal step of one length.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Step {
    half_s: f64,
    per_s: f64,
    /// Trapezoidal rule for `m dv/dt = F − d v`: `v ← glide · v + m_per_n_s · F`.
    glide: f64,
    m_per_n_s: f64,
    /// `glide / m_per_n_s`: the force that takes a velocity away in one step.
    n_s_per_m: f64,
    end_m: f64,
}

impl Step {
    /// Steps of `dt_s` (positive) on `stage`.
    pub fn new(stage: &Stage, dt_s: f64) -> Step {
        let mechanics = &stage.mechanics;
        let half_drag = 0.5 * dt_s * mechanics.viscous_n_s_per_m / mechanics.mass_kg;
        Step {
            half_s: 0.5 * dt_s,
            per_s: 1.0 / dt_s,
            glide: (1.0 - half_drag) / (1.0 + half_drag),
            m_per_n_s: dt_s / mechanics.mass_kg / (1.0 + half_drag),
            n_s_per_m: (1.0 - half_drag) * mechanics.mass_kg / dt_s,
            end_m: 0.5 * mechanics.travel_m,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Position of a carriage under a rough controller that moves it by `step_m`: one sample a servo period of 125 µs.
    fn settling(step_m: f64, ticks: usize, steps: u32) -> Vec<f64> {
        let stage = Stage::default();
        let (k_p, k_i, k_d) = (4.31e5, 1.6e7, 912.0);
        let step = Step::new(&stage, 125e-6 / f64::from(steps));
        let (mut carriage, mut integral_n, mut before_m, mut force_n) = (Carriage::new(&stage, 0), 0.0, 0.0, 0.0);
        (0..ticks)
            .map(|_| {
                let error_m = step_m - carriage.position_m();
                integral_n += k_i * error_m * 125e-6;
                let wanted_n = k_p * error_m + integral_n - k_d * (carriage.position_m() - before_m) / 125e-6;
                before_m = carriage.position_m();
                carriage.advance(&step, steps, force_n, wanted_n);
                force_n = wanted_n;
                carriage.position_m()
            })
            .collect()
    }

    #[test]
    fn half_the_internal_step_gives_the_same_settling() {
        for step_m in [50e-9, 1e-6, 5e-6, 20e-6] {
            let (coarse, fine) = (settling(step_m, 4_000, 10), settling(step_m, 4_000, 20));
            let difference_m: Vec<f64> = coarse.iter().zip(&fine).map(|(a, b)| (a - b).abs()).collect();
            let worst_m = |from_tick: usize| difference_m[from_tick..].iter().copied().fold(0.0, f64::max);
            assert!(worst_m(0) < 2e-4 * step_m, "{step_m} m: {} m during the step", worst_m(0));
            assert!(worst_m(200) < 0.1e-9, "{step_m} m: {} m after 25 ms", worst_m(200));
        }
    }

    #[test]
    fn a_late_encoder_shows_where_the_carriage_was() {
        let mut stage = Stage::default();
        (stage.friction.coulomb_n, stage.encoder.noise_m_rms, stage.encoder.latency_s) = (1e-6, 0.0, 100e-6);
        let (mut now, mut late) =
            (Carriage::new(&Stage { encoder: Stage::default().encoder, ..stage }, 0), Carriage::new(&stage, 0));
        now.stage.encoder.noise_m_rms = 0.0;
        let step = Step::new(&stage, 12.5e-6);
        let frames: Vec<[u64; 2]> = (0..80)
            .map(|_| {
                for carriage in [&mut now, &mut late] {
                    carriage.advance(&step, 1, 10.0, 10.0);
                }
                [now.encoder_frame(), late.encoder_frame()]
            })
            .collect();
        let count = |frame: u64| (frame >> 18) as u32 as i64; // two idle, twelve acknowledge, start and CDS bits before it
        for i in 20..80 {
            assert!((count(frames[i][1]) - count(frames[i - 8][0])).abs() <= 1, "step {i}");
        }
    }

    #[test]
    fn a_force_ramp_gives_the_impulse_of_its_mean() {
        let mut stage = Stage::default();
        stage.friction.coulomb_n = 1e-6;
        let mut carriage = Carriage::new(&stage, 0);
        carriage.advance(&Step::new(&stage, 1e-5), 100, 2.0, 4.0);
        let expected_m_per_s = 3.0 * 1e-3 / stage.mechanics.mass_kg;
        assert!((carriage.velocity_m_per_s() / expected_m_per_s - 1.0).abs() < 1e-5);
    }
}
