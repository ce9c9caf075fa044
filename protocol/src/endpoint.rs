//! The table of endpoints: every request, what answers it, and whether it may be carried out again.

use crate::message::{Reply, Request};

/// Whether a request may be carried out twice.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// Changes nothing: answered anew each time it arrives.
    Query,
    /// Changes something: carried out once, then answered from memory. Answered by `Done` or `Refused`.
    Command,
}

/// One row of the table.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Endpoint {
    /// Number of the variant on the wire.
    pub number: u8,
    /// Name of the request.
    pub request: &'static str,
    /// Name of the reply if nothing is wrong.
    pub reply: &'static str,
    /// Whether it may be carried out twice.
    pub kind: Kind,
    /// What it is for.
    pub doc: &'static str,
}

macro_rules! endpoints {
    ($($number:literal $kind:ident $request:ident -> $reply:ident, $doc:literal;)+) => {
        /// Every request, in the order of the wire.
        pub static ENDPOINTS: &[Endpoint] = &[$(Endpoint {
            number: $number, request: stringify!($request), reply: stringify!($reply), kind: Kind::$kind, doc: $doc,
        },)+];

        /// The row of a request.
        pub fn of(request: &Request) -> &'static Endpoint {
            match request {
                $(Request::$request { .. } => &ENDPOINTS[$number],)+
            }
        }
    };
}

endpoints! {
    0 Query Identity -> Identity, "Who are you? Never changes; to be asked first.";
    1 Query Status -> Status, "What the drive is doing.";
    2 Command Enable -> Done, "Close the loops at the present position.";
    3 Command Disable -> Done, "Bridge off.";
    4 Command ResetFault -> Done, "Acknowledge a fault.";
    5 Command Move -> Done, "Move to a position.";
    6 Command Stop -> Done, "Brake to rest.";
    7 Command Compensator -> Done, "Choose the compensator.";
    8 Command Gains -> Done, "Set the cascade from gains of the parallel form.";
    9 Command SetParameters -> Done, "Set parameters, all or none.";
    10 Query GetParameter -> Parameter, "One parameter in use.";
    11 Query Settling -> Settling, "How the last move settled.";
    12 Command Capture -> Done, "Order a capture.";
    13 Query ReadCapture -> Capture, "A block of captured words.";
    14 Query ReadParameters -> Parameters, "Parameters in use, in the order of their ids.";
    15 Command SaveParameters -> Done, "Begin to store the parameters in use.";
    16 Command LoadParameters -> Done, "Use the stored parameters.";
    17 Command ResetParameters -> Done, "Use the parameters of a new drive.";
    18 Query ParameterStore -> ParameterStore, "What is stored, and how the last save went.";
    19 Command Restart -> Done, "Start the firmware anew.";
    20 Command Stream -> Done, "Stream words of every n-th tick's record: `Block`s with this request's number follow.";
    21 Query ReadBlackBox -> BlackBox, "A block of the black box.";
    22 Command Excite -> Done, "Play an excitation, in place of one under way.";
    23 Query Excitation -> Excitation, "What the last excitation has found.";
    24 Command Align -> Done, "Look for the motor's electrical zero; the bridge is off when it has ended.";
    25 Command CollectSignals -> Done, "Collect sine and cosine from now on, while the stage moves.";
    26 Command CorrectSignals -> Done, "Correct sine and cosine by what fits those collected.";
    27 Command Control -> Done, "A controlword of CiA 402: states, quick stop, halt, fault reset.";
}

/// The name of a reply, as the table has it.
pub fn name(reply: &Reply) -> &'static str {
    match reply {
        Reply::Identity(_) => "Identity",
        Reply::Done { .. } => "Done",
        Reply::Refused(_) => "Refused",
        Reply::Status(_) => "Status",
        Reply::Parameter { .. } => "Parameter",
        Reply::Settling(_) => "Settling",
        Reply::Capture { .. } => "Capture",
        Reply::Parameters(_) => "Parameters",
        Reply::ParameterStore(_) => "ParameterStore",
        Reply::Block(_) => "Block",
        Reply::BlackBox { .. } => "BlackBox",
        Reply::Excitation { .. } => "Excitation",
    }
}

#[cfg(test)]
mod tests {
    extern crate std;
    use super::*;
    use std::vec;

    #[test]
    fn the_table_counts_as_the_wire_does() {
        for (row, endpoint) in ENDPOINTS.iter().enumerate() {
            assert_eq!(usize::from(endpoint.number), row);
            // Zeros are a value of whatever a request carries.
            let mut bytes = vec![0; 100];
            bytes[0] = endpoint.number;
            let (request, _): (Request, _) = postcard::take_from_bytes(&bytes).unwrap();
            assert_eq!(of(&request), endpoint);
        }
        let beyond = vec![ENDPOINTS.len() as u8; 100];
        assert!(postcard::take_from_bytes::<Request>(&beyond).is_err(), "the table lacks a request");
    }

    #[test]
    fn commands_are_answered_by_done_and_queries_are_not() {
        for endpoint in ENDPOINTS {
            assert_eq!(endpoint.kind == Kind::Command, endpoint.reply == "Done", "{}", endpoint.request);
        }
    }
}
