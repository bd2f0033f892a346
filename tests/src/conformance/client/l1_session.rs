//! L1.51: how clients begin, and what makes them end.

use rhumb_protocol::message::{ClientMessage, Extensions, ServerMessage, Welcome};
use rhumb_protocol::session::CloseCode;

use crate::conformance::case::Case;
use crate::conformance::outcome::{Play, Stop, ensure};
use crate::conformance::trial::Trial;

pub(super) fn cases() -> Vec<Case> {
    vec![
        Case::client("L1.51.1", "a client says hello first, and offers version 1")
            .cites("PROTOCOL 3.1-1, 3.1-2")
            .play(hello),
        Case::client(
            "L1.51.2",
            "a client that is welcomed in a version that it did not offer closes",
        )
        .cites("PROTOCOL 3.1-5")
        .play(other_version),
        Case::client(
            "L1.51.3",
            "a client ends the connection at a message of an unknown type below 0x80",
        )
        .cites("PROTOCOL 4.1-3, 2.5-3")
        .play(|trial| {
            let mut host = trial.host()?;
            host.await_message("hello", Some)?;
            host.utter(&[1, 0x7d]);
            host.must_be_closed(CloseCode::MALFORMED)
        }),
    ]
}

fn hello(trial: &mut Trial<'_>) -> Play {
    let mut host = trial.host()?;
    match host.await_message("hello", Some)? {
        ClientMessage::Hello { versions, .. } => {
            ensure(versions.contains(&1), "it offers version 1")
        }
        other => Stop::fail(format!("it begins with {other:?}")),
    }
}

fn other_version(trial: &mut Trial<'_>) -> Play {
    let mut host = trial.host()?;
    host.await_message("hello", Some)?;
    host.say(&ServerMessage::Welcome(Welcome {
        version: 7,
        scene: None,
        extensions: Extensions::NONE,
    }));
    host.must_be_closed(CloseCode::VERSION)
}
