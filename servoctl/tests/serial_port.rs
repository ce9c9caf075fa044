//! A real serial device (a pseudo-terminal) with a drive's end of the protocol behind it: found, asked, held, pulled.
#![cfg(unix)]

use std::io::{Read, Write};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use serialport::{SerialPort, TTYPort};
use servo_protocol::frame::{MAX_FRAME, encode};
use servo_protocol::message::{Identity, PROTOCOL, Reply, Request};
use servo_protocol::server::{Incoming, Server};
use servoctl::link::{Client, Drive, Error, Patience, open};

/// Answers requests for the identity until the cable is pulled.
struct Far {
    device: String,
    pulled: Arc<AtomicBool>,
    thread: JoinHandle<()>,
}

impl Far {
    fn new() -> Far {
        let (mut master, slave) = TTYPort::pair().unwrap();
        let device = slave.name().unwrap();
        // Open for the servoctl to come; the device stays while its other end does.
        drop(slave);
        let pulled = Arc::new(AtomicBool::new(false));
        let until = pulled.clone();
        master.set_timeout(Duration::from_millis(10)).unwrap();
        let thread = thread::spawn(move || {
            let mut server = Server::default();
            let mut bytes = [0; 256];
            while !until.load(Ordering::Relaxed) {
                // Nothing there, or nobody.
                let received = master.read(&mut bytes).unwrap_or(0);
                for byte in &bytes[..received] {
                    if let Some(Incoming::Fresh { id, request: Request::Identity }) = server.push(*byte) {
                        master.write_all(&answer(id)).unwrap();
                    }
                }
            }
        });
        Far { device, pulled, thread }
    }

    fn pull(self) {
        self.pulled.store(true, Ordering::Relaxed);
        self.thread.join().unwrap();
    }
}

fn answer(id: u32) -> Vec<u8> {
    let board = "terminal".try_into().unwrap();
    let identity = Identity { protocol: PROTOCOL, firmware: [0, 1, 0], program: 0, board, serial: [0; 3] };
    let mut frame = [0; MAX_FRAME];
    let length = encode(id, &Reply::Identity(identity), &mut frame).unwrap();
    frame[..length].to_vec()
}

/// As patient as a computer may need that has other things to do.
fn connect(device: &str) -> Result<Drive, Error> {
    Drive::connect(Client::new(open(device)?, Patience::TCP, 1))
}

#[test]
fn a_second_client_is_told_that_another_one_has_the_port() {
    let far = Far::new();
    let first = connect(&far.device).unwrap();
    assert_eq!(first.identity().board, "terminal");
    let Err(error) = connect(&far.device) else { panic!("two clients at one port") };
    let words = error.to_string();
    assert!(words.contains(&far.device) && words.contains("another program has it open"), "{words}");
    // And when the first one has ended, it is free.
    drop(first);
    assert!(connect(&far.device).is_ok());
}

#[test]
fn a_pulled_cable_breaks_the_link_at_once() {
    let far = Far::new();
    let mut client = Client::new(open(&far.device).unwrap(), Patience::TCP, 1);
    assert!(matches!(client.request(&Request::Identity), Ok(Reply::Identity(_))));
    far.pull();
    let error = client.request(&Request::Identity).unwrap_err();
    assert!(matches!(error, Error::Broken(_)), "{error}");
}

#[test]
fn a_cable_pulled_while_an_answer_is_waited_for_breaks_the_link_at_once() {
    let far = Far::new();
    let mut client = Client::new(open(&far.device).unwrap(), Patience::TCP, 1);
    let pulled = thread::spawn(move || {
        thread::sleep(Duration::from_millis(100));
        far.pull();
        Instant::now()
    });
    // It is never answered.
    let error = client.request(&Request::Status).unwrap_err();
    let reported = pulled.join().unwrap().elapsed();
    assert!(matches!(error, Error::Broken(_)), "{error}");
    assert!(reported < Duration::from_secs(5), "{reported:?}");
}

#[test]
fn a_device_that_is_not_there_is_named_with_what_to_do() {
    let Err(error) = open("/dev/no-such-drive") else { panic!("there is no such device") };
    let words = error.to_string();
    assert!(words.starts_with("/dev/no-such-drive: ") && words.contains("`servoctl ports`"), "{words}");
}
