//! Random numbers that depend on nothing but what they are for: (seed, purpose, move).

use std::sync::LazyLock;

use rand_pcg::Pcg64;
use rand_pcg::rand_core::{Rng, SeedableRng};
use serde::{Deserialize, Serialize};

/// What a stream is used for. The numbers are part of every recorded result: never reuse one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Purpose {
    /// Friction of a move.
    Friction = 1,
    /// Encoder noise.
    Encoder = 2,
    /// Noise of the phase-current converters.
    PhaseAdc = 3,
    /// Noise of the bus-voltage and temperature converter.
    SlowAdc = 4,
    /// Noise of the converters for sine and cosine.
    SinCosAdc = 5,
}

/// The move index of a plant that has not begun a move.
pub const BEFORE_FIRST_MOVE: u64 = u64::MAX;

/// A source of normally distributed numbers with state that can be stored.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Noise(Pcg64);

impl Noise {
    /// The stream of one purpose in one move.
    pub fn new(seed: u64, purpose: Purpose, move_index: u64) -> Noise {
        let mut key = mix(mix(mix(seed) ^ purpose as u64) ^ move_index);
        let mut state = [0; 32];
        for word in state.chunks_exact_mut(8) {
            key = mix(key);
            word.copy_from_slice(&key.to_le_bytes());
        }
        Noise(Pcg64::from_seed(state))
    }

    /// A sample of the standard normal distribution, by the ziggurat method.
    ///
    /// # Source
    /// Marsaglia & Tsang 2000, 128 layers; layer and abscissa come from different bits (Doornik 2005).
    #[inline]
    pub fn normal(&mut self) -> f64 {
        let table = &*ZIGGURAT;
        let (layer, x) = self.abscissa(table);
        // Inside the layer's rectangle: 98.8 % of all samples.
        if x.abs() < table.x[layer + 1] { x } else { self.beyond_rectangle(table, layer, x) }
    }

    /// A layer and an abscissa in it.
    #[inline]
    fn abscissa(&mut self, table: &Ziggurat) -> (usize, f64) {
        let bits = self.0.next_u64();
        let layer = (bits % LAYERS as u64) as usize;
        (layer, (bits as i64 >> 11) as f64 * TWO_POW_MINUS_52 * table.x[layer])
    }

    /// The rest of the method, for an abscissa that is not inside the layer's rectangle.
    #[cold]
    fn beyond_rectangle(&mut self, table: &Ziggurat, mut layer: usize, mut x: f64) -> f64 {
        while x.abs() >= table.x[layer + 1] {
            if layer == 0 {
                return self.tail(x < 0.0);
            }
            let y = table.y[layer] + self.uniform() * (table.y[layer + 1] - table.y[layer]);
            if y < density(x) {
                return x;
            }
            (layer, x) = self.abscissa(table);
        }
        x
    }

    /// A sample beyond the base layer's edge.
    fn tail(&mut self, negative: bool) -> f64 {
        loop {
            let beyond = -libm::log(self.uniform()) / EDGE;
            if -2.0 * libm::log(self.uniform()) >= beyond * beyond {
                return if negative { -(EDGE + beyond) } else { EDGE + beyond };
            }
        }
    }

    /// A number in (0, 1].
    fn uniform(&mut self) -> f64 {
        ((self.0.next_u64() >> 11) + 1) as f64 * (0.5 * TWO_POW_MINUS_52)
    }
}

/// One step of SplitMix64 (Steele, Lea, Flood 2014): neighbouring keys give unrelated values.
fn mix(key: u64) -> u64 {
    let z = key.wrapping_add(0x9e37_79b9_7f4a_7c15);
    let z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

const TWO_POW_MINUS_52: f64 = 1.0 / (1u64 << 52) as f64;
const LAYERS: usize = 128;
/// Right edge of the base layer for 128 layers of equal area.
const EDGE: f64 = 3.442_619_855_899;
/// Area of each layer.
const AREA: f64 = 9.912_563_035_262_17e-3;

/// The bell curve without its normalising factor.
fn density(x: f64) -> f64 {
    libm::exp(-0.5 * x * x)
}

/// Layer `i` is `x[i]` wide and lies between the heights `y[i]` and `y[i + 1]`; `x[0]` is the base layer's area over its height.
struct Ziggurat {
    x: [f64; LAYERS + 1],
    y: [f64; LAYERS + 1],
}

static ZIGGURAT: LazyLock<Ziggurat> = LazyLock::new(|| {
    let (mut x, mut y) = ([0.0; LAYERS + 1], [0.0; LAYERS + 1]);
    x[0] = AREA / density(EDGE);
    x[1] = EDGE;
    y[1] = density(EDGE);
    for i in 2..LAYERS {
        y[i] = y[i - 1] + AREA / x[i - 1];
        x[i] = libm::sqrt(-2.0 * libm::log(y[i]));
    }
    y[LAYERS] = 1.0;
    Ziggurat { x, y }
});

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_top_layer_ends_at_the_top_of_the_bell() {
        let table = &*ZIGGURAT;
        let top = table.y[LAYERS - 1] + AREA / table.x[LAYERS - 1];
        assert!((top - 1.0).abs() < 1e-9, "{top}");
    }

    #[test]
    fn samples_are_standard_normal() {
        let n = 4_000_000;
        let mut noise = Noise::new(7, Purpose::Encoder, 0);
        let (mut moments, mut beyond) = ([0.0; 4], [0u32; 3]);
        for _ in 0..n {
            let z = noise.normal();
            for (k, moment) in moments.iter_mut().enumerate() {
                *moment += libm::pow(z, (k + 1) as f64) / f64::from(n);
            }
            for (k, count) in beyond.iter_mut().enumerate() {
                *count += u32::from(z.abs() > [1.0, EDGE, 4.0][k]);
            }
        }
        // Five standard errors of each moment: sqrt(1, 2, 15, 96) / sqrt(n).
        for (k, (expected, spread)) in [(0.0, 1.0), (1.0, 2.0), (0.0, 15.0), (3.0, 96.0)].into_iter().enumerate() {
            let error = (moments[k] - expected).abs();
            assert!(error < 5.0 * libm::sqrt(spread / f64::from(n)), "moment {}: {}", k + 1, moments[k]);
        }
        // Two-sided tail probabilities of the normal distribution.
        for (k, p) in [0.317_310_508, 5.761_085e-4, 6.334_248e-5].into_iter().enumerate() {
            let expected = p * f64::from(n);
            let error = (f64::from(beyond[k]) - expected).abs();
            assert!(error < 5.0 * libm::sqrt(expected), "{} beyond, {expected} expected", beyond[k]);
        }
    }

    #[test]
    fn streams_of_neighbouring_seeds_purposes_and_moves_are_unrelated() {
        let n = 20_000;
        let base = Noise::new(1, Purpose::Encoder, 1);
        for other in [
            Noise::new(2, Purpose::Encoder, 1),
            Noise::new(1, Purpose::PhaseAdc, 1),
            Noise::new(1, Purpose::Encoder, 2),
            Noise::new(2, Purpose::Encoder, 2),
        ] {
            let (mut a, mut b) = (base.clone(), other);
            let correlation = (0..n).map(|_| a.normal() * b.normal()).sum::<f64>() / f64::from(n);
            assert!(correlation.abs() < 5.0 / libm::sqrt(f64::from(n)), "{correlation}");
        }
    }

    #[test]
    fn the_stream_of_a_move_never_changes() {
        let mut noise = Noise::new(1, Purpose::Friction, 0);
        let samples: Vec<f64> = (0..3).map(|_| noise.normal()).collect();
        assert_eq!(samples, [-0.7630379956710175, -1.3951632656742388, 1.5830816965361032]);
    }
}
