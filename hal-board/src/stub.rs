//! Temporary: the types of `servo-core` until it exists.

pub const PWM_TOP: u16 = 2500;
pub const PERIODS_PER_TICK: u32 = 5;

#[derive(Clone, Copy, Default)]
pub struct PhaseCodes {
    pub a: u16,
    pub b: u16,
}

#[derive(Clone, Copy, Default)]
pub struct Bridge {
    pub compare: [u16; 3],
    pub enabled: bool,
}

#[derive(Clone, Copy, Default)]
pub struct ServoSample {
    pub phases: PhaseCodes,
    pub frame: u64,
    pub bus_code: u16,
    pub temperature_code: u16,
    pub bridge_fault: bool,
    pub last_tick_cycles: u32,
}
