//! What the emulator had to say about a run: every breach of the reference manual and every gap in its own models. A test fails
//! on any line that [`EXPLAINED`] does not explain.

use std::fmt;

use rigless::machine::Board;
use rigless::session::Session;

/// What kind of remark a line is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum ToldKind {
    /// A model found the firmware in breach of the manual, or was asked for something it does not model.
    Told,
    /// A register that no model stands behind was read or written.
    Unimplemented,
    /// An address that nothing answers.
    Unmapped,
    /// An access to a peripheral whose clock or gate was off.
    Refused,
    /// Undefined space inside a peripheral.
    Undefined,
    /// An interrupt with no line into the core.
    Unrouted,
}

/// One remark, with its explanation where there is one.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Told {
    /// What kind of remark it is.
    pub kind: ToldKind,
    /// Peripheral and register, or the address.
    pub place: String,
    /// What happened.
    pub text: String,
    /// Why it is harmless, or `None`: then somebody has to look.
    pub explanation: Option<&'static str>,
}

impl fmt::Display for Told {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(formatter, "{:?} {}: {}", self.kind, self.place, self.text)?;
        if let Some(explanation) = self.explanation {
            write!(formatter, " [explained: {explanation}]")?;
        }
        Ok(())
    }
}

/// A remark that is known and harmless.
struct Explained {
    kind: ToldKind,
    /// The whole of [`Told::place`].
    place: &'static str,
    /// A part of [`Told::text`].
    contains: &'static str,
    why: &'static str,
}

/// The short list. Each line says why the silicon does not mind either.
const EXPLAINED: &[Explained] = &[
    Explained {
        kind: ToldKind::Told,
        place: "RCC BDCR",
        contains: "RTCSEL can be written only one time",
        why: "embassy chooses the LSI for the RTC and later none: the first choice stands, and nothing uses the RTC",
    },
    Explained {
        kind: ToldKind::Told,
        place: "RCC PLLCKSELR",
        contains: "this field cannot be changed while its PLL is enabled",
        why: "embassy turns PLL2 and PLL3 off by writing the whole register; the fields of running PLL1 are locked",
    },
    Explained {
        kind: ToldKind::Undefined,
        place: "SYSCFG 0x58000418",
        contains: "0 reads",
        why: "SYSCFG_CFGR (RM0433 12.3.6) is missing in the vendor's file: a locked-up core shall trip TIM1's break",
    },
    Explained {
        kind: ToldKind::Unimplemented,
        place: "IWDG KR",
        contains: "0 reads",
        why: "the emulator only stores the watchdog's registers; the board's own model (watchdog.rs) counts",
    },
    Explained {
        kind: ToldKind::Unimplemented,
        place: "IWDG PR",
        contains: "0 reads",
        why: "the emulator only stores the watchdog's registers; the board's own model (watchdog.rs) counts",
    },
    Explained {
        kind: ToldKind::Unimplemented,
        place: "IWDG RLR",
        contains: "0 reads",
        why: "the emulator only stores the watchdog's registers; the board's own model (watchdog.rs) counts",
    },
];

fn explain(kind: ToldKind, place: &str, text: &str) -> Option<&'static str> {
    EXPLAINED
        .iter()
        .find(|known| known.kind == kind && known.place == place && text.contains(known.contains))
        .map(|known| known.why)
}

/// Everything `session` has to say so far, in a stable order.
pub(crate) fn collect<D: Board + ?Sized>(session: &Session<D>) -> Vec<Told> {
    let line = |kind, place: String, text: String| {
        let explanation = explain(kind, &place, &text);
        Told { kind, place, text, explanation }
    };
    let mut lines = Vec::new();
    for told in session.told() {
        lines.push(line(ToldKind::Told, format!("{} {}", told.instance, told.register), told.reason.to_owned()));
    }
    for gap in session.unimplemented().values() {
        let text = format!("{} reads, {} writes, first at pc {:#010x}", gap.reads, gap.writes, gap.program_counter);
        lines.push(line(ToldKind::Unimplemented, format!("{} {}", gap.instance, gap.register), text));
    }
    for gap in session.unmapped() {
        lines.push(line(
            ToldKind::Unmapped,
            format!("{:#010x}", gap.address),
            format!("first at pc {:#010x}", gap.program_counter),
        ));
    }
    for (address, fault) in session.refused() {
        lines.push(line(ToldKind::Refused, format!("{address:#010x}"), fault.to_string()));
    }
    for (address, gap) in session.undefined() {
        let text = format!("{} reads, {} writes, first at pc {:#010x}", gap.reads, gap.writes, gap.program_counter);
        lines.push(line(ToldKind::Undefined, format!("{} {address:#010x}", gap.instance), text));
    }
    for (instance, number) in session.unrouted() {
        lines.push(line(ToldKind::Unrouted, (*instance).to_owned(), format!("interrupt {number}")));
    }
    lines
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_remark_is_explained_only_by_its_kind_its_place_and_its_reason() {
        let known = &EXPLAINED[0];
        let text = format!("RM0433: {}", known.contains);
        assert_eq!(explain(known.kind, known.place, &text), Some(known.why));
        assert_eq!(explain(ToldKind::Refused, known.place, &text), None);
        assert_eq!(explain(known.kind, "ADC3 CR", &text), None);
        assert_eq!(explain(known.kind, known.place, "something else"), None);
    }
}
