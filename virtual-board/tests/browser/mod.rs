//! Headless Chromium through its debugging protocol: as much of it as the page's test needs.

use std::cell::RefCell;
use std::net::TcpStream;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::rc::Rc;
use std::time::{Duration, Instant};

use serde_json::{Value, json};
use tempfile::TempDir;
use tungstenite::{Message, WebSocket};

/// The virtual drive is slower than the clock, and the computer may be busy.
const PATIENCE: Duration = Duration::from_secs(240);
const LOOK: Duration = Duration::from_millis(100);

/// A browser with a profile of its own.
pub struct Browser {
    child: Child,
    line: Rc<RefCell<Line>>,
    _profile: TempDir,
}

struct Line {
    socket: WebSocket<TcpStream>,
    next: u64,
    requests: Vec<String>,
}

/// A page in it.
pub struct Page {
    line: Rc<RefCell<Line>>,
    session: String,
}

impl Line {
    fn call(&mut self, session: Option<&str>, method: &str, params: &Value) -> Value {
        self.next += 1;
        let mut call = json!({ "id": self.next, "method": method, "params": params });
        if let Some(session) = session {
            call["sessionId"] = session.into();
        }
        self.socket.send(Message::text(call.to_string())).unwrap();
        loop {
            let Message::Text(text) = self.socket.read().unwrap() else { continue };
            let message: Value = serde_json::from_str(&text).unwrap();
            if message["id"] == self.next {
                assert!(message["error"].is_null(), "{method}: {}", message["error"]);
                return message["result"].clone();
            }
            let url = match message["method"].as_str() {
                Some("Network.requestWillBeSent") => &message["params"]["request"]["url"],
                Some("Network.webSocketCreated") => &message["params"]["url"],
                _ => continue,
            };
            self.requests.extend(url.as_str().map(str::to_owned));
        }
    }
}

impl Browser {
    /// Starts Debian's Chromium, or what CHROMIUM names.
    pub fn start() -> Browser {
        let profile = tempfile::tempdir().unwrap();
        let program = std::env::var("CHROMIUM").unwrap_or_else(|_| "chromium".to_owned());
        let child = Command::new(&program)
            .args(["--headless", "--no-sandbox", "--disable-gpu", "--no-first-run", "--remote-debugging-port=0"])
            .arg(format!("--user-data-dir={}", profile.path().display()))
            .args(["--disable-background-networking", "--disable-component-update", "--disable-sync", "about:blank"])
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .unwrap_or_else(|error| panic!("{program}: {error}; `cargo xtask test` installs it"));
        let file = profile.path().join("DevToolsActivePort");
        let started = Instant::now();
        let (port, path) = loop {
            let text = std::fs::read_to_string(&file).unwrap_or_default();
            if let Some((port, path)) = text.split_once('\n').filter(|(_, path)| !path.is_empty()) {
                break (port.to_owned(), path.to_owned());
            }
            assert!(started.elapsed() < PATIENCE, "{program} does not start");
            std::thread::sleep(LOOK);
        };
        let stream = TcpStream::connect(format!("127.0.0.1:{port}")).unwrap();
        let (socket, _) = tungstenite::client(format!("ws://127.0.0.1:{port}{path}"), stream).unwrap();
        let line = Line { socket, next: 0, requests: Vec::new() };
        Browser { child, line: Rc::new(RefCell::new(line)), _profile: profile }
    }

    /// Opens a page.
    pub fn open(&mut self, url: &str) -> Page {
        let mut line = self.line.borrow_mut();
        let target = line.call(None, "Target.createTarget", &json!({ "url": "about:blank" }));
        let attach = json!({ "targetId": target["targetId"], "flatten": true });
        let session = line.call(None, "Target.attachToTarget", &attach)["sessionId"].as_str().unwrap().to_owned();
        line.call(Some(&session), "Network.enable", &json!({}));
        line.call(Some(&session), "Page.enable", &json!({}));
        line.call(Some(&session), "Page.navigate", &json!({ "url": url }));
        Page { line: self.line.clone(), session }
    }

    /// Addresses of everything that pages have asked for.
    pub fn requests(&self) -> Vec<String> {
        self.line.borrow().requests.clone()
    }
}

impl Drop for Browser {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

impl Page {
    fn call(&mut self, method: &str, params: &Value) -> Value {
        self.line.borrow_mut().call(Some(&self.session), method, params)
    }

    /// The value of an expression in the page.
    pub fn eval(&mut self, expression: &str) -> Value {
        let result = self.call("Runtime.evaluate", &json!({ "expression": expression, "returnByValue": true }));
        result["result"]["value"].clone()
    }

    /// Waits until an expression is true.
    pub fn wait_for(&mut self, expression: &str) {
        let started = Instant::now();
        while self.eval(expression) != true {
            let seen = "[document.getElementById('state')?.textContent, document.getElementById('message')?.textContent].join(' | ')";
            assert!(started.elapsed() < PATIENCE, "never: {expression}; the page says {}", self.eval(seen));
            std::thread::sleep(LOOK);
        }
    }

    /// Clicks in the middle of the element, as a mouse does.
    pub fn click(&mut self, selector: &str) {
        let place = format!(
            "(() => {{ const e = document.querySelector(`{selector}`); e.scrollIntoView({{ block: 'center' }}); \
             const r = e.getBoundingClientRect(); return [r.x + r.width / 2, r.y + r.height / 2]; }})()"
        );
        let place = self.eval(&place);
        for kind in ["mousePressed", "mouseReleased"] {
            let event = json!({ "type": kind, "x": place[0], "y": place[1], "button": "left", "clickCount": 1 });
            self.call("Input.dispatchMouseEvent", &event);
        }
    }

    /// Gives a field another value and leaves it.
    pub fn fill(&mut self, selector: &str, value: &str) {
        self.eval(&format!(
            "(() => {{ const e = document.querySelector(`{selector}`); e.value = `{value}`; \
             e.dispatchEvent(new Event('change', {{ bubbles: true }})); }})()"
        ));
    }

    /// Presses the space bar, the focus being nowhere.
    pub fn press_space(&mut self) {
        self.eval("document.activeElement?.blur()");
        for kind in ["keyDown", "keyUp"] {
            self.call("Input.dispatchKeyEvent", &json!({ "type": kind, "key": " ", "code": "Space", "text": " " }));
        }
    }

    /// Leaves a picture of the page, this many pixels wide and high, in the target directory.
    pub fn screenshot(&mut self, name: &str, width: u32, height: u32) {
        let metrics = json!({ "width": width, "height": height, "deviceScaleFactor": 1, "mobile": width < 600 });
        self.call("Emulation.setDeviceMetricsOverride", &metrics);
        std::thread::sleep(Duration::from_secs(1));
        let picture = self.call("Page.captureScreenshot", &json!({ "format": "png" }));
        let bytes = decode(picture["data"].as_str().unwrap());
        assert!(self.eval("document.documentElement.scrollWidth <= window.innerWidth") == true, "{name}: too wide");
        std::fs::write(Path::new(env!("CARGO_TARGET_TMPDIR")).join(name), bytes).unwrap();
        self.call("Emulation.clearDeviceMetricsOverride", &json!({}));
    }
}

/// Base64.
fn decode(text: &str) -> Vec<u8> {
    let digit = |c: u8| match c {
        b'A'..=b'Z' => u32::from(c - b'A'),
        b'a'..=b'z' => u32::from(c - b'a') + 26,
        b'0'..=b'9' => u32::from(c - b'0') + 52,
        b'+' => 62,
        _ => 63,
    };
    let digits: Vec<u32> = text.bytes().filter(|c| *c != b'=').map(digit).collect();
    let group = |four: &[u32]| {
        let word = four.iter().fold(0, |word, digit| word << 6 | digit) << (6 * (4 - four.len()));
        word.to_be_bytes()[1..four.len()].to_vec()
    };
    digits.chunks(4).flat_map(group).collect()
}
