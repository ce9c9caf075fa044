//! A cable between the program and the virtual drive, and what happens when it is pulled.

use std::io::{Read, Write};
use std::net::{TcpListener, TcpStream};
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicU8, Ordering};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use serialport::{SerialPort, TTYPort};

use crate::{
    at, done, done_by, fault_within, first_line, json, json_by, refused_by, spoken_up_to, status_once, under_way,
};

/// What the program has in front of it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Kind {
    Tcp,
    /// A pseudo-terminal, which to the program is a serial device.
    Serial,
}

/// What becomes of it.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Cut {
    /// Nothing comes any more, and nobody says why.
    Silent,
    /// The system notices.
    Noticed,
}

const WHOLE: u8 = 0;
const SILENT: u8 = 1;
const ENDED: u8 = 2;

pub struct Cable {
    /// For `--port`.
    pub address: String,
    state: Arc<AtomicU8>,
    thread: Option<JoinHandle<()>>,
}

impl Cable {
    /// To the drive at `tcp://…`.
    pub fn new(kind: Kind, drive: &str) -> Cable {
        let state = Arc::new(AtomicU8::new(WHOLE));
        let (drive, until) = (drive.trim_start_matches("tcp://").to_owned(), state.clone());
        let (address, thread) = match kind {
            Kind::Tcp => {
                let listener = TcpListener::bind("127.0.0.1:0").unwrap();
                let address = format!("tcp://localhost:{}", listener.local_addr().unwrap().port());
                listener.set_nonblocking(true).unwrap();
                (address, thread::spawn(move || serve(&listener, &drive, &until)))
            }
            Kind::Serial => {
                let (mut near, far) = TTYPort::pair().unwrap();
                let address = far.name().unwrap();
                drop(far);
                near.set_timeout(Duration::from_millis(1)).unwrap();
                let drive = connect(&drive);
                (address, thread::spawn(move || carry(Kind::Serial, near, drive, &until)))
            }
        };
        Cable { address, state, thread: Some(thread) }
    }

    fn pull(&mut self, cut: Cut) {
        match cut {
            Cut::Silent => self.state.store(SILENT, Ordering::Relaxed),
            Cut::Noticed => self.end(),
        }
    }

    fn end(&mut self) {
        self.state.store(ENDED, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            thread.join().unwrap();
        }
    }
}

impl Drop for Cable {
    fn drop(&mut self) {
        self.end();
    }
}

fn connect(address: &str) -> TcpStream {
    let stream = TcpStream::connect(address).unwrap();
    stream.set_nodelay(true).unwrap();
    stream.set_read_timeout(Some(Duration::from_millis(1))).unwrap();
    stream
}

/// One client after the other, each with a connection of its own to the drive.
fn serve(listener: &TcpListener, drive: &str, state: &AtomicU8) {
    while state.load(Ordering::Relaxed) != ENDED {
        if let Ok((near, _)) = listener.accept() {
            near.set_nonblocking(false).unwrap();
            near.set_read_timeout(Some(Duration::from_millis(1))).unwrap();
            carry(Kind::Tcp, near, connect(drive), state);
        }
        thread::sleep(Duration::from_millis(1));
    }
}

/// Bytes both ways, until one end has gone.
fn carry(kind: Kind, mut near: impl Read + Write, mut drive: TcpStream, state: &AtomicU8) {
    let mut bytes = [0; 4096];
    loop {
        match state.load(Ordering::Relaxed) {
            WHOLE => {}
            SILENT => {
                thread::sleep(Duration::from_millis(1));
                continue;
            }
            _ => return,
        }
        match near.read(&mut bytes) {
            Ok(length) if length > 0 => drive.write_all(&bytes[..length]).unwrap(),
            Ok(_) if kind == Kind::Tcp => return,
            // A terminal that nobody has open reads as an error or as nothing.
            _ => {}
        }
        match drive.read(&mut bytes) {
            Ok(0) => return,
            // On a serial line nobody hears what comes while no program has the terminal open.
            Ok(length) if near.write_all(&bytes[..length]).is_err() && kind == Kind::Tcp => return,
            _ => {}
        }
    }
}

/// The drive behind a cable is known to be simulated, and how it settles is reported the same.
pub fn a_virtual_drive_says_so_whatever_leads_to_it(drive: &str) {
    for kind in [Kind::Tcp, Kind::Serial] {
        let cable = Cable::new(kind, drive);
        let info = json_by(at(&cable.address, "info"));
        assert_eq!((&info["board"], &info["simulated"]), (&"NUCLEO-H743ZI2".into(), &true.into()), "{info}");
        let text = done_by(at(&cable.address, "move 100um"));
        assert!(text.contains("simulated (firmware on the virtual STM32H743)"), "{text}");
    }
}

/// On a serial device the system refuses it.
pub fn a_second_client_of_a_serial_port_is_told_why(drive: &str) {
    let cable = Cable::new(Kind::Serial, drive);
    let (mut first, _line) = first_line(at(&cable.address, "watch position"));
    refused_by(at(&cable.address, "status"), &[&cable.address, "another program has it open"]);
    first.kill().unwrap();
    first.wait().unwrap();
    json_by(at(&cable.address, "status"));
}

/// The program says so within a second, and the drive ends the move by its command time-out.
pub fn a_pulled_cable_is_reported_within_a_second_and_ends_the_move(drive: &str) {
    json("params set command_timeout_s 200ms");
    // That the system takes the device away: `serial_port.rs`. Here the program itself would keep the far end of the terminal open.
    for (kind, cut, says) in [
        (Kind::Tcp, Cut::Silent, "no reply to Status"),
        (Kind::Tcp, Cut::Noticed, "the other side closed the connection"),
        (Kind::Serial, Cut::Silent, "no reply to Status"),
    ] {
        let mut cable = Cable::new(kind, drive);
        let (mut child, mut said) = under_way(at(&cable.address, "move -40mm --velocity 1mm/s"));
        thread::sleep(Duration::from_millis(300));
        let pulled = Instant::now();
        cable.pull(cut);
        assert_eq!(child.wait().unwrap().code(), Some(1));
        let reported = pulled.elapsed();
        let mut words = String::new();
        said.read_to_string(&mut words).unwrap();
        println!("{kind:?}, {cut:?}: reported after {reported:?}");
        // Within a second on the drive's own clock: `virtual-board/tests/link_faults.rs`. Here the computer may be busy.
        assert!(reported < Duration::from_secs(5), "{kind:?}, {cut:?}: {reported:?}");
        for part in [says, "the drive ends the move by itself: its command_timeout_s is 0.2 s"] {
            assert!(words.contains(part), "{kind:?}, {cut:?}: {words}");
        }
        drop(cable);
        fault_within(19);
        assert_eq!(json("status")["moving"], false);
        json("faults clear");
    }
    json("params set command_timeout_s 0");
}

/// A new drive has no command time-out; while it is commissioned it has one.
pub fn a_pulled_cable_ends_a_commissioning_on_the_drive_too(drive: &str, report: &Path) {
    assert_eq!(json("params get command_timeout_s")["command_timeout_s"], 0.0);
    let mut cable = Cable::new(Kind::Tcp, drive);
    let words = format!("commission --output {}", report.display());
    let (mut child, mut lines, _) = spoken_up_to("plant: 10 %", at(&cable.address, &words));
    cable.pull(Cut::Silent);
    assert_eq!(child.wait().unwrap().code(), Some(1));
    let said: String = lines.by_ref().map_while(Result::ok).collect();
    let report = std::fs::read_to_string(report).unwrap().replace('\u{a0}', " ");
    for part in ["whether the bridge is off is NOT known", "for 1.5 s the drive turns it off by itself (fault 19)"] {
        assert!(said.contains(part) && report.contains(part), "{said}");
    }
    drop(cable);
    fault_within(19);
    status_once(|status| status["state"] == "Fault" && status["moving"] == false);
    done("faults clear");
    done("params load");
    assert_eq!(json("params get command_timeout_s")["command_timeout_s"], 0.0);
}
