//! Symbols with an index, as they stand in plain text, set as a reader expects them: `k_P` with a subscript.

use maud::{Markup, html};

/// Longest index, characters; longer ones are names, such as those of parameters.
const LONGEST: usize = 3;

/// Text with its symbols set: a single letter (with or without a hat), `_` and a short index, then perhaps `^` and a short exponent.
pub fn typeset(text: &str) -> Markup {
    let (mut done, mut from) = (Vec::new(), 0);
    while let Some(at) = text[from..].find('_').map(|i| from + i) {
        let index = word(&text[at + 1..]);
        if index.is_empty() || !ends_in_symbol(&text[..at]) {
            let next = at + 1;
            done.push(html! { (&text[from..next]) });
            from = next;
            continue;
        }
        let mut end = at + 1 + index.len();
        let exponent = text[end..].strip_prefix('^').map_or("", word);
        done.push(html! { (&text[from..at]) sub { (index) } });
        if !exponent.is_empty() {
            done.push(html! { sup { (exponent) } });
            end += 1 + exponent.len();
        }
        from = end;
    }
    html! { @for piece in done { (piece) } (&text[from..]) }
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
            ("1/τ_d = 2π·100 1/s", "1/τ<sub>d</sub> = 2π·100 1/s"),
            ("F_i^sat / N", "F<sub>i</sub><sup>sat</sup> / N"),
            ("k_P²/4k_D", "k<sub>P</sub>²/4k<sub>D</sub>"),
            ("viscous_n_s_per_m 3, coulomb_n <1", "viscous_n_s_per_m 3, coulomb_n &lt;1"),
            ("x_counter, _a, b_", "x_counter, _a, b_"),
        ] {
            assert_eq!(typeset(text).into_string(), expected);
        }
    }
}
