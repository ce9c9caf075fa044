//! What becomes of a page's orders.

use std::thread;

use serde_json::{Value, json};
use servoctl::scope::hub::{Hub, Order};
use servoctl::scope::pilot;
use tokio::sync::mpsc;

use crate::bench_drive::{BenchDrive, Cable};
use crate::scope;
use crate::socket::Page;

/// A relative move, `count` times there and back.
fn by(to_m: f64, count: u32) -> Value {
    json!({"do": "move", "to_m": to_m, "relative": true, "velocity_m_per_s": 0.1, "acceleration_m_per_s2": 1.0,
        "jerk_m_per_s3": null, "count": count, "window_s": 0.05})
}

fn enabled(page: &mut Page) {
    assert_eq!(page.order(json!({"do": "enable"})), None);
}

#[test]
fn a_move_is_followed_by_its_capture_and_its_settling() {
    let (scope, _cable) = scope();
    let mut page = Page::open(&scope);
    enabled(&mut page);
    assert_eq!(page.order(json!({"do": "compensator", "name": "niasa"})), None);
    assert_eq!(page.order(by(1e-3, 2)), None);
    for (number, target_m) in [(1, 1e-3), (2, 0.0)] {
        let capture = page.until("capture");
        assert_eq!((&capture["number"], &capture["compensator"]), (&json!(number), &json!("niasa")));
        assert!((capture["target_m"].as_f64().unwrap() - target_m).abs() < 1e-7, "{}", capture["target_m"]);
        let errors_nm = capture["error_nm"].as_array().unwrap();
        // 50 ms at 8 kHz and a tenth more before them; at the end it is nearly there, from its target on both counts.
        assert_eq!((errors_nm.len(), &capture["before"]), (440, &json!(40)));
        assert_eq!(capture["sample_s"].as_f64(), Some(1.0 / 8000.0));
        let (error_nm, position_nm) = (errors_nm[439].as_f64().unwrap(), capture["position_nm"][439].as_f64().unwrap());
        assert!(error_nm.abs() < 200.0 && (error_nm + position_nm).abs() < 0.2, "{error_nm} {position_nm}");
        let moves = page.until("moves");
        let moved = moves["last"].as_array().unwrap().last().unwrap().clone();
        assert_eq!(moved["number"], number);
        assert!(moved["settling_ms"][0].is_f64() && moved["rms_nm"].as_f64().unwrap() < 2.0, "{moved}");
        assert_eq!(moves["settling"]["configs"][0]["settling_ms"].as_array().unwrap().len(), number);
    }
    assert!(page.until_status(|status| status["moves_left"] == 0)["position_m"].as_f64().unwrap().abs() < 1e-7);
}

#[test]
fn live_traces_come_at_500_hz_and_none_is_lost() {
    let (scope, _cable) = scope();
    let mut page = Page::open(&scope);
    let mut times_s = Vec::new();
    while times_s.len() < 1000 {
        let live = page.until("live");
        let more: Vec<f64> = live["time_s"].as_array().unwrap().iter().map(|time_s| time_s.as_f64().unwrap()).collect();
        for column in ["error_nm", "position_m", "force_n"] {
            assert_eq!(live[column].as_array().unwrap().len(), more.len(), "{column}");
        }
        times_s.extend(more);
    }
    for pair in times_s.windows(2) {
        assert!((pair[1] - pair[0] - 0.002).abs() < 1e-9, "{pair:?}");
    }
    assert_eq!(page.until("status")["lost_samples"], 0);
}

#[test]
fn what_is_refused_is_refused_in_words() {
    let (scope, _cable) = scope();
    let mut page = Page::open(&scope);
    let refused = |page: &mut Page, action: Value, says: &str| {
        let reason = page.order(action.clone()).unwrap_or_else(|| panic!("{action} was done"));
        assert!(reason.contains(says), "{action}: {reason}");
    };
    refused(&mut page, by(1e-3, 1), "enable the drive first");
    refused(
        &mut page,
        json!({"do": "set", "parameter": 0x0504, "value": 11.0}),
        "niasa_time_constant_s = 11 s is outside",
    );
    refused(&mut page, json!({"do": "set", "parameter": 0xffff, "value": 1.0}), "there is no parameter 0xffff");
    refused(&mut page, json!({"do": "compensator", "name": "magic"}), "there is no compensator magic");
    enabled(&mut page);
    refused(&mut page, by(0.08, 1), "m is outside -0.05 … 0.05 m");
    refused(&mut page, by(1e300, 1), "is outside -10 … 10 m");
    refused(&mut page, by(1e-3, 0), "number of moves = 0 is outside 1 … 1000");
    refused(&mut page, json!({"do": "set", "parameter": 0x0402, "value": 0.01}), "disable the drive first");
    assert_eq!(page.order(by(5e-3, 1)), None);
    refused(&mut page, by(5e-3, 1), "a motion is running");
    // The one that ran was not disturbed.
    assert_eq!(page.until("moves")["last"].as_array().unwrap().len(), 1);
}

#[test]
fn stop_forgets_the_moves_to_come_whoever_presses_it() {
    let (scope, _cable) = scope();
    let (mut first, mut second) = (Page::open(&scope), Page::open(&scope));
    enabled(&mut first);
    assert!(second.order(by(1e-3, 1)).unwrap().contains("page 1 commands, this is page 2"));
    assert_eq!(first.order(by(5e-3, 100)), None);
    second.until_status(|status| status["moves_left"].as_u64() >= Some(50) && status["moving"] == true);
    assert_eq!(second.order(json!({"do": "stop"})), None);
    let status = second.until_status(|status| status["moving"] == false);
    assert_eq!((&status["moves_left"], &status["torque"]), (&json!(0), &json!(true)), "braked, and held there");
}

/// The drive's thread is busy, orders wait, somebody presses stop: what waits is not what anybody wants any more.
#[test]
fn a_stop_drops_the_orders_that_still_wait() {
    let (hub, orders) = Hub::new();
    let page = hub.join().0;
    let (answers, mut answered) = mpsc::channel(8);
    let give = |id: u32, action: Value| {
        let action = serde_json::from_value(action).unwrap();
        hub.order(page, Order { action, id, answers: answers.clone() }).unwrap();
    };
    give(1, json!({"do": "enable"}));
    give(2, by(5e-3, 3));
    hub.stop();
    give(3, json!({"do": "compensator", "name": "niasa"}));
    // Only now does it find the time.
    let pilot = {
        let (hub, cable) = (hub.clone(), Cable::default());
        thread::spawn(move || pilot::run(&hub, &orders, Box::new(move || BenchDrive::connect(&cable))))
    };
    let mut answer = || serde_json::from_str::<Value>(&answered.blocking_recv().unwrap()).unwrap();
    for id in [1, 2] {
        assert_eq!(answer(), json!({"kind": "answer", "id": id, "error": "not carried out: a stop came first"}));
    }
    assert_eq!(answer(), json!({"kind": "answer", "id": 3, "error": null}));
    hub.end();
    pilot.join().unwrap();
    let known: Vec<Value> = hub.known().iter().map(|text| serde_json::from_str(text).unwrap()).collect();
    let status = known.iter().find(|message| message["kind"] == "status").unwrap();
    assert_eq!((&status["torque"], &status["moving"]), (&json!(false), &json!(false)), "{status}");
}

#[test]
fn a_page_that_comes_later_is_shown_what_there_is() {
    let (scope, _cable) = scope();
    let mut first = Page::open(&scope);
    enabled(&mut first);
    assert_eq!(first.order(by(1e-4, 1)), None);
    first.until("moves");
    let mut second = Page::open_unread(&scope);
    let kinds: Vec<String> = (0..7).map(|_| second.next()["kind"].as_str().unwrap().to_owned()).collect();
    for kind in ["welcome", "role", "link", "parameters", "moves", "capture", "status"] {
        assert!(kinds.iter().any(|seen| seen == kind), "no {kind} in {kinds:?}");
    }
}
