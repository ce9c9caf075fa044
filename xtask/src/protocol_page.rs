//! The page of the protocol, its table from the code.

use std::fmt::Write;

use servo_core::record::{COLUMNS, Kind};
use servo_protocol::endpoint::{self, ENDPOINTS};
use servo_protocol::frame::{MAX_FRAME, MAX_PAYLOAD};
use servo_protocol::message::PROTOCOL;

const HEAD: &str = "\
# Protocol between drive and host

Made by `cargo xtask docs` from [`protocol/`](../protocol/src/lib.rs); a test compares the two. Firmware and host compile the same crate; what is here is for
those who write another host.

## The line

USART3 of the board, which is the ST-LINK's virtual COM port: 8 data bits, no parity, one stop bit; the bit rate is `BAUD` in
[`hal-board/src/link.rs`](../hal-board/src/link.rs). A virtual drive carries the same bytes over TCP, and sends an empty
frame when it has had nothing to say for 100 ms: it may be slower than the clock on the wall, but a line on which nothing at all comes is dead.

## A frame

```text
COBS( postcard( id: u32, message ) ++ CRC-32 ) 0x00
```

The host numbers its requests; the reply has the number of its request. Serialisation is [postcard's](https://postcard.jamesmunns.com/wire-format). The checksum is
CRC-32/ISO-HDLC (that of Ethernet) over the serialised bytes, least significant byte first. A zero in front of a frame ends whatever noise the line held; empty frames mean nothing.

## Who is there

The first request of a host is `Identity`: with id 0 it is the bytes `01 01 05 ff 12 d9 41 00` for ever. The reply is frozen as well: protocol number (`u16`), firmware version
(three `u16`), fingerprint of the program (`u64`: FNV-1a of the program in flash, so that the ELF which decodes the log can be told), name of the board
(string), serial number of the chip (three `u32`). A host that reads another protocol number than its own goes no further: the rest may differ.
On a virtual board the chip's production lot, the last seven bytes of the serial number, is `VIRTUAL` in ASCII: everything measured there is simulated.

## Lost frames

A drive answers what it can read and is silent about the rest. A host has one request under way, waits, and sends it again with the same number; it begins with a random number, so that
two hosts in a row do not meet. **Queries** are answered anew each time. **Commands** are carried out once: the drive remembers the number of the last one and its
answer, and answers a repetition from memory. So a command whose reply is lost is not carried out twice, and one that gets no reply in all attempts is reported as *not
known whether carried out*. `servoctl` gives up when nothing at all has come for 0.75 s. `Restart` is never sent again: a drive that has started anew remembers nothing.

A command is answered by `Done` with the servo tick that carried it out, or by `Refused` with the reason. A `Status` says of which tick it is at least; one
of the command's tick or later shows the command's effect. A tick count that falls means that the drive was restarted.
";

const SIGNALS: &str = "
Whatever a host asks is a sign of life. A drive with the bridge on that hears nothing for longer than its `command_timeout_s` goes into fault 19; 0, as in a new drive, means
that it goes on and holds its last target.

## Signals, captures, streams

Every servo tick (8 kHz) makes a record of 32-bit words. A capture or a stream chooses some of them with a mask: bit n is word n.

A **capture** keeps up to 8 words of every n-th tick in a ring in the drive: 131,072 words, two seconds of eight signals at full rate. It is ordered with its number of samples, how
many of them are from before the trigger, and the trigger. When the status says that it is complete, the words of the ring are read in blocks; the status has the index of the oldest sample.

A **stream** sends blocks behind the answer to its order, with the order's number as id: number of the block, tick of its first sample, the samples' words
(least significant byte first). Within a block no sample is missing. A gap in the numbers is blocks that were lost on the line; a gap in the ticks is all samples that were lost, wherever. A
block that finds the line busy is dropped by the drive, so that answers are never late, and counted in the status.

| word | name | |
|---:|---|---|
";

/// `docs/protocol.md`.
pub fn protocol() -> String {
    let mut page = HEAD.to_owned();
    let _ = write!(
        page,
        "\n## Endpoints\n\nProtocol {PROTOCOL}. A message has at most {MAX_PAYLOAD} bytes, a frame {MAX_FRAME}. The types are in \
         [`message.rs`](../protocol/src/message.rs).\n\n| number | request | | reply | |\n|---:|---|---|---|---|\n"
    );
    for row in ENDPOINTS {
        let kind = match row.kind {
            endpoint::Kind::Query => "query",
            endpoint::Kind::Command => "command",
        };
        let _ = writeln!(page, "| {} | `{}` | {kind} | `{}` | {} |", row.number, row.request, row.reply, row.doc);
    }
    page += SIGNALS;
    for (number, (name, kind)) in COLUMNS.into_iter().enumerate() {
        let kind = match kind {
            Kind::Unsigned => "unsigned",
            Kind::Signed => "signed",
            Kind::Float => "float",
        };
        let _ = writeln!(page, "| {number} | `{name}` | {kind} |");
    }
    page
}
