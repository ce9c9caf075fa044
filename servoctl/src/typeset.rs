//! Symbols with an index, as they stand in plain text, set as a reader expects them: `k_P` with a subscript, on a page and in a picture;
//! and numbers that stay with their units.

use maud::{Markup, html};

/// Longest index, characters; longer ones are names, such as those of parameters.
const LONGEST: usize = 3;

/// Units that a line does not begin with when their number ends the one before.
const UNITS: [&str; 25] = [
    "%", "°", "pm", "nm", "µm", "mm", "m", "µs", "ms", "s", "1/s", "Hz", "kHz", "µm/s", "mm/s", "m/s", "mm/s²", "m/s²",
    "kg", "mN", "N", "N²", "N/µm", "N/m", "N/(m",
];

/// A part of a text, by where it stands.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Piece<'a> {
    /// On the line.
    Text(&'a str),
    /// Small and low.
    Index(&'a str),
    /// Small and high.
    Exponent(&'a str),
}

/// The parts of a text; a symbol is a single letter (with or without a hat), `_` and a short index, then perhaps `^` and a short exponent.
pub fn pieces(text: &str) -> Vec<Piece<'_>> {
    let (mut done, mut begun, mut from) = (Vec::new(), 0, 0);
    while let Some(at) = text[from..].find('_').map(|i| from + i) {
        let index = word(&text[at + 1..]);
        if index.is_empty() || !ends_in_symbol(&text[..at]) {
            from = at + 1;
            continue;
        }
        done.extend([Piece::Text(&text[begun..at]), Piece::Index(index)]);
        from = at + 1 + index.len();
        let exponent = text[from..].strip_prefix('^').map_or("", word);
        if !exponent.is_empty() {
            done.push(Piece::Exponent(exponent));
            from += 1 + exponent.len();
        }
        begun = from;
    }
    if begun < text.len() {
        done.push(Piece::Text(&text[begun..]));
    }
    done
}

/// A text for a page.
pub fn typeset(text: &str) -> Markup {
    html! {
        @for piece in pieces(text) {
            @match piece {
                Piece::Text(text) => { (bound(text)) },
                Piece::Index(index) => { sub { (index) } },
                Piece::Exponent(exponent) => { sup { (exponent) } },
            }
        }
    }
}

/// A text that breaks its lines neither between a number and its unit nor at a `±` between numbers.
fn bound(text: &str) -> String {
    let mut set = String::with_capacity(text.len());
    let mut pieces = text.split(' ').peekable();
    while let Some(piece) = pieces.next() {
        set.push_str(piece);
        let Some(next) = pieces.peek() else { break };
        let unit = next.trim_end_matches(['.', ',', ';', ':', ')']);
        let follows_number = piece.ends_with(|c: char| c.is_ascii_digit());
        let is_bound = (follows_number && (*next == "±" || UNITS.contains(&unit))) || piece == "±";
        set.push(if is_bound { '\u{a0}' } else { ' ' });
    }
    set
}

/// The word at the beginning, if it is short and nothing of a name follows.
fn word(text: &str) -> &str {
    let end = text.find(|c: char| !c.is_alphabetic() && !c.is_ascii_digit()).unwrap_or(text.len());
    let follows = text[end..].starts_with('_');
    if text[..end].chars().count() > LONGEST || follows { "" } else { &text[..end] }
}

/// Whether the last letter stands alone.
fn ends_in_symbol(text: &str) -> bool {
    const HAT: char = '\u{302}';
    let mut back = text.chars().rev().skip_while(|c| *c == HAT);
    let letter = back.next().is_some_and(char::is_alphabetic);
    letter && back.next().is_none_or(|before| !before.is_alphabetic() && before != '_' && before != HAT)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_symbol_gets_its_index_and_a_name_stays_a_name() {
        for (text, expected) in [
            ("k_P and F\u{302}_C/k_P", "k<sub>P</sub> and F\u{302}<sub>C</sub>/k<sub>P</sub>"),
            ("1/τ_d = 2π·100", "1/τ<sub>d</sub> = 2π·100"),
            ("F_i^sat / N", "F<sub>i</sub><sup>sat</sup> / N"),
            ("k_P²/4k_D", "k<sub>P</sub>²/4k<sub>D</sub>"),
            ("viscous_n_s_per_m 3, coulomb_n <1", "viscous_n_s_per_m 3, coulomb_n &lt;1"),
            ("x_counter, _a, b_", "x_counter, _a, b_"),
        ] {
            assert_eq!(typeset(text).into_string(), expected);
        }
    }

    #[test]
    fn a_number_stays_with_its_unit_and_with_its_spread() {
        for (text, expected) in [
            ("8 kHz, 5 mm at 1 m/s²", "8\u{a0}kHz, 5\u{a0}mm at 1\u{a0}m/s²"),
            ("8.23 ± 0.94, 17.3 N/µm.", "8.23\u{a0}±\u{a0}0.94, 17.3\u{a0}N/µm."),
            ("(within 0 to 2 %)", "(within 0 to 2\u{a0}%)"),
            ("figure 3 shows", "figure 3 shows"),
            ("table 1 and more", "table 1 and more"),
        ] {
            assert_eq!(bound(text), expected);
        }
    }
}
