//! Fingerprints: of programs, runs and parameters.

/// FNV-1a with 64 bits: tells builds and runs apart, proves nothing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Fingerprint(pub u64);

impl Default for Fingerprint {
    fn default() -> Self {
        Fingerprint(0xcbf2_9ce4_8422_2325)
    }
}

impl Fingerprint {
    /// Takes in bytes.
    #[must_use]
    pub fn with(self, bytes: &[u8]) -> Self {
        bytes.iter().copied().fold(self, Fingerprint::and)
    }

    /// Takes in words, least significant byte first.
    #[must_use]
    pub fn with_words(self, words: &[u32]) -> Self {
        words.iter().flat_map(|word| word.to_le_bytes()).fold(self, Fingerprint::and)
    }

    fn and(self, byte: u8) -> Self {
        Fingerprint((self.0 ^ u64::from(byte)).wrapping_mul(0x100_0000_01b3))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_is_fnv_1a_however_the_bytes_are_cut() {
        // Published value.
        assert_eq!(Fingerprint::default().with(b"foobar").0, 0x8594_4171_f739_67e8);
        assert_eq!(Fingerprint::default().with(b"foo").with(b"bar"), Fingerprint::default().with(b"foobar"));
        let word = u32::from_le_bytes(*b"foob");
        assert_eq!(Fingerprint::default().with_words(&[word]), Fingerprint::default().with(b"foob"));
    }
}
