//! A page without a browser: its WebSocket alone.

use std::net::TcpStream;

use serde_json::{Value, json};
use servoctl::scope::Scope;
use tungstenite::client::IntoClientRequest;
use tungstenite::stream::MaybeTlsStream;
use tungstenite::{Error, Message, WebSocket};

use crate::parts;

pub type Socket = WebSocket<MaybeTlsStream<TcpStream>>;

/// A WebSocket as a browser would open it for a page of `origin`; refused: the HTTP status.
pub fn socket(address: &str, host: &str, origin: Option<&str>) -> Result<Socket, u16> {
    let mut request = format!("ws://{address}/ws").into_client_request().unwrap();
    request.headers_mut().insert("host", host.parse().unwrap());
    if let Some(origin) = origin {
        request.headers_mut().insert("origin", origin.parse().unwrap());
    }
    match tungstenite::connect(request) {
        Ok((socket, _)) => Ok(socket),
        Err(Error::Http(response)) => Err(response.status().as_u16()),
        Err(other) => panic!("{other}"),
    }
}

/// Sends what a page sends.
pub fn say(socket: &mut Socket, token: &str, action: Value) {
    let message = json!({"token": token, "id": 1, "action": action});
    socket.send(Message::text(message.to_string())).unwrap();
}

/// Reads until the server closes; what it said until then.
pub fn until_closed(socket: &mut Socket) -> (Vec<Value>, String) {
    let mut said = Vec::new();
    loop {
        match socket.read() {
            Ok(Message::Text(text)) => said.push(serde_json::from_str(&text).unwrap()),
            Ok(Message::Close(frame)) => return (said, frame.map(|f| f.reason.to_string()).unwrap_or_default()),
            Ok(_) => {}
            Err(error) => panic!("{error}"),
        }
    }
}

/// Reads until the server has said something of this kind.
pub fn until_said(socket: &mut Socket, kind: &str) -> Value {
    loop {
        if let Message::Text(text) = socket.read().unwrap() {
            let said: Value = serde_json::from_str(&text).unwrap();
            if said["kind"] == kind {
                return said;
            }
        }
    }
}

/// A page that has said hello, and what it needs to go on.
pub struct Page {
    socket: Socket,
    token: String,
}

impl Page {
    /// Once the drive is seen.
    pub fn open(scope: &Scope) -> Self {
        let mut page = Page::open_unread(scope);
        page.until("status");
        page
    }

    /// All that it is told is still to be read.
    pub fn open_unread(scope: &Scope) -> Self {
        let (address, token) = parts(scope);
        let mut socket = socket(&address, &address, Some(&format!("http://{address}"))).unwrap();
        say(&mut socket, &token, json!({"do": "hello"}));
        Page { socket, token }
    }

    /// The next message.
    pub fn next(&mut self) -> Value {
        loop {
            if let Message::Text(text) = self.socket.read().unwrap() {
                return serde_json::from_str(&text).unwrap();
            }
        }
    }

    /// Sends an action and returns the reason why it was not done, or nothing.
    pub fn order(&mut self, action: Value) -> Option<String> {
        say(&mut self.socket, &self.token, action);
        self.until("answer")["error"].as_str().map(str::to_owned)
    }

    /// The next message of this kind.
    pub fn until(&mut self, kind: &str) -> Value {
        until_said(&mut self.socket, kind)
    }

    /// Waits for a status of which this is true.
    pub fn until_status(&mut self, what: impl Fn(&Value) -> bool) -> Value {
        loop {
            let status = self.until("status");
            if what(&status) {
                return status;
            }
        }
    }
}
