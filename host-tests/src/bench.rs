//! Drive and stage, wired.

use servo_core::axis::{Axis, ServoOutput, ServoSample};
use servo_core::config::Config;
use servo_core::current::{Bridge, PhaseCodes};
use servo_core::drive::{Command, Outcome};
use servo_core::parameters::Settings;
use servo_core::refusal::Refusal;
use servo_core::state::State;
use servo_core::{PERIODS_PER_TICK, PWM_HZ, PWM_TOP};
use servo_sim::{BridgeState, Plant, Stage};

/// PWM period, ns.
const PERIOD_NS: u64 = 1_000_000_000 / PWM_HZ as u64;

/// CPU cycles that the bench reports for each tick: about what the emulated board measures, far below the limit.
pub(crate) const TICK_CYCLES: u32 = 4_000;

/// The drive on the simulated stage.
#[derive(Clone, Debug)]
pub struct Bench {
    /// Drive and current loop.
    pub axis: Axis,
    /// The truth.
    pub plant: Plant,
    active: BridgeState,
    /// Phases A and B of the motor are on each other's terminals.
    exchanged: bool,
}

impl Bench {
    /// A drive with `settings` on `stage`, at rest in mid-travel, bridge off.
    ///
    /// # Errors
    /// Settings out of range.
    pub fn new(stage: &Stage, settings: &Settings, seed: u64) -> Result<Self, Refusal> {
        let dead_time_s = stage.amplifier.dead_time_s;
        Ok(Bench {
            axis: Axis::new(switched_on_at_zero(Config::new(settings)?)),
            plant: Plant::new(stage, seed),
            active: BridgeState { dead_time_s, ..BridgeState::OFF },
            exchanged: false,
        })
    }

    /// One servo period.
    pub fn tick(&mut self, command: Option<Command>) -> ServoOutput {
        self.tick_with(command, |_| ())
    }

    /// One servo period in which `tamper` may change what the drive sees.
    pub fn tick_with(&mut self, command: Option<Command>, tamper: impl FnOnce(&mut ServoSample)) -> ServoOutput {
        self.tick_observed(command, tamper, |_, _| ())
    }

    /// The same; `look` sees what goes in and out in the PWM periods after the servo period.
    pub fn tick_observed(
        &mut self,
        command: Option<Command>,
        tamper: impl FnOnce(&mut ServoSample),
        mut look: impl FnMut(PhaseCodes, Bridge),
    ) -> ServoOutput {
        let mut sample = self.sample();
        tamper(&mut sample);
        let output = self.axis.on_servo(&sample, command.as_ref());
        self.period(output.bridge);
        for _ in 1..PERIODS_PER_TICK {
            let phases = self.phases();
            let bridge = self.axis.on_period(phases);
            look(phases, bridge);
            self.period(bridge);
        }
        output
    }

    /// One servo period in which every current sample goes through `lie`.
    pub fn tick_lying(&mut self, lie: impl Fn(&mut PhaseCodes)) -> ServoOutput {
        let mut sample = self.sample();
        lie(&mut sample.phases);
        let output = self.axis.on_servo(&sample, None);
        self.period(output.bridge);
        for _ in 1..PERIODS_PER_TICK {
            let mut phases = self.phases();
            lie(&mut phases);
            let bridge = self.axis.on_period(phases);
            self.period(bridge);
        }
        output
    }

    /// What the board samples now.
    fn sample(&mut self) -> ServoSample {
        ServoSample {
            phases: self.phases(),
            frame: self.plant.encoder_frame(),
            bus_code: code(self.plant.bus_adc()),
            temperature_code: code(self.plant.temperature_adc()),
            signals: 0,
            last_tick_cycles: TICK_CYCLES,
        }
    }

    /// The present duties for one period, then `next`. A bridge that is turned off is off at once: that is not a compare value
    /// that waits for an update, but the timer's main output enable.
    fn period(&mut self, next: Bridge) {
        if !next.enabled {
            self.active.enabled = false;
        }
        self.plant.advance(PERIOD_NS, &self.active);
        self.active.enabled = next.enabled;
        self.active.duty = next.compare.map(|on| f64::from(on) / f64::from(PWM_TOP));
        if self.exchanged {
            self.active.duty.swap(0, 1);
        }
    }

    fn phases(&mut self) -> PhaseCodes {
        let [a, b] = self.plant.phase_codes();
        if self.exchanged { PhaseCodes { a: b, b: a } } else { PhaseCodes { a, b } }
    }

    /// Wires the motor wrongly: phases A and B are on each other's terminals. The current sensors are the drive's.
    pub fn exchange_phases_a_and_b(&mut self) {
        self.exchanged = true;
    }

    /// Gives a command in the next tick and returns the answer.
    ///
    /// # Errors
    /// The drive's refusal.
    pub fn command(&mut self, command: Command) -> Outcome {
        self.tick(Some(command)).outcome.expect("a command is answered in its tick")
    }

    /// `ticks` servo periods without command; `look` sees each result.
    pub fn run(&mut self, ticks: u32, mut look: impl FnMut(&ServoOutput)) {
        for _ in 0..ticks {
            look(&self.tick(None));
        }
    }

    /// Enables the drive and lets it hold for 0.1 s.
    ///
    /// # Errors
    /// The drive's refusal.
    ///
    /// # Panics
    /// If the drive does not reach Operation enabled: the bench is for tests.
    pub fn enable(&mut self) -> Outcome {
        self.run(5, |_| ());
        self.command(Command::Enable)?;
        self.run(800, |_| ());
        assert_eq!(self.axis.drive().state(), State::OperationEnabled);
        Ok(())
    }
}

/// An incremental encoder begins at 0 where it is switched on: on the benches that is mid-travel, so that the stored electrical zero holds.
pub(crate) fn switched_on_at_zero(config: Config) -> Config {
    Config { commutation_stored: config.commutation_stored || config.sin_cos.is_some(), ..config }
}

fn code(fraction: f64) -> u16 {
    (fraction * 65536.0) as u16
}
