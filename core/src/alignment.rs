//! Commutation without halls: where the magnets' electrical zero is, found by turning a current vector while the stage hardly moves.
//!
//! A current vector of amplitude I at electrical angle θ pulls the stage towards the place where the magnets' angle is θ: with
//! magnets at θ_m the force is `K·I·sin(θ − θ_m)`. Instead of letting the stage fall into that place, half a magnet pitch away in the
//! worst case, a position loop holds the stage where it is and *turns the vector*: a small angle is a force, `2π·K·I` newtons per
//! turn. What the loop's integral action ends at is the angle at which no force is needed: the magnets'.
//!
//! First a current too small to move much goes in three directions, a third of a turn apart: with an open phase at least one of them
//! cannot be had. While the amplitude then rises from nothing, friction is the larger force and a micrometre turns the vector a long way; so the angle is
//! found, from wherever it starts, before the stage has moved far. Then the stage is moved a little to and fro, by turning the vector,
//! and the angle is taken at two places, at one of them three times. The angle must change between the places as the encoder says
//! (phases and encoder count the same way, and the stage is free), and must be the same at the same place. Anything else is refused.

use core::f32::consts::TAU;

use crate::SERVO_HZ;
use crate::position::Position;

/// Coefficients of the procedure.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Plan {
    /// Amplitude of the vector at the end of its ramp, A.
    pub current_a: f32,
    /// Force per ampere, N/A.
    pub newtons_per_amp: f32,
    /// Electrical turns per count.
    pub turns_per_ct: f32,
    /// The stage is never to be further from where it began, counts.
    pub travel_max_ct: i32,
    /// Proportional gain of the loop that holds the stage, N per count.
    pub proportional_n_per_ct: f32,
    /// Its derivative gain, N per count per tick.
    pub derivative_n_per_ct: f32,
}

/// Why no angle was found. The bridge is off.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Reason {
    /// The stage left its bound.
    TooFar,
    /// The stage did not follow the vector: blocked, or the current is too small.
    Blocked,
    /// The angle ran against the position: two phases are exchanged, or the encoder counts backwards.
    Reversed,
    /// The angle was not the same at the same place.
    NotRepeatable,
    /// The phases did not carry the current: one is open.
    NoCurrent,
}

impl core::fmt::Display for Reason {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str(match self {
            Reason::TooFar => "the stage went beyond alignment_travel_m; look for an external force",
            Reason::Blocked => {
                "the stage did not follow the current: it is blocked, or alignment_current_a is too small"
            }
            Reason::Reversed => "the stage went the wrong way: exchange two phases, or turn the encoder's direction",
            Reason::NotRepeatable => "the angle was not the same twice: look for play, or an external force",
            Reason::NoCurrent => "the phases did not carry the current: one is open; check the motor's wiring",
        })
    }
}

/// What to do until the next tick.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Step {
    /// Put a current of `amps` at electrical angle `turns`.
    Hold {
        /// Electrical angle in turns, `0.0..1.0`.
        turns: f32,
        /// A.
        amps: f32,
    },
    /// The magnets' electrical angle at a position.
    Found {
        /// The position.
        at: Position,
        /// In turns, `0.0..1.0`.
        turns: f32,
    },
    /// Bridge off.
    Refused(Reason),
}

/// Directions in which the phases are tried. Whichever phase is open, one of the three has no more than a quarter of its current.
const DIRECTIONS: u32 = 3;
/// Ticks in each direction; the current is taken in the second half.
const DIRECTION_TICKS: u32 = SERVO_HZ / 200;
/// Ticks before the ramp.
const TRIAL_TICKS: u32 = DIRECTIONS * DIRECTION_TICKS;
/// Share of the current with which the phases are tried.
const TRIAL: f32 = 0.01;
/// Share of the current that the phases must carry.
const CARRIED: f32 = 0.8;
/// Ticks in which the amplitude rises.
const RAMP_TICKS: u32 = 2 * SERVO_HZ;
/// Ticks of a way between two places.
const WAY_TICKS: u32 = SERVO_HZ / 4;
/// Ticks of a stay; the angle is taken in the second half.
const STAY_TICKS: u32 = SERVO_HZ / 4;
/// Places in the order in which they are visited, as a share of [`Plan::travel_max_ct`]. The angle is taken at [`LOW`] and [`HIGH`], from
/// below and from above, each time after a way of the same length: friction's share of the angle is the same but for the sign.
const PLACES: [f32; 10] = [-0.6, -0.3, 0.0, -0.3, 0.0, 0.3, 0.6, 0.3, -0.6, -0.3];
/// Visits of −0.3: from below, from above, from below once more.
const LOW: [usize; 3] = [1, 3, 9];
/// Visits of 0.3: from below, from above.
const HIGH: [usize; 2] = [5, 7];
/// To and fro during the ramp, as a share of [`Plan::travel_max_ct`], so that the vector does not rest half a turn away, where friction
/// alone would hold the stage.
const WIGGLE: f32 = 0.02;
/// Ticks of one to and fro.
const WIGGLE_TICKS: u32 = SERVO_HZ / 10;
/// Amplitude at the beginning of the ramp, as a share.
const LEAST_AMPLITUDE: f32 = 0.005;
/// Time constant of the integral action, ticks.
const INTEGRAL_TICKS: f32 = 0.02 * SERVO_HZ as f32;
/// The vector is turned against its resting angle by at most this: a quarter of a turn gives all the force there is.
const MOST_TURNS: f32 = 0.2;
/// Distance from a place at its end that still counts as having followed, as a share of [`Plan::travel_max_ct`].
const FOLLOWED: f32 = 0.05;
/// Difference of two angles at one place that counts as the same, turns (3°).
const REPEATABLE_TURNS: f32 = 3.0 / 360.0;

/// The procedure under way.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Alignment {
    began_at: Position,
    tick: u32,
    error_ct: f32,
    /// Angle at which the loop's integral action is now, turns; not wrapped.
    rest_turns: f32,
    sum_turns: f32,
    /// Angles taken at the places.
    found_turns: [f32; PLACES.len()],
    /// Mean of the measured amplitude so far, as a share of what was asked for.
    carried: f32,
    /// Sum of the current in the direction that is tried, A.
    sum_a: f32,
}

impl Alignment {
    /// Begins at `position`, with the vector at angle 0.
    pub fn start(position: Position) -> Self {
        Alignment {
            began_at: position,
            tick: 0,
            error_ct: 0.0,
            rest_turns: 0.0,
            sum_turns: 0.0,
            found_turns: [0.0; PLACES.len()],
            carried: 1.0,
            sum_a: 0.0,
        }
    }

    /// One servo tick: the position now and the amplitude that the phases carried, A.
    pub fn step(&mut self, plan: &Plan, position: Position, carried_a: f32) -> Step {
        let moved_ct = position.minus(self.began_at);
        if moved_ct.unsigned_abs() > plan.travel_max_ct.unsigned_abs() {
            return Step::Refused(Reason::TooFar);
        }
        self.tick += 1;
        let Some(tick) = self.tick.checked_sub(TRIAL_TICKS) else {
            return self.try_phases(plan, carried_a);
        };
        let rise = (tick as f32 / RAMP_TICKS as f32).min(1.0);
        let amps = plan.current_a * (LEAST_AMPLITUDE + (1.0 - LEAST_AMPLITUDE) * rise * rise);
        let newtons_per_turn = TAU * plan.newtons_per_amp * amps;

        let (place, since) = schedule(tick);
        let error_ct = reference_ct(place, since, plan.travel_max_ct) - moved_ct as f32;
        let force_n = plan.proportional_n_per_ct * error_ct + plan.derivative_n_per_ct * (error_ct - self.error_ct);
        self.error_ct = error_ct;
        let turn = (force_n / newtons_per_turn).clamp(-MOST_TURNS, MOST_TURNS);
        self.rest_turns += turn / INTEGRAL_TICKS;
        let turns = self.rest_turns + turn;

        // Slow: a current loop in trouble does not come and go in milliseconds.
        self.carried += (carried_a / amps - self.carried) / (0.1 * SERVO_HZ as f32);
        if tick > RAMP_TICKS && self.carried < CARRIED {
            return Step::Refused(Reason::NoCurrent);
        }
        if let Some(place) = place {
            if since >= WAY_TICKS + STAY_TICKS / 2 {
                self.sum_turns += turns;
            }
            if since + 1 == WAY_TICKS + STAY_TICKS {
                if error_ct.abs() > FOLLOWED * plan.travel_max_ct as f32 {
                    return Step::Refused(Reason::Blocked);
                }
                self.found_turns[place] = self.sum_turns / (STAY_TICKS / 2) as f32;
                self.sum_turns = 0.0;
                if place + 1 == PLACES.len() {
                    return self.judge(plan);
                }
            }
        }
        Step::Hold { turns: wrapped(turns), amps }
    }

    /// One tick of the trial: what was measured in it belongs to the tick before.
    fn try_phases(&mut self, plan: &Plan, carried_a: f32) -> Step {
        let amps = TRIAL * plan.current_a;
        let since = (self.tick - 1) % DIRECTION_TICKS;
        if since == 0 {
            self.sum_a = 0.0;
        } else if since > DIRECTION_TICKS / 2 {
            self.sum_a += carried_a;
            let measured = since - DIRECTION_TICKS / 2;
            if since + 1 == DIRECTION_TICKS && self.sum_a < CARRIED * amps * measured as f32 {
                return Step::Refused(Reason::NoCurrent);
            }
        }
        let direction = (self.tick - 1) / DIRECTION_TICKS;
        Step::Hold { turns: direction as f32 / DIRECTIONS as f32, amps }
    }

    /// What the angles say.
    fn judge(&self, plan: &Plan) -> Step {
        let at = |visit: usize| self.found_turns[visit];
        // Friction pulls the one way coming from below and the other way coming from above.
        let low = 0.5 * (at(LOW[0]) + at(LOW[1]));
        let high = 0.5 * (at(HIGH[0]) + at(HIGH[1]));
        let expected = (PLACES[HIGH[0]] - PLACES[LOW[0]]) * plan.travel_max_ct as f32 * plan.turns_per_ct;
        let followed = (high - low) / expected;
        if followed < 0.5 {
            return Step::Refused(if followed < -0.5 { Reason::Reversed } else { Reason::Blocked });
        }
        if followed > 1.5 || (at(LOW[2]) - at(LOW[0])).abs() > REPEATABLE_TURNS {
            return Step::Refused(Reason::NotRepeatable);
        }
        Step::Found { at: self.began_at, turns: wrapped(0.5 * (low + high)) }
    }
}

/// The place that is being visited, if any, and the ticks since the way to it began.
fn schedule(tick: u32) -> (Option<usize>, u32) {
    let Some(since) = tick.checked_sub(RAMP_TICKS) else { return (None, tick) };
    let each = WAY_TICKS + STAY_TICKS;
    let place = (since / each) as usize;
    (Some(place.min(PLACES.len() - 1)), since % each)
}

/// Where the stage is to be, counts from the beginning: during the ramp where it was, then on a straight way to the next place.
fn reference_ct(place: Option<usize>, since: u32, travel_max_ct: i32) -> f32 {
    let Some(place) = place else {
        // A triangle, smaller and smaller.
        let phase = (since % WIGGLE_TICKS) as f32 / WIGGLE_TICKS as f32;
        let triangle = (2.0 - (4.0 * phase - 1.0).abs()).abs() - 1.0;
        let left = 1.0 - since as f32 / RAMP_TICKS as f32;
        return WIGGLE * left * triangle * travel_max_ct as f32;
    };
    let from = if place == 0 { 0.0 } else { PLACES[place - 1] };
    let share = (since as f32 / WAY_TICKS as f32).min(1.0);
    (from + (PLACES[place] - from) * share) * travel_max_ct as f32
}

/// Into `0.0..1.0`.
fn wrapped(turns: f32) -> f32 {
    let fraction = turns - libm::floorf(turns);
    if fraction < 1.0 { fraction } else { 0.0 }
}
