//! `servoctl control`: a controlword of CiA 402, and the statusword in words.

use anyhow::Result;
use serde_json::json;
use servo_core::record::flags;
use servo_core::state::{ControlWord, status};
use servo_protocol::message::{Request, Status};

use super::super::output::Json;
use super::Link;

/// Options of `control`.
#[derive(Debug, clap::Args)]
pub struct Options {
    /// The controlword (object 6040), 0 to 0xffff: 0x06 shutdown, 0x07 switch on or disable operation, 0x0f enable operation, 0x10f halt,
    /// 0x02 quick stop, 0x00 disable voltage, 0x80 fault reset
    #[arg(value_parser = word)]
    word: u16,
    #[command(flatten)]
    json: Json,
}

fn word(text: &str) -> Result<u16, String> {
    let parsed = match text.strip_prefix("0x") {
        Some(digits) => u32::from_str_radix(digits, 16),
        None => text.parse(),
    };
    let number = parsed.map_err(|_| format!("controlword = {text} is no number such as 15 or 0x0f"))?;
    u16::try_from(number).map_err(|_| format!("controlword = {text} is outside 0 to 0xffff"))
}

/// Sends the controlword and shows the state after it; a transition may take some ticks more.
///
/// # Errors
/// A refusal; those of the link.
pub fn run(link: &Link, options: &Options) -> Result<()> {
    let mut drive = link.connect()?.drive;
    drive.order(&Request::Control(ControlWord(options.word)))?;
    let status = drive.status()?;
    let value = json!({ "state": status.state.to_string(), "status_word": status.status_word });
    options.json.write(&value, || format!("state       {}\n{}", status.state, status_word(&status)))
}

/// Two lines: the statusword, and the limits that act.
pub fn status_word(status: &Status) -> String {
    const BITS: [(u16, &str); 5] = [
        (status::VOLTAGE_ENABLED, "voltage enabled"),
        (status::WARNING, "encoder warning"),
        (status::TARGET_REACHED, "target reached"),
        (status::INTERNAL_LIMIT, "limit active"),
        (status::FOLLOWING_ERROR, "following error"),
    ];
    let bits: Vec<_> = BITS.iter().filter(|(bit, _)| status.status_word & bit != 0).map(|(_, name)| *name).collect();
    let limits = limits(status);
    let limits = if limits.is_empty() { "none".to_owned() } else { limits.join(", ") };
    format!("statusword  {:#06x}: {}\nlimits      {limits}\n", status.status_word, bits.join(", "))
}

/// Names of the limits that act.
pub fn limits(status: &Status) -> Vec<&'static str> {
    flags::LIMITS.iter().filter(|(bit, ..)| status.flags & bit != 0).map(|(_, name, _)| *name).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_controlword_is_decimal_or_hexadecimal_and_has_sixteen_bits() {
        assert_eq!((word("15"), word("0x10f"), word("65535")), (Ok(15), Ok(0x10f), Ok(0xffff)));
        for (text, why) in
            [("0x10000", "outside 0 to 0xffff"), ("-1", "no number"), ("halt", "no number"), ("", "no number")]
        {
            assert!(word(text).unwrap_err().contains(why), "{text}");
        }
    }
}
