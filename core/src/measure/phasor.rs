//! A rotating pointer instead of trigonometry.

use core::f64::consts::TAU;

/// A complex number.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Complex {
    /// Real part.
    pub re: f64,
    /// Imaginary part.
    pub im: f64,
}

/// `e^(j 2π k turns)`, times a factor that shrinks with every tick.
///
/// Double precision: after an hour of ticks amplitude and phase are still exact to 1e-8.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Phasor {
    value: Complex,
    step: Complex,
}

impl Phasor {
    /// Begins at 1 + 0j and turns by `turns_per_tick`; its length is multiplied by `shrink_per_tick`.
    ///
    /// Not for the tick: it computes sine and cosine.
    pub fn new(turns_per_tick: f64, shrink_per_tick: f64) -> Phasor {
        let (sin, cos) = libm::sincos(TAU * turns_per_tick);
        Phasor {
            value: Complex { re: 1.0, im: 0.0 },
            step: Complex { re: shrink_per_tick * cos, im: shrink_per_tick * sin },
        }
    }

    /// The value in this tick; the next call gives the next tick's.
    #[inline]
    pub fn advance(&mut self) -> Complex {
        let (v, s) = (self.value, self.step);
        self.value = Complex { re: v.re * s.re - v.im * s.im, im: v.re * s.im + v.im * s.re };
        v
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_turns_and_shrinks_as_sine_and_power_do() {
        let (turns, shrink) = (1.0 / 1000.0 + 1e-7, 0.999_99);
        let mut phasor = Phasor::new(turns, shrink);
        for k in 0..100_000 {
            let value = phasor.advance();
            let (sin, cos) = libm::sincos(TAU * turns * f64::from(k));
            let length = libm::pow(shrink, f64::from(k));
            assert!((value.re - length * cos).abs() < 1e-9 && (value.im - length * sin).abs() < 1e-9, "{k}");
        }
    }
}
