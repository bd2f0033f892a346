//! L0.1: framing of messages.

use rhumb_protocol::limits::MESSAGE_BYTES_MAX;
use rhumb_protocol::message::{ClientMessage, ServerMessage, frame};
use rhumb_protocol::session::CloseCode;

use super::scenery::lockstep;
use crate::case::Case;
use crate::outcome::{CaseResult, ensure};
use crate::trial::Trial;

pub(super) fn cases() -> Vec<Case> {
    let refused = |id: &str, name: &str, cites: &str, bytes: Vec<u8>| {
        Case::server(id, name).cites(cites).play(move |trial| {
            let mut client = trial.client()?;
            client.hello()?;
            client.send_bytes(&bytes);
            client.must_be_closed(CloseCode::MALFORMED)
        })
    };
    vec![
        Case::server(
            "L0.1.1",
            "messages are decoded however their bytes are split",
        )
        .cites("PROTOCOL 4.1-1, 1.2-1")
        .play(cut_anywhere),
        Case::server(
            "L0.1.2",
            "a message of an unknown type from 0x80 on is skipped",
        )
        .cites("PROTOCOL 4.1-2, 3.5-3, 3.5-1")
        .play(optional_types),
        refused(
            "L0.1.3",
            "a message without a type is malformed",
            "PROTOCOL 4.1-1, 2.5-1, 2.5-3",
            vec![0],
        ),
        refused(
            "L0.1.4",
            "a length in a longer form is malformed",
            "PROTOCOL 4.1-1, 2.2-3",
            vec![0x81, 0, 4],
        ),
        refused(
            "L0.1.5",
            "a length beyond the longest message is malformed",
            "PROTOCOL 4.1-1; PROTOCOL 2.5-1",
            vec![0x82, 0x80, 1, 0xee],
        ),
        refused(
            "L0.1.6",
            "a length of more than ten bytes is malformed",
            "PROTOCOL 2.2-2",
            vec![0xff; 11],
        ),
        refused(
            "L0.1.7",
            "a message of an unknown type below 0x80 is malformed",
            "PROTOCOL 4.1-3, 3.5-3",
            vec![1, 0x7f],
        ),
    ]
}

fn cut_anywhere(trial: &mut Trial<'_>) -> CaseResult {
    let mut client = trial.client()?;
    client.hello()?;
    let mut bytes = Vec::new();
    ClientMessage::Create(lockstep()).encode(&mut bytes);
    for byte in bytes {
        client.send_bytes(&[byte]);
    }
    client.await_message("answer to create", |message| {
        matches!(message, ServerMessage::Created).then_some(())
    })
}

fn optional_types(trial: &mut Trial<'_>) -> CaseResult {
    let mut client = trial.client()?;
    let mut bytes = Vec::new();
    // Before the hello, and of every permitted length.
    frame(0x8a, &[], &mut bytes);
    client.send_bytes(&bytes);
    client.hello()?;
    let mut bytes = Vec::new();
    // Those below are known to a server with cells (15).
    for kind in 0x82..=0xff {
        frame(kind, &[kind; 3], &mut bytes);
    }
    frame(0xfa, &[0; MESSAGE_BYTES_MAX], &mut bytes);
    client.send_bytes(&bytes);
    let received = client.barrier()?;
    ensure(
        received.is_empty(),
        format!("it has no effect, not {received:?}"),
    )
}
