//! Where an axis is marked, and how a number is written there.

use super::Scale;

/// A marked place of an axis.
#[derive(Debug, Clone, PartialEq)]
pub struct Tick {
    /// Value on the axis.
    pub value: f64,
    /// Text; `None` for a fine grid line without one.
    pub label: Option<String>,
}

/// Ticks within `low..=high` for about `wanted` labels; the range must be valid for the scale.
pub fn ticks(scale: &Scale, low: f64, high: f64, wanted: usize) -> Vec<Tick> {
    match scale {
        Scale::Linear => linear(low, high, wanted),
        Scale::Log => log(low, high, wanted),
        Scale::Names(names) => (0u32..)
            .map(f64::from)
            .zip(names)
            .filter(|(value, _)| (low..=high).contains(value))
            .map(|(value, name)| Tick { value, label: Some(name.clone()) })
            .collect(),
    }
}

/// Multiples of 1, 2 or 5 times a power of ten.
fn linear(low: f64, high: f64, wanted: usize) -> Vec<Tick> {
    let step = round_step((high - low) / wanted.max(1) as f64);
    let decimals = (-step.log10().floor()).max(0.0) as usize;
    let slack = 1e-9 * (high - low) / step;
    let (first, last) = ((low / step - slack).ceil(), (high / step + slack).floor());
    (0..=(last - first).max(0.0) as usize)
        .map(|i| (first + i as f64) * step)
        .map(|value| Tick { value, label: Some(decimal(value, decimals)) })
        .collect()
}

/// The smallest of 1, 2, 5 times a power of ten that is at least `raw`.
fn round_step(raw: f64) -> f64 {
    let decade = 10f64.powf(raw.log10().floor());
    [1.0, 2.0, 5.0, 10.0].into_iter().map(|m| m * decade).find(|&step| step >= raw * (1.0 - 1e-9)).unwrap_or(raw)
}

/// Decades, thinned to the wanted number; with less than two of them 2 and 5 are labelled as well.
fn log(low: f64, high: f64, wanted: usize) -> Vec<Tick> {
    let (first, last) = (low.log10().floor() as i32, high.log10().ceil() as i32);
    let decades = high.log10() - low.log10();
    let every = (decades / wanted.max(1) as f64).round().max(1.0) as i32;
    let inside = |v: f64| v >= low * (1.0 - 1e-9) && v <= high * (1.0 + 1e-9);
    let mut ticks = Vec::new();
    for exponent in first..=last {
        for digit in 1..=9u8 {
            let value = f64::from(digit) * 10f64.powi(exponent);
            let labelled = match digit {
                1 => exponent.rem_euclid(every) == 0,
                2 | 5 => decades < 2.0,
                _ => false,
            };
            if inside(value) && (digit == 1 || every == 1) {
                ticks.push(Tick { value, label: labelled.then(|| power(digit, exponent)) });
            }
        }
    }
    ticks
}

/// A number with fixed decimals, thin spaces between thousands from 10 000 up, and a typographic minus.
fn decimal(value: f64, decimals: usize) -> String {
    let text = crate::table::number(value, decimals);
    let (whole, fraction) = text.split_at(text.find('.').unwrap_or(text.len()));
    let (sign, digits) = whole.split_at(whole.find(|c: char| c.is_ascii_digit()).unwrap_or(0));
    if digits.len() < 5 {
        return text;
    }
    let groups: Vec<_> = digits.as_bytes().rchunks(3).rev().map(String::from_utf8_lossy).collect();
    format!("{sign}{}{fraction}", groups.join("\u{2009}"))
}

/// `digit · 10^exponent`: plain from 0.001 to 9000, else as a power.
fn power(digit: u8, exponent: i32) -> String {
    if (-3..=3).contains(&exponent) {
        return format!("{:.*}", (-exponent).max(0) as usize, f64::from(digit) * 10f64.powi(exponent));
    }
    let raised: String = exponent
        .to_string()
        .chars()
        .map(|c| c.to_digit(10).map_or('⁻', |d| ['⁰', '¹', '²', '³', '⁴', '⁵', '⁶', '⁷', '⁸', '⁹'][d as usize]))
        .collect();
    if digit == 1 { format!("10{raised}") } else { format!("{digit}·10{raised}") }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn labels(scale: &Scale, low: f64, high: f64, wanted: usize) -> Vec<String> {
        ticks(scale, low, high, wanted).into_iter().filter_map(|t| t.label).collect()
    }

    #[test]
    fn linear_ticks_are_round_numbers_inside_the_range() {
        assert_eq!(labels(&Scale::Linear, -100.0, 100.0, 5), ["−100", "−50", "0", "50", "100"]);
        assert_eq!(labels(&Scale::Linear, 0.0, 1.0, 5), ["0.0", "0.2", "0.4", "0.6", "0.8", "1.0"]);
        assert_eq!(labels(&Scale::Linear, 0.13, 0.27, 3), ["0.15", "0.20", "0.25"]);
        assert_eq!(labels(&Scale::Linear, -5e3, 12e3, 3), ["0", "10\u{2009}000"]);
        assert_eq!(labels(&Scale::Linear, -20e3, 0.0, 2), ["−20\u{2009}000", "−10\u{2009}000", "0"]);
    }

    #[test]
    fn log_ticks_label_decades_and_help_out_with_two_and_five() {
        assert_eq!(labels(&Scale::Log, 1.0, 1000.0, 5), ["1", "10", "100", "1000"]);
        assert_eq!(labels(&Scale::Log, 30.0, 300.0, 5), ["50", "100", "200"]);
        assert_eq!(labels(&Scale::Log, 1e-5, 1e-3, 5), ["10⁻⁵", "10⁻⁴", "0.001"]);
        assert_eq!(labels(&Scale::Log, 1e-9, 1e3, 4), ["10⁻⁹", "10⁻⁶", "0.001", "1", "1000"]);
    }

    #[test]
    fn names_sit_at_whole_numbers() {
        let names = Scale::Names(vec!["±3 nm".into(), "±5 nm".into()]);
        let ticks = ticks(&names, -0.5, 1.5, 9);
        assert_eq!(ticks.iter().map(|t| t.value).collect::<Vec<_>>(), [0.0, 1.0]);
    }
}
