//! Who may look and who may command.
//!
//! Three things keep other pages of the same browser out: the page's token, which only the page itself can read; the `Origin` that a browser
//! sends with every WebSocket, which must be ours; and the `Host`, which must be ours too, so that no foreign name that points here gets the page.

/// Number of a connected browser.
pub type Visitor = u64;

/// A random token, 128 bits in hexadecimal.
pub fn random_token() -> String {
    use std::hash::{BuildHasher, RandomState};
    // Keys of the standard library's hash maps come from the system's generator.
    (0..2).map(|part| format!("{:016x}", RandomState::new().hash_one(part))).collect()
}

/// Compares without telling by its duration how much was right.
pub fn is_token(token: &str, tried: &str) -> bool {
    let differ = token.bytes().zip(tried.bytes()).fold(0, |differ, (a, b)| differ | (a ^ b));
    token.len() == tried.len() && differ == 0
}

/// Whether a `Host` header names this server: a loopback name, or exactly the address that it was told to listen on; and its port.
pub fn is_own_host(host: &str, listen: std::net::SocketAddr) -> bool {
    let names = ["127.0.0.1".to_owned(), "localhost".to_owned(), "[::1]".to_owned()];
    let own = match listen.ip() {
        ip if ip.is_loopback() => None,
        // Every address of this computer: the token decides.
        ip if ip.is_unspecified() => return host.ends_with(&format!(":{}", listen.port())),
        _ => Some(listen.to_string()),
    };
    names.iter().any(|name| host == format!("{name}:{}", listen.port())) || own.as_deref() == Some(host)
}

/// Whether an `Origin` header is that of the page which `host` served.
pub fn is_own_origin(origin: &str, host: &str) -> bool {
    origin.strip_prefix("http://") == Some(host)
}

/// The one who commands.
#[derive(Debug, Default)]
pub struct Commander {
    holder: Option<Visitor>,
}

impl Commander {
    /// Whether `visitor` may command; the first who tries does until it leaves or gives up.
    ///
    /// # Errors
    /// Says who does.
    pub fn admit(&mut self, visitor: Visitor) -> Result<(), String> {
        let holder = *self.holder.get_or_insert(visitor);
        if holder == visitor {
            Ok(())
        } else {
            Err(format!(
                "browser {holder} commands this drive; you are browser {visitor} and can look. Close that page, or press Release there"
            ))
        }
    }

    /// `visitor` has left or gives up.
    pub fn release(&mut self, visitor: Visitor) {
        if self.holder == Some(visitor) {
            self.holder = None;
        }
    }

    /// Who commands.
    pub fn holder(&self) -> Option<Visitor> {
        self.holder
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_commands_until_it_leaves_and_the_others_are_told_who() {
        let mut commander = Commander::default();
        assert_eq!(commander.admit(1), Ok(()));
        assert_eq!(commander.admit(1), Ok(()));
        assert!(commander.admit(2).unwrap_err().contains("browser 1 commands"));
        commander.release(2);
        assert!(commander.admit(2).is_err(), "only the holder can give up");
        commander.release(1);
        assert_eq!(commander.admit(2), Ok(()));
    }

    #[test]
    fn only_our_own_names_are_hosts() {
        let loopback = "127.0.0.1:8000".parse().unwrap();
        for host in ["127.0.0.1:8000", "localhost:8000", "[::1]:8000"] {
            assert!(is_own_host(host, loopback), "{host}");
        }
        for host in ["127.0.0.1:8001", "127.0.0.1", "evil.example:8000", "localhost.evil.example:8000", ""] {
            assert!(!is_own_host(host, loopback), "{host}");
        }
        let told = "192.168.1.5:8000".parse().unwrap();
        assert!(is_own_host("192.168.1.5:8000", told) && !is_own_host("192.168.1.6:8000", told));
    }

    #[test]
    fn only_our_own_page_is_an_origin() {
        assert!(is_own_origin("http://127.0.0.1:8000", "127.0.0.1:8000"));
        for origin in
            ["http://evil.example", "https://127.0.0.1:8000", "null", "", "http://127.0.0.1:8000.evil.example"]
        {
            assert!(!is_own_origin(origin, "127.0.0.1:8000"), "{origin}");
        }
    }

    #[test]
    fn tokens_are_long_different_and_compared_whole() {
        let (one, other) = (random_token(), random_token());
        assert_eq!(one.len(), 32);
        assert!(one != other && is_token(&one, &one) && !is_token(&one, &other));
        assert!(!is_token(&one, &one[..31]) && !is_token(&one, ""));
    }
}
