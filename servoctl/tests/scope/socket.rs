//! A page without a browser: its WebSocket alone.

use std::io::ErrorKind;
use std::net::TcpStream;
use std::sync::mpsc::{Receiver, Sender, TryRecvError, channel};
use std::thread;
use std::time::Duration;

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

/// A page that has said hello. As in a browser, pings are answered whatever the page is doing: a thread sees to it, so that a
/// test that looks at another page for long has not gone away from this one.
pub struct Page {
    said: Receiver<Value>,
    to_say: Sender<Value>,
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
        let MaybeTlsStream::Plain(stream) = socket.get_ref() else { panic!("ws:// is not encrypted") };
        stream.set_read_timeout(Some(Duration::from_millis(5))).unwrap();
        let ((hears, said), (to_say, says)) = (channel(), channel());
        thread::spawn(move || converse(socket, &token, &hears, &says));
        Page { said, to_say }
    }

    /// The next message.
    pub fn next(&mut self) -> Value {
        self.said.recv().expect("the server has closed the socket")
    }

    /// Sends an action and returns the reason why it was not done, or nothing.
    pub fn order(&mut self, action: Value) -> Option<String> {
        self.to_say.send(action).expect("the server has closed the socket");
        self.until("answer")["error"].as_str().map(str::to_owned)
    }

    /// The next message of this kind.
    pub fn until(&mut self, kind: &str) -> Value {
        loop {
            let said = self.next();
            if said["kind"] == kind {
                return said;
            }
        }
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

/// Says what the page wants said and hears what the server says, until one of them has gone.
fn converse(mut socket: Socket, token: &str, hears: &Sender<Value>, says: &Receiver<Value>) {
    loop {
        match says.try_recv() {
            Ok(action) => say(&mut socket, token, action),
            Err(TryRecvError::Empty) => {}
            Err(TryRecvError::Disconnected) => return,
        }
        match socket.read() {
            Ok(Message::Text(text)) => {
                if hears.send(serde_json::from_str(&text).unwrap()).is_err() {
                    return;
                }
            }
            Ok(_) => {}
            Err(Error::Io(error)) if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) => {}
            Err(_) => return,
        }
    }
}
