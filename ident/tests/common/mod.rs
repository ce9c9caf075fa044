//! Synthetic identification profiles on the simulation's friction.
#![allow(dead_code, reason = "each test uses its part")]

use std::f64::consts::TAU;

use servo_sim::friction::{Dahl, Friction};
use servo_sim::random::{Noise, Purpose};

/// A decaying sine on some friction, and what is measured of it.
#[derive(Clone, Copy, Debug)]
pub struct Profile {
    pub rate_hz: f64,
    pub frequency_hz: f64,
    pub length_s: f64,
    pub amplitude_m: f64,
    /// Amplitude at the end over that at the beginning.
    pub decay: f64,
    pub mass_kg: f64,
    pub position_noise_m: f64,
    pub force_noise_n: f64,
    /// Correlation of the force's noise from sample to sample.
    pub correlation: f64,
    pub offset_n: f64,
}

/// Eight periods at 8 Hz, as an encoder of 0.44 nm and a current of 2.8 mN rms show them.
pub const USUAL: Profile = Profile {
    rate_hz: 8_000.0,
    frequency_hz: 8.0,
    length_s: 1.0,
    amplitude_m: 1e-6,
    decay: 0.3,
    mass_kg: 1.8,
    position_noise_m: 0.44e-9,
    force_noise_n: 2.8e-3,
    correlation: 0.0,
    offset_n: 0.05,
};

/// Columns as they would be in a file; `driving_n` is what the motor gives, `friction_n` friction with noise.
pub struct Columns {
    pub time_s: Vec<f64>,
    pub position_m: Vec<f64>,
    pub friction_n: Vec<f64>,
    pub driving_n: Vec<f64>,
    /// Friction without noise and offset.
    pub true_n: Vec<f64>,
}

impl Columns {
    pub fn current_a(&self, force_constant_n_per_a: f64) -> Vec<f64> {
        self.driving_n.iter().map(|f| f / force_constant_n_per_a).collect()
    }
}

impl Profile {
    pub fn position_m(&self, t: f64) -> f64 {
        self.amplitude_m * self.decay.powf(t / self.length_s) * libm::sin(TAU * self.frequency_hz * t)
    }

    /// Moves `friction` along the profile in twenty steps a sample.
    pub fn measure(&self, friction: &mut Friction, draw: u64) -> Columns {
        const STEPS: usize = 20;
        let mut noise = Noise::new(17, Purpose::Friction, draw);
        let mut columns = Columns {
            time_s: Vec::new(),
            position_m: Vec::new(),
            friction_n: Vec::new(),
            driving_n: Vec::new(),
            true_n: Vec::new(),
        };
        let (mut before_m, mut noise_n) = (self.position_m(0.0), self.force_noise_n * noise.normal());
        let fresh = (1.0 - self.correlation * self.correlation).sqrt() * self.force_noise_n;
        for i in 0..(self.rate_hz * self.length_s) as usize {
            let t = i as f64 / self.rate_hz;
            for step in (0..STEPS).rev() {
                let x = self.position_m((t - step as f64 / STEPS as f64 / self.rate_hz).max(0.0));
                friction.advance(x - before_m, 0.0);
                before_m = x;
            }
            noise_n = self.correlation * noise_n + fresh * noise.normal();
            let h = 1e-5;
            let acceleration = (self.position_m(t + h) - 2.0 * self.position_m(t) + self.position_m(t - h)) / (h * h);
            let friction_n = friction.force_n() + self.offset_n + noise_n;
            columns.time_s.push(t);
            columns.position_m.push(before_m + self.position_noise_m * noise.normal());
            columns.friction_n.push(friction_n);
            columns.driving_n.push(friction_n + self.mass_kg * acceleration);
            columns.true_n.push(friction.force_n());
        }
        columns
    }
}

/// Virgin Dahl friction.
pub fn dahl(sigma_n_per_m: f64, coulomb_n: f64) -> Friction {
    Friction::Dahl(Dahl::new(sigma_n_per_m, coulomb_n))
}
