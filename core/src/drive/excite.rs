//! What the drive does with an excitation.

use super::{Drive, Outcome};
use crate::measure::{Node, Order, Reading};
use crate::record::{TickRecord, flags};

impl Drive {
    /// What the excitation under way, or the last one, has found.
    pub fn measured(&self) -> Reading {
        self.excitation.reading()
    }

    pub(super) fn begin_excitation(&mut self, order: &Order) -> Outcome {
        self.may_move()?;
        self.excitation.begin(order, self.tracker.position());
        Ok(())
    }

    /// Adds the excitation to what the tick has decided, and takes in what came of it.
    ///
    /// What joins at the velocity node goes the way of the velocity error: straight through K_v, and into the integral. Apart from the
    /// tick, so that one without excitation pays for a branch only.
    #[cold]
    #[inline(never)]
    pub(super) fn excite(&mut self, record: &mut TickRecord, step_ct: i32) {
        let k = &self.config;
        let added = self.excitation.advance(record.position, step_ct, record.iq_a);
        let through_n = k.cascade.velocity_n_s_per_m * added.velocity_m_per_s;
        let wanted_n = record.force_n + added.force_n + through_n;
        let force_n = wanted_n.clamp(-k.force_limit_n, k.force_limit_n);
        match self.excitation.node() {
            Node::Force => self.excitation.take(record.error_ct, record.force_n, force_n),
            Node::Velocity => {
                let error_m_per_s = record.proportional_n / k.cascade.velocity_n_s_per_m;
                self.excitation.take(record.error_ct, error_m_per_s, error_m_per_s + added.velocity_m_per_s);
            }
        }
        if force_n == wanted_n {
            self.cascade.integrate(through_n * k.cascade.integral_per_tick);
        } else {
            record.flags |= flags::FORCE_LIMITED;
        }
        self.force_n = force_n;
        record.proportional_n += through_n;
        record.force_n = force_n;
        record.iq_set_a = force_n * k.amps_per_newton;
        record.flags |= flags::EXCITED;
    }
}
