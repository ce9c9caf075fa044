//! Quantities as people type and read them: `1.5mm`, `50 mm/s`, `4N/µm`, `20 nm`.

/// A unit that may be typed instead of an SI unit: SI unit, what is typed, its size.
const UNITS: &[(&str, &str, f64)] = &[
    ("m", "mm", 1e-3),
    ("m", "µm", 1e-6),
    ("m", "nm", 1e-9),
    ("m", "pm", 1e-12),
    ("m/s", "mm/s", 1e-3),
    ("m/s", "µm/s", 1e-6),
    ("m/s", "nm/s", 1e-9),
    ("m/s²", "mm/s²", 1e-3),
    ("m/s³", "mm/s³", 1e-3),
    ("s", "ms", 1e-3),
    ("s", "µs", 1e-6),
    ("s", "ns", 1e-9),
    ("N", "mN", 1e-3),
    ("N/m", "N/µm", 1e6),
    ("N/m", "N/mm", 1e3),
    ("A", "mA", 1e-3),
    ("V", "mV", 1e-3),
    ("Hz", "kHz", 1e3),
    ("Ω", "mΩ", 1e-3),
    ("H", "mH", 1e-3),
    ("H", "µH", 1e-6),
    ("kg", "g", 1e-3),
];

/// Reads a number with a unit of the same dimension as `unit` and returns it in `unit`. `bare` allows a number alone, in `unit`.
/// `u` stands for `µ`, `Ohm` for `Ω`, `2` and `3` or `^2` and `^3` for `²` and `³`; blanks do not matter.
///
/// # Errors
/// Says what was typed and which units there are.
pub fn parse(text: &str, unit: &str, bare: bool) -> Result<f64, String> {
    let text = text.trim();
    // The number is the longest beginning that is one: `1e3mm` has an exponent, `1em` has not; `2 1/s` has a blank before its unit.
    let ends = text.char_indices().map(|(at, _)| at).chain([text.len()]).rev();
    let split = ends.filter(|at| *at > 0).find_map(|at| Some((text[..at].parse::<f64>().ok()?, &text[at..])));
    let known = || {
        let others: Vec<&str> = UNITS.iter().filter(|row| row.0 == unit).map(|row| row.1).collect();
        if others.is_empty() { unit.to_owned() } else { format!("{unit}, {}", others.join(", ")) }
    };
    let Some((number, typed)) = split.filter(|(number, _)| number.is_finite()) else {
        return Err(format!("`{text}` is no number with a unit ({})", known()));
    };
    let typed: String = typed.chars().filter(|c| !c.is_whitespace()).collect();
    let typed = typed.replace(['u', 'μ'], "µ").replace('^', "").replace("Ohm", "Ω");
    let typed = match typed.strip_suffix('2').or_else(|| typed.strip_suffix('3')) {
        Some(base) if typed.ends_with('2') => format!("{base}²"),
        Some(base) => format!("{base}³"),
        None => typed,
    };
    match typed.as_str() {
        "" if bare || unit.is_empty() => Ok(number),
        "" => Err(format!("`{text}` has no unit ({})", known())),
        _ if typed.chars().eq(unit.chars().filter(|c| !c.is_whitespace())) => Ok(number),
        _ => match UNITS.iter().find(|row| row.0 == unit && row.1 == typed) {
            Some(row) => Ok(number * row.2),
            None => Err(format!("`{text}`: the unit must be one of {}", known())),
        },
    }
}

/// A length, m; for `clap`.
///
/// # Errors
/// Those of [`parse`].
pub fn length(text: &str) -> Result<f64, String> {
    parse(text, "m", false)
}

/// A speed, m/s; for `clap`.
///
/// # Errors
/// Those of [`parse`].
pub fn speed(text: &str) -> Result<f64, String> {
    parse(text, "m/s", false)
}

/// An acceleration, m/s²; for `clap`.
///
/// # Errors
/// Those of [`parse`].
pub fn acceleration(text: &str) -> Result<f64, String> {
    parse(text, "m/s²", false)
}

/// A jerk, m/s³; for `clap`.
///
/// # Errors
/// Those of [`parse`].
pub fn jerk(text: &str) -> Result<f64, String> {
    parse(text, "m/s³", false)
}

/// A frequency, Hz, which may be a number alone; for `clap`.
///
/// # Errors
/// Those of [`parse`].
pub fn frequency(text: &str) -> Result<f64, String> {
    parse(text, "Hz", true)
}

/// A time, s; for `clap`.
///
/// # Errors
/// Those of [`parse`].
pub fn time(text: &str) -> Result<f64, String> {
    parse(text, "s", false)
}

/// A length in the unit that suits it: nm below a micrometre, µm below a millimetre, else mm; six digits.
pub fn show_length(length_m: f64) -> String {
    let (size, unit) = match length_m.abs() {
        l if l < 0.999_999_5e-6 => (1e9, "nm"),
        l if l < 0.999_999_5e-3 => (1e6, "µm"),
        _ => (1e3, "mm"),
    };
    let shown = length_m * size;
    // To the picometre, which no encoder resolves.
    let digits = match unit {
        "nm" => 1,
        "µm" => 4,
        _ => 6,
    };
    format!("{shown:.digits$} {unit}")
}

/// An encoder's error within its signal period: whole picometres.
pub fn show_error(error_m: f32) -> String {
    format!("{:.0} pm", f64::from(error_m) * 1e12)
}

/// A number in ten digits, with the fewest characters.
pub fn show_number(value: f64) -> String {
    show_exactly(format!("{value:.9e}").parse().unwrap_or(value))
}

/// A number that reads back as the same, with the fewest characters.
pub fn show_exactly(value: f64) -> String {
    let (plain, scientific) = (value.to_string(), format!("{value:e}"));
    if plain.len() <= scientific.len() + 2 { plain } else { scientific }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_take_units_of_their_dimension() {
        for (text, unit, value) in [
            ("5mm", "m", 5e-3),
            ("-1.5 mm", "m", -1.5e-3),
            ("200nm", "m", 200e-9),
            ("3um", "m", 3e-6),
            ("3μm", "m", 3e-6),
            ("1e3µm", "m", 1e-3),
            ("2m", "m", 2.0),
            ("50mm/s", "m/s", 0.05),
            ("1m/s2", "m/s²", 1.0),
            ("1m/s^2", "m/s²", 1.0),
            ("20 m/s³", "m/s³", 20.0),
            ("4N/um", "N/m", 4e6),
            ("10ms", "s", 0.01),
            ("3Ohm", "Ω", 3.0),
            ("7", "", 7.0),
            ("432 1/s", "1/s", 432.0),
            ("912Ns/m", "N s/m", 912.0),
        ] {
            let read = parse(text, unit, false).unwrap();
            assert!((read - value).abs() <= 1e-15 * value.abs(), "{text}: {read}");
        }
        assert_eq!(parse("0.01", "s", true), Ok(0.01));
    }

    #[test]
    fn everything_else_is_refused_with_what_was_typed_and_what_would_do() {
        for (text, unit, says) in [
            ("5", "m", "`5` has no unit (m, mm, µm, nm, pm)"),
            ("5ms", "m", "`5ms`: the unit must be one of m, mm, µm, nm, pm"),
            ("mm", "m", "`mm` is no number with a unit (m, mm, µm, nm, pm)"),
            ("", "m", "`` is no number with a unit (m, mm, µm, nm, pm)"),
            ("nan m", "m", "`nan m` is no number with a unit (m, mm, µm, nm, pm)"),
            ("inf m", "m", "`inf m` is no number with a unit (m, mm, µm, nm, pm)"),
            ("7x", "", "`7x`: the unit must be one of "),
        ] {
            assert_eq!(parse(text, unit, false).unwrap_err(), says, "{text}");
        }
    }

    #[test]
    fn numbers_are_shown_without_the_noise_of_their_last_bits() {
        for (value, shown) in [
            (1.9799999999999998e-9, "1.98e-9"),
            (4e-6 / 65536.0, "6.103515625e-11"),
            (0.0, "0"),
            (0.02, "0.02"),
            (4e6, "4e6"),
            (2_147_483_648.0, "2147483648"),
            (-1.0, "-1"),
        ] {
            assert_eq!(show_number(value), shown);
        }
    }

    #[test]
    fn what_is_shown_exactly_reads_back_the_same() {
        for (value, shown) in [(4e-6 / 65536.0, "6.103515625e-11"), (0.1 + 0.2, "0.30000000000000004"), (4e6, "4e6")] {
            assert_eq!((show_exactly(value).as_str(), parse(&show_exactly(value), "m", true)), (shown, Ok(value)));
        }
    }

    #[test]
    fn lengths_are_shown_in_the_unit_that_suits_them() {
        for (length_m, shown) in [
            (0.0, "0.0 nm"),
            (-3.21e-9, "-3.2 nm"),
            (20e-6, "20.0000 µm"),
            (1e-3, "1.000000 mm"),
            (-5e-3, "-5.000000 mm"),
        ] {
            assert_eq!(show_length(length_m), shown);
        }
    }
}
