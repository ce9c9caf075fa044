//! The scope's page in a real browser, headless, on the virtual drive.

mod browser;

use std::io::{Read, Write};
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::sync::OnceLock;
use std::sync::mpsc::channel;
use std::time::Duration;

use browser::{Browser, Page};
use servo_host_tests::tuning;
use servo_sim::Stage;
use servo_virtual_board::serve::{Service, serve};
use servo_virtual_board::{Config, Elf, VirtualBoard, flash};
use servoctl::cli::drive::Link;
use servoctl::scope::{self, Hub};

/// A virtual drive and the scope's server in this process, for all tests: where the page is.
fn scope() -> SocketAddr {
    static SCOPE: OnceLock<SocketAddr> = OnceLock::new();
    *SCOPE.get_or_init(|| {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let drive = listener.local_addr().unwrap();
        std::thread::spawn(move || {
            let parameters = flash::saved(&tuning::settings(&Stage::default(), &tuning::STANDARD).unwrap());
            let config = Config { parameters, ..Config::default() };
            let mut board = VirtualBoard::boot(&Elf::find(None).unwrap(), &config).unwrap();
            board.run_for(Duration::from_millis(150)).unwrap();
            let service = Service { log: None, while_exists: None, idle: Duration::MAX, runs_on: false };
            serve(&mut board, &listener, &service).unwrap();
        });
        let (told, address) = channel();
        std::thread::spawn(move || {
            let link = Link { port: Some(format!("tcp://{drive}")), virtual_drive: false };
            let hub = Hub::start(link.connect().unwrap()).unwrap();
            let settings = scope::Settings { listen: "127.0.0.1:0".parse().unwrap(), remote_token: None };
            let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
            runtime.block_on(scope::serve(hub, settings, |page| told.send(page.to_owned()).unwrap())).unwrap();
        });
        let page = address.recv().unwrap();
        page.trim_start_matches("http://").trim_end_matches('/').parse().unwrap()
    })
}

fn settled_rows(page: &mut Page) -> f64 {
    page.eval("document.querySelector('#settled tbody').rows.length").as_f64().unwrap()
}

#[test]
fn a_person_moves_edits_sees_a_fault_and_clears_it_and_a_second_browser_only_looks() {
    let mut browser = Browser::start();
    let address = scope();
    let mut page = browser.open(&format!("http://{address}/"));
    page.wait_for("document.getElementById('drive').textContent.includes('NUCLEO-H743ZI2')");
    page.wait_for("typeof uPlot === 'function'");

    page.click("[data-do=enable]");
    page.wait_for("document.getElementById('state').textContent.startsWith('Operation enabled')");
    page.wait_for("document.getElementById('commander').textContent === 'you command'");

    // A move by a click, its trace and its settling, without NIASA and with it.
    page.fill("#target", "100µm");
    page.click("#move button");
    page.wait_for("document.querySelector('#settled tbody').rows.length === 1");
    page.wait_for("plots.settle.data[0].length === 2000 && plots.loop.data[2][0].length === 2000");
    page.wait_for("plots.error.data[0].length > 20");
    page.fill("#compensator", "1");
    page.wait_for("document.getElementById('message').textContent === 'compensator = 1'");
    page.fill("#target", "0µm");
    page.click("#move button");
    page.wait_for("document.querySelector('#settled tbody').rows.length === 2");
    page.screenshot("scope-desktop.png", 1280, 1900);
    page.screenshot("scope-phone.png", 390, 3600);

    // A parameter: taken, refused with its range.
    page.fill("[data-name=niasa_time_constant_s]", "20ms");
    page.wait_for("document.getElementById('message').textContent === 'niasa_time_constant_s = 20ms'");
    page.wait_for("document.querySelector('[data-name=niasa_time_constant_s]').value === '0.02'");
    page.fill("[data-name=niasa_time_constant_s]", "1000");
    page.wait_for("document.getElementById('message').textContent.includes('outside 0.0001 … 10 s')");

    // Another browser looks and is told why it may not do more; it may stop.
    let mut other = browser.open(&format!("http://{address}/"));
    other.wait_for("document.getElementById('commander').textContent.includes('you look')");
    other.click("[data-do=disable]");
    other.wait_for("document.getElementById('message').textContent.includes('commands this drive')");
    other.press_space();
    other.wait_for("document.getElementById('message').textContent === 'braking'");
    drop(other);

    // A fault: a limit so narrow that the next move cannot keep it.
    page.fill("[data-name=following_error_max_m]", "0.2µm");
    page.wait_for("document.getElementById('message').textContent === 'following_error_max_m = 0.2µm'");
    page.click("[data-jog='1mm']");
    page.wait_for("!document.getElementById('fault').hidden");
    assert!(page.eval("document.getElementById('fault').textContent").as_str().unwrap().contains("Fault"));
    page.click("[data-do=clear]");
    page.wait_for("document.getElementById('fault').hidden");
    assert_eq!(settled_rows(&mut page), 2.0, "the interrupted move has not settled");

    let beyond: Vec<String> = browser.requests().into_iter().filter(|url| !is_ours(url, address)).collect();
    assert!(beyond.is_empty(), "left loopback: {beyond:?}");
}

fn is_ours(url: &str, address: SocketAddr) -> bool {
    [format!("http://{address}/"), format!("ws://{address}/"), "data:".to_owned(), "about:".to_owned()]
        .iter()
        .any(|own| url.starts_with(own))
}

/// The status line of a reply to a bare request.
fn status_line(request: &str) -> String {
    let mut stream = TcpStream::connect(scope()).unwrap();
    stream.write_all(request.as_bytes()).unwrap();
    let (mut reply, mut bytes) = (Vec::new(), [0; 256]);
    while !reply.contains(&b'\n') {
        let length = stream.read(&mut bytes).unwrap();
        assert!(length > 0, "closed without a reply");
        reply.extend(&bytes[..length]);
    }
    String::from_utf8_lossy(&reply).lines().next().unwrap().to_owned()
}

#[test]
fn other_pages_cannot_command_the_drive() {
    let address = scope();
    let mut page = TcpStream::connect(address).unwrap();
    write!(page, "GET / HTTP/1.1\r\nHost: {address}\r\nConnection: close\r\n\r\n").unwrap();
    let mut text = String::new();
    page.read_to_string(&mut text).unwrap();
    let token = text.split("name=\"token\" content=\"").nth(1).unwrap()[..32].to_owned();

    let link = |host: &str, origin: &str, token: &str| {
        status_line(&format!(
            "GET /link?token={token} HTTP/1.1\r\nHost: {host}\r\nOrigin: {origin}\r\nConnection: Upgrade\r\nUpgrade: websocket\r\n\
             Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\r\n"
        ))
    };
    let (host, origin) = (address.to_string(), format!("http://{address}"));
    assert!(link(&host, &origin, &token).contains("101"), "the page itself is let in");
    for (host, origin, token) in [
        (host.as_str(), "http://evil.example", token.as_str()),
        (&host, "null", &token),
        (&host, &origin, "0123456789abcdef0123456789abcdef"),
        (&host, &origin, ""),
        ("evil.example", "http://evil.example", &token),
    ] {
        let line = link(host, origin, token);
        assert!(line.contains("403"), "{host} {origin}: {line}");
    }
    let line = status_line("GET / HTTP/1.1\r\nHost: evil.example\r\n\r\n");
    assert!(line.contains("403"), "the token is not shown to a foreign name: {line}");
}
