//! The page in front of the firmware's ELF on the virtual board.

use servoctl::cli::drive::Link;
use servoctl::link::virtual_drive;
use servoctl::scope::Scope;

use crate::browser::Browser;

/// Started for this test, ended with it.
struct Background;

impl Drop for Background {
    fn drop(&mut self) {
        let _ = virtual_drive::stop();
    }
}

#[test]
#[ignore = "needs the virtual drive and Chromium: cargo xtask test --only scope"]
fn a_click_moves_the_virtual_drive() {
    let _background = Background;
    let link = Link { virtual_drive: true, ..Link::default() };
    let connect = Box::new(move || link.connect());
    let scope = Scope::start(connect, "127.0.0.1:0".parse().unwrap(), None).unwrap();
    let mut page = Browser::open(scope.url(), [1280, 900]);
    page.wait_text("#state", "Switch on disabled");
    page.wait_text("#simulated", "simulated");
    page.click("#enable");
    page.wait_text("#state", "Operation enabled");
    page.click("#niasa + span");
    page.wait("document.querySelector('#compensator').value === 'niasa'");
    page.click("#jog-forward");
    page.wait_text("#moves tbody", "niasa");
    page.wait("document.querySelector('#settling').dataset.samples === '4400'");
    // A parameter is changed and saved.
    page.click("#disable");
    page.wait_text("#state", "Switch on disabled");
    page.eval("for (const group of document.querySelectorAll('#parameters details')) group.open = true");
    page.enter("#parameter-niasa_time_constant_s", "0.02");
    page.wait("!document.querySelector('#unsaved').hidden");
    page.click("#save");
    page.wait("document.querySelector('#unsaved').hidden");
    // A fault, and cleared.
    page.enter("#parameter-following_error_max_m", "1e-7");
    page.wait("!document.querySelector('#unsaved').hidden");
    page.click("#enable");
    page.wait_text("#state", "Operation enabled");
    page.click("#move-to");
    page.wait_text("#fault h2", "Fault 7: following error");
    page.click("#load");
    page.wait("document.querySelector('#unsaved').hidden");
    page.click("#clear-fault");
    page.wait("document.querySelector('#fault').hidden");
    if let Some(directory) = std::env::var_os("SCOPE_PICTURES") {
        page.picture(&std::path::Path::new(&directory).join("virtual.png"));
    }
}
