//! Version numbers as programs print them.

use std::fmt;

/// A release number; compares as one expects.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Version {
    /// Incompatible changes.
    pub major: u32,
    /// Additions.
    pub minor: u32,
    /// Corrections; 0 where the program prints two numbers only.
    pub patch: u32,
}

impl Version {
    /// The release `major.minor.0`.
    pub const fn new(major: u32, minor: u32) -> Version {
        Version { major, minor, patch: 0 }
    }

    /// The first word of `text` that begins with `digits.digits`: `rustc 1.95.0 (59807616e 2026-04-14)`, `QEMU emulator
    /// version 7.2.22 (Debian 1:7.2+dfsg-7)`. Suffixes such as `-nightly` are ignored. `None` if there is no such word.
    pub fn find(text: &str) -> Option<Version> {
        text.split_whitespace().find_map(Version::parse)
    }

    fn parse(word: &str) -> Option<Version> {
        let end = word.find(|c: char| !c.is_ascii_digit() && c != '.').unwrap_or(word.len());
        let mut numbers = word[..end].split('.');
        Some(Version {
            major: numbers.next()?.parse().ok()?,
            minor: numbers.next()?.parse().ok()?,
            patch: numbers.next().and_then(|number| number.parse().ok()).unwrap_or(0),
        })
    }
}

impl fmt::Display for Version {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}.{}.{}", self.major, self.minor, self.patch)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn versions_are_found_in_what_programs_print() {
        let cases = [
            ("rustc 1.95.0 (59807616e 2026-04-14)", Some((1, 95, 0))),
            ("rustc 1.97.0-nightly (0123abc 2026-05-01)", Some((1, 97, 0))),
            ("QEMU emulator version 7.2.22 (Debian 1:7.2+dfsg-7+deb12u18)\nCopyright (c) 2003", Some((7, 2, 22))),
            ("QEMU emulator version 10.0", Some((10, 0, 0))),
            ("cc (Debian 12.2.0-14) 12.2.0", Some((12, 2, 0))),
            ("no number here", None),
            ("", None),
        ];
        for (text, expected) in cases {
            let expected = expected.map(|(major, minor, patch)| Version { major, minor, patch });
            assert_eq!(Version::find(text), expected, "{text:?}");
        }
    }

    #[test]
    fn versions_compare_by_number_not_by_text() {
        assert!(Version::new(1, 100) > Version::new(1, 95));
        assert!(Version::new(10, 0) > Version::new(7, 2));
        assert!(Version { major: 7, minor: 2, patch: 22 } > Version::new(7, 2));
    }
}
