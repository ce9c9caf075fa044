//! Why the processor started.

use embassy_stm32::pac::RCC;

/// Cause of the last reset. When several flags stand, the most specific one.
#[derive(Clone, Copy, Debug, PartialEq, Eq, defmt::Format)]
pub enum ResetCause {
    /// Supply switched on.
    PowerOn,
    /// Supply dipped below the brown-out level.
    BrownOut,
    /// Reset pin or debugger.
    Pin,
    /// Requested by the firmware: by [`restart`], or after a panic or a fault.
    Software,
    /// Independent or window watchdog.
    Watchdog,
    /// None of these flags stands.
    Unknown,
}

/// Reads the reset flags and clears them for the next time.
pub fn take_cause() -> ResetCause {
    let flags = RCC.rsr().read();
    RCC.rsr().write(|w| w.set_rmvf(true));
    if flags.iwdg1rstf() || flags.wwdg1rstf() {
        ResetCause::Watchdog
    } else if flags.sftrstf() {
        ResetCause::Software
    } else if flags.porrstf() {
        ResetCause::PowerOn
    } else if flags.borrstf() {
        ResetCause::BrownOut
    } else if flags.pinrstf() {
        ResetCause::Pin
    } else {
        ResetCause::Unknown
    }
}

/// Starts the firmware anew: every peripheral is reset, the bridge is off. RAM keeps its contents.
pub fn restart() -> ! {
    cortex_m::peripheral::SCB::sys_reset()
}
