//! L1.2: every message in every state.
//!
//! One case for each message and state of the table of 3.2: it is allowed, skipped, or ends the connection.

use rhumb_protocol::Instant;
use rhumb_protocol::message::{
    ClientMessage, Drive, Extensions, Moves, ServerMessage, StreamChoice,
};
use rhumb_protocol::packet::StreamId;
use rhumb_protocol::scene::Command;
use rhumb_protocol::session::CloseCode;
use rhumb_reckoning::{Tick, Tolerance};

use super::scenery::lockstep;
use crate::conformance::case::Case;
use crate::conformance::outcome::{Play, ensure};
use crate::conformance::peer::Guest;
use crate::conformance::trial::Trial;

/// How far a conversation has come.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum State {
    Silent,
    Lobby,
    Member,
    Parted,
}

/// What a message must come to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Fate {
    Heard,
    Skipped,
    Violation,
}

const NAMES: [&str; 16] = [
    "Hello", "Create", "Join", "Leave", "Delete", "Reserve", "Command", "Advance", "Resync",
    "Ping", "Inspect", "Follow", "Followed", "Drive", "Upstream", "Moves",
];

pub(super) fn cases() -> Vec<Case> {
    let mut cases = Vec::new();
    for (place, state) in [State::Silent, State::Lobby, State::Member, State::Parted]
        .into_iter()
        .enumerate()
    {
        for (kind, name) in (1_u8..).zip(NAMES) {
            let fate = fate(state, kind);
            if state == State::Silent && kind == 1 {
                continue;
            }
            let id = format!("L1.2.{}", place * 20 + usize::from(kind));
            let (cites, words) = match fate {
                Fate::Heard => ("PROTOCOL 3.2-1", "is allowed"),
                Fate::Skipped => ("PROTOCOL 3.2-3", "is skipped"),
                Fate::Violation => ("PROTOCOL 3.2-1", "ends the connection with code 2"),
            };
            let name = format!("{name} said by who is {} {words}", word(state));
            let case = Case::server(&id, &name).cites(cites);
            cases.push(case.play(move |trial| play(trial, state, kind, fate)));
        }
    }
    cases
}

/// Who is in a state.
const fn word(state: State) -> &'static str {
    match state {
        State::Silent => "silent",
        State::Lobby => "in the lobby",
        State::Member => "a member",
        State::Parted => "parted",
    }
}

/// The table of PROTOCOL 3.2.
const fn fate(state: State, kind: u8) -> Fate {
    let for_lobby = matches!(kind, 2 | 3 | 5 | 10);
    let for_members = matches!(kind, 4..=16);
    match state {
        State::Lobby if for_lobby => Fate::Heard,
        State::Member if for_members => Fate::Heard,
        State::Parted if for_lobby => Fate::Heard,
        State::Parted if for_members => Fate::Skipped,
        _ => Fate::Violation,
    }
}

fn play(trial: &mut Trial<'_>, state: State, kind: u8, fate: Fate) -> Play {
    let mut guest = in_state(trial, state)?;
    let message = message(&guest, kind);
    guest.say(&message);
    match fate {
        Fate::Violation => guest.must_be_closed(CloseCode::VIOLATION),
        Fate::Heard => guest.barrier().map(drop),
        Fate::Skipped => {
            let heard = guest.barrier()?;
            ensure(
                heard.is_empty(),
                format!("it is not answered, but by {heard:?}"),
            )
        }
    }
}

fn in_state(trial: &mut Trial<'_>, state: State) -> Result<Guest, crate::conformance::Stop> {
    let mut guest = trial.guest()?;
    if state == State::Silent {
        return Ok(guest);
    }
    guest.hello()?;
    guest.create(lockstep())?;
    if state == State::Lobby {
        return Ok(guest);
    }
    guest.join(StreamChoice::Full)?;
    if state == State::Parted {
        guest.say(&ClientMessage::Leave);
        guest.await_message("answer to leave", |message| {
            matches!(message, ServerMessage::Left).then_some(())
        })?;
    }
    Ok(guest)
}

/// A plain message of a type.
fn message(guest: &Guest, kind: u8) -> ClientMessage {
    match kind {
        1 => ClientMessage::Hello {
            versions: vec![1],
            scene: guest.scene.clone(),
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
        9 => ClientMessage::Resync,
        10 => ClientMessage::Ping {
            sent: Instant::from_nanos(7),
        },
        11 => ClientMessage::Inspect,
        12 => ClientMessage::Follow(StreamChoice::Within(Tolerance::NORMAL)),
        13 => ClientMessage::Followed(StreamId(0)),
        14 => ClientMessage::Drive(Drive {
            tolerance: Tolerance::NORMAL,
            bodies: Vec::new(),
        }),
        15 => ClientMessage::Upstream(vec![1, 0]),
        _ => ClientMessage::Moves(Moves::Never),
    }
}
