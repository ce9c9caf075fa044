//! Telemetry: the record queue drained, decimated records and every change of state in the log, chosen words in a stream.

use defmt::{error, info, warn};
use embassy_time::{Duration, Ticker};
use servo_board::watchdog::Client;
use servo_core::record::TickRecord;
use servo_protocol::message::Reply;
use servo_protocol::stream::Packer;

use crate::clients;
use crate::commands::Frame;
use crate::drive::{BLACK_BOX, Latest, Reports};

/// Time between two visits to the queue; it holds three times as much.
const VISIT: Duration = Duration::from_millis(5);
/// Visits per logged record: ten a second.
const VISITS_PER_LINE: u32 = 20;

/// Drains the records for ever.
#[embassy_executor::task]
pub async fn run(mut reports: Reports, latest: &'static Latest) {
    let alive = Client::register(clients::TELEMETRY);
    let mut ticker = Ticker::every(VISIT);
    let mut visits = 0;
    let mut stream: Option<(u32, Packer)> = None;
    loop {
        ticker.next().await;
        alive.check_in();
        if let Some((id, order)) = latest.stream.take() {
            stream = (!order.words.is_empty()).then(|| (id, Packer::new(order)));
        }
        while let Some(record) = reports.records.dequeue() {
            log_change(&latest.record.replace(record), &record);
            if let Some((id, packer)) = &mut stream
                && let Some(block) = packer.push(&record)
                && !Frame::of(*id, &Reply::Block(block)).is_ok_and(Frame::try_send)
            {
                latest.lost_blocks.set(latest.lost_blocks.get().wrapping_add(1));
            }
        }
        if let Some(snapshot) = reports.snapshots.dequeue() {
            latest.snapshot.set(snapshot);
        }
        if let Some(drive) = reports.copies.dequeue()
            && BLACK_BOX.copy(drive.counters().ticks, &drive).is_err()
        {
            warn!("black box: a copy of the drive does not fit");
        }
        if BLACK_BOX.is_to_be_sealed() {
            BLACK_BOX.seal();
            info!("black box: complete");
        }
        visits += 1;
        if visits == VISITS_PER_LINE {
            visits = 0;
            log_record(&latest.record.get());
        }
    }
}

fn log_change(before: &TickRecord, now: &TickRecord) {
    if now.fault != before.fault {
        match now.fault {
            Some(fault) => error!("tick {=u32}: fault {=u16} {}", now.sequence, fault.number(), fault),
            None => info!("tick {=u32}: fault cleared", now.sequence),
        }
    }
    if now.state != before.state {
        info!("tick {=u32}: {} -> {}", now.sequence, before.state, now.state);
    }
}

fn log_record(record: &TickRecord) {
    info!(
        "tick {=u32} position {=i64} ct error {=i32} ct force {=f32} N niasa {=f32} N iq {=f32} A bus {=f32} V flags {=u16:#x} {} {=u16} cycles",
        record.sequence,
        record.position.0,
        record.error_ct,
        record.force_n,
        record.compensator_n,
        record.iq_a,
        record.bus_v,
        record.flags,
        record.state,
        record.tick_cycles,
    );
}
