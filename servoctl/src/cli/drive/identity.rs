//! `servoctl info`, `status`, `ports`, `enable`, `disable`, `stop`, `restart`.

use anyhow::Result;
use serde::Serialize;
use serde_json::json;
use servo_core::capture::Progress;
use servo_protocol::message::{Request, Status};

use super::super::output::Json;
use super::{Connected, Link, control, serial_ports};
use crate::link::units::{show_error, show_length};

/// Options of commands that take none of their own.
#[derive(Debug, clap::Args)]
pub struct Options {
    #[command(flatten)]
    pub(super) json: Json,
}

#[derive(Serialize)]
struct Info {
    board: String,
    simulated: bool,
    serial: String,
    firmware: String,
    protocol: u16,
    program: String,
    parameters_saved: Option<u32>,
    parameters_unsaved: bool,
}

/// Who the drive is.
///
/// # Errors
/// Those of the link.
pub fn info(link: &Link, options: &Options) -> Result<()> {
    let Connected { mut drive, is_virtual } = link.connect()?;
    let store = drive.parameter_store()?;
    let identity = drive.identity();
    let [major, minor, patch] = identity.firmware;
    let info = Info {
        board: identity.board.to_string(),
        simulated: is_virtual,
        serial: identity.serial.map(|word| format!("{word:08x}")).concat(),
        firmware: format!("{major}.{minor}.{patch}"),
        protocol: identity.protocol,
        program: format!("{:016x}", identity.program),
        parameters_saved: store.image.map(|image| image.sequence),
        parameters_unsaved: store.unsaved,
    };
    options.json.write(&info, || {
        let saved = match (info.parameters_saved, info.parameters_unsaved) {
            (None, _) => "none saved: set them, then `servoctl params save`".to_owned(),
            (Some(number), false) => format!("save {number}"),
            (Some(number), true) => format!("save {number}, changed since (`servoctl params diff` shows what)"),
        };
        let simulated = if info.simulated { ", virtual: motor and stage are simulated" } else { "" };
        format!(
            "board       {}{simulated}\nserial      {}\nfirmware    {}, protocol {}, program {}\nparameters  {saved}\n",
            info.board, info.serial, info.firmware, info.protocol, info.program
        )
    })
}

/// Prints what the drive is doing.
///
/// # Errors
/// Those of the link.
pub fn status(link: &Link, options: &Options) -> Result<()> {
    let mut drive = link.connect()?.drive;
    let status = drive.status()?;
    let count_m = drive.parameters()?.encoder_count_m;
    let losses = drive.client().losses();
    let value = json!({
        "tick": status.tick,
        "state": status.state.to_string(),
        "fault": status.fault.map(|fault| fault.number()),
        "status_word": status.status_word,
        "limits": control::limits(&status),
        "moving": status.moving,
        "position_m": status.position_ct as f64 * count_m,
        "error_m": f64::from(status.error_ct) * count_m,
        "force_n": status.force_n,
        "bus_v": status.bus_v,
        "ticks": status.counters.ticks,
        "overruns": status.counters.overruns,
        "longest_tick_cycles": status.counters.longest_tick_cycles,
        "bad_encoder_frames": status.counters.bad_frames,
        "subdivisional_error_m": status.subdivisional_error_m,
        "unreadable_requests": status.bad_requests,
        "lost_records": status.lost_records,
        "link_repeated": losses.repeated,
        "link_unreadable": losses.unreadable,
    });
    options.json.write(&value, || describe(&status, count_m))
}

/// The status in words.
pub fn describe(status: &Status, count_m: f64) -> String {
    let fault = status.fault.map_or("none".to_owned(), |fault| format!("{} {}", fault.number(), fault.explanation()));
    let motion = if status.moving { "moving" } else { "at rest" };
    let capture = match status.capture {
        Progress::Idle => "none ordered".to_owned(),
        Progress::Armed => "waiting for its trigger".to_owned(),
        Progress::Running(samples) => format!("{samples} samples so far"),
        Progress::Complete(complete) => format!("{} samples, complete", complete.order.samples),
    };
    let counters = status.counters;
    // Only sine and cosine have one.
    let encoder = status.subdivisional_error_m.map_or(String::new(), |error_m| {
        format!("encoder     sub-divisional error {} (estimated, peak)\n", show_error(error_m))
    });
    format!(
        "state       {}, {motion}\nfault       {fault}\n{}position    {}\nerror       {}\nforce       {:.3} N\nbus         {:.1} V\n\
         tick        {}; {} overruns, longest {} cycles\nlosses      {} bad encoder frames, {} unreadable requests, {} records\n\
         {encoder}capture     {capture}\n",
        status.state,
        control::status_word(status),
        show_length(status.position_ct as f64 * count_m),
        show_length(f64::from(status.error_ct) * count_m),
        status.force_n,
        status.bus_v,
        status.tick,
        counters.overruns,
        counters.longest_tick_cycles,
        counters.bad_frames,
        status.bad_requests,
        status.lost_records,
    )
}

/// Serial ports that may be drives.
///
/// # Errors
/// The system does not tell.
pub fn ports(options: &Options) -> Result<()> {
    let ports = serial_ports()?;
    options.json.write(&ports, || match &ports[..] {
        [] => "no USB serial port\n".to_owned(),
        ports => ports.iter().map(|(address, what)| format!("{address}   {what}\n")).collect(),
    })
}

/// Closes the loops.
///
/// # Errors
/// A refusal; those of the link.
pub fn enable(link: &Link, options: &Options) -> Result<()> {
    let status = link.connect()?.drive.enable()?;
    said(options, &status)
}

/// Turns the bridge off.
///
/// # Errors
/// A refusal; those of the link.
pub fn disable(link: &Link, options: &Options) -> Result<()> {
    let mut drive = link.connect()?.drive;
    drive.order(&Request::Disable)?;
    said(options, &drive.status()?)
}

/// Brakes.
///
/// # Errors
/// A refusal; those of the link.
pub fn stop(link: &Link, options: &Options) -> Result<()> {
    let mut drive = link.connect()?.drive;
    drive.order(&Request::Stop)?;
    let status = drive.wait_until("stopping", u32::MAX / 2, |_| true, |status| !status.moving)?;
    said(options, &status)
}

/// Starts the firmware anew.
///
/// # Errors
/// A refusal; those of the link.
pub fn restart(link: &Link, options: &Options) -> Result<()> {
    let status = link.connect()?.drive.restart()?;
    said(options, &status)
}

fn said(options: &Options, status: &Status) -> Result<()> {
    let value = json!({ "tick": status.tick, "state": status.state.to_string(), "moving": status.moving });
    options.json.write(&value, || format!("{}\n", status.state))
}
