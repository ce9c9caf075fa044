//! Who may talk to the server: pages that it served itself, and of those only the ones that know its token.
//!
//! A browser runs pages of other sites as well, and any of them can reach a port on loopback. Three things keep them out: the
//! request must be addressed to this server by number (a name can be made to lead here), it must come from a page of this server
//! (`Origin`, which a page cannot forge), and whatever a page says must carry the token of this start.

use std::net::{IpAddr, SocketAddr};

use axum::http::{HeaderMap, header};

/// Shortest token that may be given, characters.
pub const SHORTEST_TOKEN: usize = 16;
/// Random bytes in a token of our own.
const TOKEN_BYTES: usize = 16;

/// What a request must show.
#[derive(Clone, Debug)]
pub struct Access {
    address: SocketAddr,
    token: String,
}

impl Access {
    /// Access to a server at `address` for those who know `token`.
    pub fn new(address: SocketAddr, token: String) -> Self {
        Access { address, token }
    }

    /// What a person opens. The token stands behind `#`: browsers keep that part to themselves.
    pub fn url(&self) -> String {
        format!("http://{}/#{}", self.address, self.token)
    }

    /// The request is addressed to this server by number, or by the name that means loopback everywhere.
    ///
    /// # Errors
    /// The reason, for the reader of the answer.
    pub fn check_host(&self, headers: &HeaderMap) -> Result<(), String> {
        let host = text(headers, header::HOST).ok_or("a request without Host")?;
        let (name, port) = match host.rsplit_once(':') {
            Some((name, port)) if !port.ends_with(']') => (name, port.parse().ok()),
            _ => (host, Some(80)),
        };
        let ip = name.trim_start_matches('[').trim_end_matches(']').parse::<IpAddr>();
        let ours = match ip {
            Ok(ip) if self.address.ip().is_loopback() => ip.is_loopback(),
            Ok(_) => true,
            Err(_) => name == "localhost",
        };
        if ours && port == Some(self.address.port()) {
            Ok(())
        } else {
            Err(format!("this server is {}, not {host}", self.address))
        }
    }

    /// The request comes from a page of this server.
    ///
    /// # Errors
    /// The reason.
    pub fn check_origin(&self, headers: &HeaderMap) -> Result<(), String> {
        self.check_host(headers)?;
        let host = text(headers, header::HOST).unwrap_or_default();
        match text(headers, header::ORIGIN) {
            Some(origin) if origin.strip_prefix("http://") == Some(host) => Ok(()),
            Some(origin) => Err(format!("pages of {origin} have no business here")),
            None => Err("a request without Origin".to_owned()),
        }
    }

    /// `given` is the token. Takes as long for a wrong one as for the right one.
    pub fn knows(&self, given: &str) -> bool {
        let differ = given.bytes().zip(self.token.bytes()).fold(0, |differ, (a, b)| differ | (a ^ b));
        given.len() == self.token.len() && differ == 0
    }
}

fn text(headers: &HeaderMap, name: header::HeaderName) -> Option<&str> {
    headers.get(name)?.to_str().ok()
}

/// A token that nobody can guess.
///
/// # Errors
/// The system has no random numbers.
pub fn random_token() -> anyhow::Result<String> {
    let mut bytes = [0; TOKEN_BYTES];
    getrandom::fill(&mut bytes).map_err(|error| anyhow::anyhow!("no random numbers for the page's token: {error}"))?;
    Ok(bytes.iter().map(|byte| format!("{byte:02x}")).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn headers(host: &str, origin: Option<&str>) -> HeaderMap {
        let mut headers = HeaderMap::new();
        headers.insert(header::HOST, host.parse().unwrap());
        if let Some(origin) = origin {
            headers.insert(header::ORIGIN, origin.parse().unwrap());
        }
        headers
    }

    fn at(address: &str) -> Access {
        Access::new(address.parse().unwrap(), "0123456789abcdef".to_owned())
    }

    #[test]
    fn on_loopback_only_loopback_is_a_name_for_this_server() {
        for (host, ours) in [
            ("127.0.0.1:8080", true),
            ("localhost:8080", true),
            ("[::1]:8080", true),
            ("127.0.0.1:8081", false),
            ("127.0.0.1", false),
            ("[::1]", false),
            ("192.168.0.7:8080", false),
            ("evil.example:8080", false),
            ("localhost.evil.example:8080", false),
            ("", false),
        ] {
            assert_eq!(at("127.0.0.1:8080").check_host(&headers(host, None)).is_ok(), ours, "{host}");
        }
        assert!(at("127.0.0.1:8080").check_host(&HeaderMap::new()).is_err());
    }

    #[test]
    fn elsewhere_numbers_are_and_names_are_not() {
        for (host, ours) in [("192.168.0.7:8080", true), ("evil.example:8080", false), ("localhost:8080", true)] {
            assert_eq!(at("0.0.0.0:8080").check_host(&headers(host, None)).is_ok(), ours, "{host}");
        }
    }

    #[test]
    fn only_pages_of_this_very_server_are_heard() {
        for (origin, heard) in [
            (Some("http://127.0.0.1:8080"), true),
            (Some("http://localhost:8080"), false),
            (Some("http://127.0.0.1:8081"), false),
            (Some("https://127.0.0.1:8080"), false),
            (Some("http://evil.example"), false),
            (Some("null"), false),
            (None, false),
        ] {
            assert_eq!(
                at("127.0.0.1:8080").check_origin(&headers("127.0.0.1:8080", origin)).is_ok(),
                heard,
                "{origin:?}"
            );
        }
        // The name was made to lead here, and the page agrees with it: still not ours.
        assert!(
            at("127.0.0.1:8080").check_origin(&headers("evil.example:8080", Some("http://evil.example:8080"))).is_err()
        );
    }

    #[test]
    fn the_token_is_the_whole_token() {
        let access = at("127.0.0.1:8080");
        assert!(access.knows("0123456789abcdef"));
        for wrong in ["", "0123456789abcde", "0123456789abcdef0", "0123456789abcdeF"] {
            assert!(!access.knows(wrong), "{wrong}");
        }
    }

    #[test]
    fn every_start_has_a_token_of_its_own() {
        let (a, b) = (random_token().unwrap(), random_token().unwrap());
        assert!(a.len() >= SHORTEST_TOKEN && a != b, "{a} {b}");
    }
}
