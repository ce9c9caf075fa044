//! The current loop: two phase currents in, three compare values out, once per PWM period.
//!
//! Amplitude-invariant dq frame: `i_d = 0` is held, `i_q` makes the force. A PI controller per axis cancels the motor's R–L pole
//! (`k_p = L·ω_c`, `k_i = R·ω_c`), voltages become duties by the measured bus voltage, and min-max injection (the centred
//! space-vector modulation) uses the whole hexagon.

use crate::math::{limit, sin_cos_turns};
use crate::monitor::signals;
use crate::{PWM_DT_S, PWM_TOP};

/// Smallest duty of a high side: the dead time.
pub const DUTY_MIN: f32 = 0.02;
/// Largest duty of a high side. Its low side is left 2 µs: half of them behind the sampling instant for the 0.6 µs of both converters, half
/// before it, of which the dead time takes 0.5 µs and a shunt's amplifier 0.3 µs to settle. Bootstraps are recharged meanwhile.
pub const DUTY_MAX: f32 = 0.92;
/// Share of the bus voltage that is to be had between two phases.
pub const DUTY_SPAN: f32 = DUTY_MAX - DUTY_MIN;
/// Around which the phases are centred.
const DUTY_CENTRE: f32 = 0.5 * (DUTY_MIN + DUTY_MAX);

const SQRT3_2: f32 = 0.866_025_4;
const INV_SQRT3: f32 = 0.577_350_26;

/// Raw 16-bit ADC codes of phases A and B; 32768 is 0 A, larger is current into the motor.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PhaseCodes {
    /// Phase A.
    pub a: u16,
    /// Phase B.
    pub b: u16,
}

/// What the bridge does in the next period.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Bridge {
    /// High-side on-time of phases A, B, C in timer counts, `0..=`[`PWM_TOP`].
    pub compare: [u16; 3],
    /// `false`: all six switches off.
    pub enabled: bool,
}

impl Bridge {
    /// All switches off.
    pub const OFF: Bridge = Bridge { compare: [PWM_TOP / 2; 3], enabled: false };
}

/// Coefficients of the period.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Coefficients {
    /// A per ADC code.
    pub amps_per_code: f32,
    /// V/A.
    pub proportional_v_per_a: f32,
    /// V/A per period.
    pub integral_v_per_a: f32,
    /// Any phase current above this trips the bridge in the same period, A.
    pub trip_a: f32,
    /// Equal codes of a phase in a row, one a tick, that are a converter which has stopped; `u16::MAX`: never.
    pub frozen_ticks: u16,
    /// Share of the period that dead time takes from (or gives to) a phase.
    pub dead_time_duty: f32,
    /// 1/A: dead-time compensation is linear in the phase set-point up to the inverse of this, then constant.
    pub dead_time_per_a: f32,
}

impl Coefficients {
    /// PI gains for closed-loop bandwidth `bandwidth_hz` on a phase of `resistance_ohm` and `inductance_h`.
    pub fn gains(bandwidth_hz: f64, resistance_ohm: f64, inductance_h: f64) -> (f32, f32) {
        let omega = core::f64::consts::TAU * bandwidth_hz;
        ((inductance_h * omega) as f32, (resistance_ohm * omega * f64::from(PWM_DT_S)) as f32)
    }
}

/// What the servo tick asks of the next periods.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Demand {
    /// Bridge on.
    pub enabled: bool,
    /// Force-making current, A.
    pub iq_a: f32,
    /// Electrical angle at the tick, turns in `0.0..1.0`.
    pub turns: f32,
    /// Change of the angle per period, turns.
    pub turns_per_period: f32,
    /// 1/bus voltage, 1/V.
    pub per_bus_v: f32,
}

impl Demand {
    /// Bridge off.
    pub const OFF: Demand = Demand { enabled: false, iq_a: 0.0, turns: 0.0, turns_per_period: 0.0, per_bus_v: 0.0 };
}

/// The loop's memory.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CurrentLoop {
    d_integral_v: f32,
    q_integral_v: f32,
    iq_a: f32,
    id_a: f32,
    peak_a: f32,
    /// What is wrong and which limit acts: bits of [`signals`].
    signals: u32,
    /// Codes of the last tick, and in how many in a row each has been the same.
    watched: PhaseCodes,
    same: [u16; 2],
}

impl Default for CurrentLoop {
    fn default() -> Self {
        CurrentLoop {
            d_integral_v: 0.0,
            q_integral_v: 0.0,
            iq_a: 0.0,
            id_a: 0.0,
            peak_a: 0.0,
            signals: 0,
            watched: PhaseCodes { a: 32768, b: 32768 },
            same: [0; 2],
        }
    }
}

impl CurrentLoop {
    /// Measured force-making current of the last period, A.
    #[inline]
    pub fn iq_a(&self) -> f32 {
        self.iq_a
    }

    /// Measured current along the magnets' flux in the last period, A.
    #[inline]
    pub fn id_a(&self) -> f32 {
        self.id_a
    }

    /// What the loop tells, as bits of [`signals`]: [`signals::OVER_CURRENT`], latched until [`CurrentLoop::clear_trip`];
    /// [`signals::CURRENT_FROZEN`] as of the last tick; [`signals::VOLTAGE_LIMITED`] if in the last period the bus did not give the
    /// voltage asked for.
    #[inline]
    pub fn signals(&self) -> u32 {
        self.signals
    }

    /// Forgets a trip.
    pub fn clear_trip(&mut self) {
        self.signals &= !signals::OVER_CURRENT;
    }

    /// Once a tick, in a period without servo tick: whether a converter has stopped. A live one has noise, in its last bit at the least,
    /// so that the same code [`Coefficients::frozen_ticks`] times in a row is none of its. With the bridge off nothing is looked for:
    /// sensors without supply rest at an end of their range.
    #[inline]
    pub fn watch(&mut self, k: &Coefficients, enabled: bool, phases: PhaseCodes) {
        let count = |same: u16, is_same: bool| if is_same && enabled { same.saturating_add(1) } else { 0 };
        self.same = [count(self.same[0], phases.a == self.watched.a), count(self.same[1], phases.b == self.watched.b)];
        self.watched = phases;
        let frozen = self.same[0].max(self.same[1]) >= k.frozen_ticks;
        self.signals = self.signals & !signals::CURRENT_FROZEN | if frozen { signals::CURRENT_FROZEN } else { 0 };
    }

    /// One PWM period: `periods` is how many have passed since the demand was made.
    ///
    /// # Range
    /// Duties stay within `DUTY_MIN..=DUTY_MAX`; if the voltages ask for more, all are scaled down together and
    /// the integrators stop (anti-windup). A trip turns the bridge off in this very period.
    #[inline]
    pub fn step(&mut self, k: &Coefficients, demand: &Demand, phases: PhaseCodes, periods: u32) -> Bridge {
        let ia = (i32::from(phases.a) - 32768) as f32 * k.amps_per_code;
        let ib = (i32::from(phases.b) - 32768) as f32 * k.amps_per_code;
        let ic = -ia - ib;
        self.peak_a = ia.abs().max(ib.abs()).max(ic.abs());
        let tripped = demand.enabled && self.peak_a > k.trip_a;
        let mut told = self.signals & !signals::VOLTAGE_LIMITED | if tripped { signals::OVER_CURRENT } else { 0 };

        let (sin, cos) = sin_cos_turns(demand.turns + periods as f32 * demand.turns_per_period);
        let i_beta = (ia + 2.0 * ib) * INV_SQRT3;
        self.id_a = cos * ia + sin * i_beta;
        self.iq_a = cos * i_beta - sin * ia;
        if !demand.enabled || told & signals::OVER_CURRENT != 0 {
            self.d_integral_v = 0.0;
            self.q_integral_v = 0.0;
            self.signals = told;
            return Bridge::OFF;
        }

        let (d_error, q_error) = (-self.id_a, demand.iq_a - self.iq_a);
        let (d_increment_v, q_increment_v) = (k.integral_v_per_a * d_error, k.integral_v_per_a * q_error);
        let d_v = k.proportional_v_per_a * d_error + self.d_integral_v + d_increment_v;
        let q_v = k.proportional_v_per_a * q_error + self.q_integral_v + q_increment_v;

        let (mut a, mut b, mut c) = phases_of(cos * d_v - sin * q_v, sin * d_v + cos * q_v);
        let (high, low) = (a.max(b).max(c), a.min(b).min(c));
        let mut centre = (high + low) * 0.5;
        let span = (high - low) * demand.per_bus_v;
        let saturated = span > DUTY_SPAN;
        if saturated {
            told |= signals::VOLTAGE_LIMITED;
            let scale = DUTY_SPAN / span;
            (a, b, c, centre) = (a * scale, b * scale, c * scale, centre * scale);
        }
        self.signals = told;
        // Anti-windup: at the limit an integrator may only turn back.
        if !saturated || d_increment_v * d_v < 0.0 {
            self.d_integral_v += d_increment_v;
        }
        if !saturated || q_increment_v * q_v < 0.0 {
            self.q_integral_v += q_increment_v;
        }
        // The set-points' signs, not the measured currents': a compensation that follows the measurement is positive feedback.
        let (ra, rb, rc) = phases_of(-sin * demand.iq_a, cos * demand.iq_a);
        let compare = |v: f32, reference_a: f32| {
            let dead_time = k.dead_time_duty * limit(reference_a * k.dead_time_per_a, -1.0, 1.0);
            let duty = DUTY_CENTRE + (v - centre) * demand.per_bus_v + dead_time;
            (limit(duty, DUTY_MIN, DUTY_MAX) * f32::from(PWM_TOP) + 0.5) as u32 as u16
        };
        Bridge { compare: [compare(a, ra), compare(b, rb), compare(c, rc)], enabled: true }
    }
}

/// Inverse Clarke transform.
#[inline]
fn phases_of(alpha: f32, beta: f32) -> (f32, f32, f32) {
    let b = SQRT3_2 * beta - 0.5 * alpha;
    (alpha, b, -alpha - b)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn coefficients() -> Coefficients {
        let (proportional_v_per_a, integral_v_per_a) = Coefficients::gains(3000.0, 3.0, 1.5e-3);
        Coefficients {
            amps_per_code: 10.0 / 32768.0,
            proportional_v_per_a,
            integral_v_per_a,
            trip_a: 9.5,
            frozen_ticks: 80,
            dead_time_duty: 0.02,
            dead_time_per_a: 20.0,
        }
    }

    fn codes(ia: f32, ib: f32) -> PhaseCodes {
        let code = |i: f32| (32768.0 + i * 3276.8) as u16;
        PhaseCodes { a: code(ia), b: code(ib) }
    }

    fn demand(iq_a: f32, turns: f32) -> Demand {
        Demand { enabled: true, iq_a, turns, turns_per_period: 0.0, per_bus_v: 1.0 / 48.0 }
    }

    #[test]
    fn park_finds_the_force_making_current_at_any_angle() {
        for i in 0..48 {
            let turns = i as f32 / 48.0;
            let (s, c) = (libm::sinf(turns * core::f32::consts::TAU), libm::cosf(turns * core::f32::consts::TAU));
            let (iq, id) = (2.0, -0.5);
            let (ia, ib, _) = phases_of(c * id - s * iq, s * id + c * iq);
            let mut current = CurrentLoop::default();
            current.step(&coefficients(), &demand(0.0, turns), codes(ia, ib), 0);
            assert!((current.iq_a() - iq).abs() < 1e-3 && (current.id_a() - id).abs() < 1e-3);
        }
    }

    #[test]
    fn without_demand_or_current_every_duty_is_the_centre() {
        let bridge = CurrentLoop::default().step(&coefficients(), &demand(0.0, 0.3), codes(0.0, 0.0), 0);
        assert_eq!(bridge, Bridge { compare: [(DUTY_CENTRE * f32::from(PWM_TOP) + 0.5) as u16; 3], enabled: true });
    }

    #[test]
    fn a_current_step_asks_for_the_voltage_of_its_bandwidth() {
        let k = Coefficients { dead_time_duty: 0.0, ..coefficients() };
        // At 0 turns q is the beta axis: phase B gets √3/2 of the voltage, phase C the opposite, A none.
        let bridge = CurrentLoop::default().step(&k, &demand(0.1, 0.0), codes(0.0, 0.0), 0);
        let volts = (k.proportional_v_per_a + k.integral_v_per_a) * 0.1;
        let counts = volts * SQRT3_2 / 48.0 * f32::from(PWM_TOP);
        let centre = DUTY_CENTRE * f32::from(PWM_TOP);
        let round = |x: f32| (x + 0.5) as u16;
        assert_eq!(bridge.compare, [round(centre), round(centre + counts), round(centre - counts)]);
    }

    #[test]
    fn an_excess_current_in_any_phase_turns_the_bridge_off_in_the_same_period_and_stays() {
        for (ia, ib) in [(9.6, 0.0), (0.0, -9.6), (-4.9, -4.9), (4.9, 4.9)] {
            let mut current = CurrentLoop::default();
            assert_eq!(current.step(&coefficients(), &demand(1.0, 0.1), codes(ia, ib), 0), Bridge::OFF);
            assert_eq!(current.signals(), signals::OVER_CURRENT);
            assert_eq!(current.step(&coefficients(), &demand(1.0, 0.1), codes(0.0, 0.0), 0), Bridge::OFF);
            current.clear_trip();
            assert!(current.step(&coefficients(), &demand(1.0, 0.1), codes(0.0, 0.0), 0).enabled);
        }
    }

    #[test]
    fn a_converter_is_frozen_once_it_has_given_one_code_for_so_many_ticks_with_the_bridge_on() {
        let k = coefficients();
        for stuck in [[true, false], [false, true], [true, true]] {
            let mut current = CurrentLoop::default();
            let mut watch = |enabled, tick: u16| {
                let [a, b] = stuck.map(|stuck| if stuck { 33_000 } else { 33_000 + tick % 2 });
                current.watch(&k, enabled, PhaseCodes { a, b });
                current.signals()
            };
            assert!((0..300).all(|tick| watch(false, tick) == 0), "bridge off");
            assert!((0..79).all(|tick| watch(true, tick) == 0), "{stuck:?}");
            assert_eq!(watch(true, 79), signals::CURRENT_FROZEN, "{stuck:?}");
            assert_eq!(watch(false, 80), 0, "and gone with the bridge");
        }
        let mut live = CurrentLoop::default();
        for tick in 0..10_000_u16 {
            // The most that a live one repeats itself.
            let code = 40_000 + tick / 80 % 2;
            live.watch(&k, true, PhaseCodes { a: code, b: code });
            assert_eq!(live.signals(), 0);
        }
        live.watch(&Coefficients { frozen_ticks: u16::MAX, ..k }, true, PhaseCodes { a: 0, b: 0 });
        assert_eq!(live.signals(), 0);
    }

    #[test]
    fn long_saturation_leaves_no_windup() {
        let k = coefficients();
        let mut current = CurrentLoop::default();
        for _ in 0..10_000 {
            current.step(&k, &demand(8.0, 0.2), codes(0.0, 0.0), 0);
        }
        // A blocked bridge cannot have integrated further than the voltage it can give.
        assert!(current.q_integral_v.abs() <= 48.0 && current.d_integral_v.abs() <= 48.0);
    }

    proptest! {
        #[test]
        fn duties_keep_their_margin_and_the_highest_and_the_lowest_are_centred(
            a: u16, b: u16, iq in -8.0f32..8.0, turns in 0.0f32..1.0, bus_v in 20.0f32..60.0, periods in 0u32..5,
        ) {
            let mut current = CurrentLoop::default();
            // Dead-time compensation is added phase by phase, afterwards.
            let k = Coefficients { trip_a: 100.0, dead_time_duty: 0.0, ..coefficients() };
            for _ in 0..20 {
                let demand = Demand { enabled: true, iq_a: iq, turns, turns_per_period: 1e-4, per_bus_v: 1.0 / bus_v };
                let bridge = current.step(&k, &demand, PhaseCodes { a, b }, periods);
                let [low, high, centre] =
                    [DUTY_MIN, DUTY_MAX, DUTY_CENTRE].map(|duty| (duty * f32::from(PWM_TOP) + 0.5) as u16);
                for compare in bridge.compare {
                    prop_assert!((low..=high).contains(&compare));
                }
                let (highest, lowest) = (bridge.compare.iter().max().unwrap(), bridge.compare.iter().min().unwrap());
                prop_assert!((highest + lowest).abs_diff(2 * centre) <= 1, "{bridge:?}");
            }
            prop_assert!(current.iq_a().is_finite() && current.q_integral_v.is_finite());
        }
    }
}
