//! L1.2: every message in every state.
//!
//! One case for each message and each state in the table of 3.2: the message is allowed, skipped, or ends the
//! connection.

use rhumb_protocol::Instant;
use rhumb_protocol::message::{
    ClientMessage, Extensions, ResyncCause, ServerMessage, StreamChoice, TakeAuthority, TierPolicy,
};
use rhumb_protocol::packet::{LargestPacket, StreamId};
use rhumb_protocol::scene::{Command, Query};
use rhumb_protocol::session::CloseCode;
use rhumb_reckoning::{Tick, Tolerance};

use super::scenery::lockstep;
use crate::case::Case;
use crate::outcome::{CaseResult, ensure};
use crate::peer::RawClient;
use crate::trial::Trial;

/// The state of a session.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum SessionStage {
    Silent,
    Lobby,
    Member,
    Parted,
}

/// The required reaction to a message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Expected {
    Handled,
    Skipped,
    Violation,
}

const NAMES: [&str; 17] = [
    "Hello",
    "Create",
    "Join",
    "Leave",
    "Delete",
    "Reserve",
    "Command",
    "Advance",
    "Resync",
    "Ping",
    "Inspect",
    "Subscribe",
    "Subscribed",
    "TakeAuthority",
    "Upstream",
    "TierPolicy",
    "Query",
];

pub(super) fn cases() -> Vec<Case> {
    let mut cases = Vec::new();
    for (place, state) in [
        SessionStage::Silent,
        SessionStage::Lobby,
        SessionStage::Member,
        SessionStage::Parted,
    ]
    .into_iter()
    .enumerate()
    {
        for (kind, name) in (1_u8..).zip(NAMES) {
            let expected = expected(state, kind);
            if state == SessionStage::Silent && kind == 1 {
                continue;
            }
            let id = format!("L1.2.{}", place * 20 + usize::from(kind));
            let (cites, words) = match expected {
                Expected::Handled => ("PROTOCOL 3.2-1", "is allowed"),
                Expected::Skipped => ("PROTOCOL 3.2-2", "is skipped"),
                Expected::Violation => ("PROTOCOL 3.2-1", "ends the connection with code 2"),
            };
            let name = format!("{name} from a client {} {words}", word(state));
            let case = Case::server(&id, &name).cites(cites);
            cases.push(case.play(move |trial| play(trial, state, kind, expected)));
        }
    }
    cases
}

/// The state in words.
const fn word(state: SessionStage) -> &'static str {
    match state {
        SessionStage::Silent => "silent",
        SessionStage::Lobby => "in the lobby",
        SessionStage::Member => "that is a member",
        SessionStage::Parted => "parted",
    }
}

/// The table of PROTOCOL 3.2.
const fn expected(state: SessionStage, kind: u8) -> Expected {
    let for_lobby = matches!(kind, 2 | 3 | 5 | 10);
    let for_members = matches!(kind, 4..=17);
    match state {
        SessionStage::Lobby if for_lobby => Expected::Handled,
        SessionStage::Member if for_members => Expected::Handled,
        SessionStage::Parted if for_lobby => Expected::Handled,
        SessionStage::Parted if for_members => Expected::Skipped,
        _ => Expected::Violation,
    }
}

fn play(trial: &mut Trial<'_>, state: SessionStage, kind: u8, expected: Expected) -> CaseResult {
    let mut client = in_state(trial, state)?;
    let message = message(&client, kind);
    client.send(&message);
    match expected {
        Expected::Violation => client.must_be_closed(CloseCode::VIOLATION),
        Expected::Handled => client.barrier().map(drop),
        Expected::Skipped => {
            let received = client.barrier()?;
            ensure(
                received.is_empty(),
                format!("it must not be answered, but the answer is {received:?}"),
            )
        }
    }
}

fn in_state(trial: &mut Trial<'_>, state: SessionStage) -> Result<RawClient, crate::Stop> {
    let mut client = trial.client()?;
    if state == SessionStage::Silent {
        return Ok(client);
    }
    client.hello()?;
    client.create(lockstep())?;
    if state == SessionStage::Lobby {
        return Ok(client);
    }
    client.join(StreamChoice::Full)?;
    if state == SessionStage::Parted {
        client.send(&ClientMessage::Leave);
        client.await_message("answer to leave", |message| {
            matches!(message, ServerMessage::Left).then_some(())
        })?;
    }
    Ok(client)
}

/// An ordinary message of a type.
fn message(client: &RawClient, kind: u8) -> ClientMessage {
    match kind {
        1 => ClientMessage::Hello {
            versions: vec![1],
            scene: client.scene.clone(),
            extensions: Extensions::NONE,
        },
        2 => ClientMessage::Create(lockstep()),
        3 => ClientMessage::Join(StreamChoice::Full),
        4 => ClientMessage::Leave,
        5 => ClientMessage::Delete,
        6 => ClientMessage::Reserve { count: 1 },
        7 => ClientMessage::Command(Command::SetGravity {
            gravity: glam::Vec3::ZERO,
        }),
        8 => ClientMessage::Advance { to: Tick::new(1) },
        9 => ClientMessage::Resync(ResyncCause::LostSync),
        10 => ClientMessage::Ping {
            sent: Instant::from_nanos(7),
        },
        11 => ClientMessage::Inspect,
        12 => ClientMessage::Subscribe(StreamChoice::Within(Tolerance::NORMAL)),
        13 => ClientMessage::Subscribed(StreamId(0)),
        14 => ClientMessage::TakeAuthority(TakeAuthority {
            tolerance: Tolerance::NORMAL,
            largest_packet: LargestPacket::DEFAULT,
            bodies: Vec::new(),
        }),
        15 => ClientMessage::Upstream(vec![1, 0]),
        16 => ClientMessage::TierPolicy(TierPolicy::Never),
        _ => ClientMessage::Query(vec![Query::ray(glam::Vec3::ZERO, glam::Vec3::X)]),
    }
}
