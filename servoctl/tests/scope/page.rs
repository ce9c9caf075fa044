//! What a person does with the page.

use std::path::PathBuf;
use std::sync::atomic::Ordering;

use crate::browser::Browser;
use crate::{parts, scope};

const DESKTOP: [u32; 2] = [1280, 900];
const PHONE: [u32; 2] = [390, 844];

/// The page, once the drive is seen.
fn open(url: &str, size: [u32; 2]) -> Browser {
    let mut page = Browser::open(url, size);
    page.wait_text("#state", "Switch on disabled");
    page
}

fn enable(page: &mut Browser) {
    page.click("#enable");
    page.wait_text("#state", "Operation enabled");
}

fn choose(page: &mut Browser, list: &str, option: &str) {
    page.eval(&format!(
        "(() => {{ const list = document.querySelector({list:?}); list.value = {option:?}; \
         list.dispatchEvent(new Event('change')); return list.value }})()"
    ));
}

fn jog(page: &mut Browser, step: &str, button: &str) {
    choose(page, "#step", step);
    page.click(button);
}

/// Pixels of a plot that have about the colour of the first trace.
fn drawn(page: &mut Browser, plot: &str) -> u64 {
    let count = format!(
        "(() => {{ const canvas = document.querySelector('{plot} canvas'); \
         const c = getComputedStyle(document.documentElement).getPropertyValue('--c0').trim(); \
         const [r, g, b] = [1, 3, 5].map((i) => parseInt(c.slice(i, i + 2), 16)); \
         const data = canvas.getContext('2d').getImageData(0, 0, canvas.width, canvas.height).data; let n = 0; \
         for (let i = 0; i < data.length; i += 4) \
         if (data[i + 3] > 128 && Math.abs(data[i] - r) + Math.abs(data[i + 1] - g) + Math.abs(data[i + 2] - b) < 60) n++; \
         return n }})()"
    );
    page.eval(&count).as_u64().unwrap()
}

fn position_mm(page: &mut Browser) -> f64 {
    let text = page.text("#position").replace('−', "-");
    text.trim_end_matches(" mm").parse().unwrap()
}

/// Where pictures go, if somebody wants to look at them.
fn pictures() -> Option<PathBuf> {
    std::env::var_os("SCOPE_PICTURES").map(PathBuf::from)
}

/// Pictures of the page as it is now: desktop and phone, light and dark.
fn picture(page: &mut Browser, name: &str) {
    let Some(directory) = pictures() else { return };
    for (size, width) in [(PHONE, "phone"), (DESKTOP, "desktop")] {
        for scheme in ["dark", "light"] {
            page.resize(size);
            page.scheme(scheme);
            page.eval("scrollTo(0, 0); new Promise((end) => setTimeout(end, 500))");
            page.picture(&directory.join(format!("{name}-{width}-{scheme}.png")));
        }
    }
}

#[test]
#[ignore = "needs Chromium: cargo xtask test --only scope"]
fn a_click_moves_the_drive_and_the_traces_show_it() {
    let (scope, _cable) = scope();
    let (address, token) = parts(&scope);
    let mut page = open(scope.url(), DESKTOP);
    assert!(!page.eval("location.href").as_str().unwrap().contains(&token), "the token stays in sight");
    picture(&mut page, "empty");
    enable(&mut page);
    jog(&mut page, "1 mm", "#jog-forward");
    page.wait_text("#moves", "1 mm");
    let position_mm = position_mm(&mut page);
    assert!((position_mm - 1.0).abs() < 1e-4, "{position_mm} mm");
    // Half a second at the full 8 kHz from the end of the profile on, and a tenth of it before.
    page.wait("document.querySelector('#settling').dataset.samples === '4400'");
    for plot in ["#live", "#settling", "#loop"] {
        page.wait(&format!("Number(document.querySelector('{plot}').dataset.samples) > 10"));
        assert!(drawn(&mut page, plot) > 50, "{plot} shows no trace");
    }
    page.wait_text("#settling-caption", "move 1, pid");

    // With NIASA: the table puts both beside each other.
    page.click("#niasa + span");
    page.wait("document.querySelector('#compensator').value === 'niasa'");
    page.click("#jog-back");
    page.wait_text("#statistics", "niasa");
    assert!(page.text("#statistics").contains("pid, ms"), "{}", page.text("#statistics"));
    page.wait_text("#settling-caption", "move 2, niasa");

    let elsewhere: Vec<_> = page
        .requests
        .iter()
        .filter(|url| !["http://", "ws://"].iter().any(|scheme| url.starts_with(&format!("{scheme}{address}/"))))
        .filter(|url| !url.starts_with("data:") && *url != "about:blank")
        .collect();
    assert!(elsewhere.is_empty(), "{elsewhere:?}");
    assert!(page.requests.iter().any(|url| *url == format!("ws://{address}/ws")), "{:?}", page.requests);
    assert_eq!(page.complaints, Vec::<String>::new());
    // And it could not if it wanted to.
    let fetch = "fetch('http://192.0.2.1/').then(() => 'sent', (error) => error.message)";
    let blocked = "new Promise((end) => addEventListener('securitypolicyviolation', (e) => end(e.effectiveDirective)))";
    let both = format!("(() => {{ const blocked = {blocked}; {fetch}; return blocked }})()");
    assert_eq!(page.eval(&both), "connect-src");
}

/// What a button would download: the page hands a file to the browser, which is taken from it here.
fn downloaded(page: &mut Browser, button: &str) -> (Vec<String>, Vec<Vec<String>>) {
    page.eval(
        "window.file = null; URL.createObjectURL = (blob) => { blob.text().then((text) => { window.file = text }); return '#' }",
    );
    page.click(button);
    page.wait("window.file !== null");
    let text = page.eval("window.file");
    let (head, rows): (Vec<&str>, Vec<&str>) = text.as_str().unwrap().lines().partition(|line| line.starts_with('#'));
    let cells = |row: &str| row.split(',').map(str::to_owned).collect();
    (head.into_iter().map(str::to_owned).collect(), rows.into_iter().map(cells).collect())
}

#[test]
#[ignore = "needs Chromium: cargo xtask test --only scope"]
fn what_is_shown_can_be_taken_away_as_csv() {
    let (scope, _cable) = scope();
    let mut page = open(scope.url(), DESKTOP);
    enable(&mut page);
    jog(&mut page, "100 µm", "#jog-forward");
    page.wait_text("#moves", "100 µm");
    let number = |cell: &str| cell.parse::<f64>().unwrap_or_else(|_| panic!("{cell}"));

    let (head, rows) = downloaded(&mut page, "#capture-csv");
    for part in
        ["firmware 0.1.0", "on bench, simulated", "parameters ", "rate: 8000 Hz", "move 1, pid", "units: s, m, m, N"]
    {
        assert!(head.iter().any(|line| line.contains(part)), "{part} in {head:?}");
    }
    assert_eq!(rows[0], ["time_s", "error_m", "position_m", "force_n"]);
    assert_eq!(rows.len(), 4401);
    // A tenth of it from before the end of the profile; at the end in position, in metres.
    assert_eq!((number(&rows[1][0]), number(&rows[401][0])), (-0.05, 0.0));
    let last: Vec<f64> = rows[4400].iter().map(|cell| number(cell)).collect();
    assert!(last[1].abs() < 1e-6 && (last[2] + last[1] - 1e-4).abs() < 1e-9, "{last:?}");

    let (head, rows) = downloaded(&mut page, "#live-csv");
    assert!(head.iter().any(|line| line.contains("rate: 500 Hz")), "{head:?}");
    assert_eq!(rows[0], ["time_s", "error_m", "position_m", "force_n"]);
    let times_s: Vec<f64> = rows[1..].iter().map(|row| number(&row[0])).collect();
    assert!(times_s.len() > 500 && times_s.windows(2).all(|pair| pair[0] < pair[1]), "{}", times_s.len());

    let (_, rows) = downloaded(&mut page, "#moves-csv");
    assert_eq!(rows[0][..4], ["move", "distance_m", "compensator", "settling_3nm_ms"]);
    assert_eq!((rows.len(), rows[1][0].as_str(), rows[1][2].as_str()), (2, "1", "pid"));
    assert!((number(&rows[1][1]) - 1e-4).abs() < 1e-9, "{rows:?}");
}

#[test]
#[ignore = "needs Chromium: cargo xtask test --only scope"]
fn a_parameter_is_edited_within_its_range() {
    let (scope, _cable) = scope();
    let mut page = open(scope.url(), DESKTOP);
    page.eval("for (const group of document.querySelectorAll('#parameters details')) group.open = true");
    let field = "#parameter-niasa_time_constant_s";
    page.enter(field, "0.02");
    page.wait("!document.querySelector('#unsaved').hidden");
    page.wait(&format!("document.querySelector('{field}').value === '0.02'"));
    page.enter(field, "11");
    page.wait_text("#parameters-error", "niasa_time_constant_s = 11 s is outside 0.0001 … 10 s");
    // In range by itself, but not beside another one: the drive says so, and the page shows what is in use.
    page.enter("#parameter-bus_max_v", "2");
    page.wait_text("#notice", "is outside");
    page.wait("Number(document.querySelector('#parameter-bus_max_v').value) > 2");
    // With torque on, what needs the bridge off is refused in words.
    enable(&mut page);
    page.enter("#parameter-travel_max_m", "0.01");
    page.wait_text("#notice", "disable the drive first");
    // Another page sees the same.
    let mut other = open_any(scope.url());
    other.wait(&format!("document.querySelector('{field}')?.value === '0.02'"));
}

fn open_any(url: &str) -> Browser {
    let mut page = Browser::open(url, DESKTOP);
    page.wait("document.body.dataset.link === 'up'");
    page
}

#[test]
#[ignore = "needs Chromium: cargo xtask test --only scope"]
fn a_fault_is_explained_and_cleared() {
    let (scope, _cable) = scope();
    let mut page = open(scope.url(), DESKTOP);
    page.eval("for (const group of document.querySelectorAll('#parameters details')) group.open = true");
    page.enter("#parameter-following_error_max_m", "1e-7");
    page.wait("!document.querySelector('#unsaved').hidden");
    enable(&mut page);
    jog(&mut page, "5 mm", "#jog-forward");
    page.wait("!document.querySelector('#fault').hidden");
    assert_eq!(page.text("#fault h2"), "Fault 7: following error");
    assert_eq!(page.text("#fault .advice"), "Check for an obstacle, gains and limits.");
    page.wait_text("#state", "Fault");
    picture(&mut page, "fault");
    page.enter("#parameter-following_error_max_m", "2e-4");
    page.click("#clear-fault");
    page.wait("document.querySelector('#fault').hidden");
    page.wait_text("#state", "Switch on disabled");
    enable(&mut page);
}

#[test]
#[ignore = "needs Chromium: cargo xtask test --only scope"]
fn of_two_browsers_one_commands_and_the_other_sees_why_it_may_not() {
    let (scope, _cable) = scope();
    let mut first = open(scope.url(), DESKTOP);
    let mut second = open(scope.url(), DESKTOP);
    second.wait_text("#role", "Page 1 commands, this is page 2 of 2: it looks on.");
    assert_eq!(second.eval("[...document.querySelectorAll('.command')].every((element) => element.disabled)"), true);
    assert_eq!(first.eval("document.querySelector('#role').hidden"), true);
    enable(&mut first);
    second.wait_text("#state", "Operation enabled");
    // Whoever sees danger may stop.
    choose(&mut first, "#step", "5 mm");
    first.enter("#velocity", "0.5 mm/s");
    first.click("#jog-forward");
    second.wait_text("#state", "moving");
    picture(&mut second, "looks-on");
    second.click("#stop");
    second.wait("!document.querySelector('#state').textContent.includes('moving')");
    let position_mm = position_mm(&mut second);
    assert!(position_mm < 4.9, "{position_mm} mm");

    second.click("#take-over");
    first.wait_text("#role", "Page 2 commands, this is page 1 of 2");
    second.wait("document.querySelector('#role').hidden");
    second.click("#disable");
    first.wait_text("#state", "Switch on disabled");
    // The one that commands goes: the other is next.
    drop(second);
    first.wait("document.querySelector('#role').hidden");
    enable(&mut first);
}

#[test]
#[ignore = "needs Chromium: cargo xtask test --only scope"]
fn a_browser_that_goes_away_in_mid_move_stops_the_drive() {
    let (scope, _cable) = scope();
    let mut first = open(scope.url(), DESKTOP);
    let mut second = open(scope.url(), DESKTOP);
    enable(&mut first);
    first.enter("#velocity", "1 mm/s");
    jog(&mut first, "5 mm", "#jog-forward");
    second.wait_text("#state", "moving");
    drop(first);
    second.wait("!document.querySelector('#state').textContent.includes('moving')");
    let position_mm = position_mm(&mut second);
    assert!(position_mm < 4.9, "{position_mm} mm");
}

#[test]
#[ignore = "needs Chromium: cargo xtask test --only scope"]
fn space_stops_wherever_the_focus_is() {
    let (scope, _cable) = scope();
    let mut page = open(scope.url(), DESKTOP);
    enable(&mut page);
    page.enter("#velocity", "1 mm/s");
    for focus in ["#target", "#jog-forward", "#compensator", "#filter"] {
        jog(&mut page, "5 mm", "#jog-forward");
        page.wait_text("#state", "moving");
        page.eval(&format!("document.querySelector('{focus}').focus()"));
        page.press(" ", "Space", 32, " ");
        page.wait("!document.querySelector('#state').textContent.includes('moving')");
    }
    assert!(position_mm(&mut page) < 15.0, "four moves of 5 mm, each cut short");
    assert_eq!(page.eval("document.querySelector('#target').value"), "5 mm", "no blank in the field");
}

#[test]
#[ignore = "needs Chromium: cargo xtask test --only scope"]
fn a_pulled_cable_is_said_and_a_new_one_is_found() {
    let (scope, cable) = scope();
    let mut page = open(scope.url(), DESKTOP);
    cable.store(true, Ordering::Relaxed);
    page.wait_text("#link-trouble", "the cable was pulled");
    page.wait("!document.querySelector('#link-trouble').hidden");
    assert_eq!(page.eval("document.querySelector('#enable').disabled"), true);
    picture(&mut page, "pulled");
    cable.store(false, Ordering::Relaxed);
    page.wait("document.querySelector('#link-trouble').hidden");
    enable(&mut page);
}

#[test]
#[ignore = "needs Chromium: cargo xtask test --only scope"]
fn a_sweep_draws_the_hysteresis_of_friction() {
    let (scope, _cable) = scope();
    let mut page = open(scope.url(), DESKTOP);
    enable(&mut page);
    page.click("#sweep");
    page.wait_text("#moves tbody td", "4");
    // Four moves of 2 s, seen fifty times a second if nothing is lost; and width: more than a line there and back.
    page.wait("Number(document.querySelector('#loop').dataset.samples) > 100");
    assert!(drawn(&mut page, "#loop") > 300);
    picture(&mut page, "sweep");
}

#[test]
#[ignore = "needs Chromium: cargo xtask test --only scope"]
fn the_live_trace_waits_for_its_trigger() {
    let (scope, _cable) = scope();
    let mut page = open(scope.url(), DESKTOP);
    choose(&mut page, "#signal", "position");
    page.eval("document.querySelector('#level').value = '500 µm'");
    choose(&mut page, "#trigger", "rising");
    page.wait_text("#trigger-state", "waiting");
    enable(&mut page);
    page.enter("#velocity", "5 mm/s");
    jog(&mut page, "1 mm", "#jog-forward");
    page.wait_text("#trigger-state", "triggered");
}

#[test]
#[ignore = "needs Chromium: cargo xtask test --only scope"]
fn on_a_phone_nothing_sticks_out_and_stop_stays_in_reach() {
    let (scope, _cable) = scope();
    let mut page = open(scope.url(), PHONE);
    enable(&mut page);
    for (niasa, moves) in [(false, 2), (true, 4)] {
        if niasa {
            page.click("#niasa + span");
        }
        page.eval("document.querySelector('#count').value = 2");
        page.click("#move-by");
        page.wait_text("#moves tbody td", &format!("{moves}"));
    }
    page.eval("document.querySelector('#parameters details').open = true");
    let widths = "[document.documentElement.scrollWidth, innerWidth]";
    assert_eq!(page.eval(widths), serde_json::json!([PHONE[0], PHONE[0]]));
    let stop = "(() => { const r = document.querySelector('#stop').getBoundingClientRect(); return r.bottom <= innerHeight && r.height >= 44 })()";
    page.resize(DESKTOP);
    assert_eq!(page.eval("document.documentElement.scrollWidth > document.documentElement.clientWidth"), false);
    page.resize(PHONE);
    for scroll in ["0", "document.body.scrollHeight"] {
        page.eval(&format!("scrollTo(0, {scroll})"));
        assert_eq!(page.eval(stop), true);
    }
    picture(&mut page, "moves");
}
