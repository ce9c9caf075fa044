//! Who is not served: other sites' pages, names that were made to lead here, whoever does not know the token.

use std::io::{Read, Write};
use std::net::{TcpListener, TcpStream};
use std::thread;

use serde_json::{Value, json};

use crate::browser::Browser;
use crate::socket::{say, socket, until_closed, until_said};
use crate::{parts, scope};

#[test]
fn a_page_of_another_site_gets_no_socket() {
    let (scope, _cable) = scope();
    let (address, _) = parts(&scope);
    let port = address.rsplit(':').next().unwrap();
    let evil = format!("evil.example:{port}");
    for (host, origin) in [
        (address.as_str(), Some("http://evil.example".to_owned())),
        (&address, Some("null".to_owned())),
        (&address, Some(format!("https://{address}"))),
        (&address, Some("http://127.0.0.1:1".to_owned())),
        (&address, None),
        // A name of theirs that leads to loopback: page and socket agree, and are still not ours.
        (&evil, Some(format!("http://{evil}"))),
    ] {
        assert_eq!(socket(&address, host, origin.as_deref()).err(), Some(403), "{host} {origin:?}");
    }
    assert!(socket(&address, &address, Some(&format!("http://{address}"))).is_ok());
}

#[test]
fn files_are_only_given_to_who_asks_for_this_server() {
    let (scope, _cable) = scope();
    let (address, token) = parts(&scope);
    let get = |host: &str| {
        let mut stream = TcpStream::connect(&address).unwrap();
        write!(stream, "GET / HTTP/1.1\r\nHost: {host}\r\nConnection: close\r\n\r\n").unwrap();
        let mut answer = String::new();
        stream.read_to_string(&mut answer).unwrap();
        answer
    };
    let page = get(&address);
    assert!(page.starts_with("HTTP/1.1 200") && page.contains("default-src 'self'"), "{page}");
    assert!(!page.contains(&token), "whoever can open a socket would know the token");
    assert!(get("evil.example").starts_with("HTTP/1.1 403"));
}

#[test]
fn without_the_token_nothing_is_said_and_nothing_is_done() {
    let (scope, _cable) = scope();
    let (address, token) = parts(&scope);
    let origin = format!("http://{address}");
    let wrong = token.replace(|_: char| true, "0");
    for (token, action) in [
        (wrong.as_str(), json!({"do": "hello"})),
        ("", json!({"do": "hello"})),
        // Right, but it has not said hello.
        (&token, json!({"do": "enable"})),
    ] {
        let mut stranger = socket(&address, &address, Some(&origin)).unwrap();
        say(&mut stranger, token, action);
        let (said, reason) = until_closed(&mut stranger);
        assert_eq!(said, Vec::<Value>::new());
        assert!(reason.contains("open the address that servoctl prints"), "{reason}");
    }
    // Each command needs it, not only the first message.
    for action in [json!({"do": "enable"}), json!({"do": "stop"}), json!({"do": "take_over"})] {
        let mut page = socket(&address, &address, Some(&origin)).unwrap();
        say(&mut page, &token, json!({"do": "hello"}));
        until_said(&mut page, "status");
        say(&mut page, &wrong, action);
        assert_eq!(until_closed(&mut page).1, "a message without the token");
    }
    let mut page = socket(&address, &address, Some(&origin)).unwrap();
    say(&mut page, &token, json!({"do": "hello"}));
    assert_eq!(until_said(&mut page, "status")["torque"], false, "nobody has enabled it");
    say(&mut page, &token, json!({"do": "enable"}));
    assert_eq!(until_said(&mut page, "answer")["error"], Value::Null);
}

#[test]
#[ignore = "needs Chromium: cargo xtask test --only scope"]
fn a_foreign_page_in_the_same_browser_reaches_nothing() {
    let (scope, _cable) = scope();
    let (address, token) = parts(&scope);
    // Another site, which happens to know everything but cannot be this site.
    let site = TcpListener::bind("127.0.0.1:0").unwrap();
    let url = format!("http://{}/", site.local_addr().unwrap());
    thread::spawn(move || {
        for stream in site.incoming().map_while(Result::ok) {
            let mut stream = stream;
            let _ = stream.read(&mut [0; 4096]);
            let _ = write!(
                stream,
                "HTTP/1.1 200 OK\r\nContent-Type: text/html\r\nContent-Length: 4\r\nConnection: close\r\n\r\nevil"
            );
        }
    });
    let mut browser = Browser::open(&url, [800, 600]);
    let hello = json!({"token": token, "id": 1, "action": {"do": "hello"}}).to_string();
    let socket = format!(
        "new Promise((end) => {{ const s = new WebSocket('ws://{address}/ws'); s.onopen = () => s.send({hello:?}); \
         s.onmessage = () => end('heard'); s.onerror = () => end('refused') }})"
    );
    assert_eq!(browser.eval(&socket), "refused");
    let fetch = format!("fetch('http://{address}/').then(() => 'read', () => 'refused')");
    assert_eq!(browser.eval(&fetch), "refused");
    let frame = format!(
        "new Promise((end) => {{ const f = document.createElement('iframe'); f.src = 'http://{address}/'; \
         f.onload = () => {{ let seen = 'hidden'; try {{ seen = f.contentDocument ? 'read' : 'hidden' }} catch {{}} end(seen) }}; \
         document.body.append(f) }})"
    );
    assert_eq!(browser.eval(&frame), "hidden");
}
