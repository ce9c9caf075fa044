//! Bytes from the serial link, as the drive and as the host read them.

use servo_core::capture::{Order, Trigger};
use servo_core::cascade::ParallelGains;
use servo_core::config::Compensator;
use servo_core::profile::Limits;
use servo_core::record::Selection;
use servo_protocol::frame::{Collector, FrameError, MAX_FRAME, MAX_PAYLOAD, encode};
use servo_protocol::message::{Reply, Request};
use servo_protocol::stream;

/// Feeds the bytes to a collector of requests and to one of replies: as they come, then as the message of one frame with a right checksum,
/// which no fuzzer would find by itself.
///
/// # Panics
/// Where a message that was read is not read again from its own frame, or a frame that is right is not taken for one.
pub fn check(bytes: &[u8]) {
    let (mut requests, mut replies) = (Collector::default(), Collector::default());
    for byte in bytes {
        if let Some(Ok((id, request))) = requests.push::<Request>(*byte) {
            again(id, &request);
        }
        if let Some(Ok((id, reply))) = replies.push::<Reply>(*byte) {
            again(id, &reply);
        }
    }
    let (mut requests, mut replies) = (Collector::default(), Collector::default());
    let line = around(&bytes[..bytes.len().min(MAX_PAYLOAD)]);
    for byte in &line {
        match requests.push::<Request>(*byte) {
            Some(Ok((id, request))) => again(id, &request),
            Some(Err(error)) => assert_eq!(error, FrameError::Content),
            None => {}
        }
        match replies.push::<Reply>(*byte) {
            Some(Ok((id, reply))) => again(id, &reply),
            Some(Err(error)) => assert_eq!(error, FrameError::Content),
            None => {}
        }
    }
}

/// A frame with these bytes as its message.
fn around(payload: &[u8]) -> Vec<u8> {
    let checksum = crc::Crc::<u32>::new(&crc::CRC_32_ISO_HDLC).checksum(payload).to_le_bytes();
    let mut line = Vec::new();
    // Byte stuffing by its definition: each run of non-zero bytes behind its length + 1, at most 254 of them.
    let plain: Vec<u8> = payload.iter().copied().chain(checksum).collect();
    for (number, run) in plain.split(|byte| *byte == 0).enumerate() {
        let mut chunks = run.chunks(254).peekable();
        if chunks.peek().is_none() {
            line.push(1);
        }
        while let Some(chunk) = chunks.next() {
            line.push(chunk.len() as u8 + 1);
            line.extend(chunk);
            if chunk.len() == 254 && chunks.peek().is_none() && number < plain.iter().filter(|b| **b == 0).count() {
                line.push(1);
            }
        }
    }
    line.push(0);
    line
}

/// Equality by bytes, since NaN is a value that a request may carry.
fn again<T: serde::Serialize + serde::de::DeserializeOwned>(id: u32, message: &T) {
    let mut frame = [0; MAX_FRAME];
    let length = encode(id, message, &mut frame).expect("what came in a frame fits a frame");
    let mut collector = Collector::default();
    let read: Vec<_> = frame[..length].iter().filter_map(|byte| collector.push::<T>(*byte)).collect();
    let [Ok((read_id, read_message))] = &read[..] else { panic!("its own frame is not read") };
    let mut second = [0; MAX_FRAME];
    assert_eq!(encode(*read_id, read_message, &mut second), Ok(length));
    assert_eq!(frame, second);
}

/// Requests of every shape.
pub fn seeds() -> Vec<Vec<u8>> {
    let limits = Limits { velocity_m_per_s: 0.5, acceleration_m_per_s2: 1.0, jerk_m_per_s3: None };
    let requests = [
        Request::Identity,
        Request::Status,
        Request::Enable,
        Request::Move { target_ct: 81_920_000, limits },
        Request::Compensator(Compensator::Niasa),
        Request::Gains(ParallelGains { kp_n_per_m: 4.31e5, ki_n_per_m_s: 1.6e7, kd_n_s_per_m: 912.0 }),
        Request::SetParameters([(0x0502, 4e6), (0x0503, 0.6)].into_iter().collect()),
        Request::GetParameter(0x0101),
        Request::Capture(Order {
            words: Selection::ERROR_POSITION_FORCE,
            samples: 100,
            before: 10,
            every_ticks: 2,
            trigger: Trigger::Error(50),
        }),
        Request::Stream(stream::Order { words: Selection::ERROR_POSITION_FORCE, every_ticks: 1 }),
        Request::ReadCapture { first: 90 },
        Request::ReadParameters { first: 0 },
        Request::SaveParameters,
    ];
    let frame_of = |request: &Request| {
        let mut frame = [0; MAX_FRAME];
        let length = encode(1, request, &mut frame).unwrap_or(0);
        frame[..length].to_vec()
    };
    let mut seeds: Vec<Vec<u8>> = requests.iter().map(frame_of).collect();
    // Payloads without a frame: id, variant, content.
    seeds.extend((0..20).map(|variant| [&[1, variant][..], &[0x11; 40]].concat()));
    seeds
}
