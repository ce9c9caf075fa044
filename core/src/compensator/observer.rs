//! Friction observers: a modelled friction force is added to the control, and an error term drives the model to the truth.

use super::{Action, Situation};
use crate::SERVO_DT_S;
use crate::friction::dahl::{self, Dahl};
use crate::friction::lugre::{self, LuGre};
use crate::position::Position;

/// Coefficients of the tick.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Coefficients {
    /// The LuGre model of (4.4), (4.5).
    pub lugre: lugre::Coefficients,
    /// Driving term of (4.4), m/s per count of position error: k·count.
    pub drive_m_per_s_per_ct: f32,
    /// Speed per count of movement in a tick, m/s.
    pub speed_m_per_s_per_ct: f32,
    /// Play between the measured position and the bristles, counts to either side, at least 0.
    pub play_ct: i32,
    /// Largest force of the driven bristles, N: what the drive can give. Driven, they have no bound of their own, and they are
    /// all the integral action there is: whatever the stage needs at rest, they must be able to hold.
    pub limit_n: f32,
    /// The Dahl model of (7.20).
    pub dahl: dahl::Coefficients,
    /// dt/τ_d and count in one, m: k_P · error · this is the increment of the integral action with `k_I = k_P/τ_d` (7.23).
    pub integral_m_per_ct: f32,
}

/// Observer on the LuGre model.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct OnLugre {
    model: LuGre,
    /// Where the bristles' root is: the measured position drags it along with [`Coefficients::play_ct`] of play.
    root: Position,
}

impl OnLugre {
    /// Relaxed at `position`.
    pub fn relaxed(position: Position) -> Self {
        OnLugre { model: LuGre::RELAXED, root: position }
    }

    /// `F̂ = σ_0 ẑ + σ_1 dẑ/dt + σ_2 v` with `dẑ/dt = v − σ_0 |v|/s(v)·ẑ + k e`: its driving term is the integral action.
    ///
    /// `v` is the speed behind the play. Differences of the position itself have a mean `|v|` of some µm/s from noise alone; at rest
    /// ẑ would leak away within milliseconds, and an error would have to stay that makes up for it.
    ///
    /// # Source
    /// (4.4) corrected (ẑ in the second term; the sign of `k e` follows from e = r − x), (4.5); the play is ours.
    #[inline]
    pub fn act(&mut self, k: &Coefficients, tick: &Situation) -> Action {
        let ahead_ct = tick.position.minus(self.root);
        let step_ct = ahead_ct - ahead_ct.max(-k.play_ct).min(k.play_ct);
        self.root = self.root.plus(i64::from(step_ct));
        let speed_m_per_s = step_ct as f32 * k.speed_m_per_s_per_ct;
        let drive_m_per_s = tick.error_ct as f32 * k.drive_m_per_s_per_ct;
        let friction_n = self.model.step_driven(&k.lugre, speed_m_per_s, drive_m_per_s, SERVO_DT_S);
        let limit_m = k.limit_n / k.lugre.stiffness_n_per_m;
        self.model.deflection_m = self.model.deflection_m.clamp(-limit_m, limit_m);
        Action { direct_n: friction_n, friction_n, replaces_integral: true, ..Action::NONE }
    }
}

/// Observer on the Dahl model.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct OnDahl {
    model: Dahl,
}

impl OnDahl {
    /// Relaxed at `position`.
    pub fn relaxed(position: Position) -> Self {
        OnDahl { model: Dahl::relaxed(position) }
    }

    /// `u = F̂(x) + k_P e + k_D ė + ∫ (k_P/τ_d) e dt`: the model's force in full, the integral as driving term.
    ///
    /// # Source
    /// (7.20), (7.23).
    #[inline]
    pub fn act(&mut self, k: &Coefficients, tick: &Situation) -> Action {
        self.model.update(&k.dahl, tick.position);
        Action {
            direct_n: self.model.force_n(),
            increment_n: tick.proportional_n_per_m * (tick.error_ct as f32 * k.integral_m_per_ct),
            replaces_integral: true,
            friction_n: self.model.force_n(),
            slope_n_per_m: self.model.slope_n_per_m(),
            ..Action::NONE
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::friction::stribeck::Level;
    use crate::profile::Profile;

    fn coefficients(play_ct: i32) -> Coefficients {
        Coefficients {
            lugre: lugre::Coefficients {
                stiffness_n_per_m: 8.66e6,
                damping_n_s_per_m: 0.0,
                viscous_n_s_per_m: 0.0,
                level: Level::constant(0.64),
            },
            drive_m_per_s_per_ct: 0.0,
            speed_m_per_s_per_ct: 61.035e-12 * 8000.0,
            play_ct,
            limit_n: 60.0,
            dahl: dahl::Coefficients {
                stiffness_n_per_m: 8.66e6,
                coulomb_n: 0.64,
                exponent_per_ct: 8.26e-4,
                hysteresis_ct: play_ct,
            },
            integral_m_per_ct: 0.0,
        }
    }

    fn friction_n(observer: &mut OnLugre, k: &Coefficients, position: i64) -> f32 {
        let reference = Profile::at_rest(Position(0)).advance();
        let position = Position(position);
        let tick =
            Situation { position, step_ct: 0, error_ct: 0, reference, proportional_n_per_m: 4.31e5, force_n: 0.0 };
        observer.act(k, &tick).friction_n
    }

    /// 1 s at rest with ±8 counts (0.49 nm) of noise, after 20 µm in one direction.
    #[test]
    fn noise_within_the_play_leaves_the_bristles_bent_and_without_play_they_relax() {
        for (play_ct, keeps) in [(16, true), (0, false)] {
            let k = coefficients(play_ct);
            let mut observer = OnLugre::relaxed(Position(0));
            let rolling_n = (1..=400).map(|i| friction_n(&mut observer, &k, i * 1000)).last().unwrap_or(0.0);
            assert!((rolling_n / 0.64 - 1.0).abs() < 1e-3, "{rolling_n} N");
            let rested_n = (0..8000).map(|i| friction_n(&mut observer, &k, 400_000 + 16 * (i % 2) - 8)).last();
            let share = rested_n.unwrap_or(0.0) / rolling_n;
            assert!(if keeps { share > 0.999 } else { share.abs() < 0.1 }, "play {play_ct}: {share} is left");
        }
    }

    #[test]
    fn beyond_the_play_every_count_counts() {
        let k = coefficients(16);
        let mut observer = OnLugre::relaxed(Position(0));
        assert_eq!(friction_n(&mut observer, &k, 16), 0.0);
        // 10 counts are 0.61 nm: far from sliding.
        let pulled_n = friction_n(&mut observer, &k, 26);
        assert!((pulled_n / (8.66e6 * 10.0 * 61.035e-12) - 1.0).abs() < 0.01, "{pulled_n} N");
        assert_eq!(friction_n(&mut observer, &k, -6), pulled_n, "32 counts back");
        assert!(friction_n(&mut observer, &k, -16) < 0.0);
    }
}
