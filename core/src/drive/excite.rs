//! What the drive does with an excitation.

use super::{Drive, Outcome};
use crate::measure::{Node, Order, Reading};
use crate::position::Position;

impl Drive {
    /// What the excitation under way, or the last one, has found.
    pub fn measured(&self) -> Reading {
        self.excitation.reading()
    }

    pub(super) fn begin_excitation(&mut self, order: &Order) -> Outcome {
        self.may_move()?;
        self.excitation.begin(order, self.tracker.position());
        self.exciting = true;
        Ok(())
    }

    pub(super) fn abort_excitation(&mut self) {
        self.excitation.abort();
        self.exciting = false;
    }

    /// Adds the excitation to the force that the tick has decided, and takes in what came of it.
    ///
    /// What joins at the velocity node goes the way of the velocity error: straight through K_v, and into the integral. Apart from the
    /// tick, so that one without excitation pays for a branch only.
    #[cold]
    #[inline(never)]
    pub(super) fn excite(
        &mut self,
        position: Position,
        step_ct: i32,
        iq_a: f32,
        proportional_n: f32,
        decided_n: f32,
    ) -> Excited {
        let k = &self.config;
        let added = self.excitation.advance(position, step_ct, iq_a);
        self.exciting = self.excitation.is_running();
        let through_n = k.cascade.velocity_n_s_per_m * added.velocity_m_per_s;
        let wanted_n = decided_n + added.force_n + through_n;
        let force_n = wanted_n.clamp(-k.force_limit_n, k.force_limit_n);
        match self.excitation.node() {
            Node::Force => self.excitation.take(self.error_ct, decided_n, force_n),
            Node::Velocity => {
                let error_m_per_s = proportional_n / k.cascade.velocity_n_s_per_m;
                self.excitation.take(self.error_ct, error_m_per_s, error_m_per_s + added.velocity_m_per_s);
            }
        }
        if force_n == wanted_n {
            self.cascade.integrate(through_n * k.cascade.integral_per_tick);
        }
        self.force_n = force_n;
        Excited { force_n, through_n }
    }
}

/// What an excitation makes of a tick.
pub(super) struct Excited {
    /// Force asked of the motor, N.
    pub force_n: f32,
    /// Share of it that came through the velocity node, N.
    pub through_n: f32,
}
