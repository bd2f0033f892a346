//! L1.51: how clients begin a session, and what they refuse before joining.

use std::time::Duration;

use rhumb_protocol::message::{
    ClientMessage, Denial, Extension, Extensions, Joined, ServerMessage, Welcome,
};
use rhumb_protocol::session::CloseCode;
use rhumb_reckoning::Predictor;
use rhumb_transport::Certificate;

use super::hand;
use super::table::table;
use crate::case::{Case, CaseRow};
use crate::outcome::{CaseResult, Stop, ensure, should};
use crate::peer::RawServer;
use crate::trial::Trial;

pub(super) fn cases() -> Vec<Case> {
    let mut cases = table("L1.51", BEGINNINGS);
    cases.extend(WELCOMES_REFUSED.map(refused));
    cases.extend(table("L1.51", WELCOMES));
    cases.extend(table("L1.51", ENDS));
    cases.extend(codes());
    cases
}

/// The client's first messages.
const BEGINNINGS: &[CaseRow] = &[
    (
        1,
        "a client sends hello first, and offers version 1",
        "PROTOCOL 1.1-1, 1.3-1, 3.1-1, 3.1-2, 4.1-1",
        hello,
    ),
    (
        4,
        "a client opens one bidirectional stream, and no other",
        "PROTOCOL 1.1-2, 1.1-3",
        |trial| {
            let mut server = trial.raw_server()?;
            hand::admit(&mut server)?;
            hand::must_go_on(
                &mut server,
                hand::NEXT + 1,
                hand::TICK + 1,
                hand::SCENE_EVENTS,
            )?;
            ensure(
                server.opened == [true],
                "it opens exactly one bidirectional stream",
            )
        },
    ),
    (
        5,
        "a client accepts datagrams of 1150 bytes",
        "PROTOCOL 1.1-4, 5.8-5",
        |trial| {
            let mut server = trial.raw_server()?;
            server.await_message("hello", Some)?;
            let most = server.connection.datagram_bytes_max();
            ensure(
                most >= Some(1150),
                format!("it accepts 1150 bytes, not {most:?}"),
            )
        },
    ),
    (
        6,
        "a client waits for the welcome before it sends more",
        "PROTOCOL 3.2-3",
        waits_for_welcome,
    ),
    (
        7,
        "a client offers a greased version, and sends a greased extension",
        "PROTOCOL 3.5-16, 3.5-17",
        greases,
    ),
    (
        19,
        "a client sends nothing to a server with an unexpected certificate",
        "PROTOCOL 1.3-1",
        another_server,
    ),
    (
        8,
        "a client declares an unsupported task by its exit code",
        "PROTOCOL 3.1-3",
        |trial| {
            // The task is invented: a client that subscribes anyway would pass cases of tasks that it does not
            // perform.
            let exit = match trial.raw_server_for("made-up words of the suite") {
                Err(Stop::Unsupported(_)) => return Ok(()),
                Err(other) => return Err(other),
                Ok(mut server) => server.await_message("hello", Some).map(drop),
            };
            match exit {
                Err(Stop::Unsupported(_)) => Ok(()),
                _ => Stop::fail("it performs another task than the given one"),
            }
        },
    ),
];

/// A case of a welcome that ends the connection: number, promise, citations, the welcome, the close code.
type RefusedWelcome = (u32, &'static str, &'static str, fn() -> Welcome, CloseCode);

const WELCOMES_REFUSED: [RefusedWelcome; 4] = [
    (
        2,
        "a client closes when the welcome has a version that it did not offer",
        "PROTOCOL 3.1-6, 3.5-2",
        || of_version(7),
        CloseCode::VERSION,
    ),
    (
        9,
        "a client closes when the welcome has a future version",
        "PROTOCOL 3.1-6, 3.5-2",
        || of_version(2),
        CloseCode::VERSION,
    ),
    (
        10,
        "a welcome with an unknown critical extension ends the connection",
        "PROTOCOL 3.5-1, 3.5-13, 3.5-4",
        || Welcome {
            extensions: extension(28),
            ..hand::welcome()
        },
        CloseCode::EXTENSION,
    ),
    (
        11,
        "a welcome with a configuration outside the limits ends the connection",
        "PROTOCOL 4.3-2, 7-1",
        || {
            let mut config = hand::config();
            config.gravity.y = -2_000.0;
            Welcome {
                scene: Some(config),
                ..hand::welcome()
            }
        },
        CloseCode::VIOLATION,
    ),
];

fn refused((number, name, cites, welcome, code): RefusedWelcome) -> Case {
    Case::client(&format!("L1.51.{number}"), name)
        .cites(cites)
        .play(move |trial| {
            let mut server = trial.raw_server()?;
            server.await_message("hello", Some)?;
            server.send(&ServerMessage::Welcome(welcome()));
            server.must_be_closed(code)
        })
}

/// Content of a welcome, and of the messages after it.
const WELCOMES: &[CaseRow] = &[
    (
        12,
        "a welcome with a greased version is refused although the client offered it",
        "PROTOCOL 3.5-18",
        greased_version,
    ),
    (
        13,
        "optional extensions and greased messages are skipped",
        "PROTOCOL 3.5-1, 3.5-12, 3.5-16, 3.5-3, 3.5-4, 4.1-2",
        skips,
    ),
    (
        14,
        "a joined with a critical extension ends the connection",
        "PROTOCOL 3.5-4",
        |trial| {
            let mut server = trial.raw_server()?;
            hand::awaits_join(&mut server)?;
            server.send(&ServerMessage::Joined(Joined {
                extensions: extension(1_000),
                ..hand::joined()
            }));
            server.must_be_closed(CloseCode::EXTENSION)
        },
    ),
    (
        15,
        "a joined with a configuration outside the limits ends the connection",
        "PROTOCOL 4.3-2",
        |trial| {
            let mut server = trial.raw_server()?;
            hand::awaits_join(&mut server)?;
            let mut joined = hand::joined();
            joined.config.integrator.substeps =
                core::num::NonZeroU32::new(17).expect("17 is not zero");
            server.send(&ServerMessage::Joined(joined));
            server.must_be_closed(CloseCode::VIOLATION)
        },
    ),
    (
        16,
        "a second welcome ends the connection",
        "PROTOCOL 3.1-4",
        |trial| {
            let mut server = trial.raw_server()?;
            hand::awaits_join(&mut server)?;
            server.send(&ServerMessage::Welcome(hand::welcome()));
            server.must_be_closed(CloseCode::VIOLATION)
        },
    ),
    (
        17,
        "control bytes may be split at any position",
        "PROTOCOL 4.1-1, 4.8-1, 4.8-4",
        byte_by_byte,
    ),
];

/// Messages that end a connection, and those that do not.
const ENDS: &[CaseRow] = &[
    (
        3,
        "a client ends the connection at a message of an unknown type below 0x80",
        "PROTOCOL 4.1-3, 2.5-3, 3.5-3",
        |trial| {
            let mut server = trial.raw_server()?;
            server.await_message("hello", Some)?;
            server.send_bytes(&[1, 0x7d]);
            server.must_be_closed(CloseCode::MALFORMED)
        },
    ),
    (
        18,
        "a denied join leaves the connection open",
        "PROTOCOL 4.7-1, 3.5-7",
        |trial| {
            let mut server = trial.raw_server()?;
            hand::awaits_join(&mut server)?;
            server.send(&ServerMessage::Denied(Denial::NoSuchScene));
            server.listen(Duration::from_millis(200))?;
            ensure(
                server.ended.is_none() || server.ended_as(0),
                "it does not close with an error",
            )
        },
    ),
];

/// Close codes that a server may use.
fn codes() -> Vec<Case> {
    let mut cases = Vec::new();
    for (place, code) in [0_u32, 256, 257, 9_999, u32::MAX >> 2]
        .into_iter()
        .enumerate()
    {
        let id = format!("L1.51.{}", 30 + place);
        let name = format!("a client exits normally when the server closes with {code}");
        cases.push(
            Case::client(&id, &name)
                .cites("PROTOCOL 3.4-1, 3.5-9")
                .play(move |trial| {
                    let mut server = trial.raw_server()?;
                    hand::admit(&mut server)?;
                    server.connection.close(code);
                    server.must_exit()
                }),
        );
    }
    cases
}

fn of_version(version: u16) -> Welcome {
    Welcome {
        version,
        ..hand::welcome()
    }
}

fn extension(id: u32) -> Extensions {
    let mut extensions = Extensions::NONE;
    let value = vec![1, 2, 3];
    assert!(extensions.insert(Extension { id, value }));
    extensions
}

/// The certificate is generated by the suite; the client was given the fingerprint of another one.
fn another_server(trial: &mut Trial<'_>) -> CaseResult {
    let other = Certificate::development(["localhost"]);
    let other = other.map_err(|error| Stop::Inconclusive(error.to_string()))?;
    match trial.raw_server_pinned("subscribe 10000", Some(other.fingerprint())) {
        // The client may refuse the connection or check after the handshake. It must attempt to connect.
        Err(Stop::Fail(_)) => Ok(()),
        Err(other) => Err(other),
        Ok(mut server) => {
            let sent = server.listen(Duration::from_millis(300))?;
            ensure(
                sent.is_empty(),
                format!("it sends nothing to another server, not {sent:?}"),
            )
        }
    }
}

fn hello(trial: &mut Trial<'_>) -> CaseResult {
    let mut server = trial.raw_server()?;
    match server.await_message("hello", Some)? {
        ClientMessage::Hello {
            versions, scene, ..
        } => {
            let wanted = format!("conformance/{}", trial.id());
            ensure(versions.contains(&1), "it offers version 1")?;
            ensure(
                scene.as_str() == wanted,
                format!("it names scene {wanted}, not {}", scene.as_str()),
            )
        }
        other => Stop::fail(format!("it begins with {other:?}")),
    }
}

fn waits_for_welcome(trial: &mut Trial<'_>) -> CaseResult {
    let mut server = trial.raw_server()?;
    server.await_message("hello", Some)?;
    let early = server.listen(Duration::from_millis(250))?;
    ensure(
        early.is_empty(),
        format!("it sends nothing before the welcome, not {early:?}"),
    )?;
    server.send(&ServerMessage::Welcome(hand::welcome()));
    server.await_message("join", |message| {
        matches!(message, ClientMessage::Join(_)).then_some(())
    })
}

fn greases(trial: &mut Trial<'_>) -> CaseResult {
    let mut server = trial.raw_server()?;
    let hello = server.await_message("hello", Some)?;
    let ClientMessage::Hello {
        versions,
        extensions,
        ..
    } = hello
    else {
        return Stop::fail("it does not begin with a hello");
    };
    let greased = |version: &u16| version & 0x0f0f == 0x0a0a && version >> 8 == version & 0xff;
    should(
        versions.iter().any(greased),
        format!("one of its versions {versions:?} is greased"),
    )?;
    let greased = |id: u32| id >= 27 && (id - 27).is_multiple_of(62);
    should(
        extensions.iter().any(|one| greased(one.id)),
        "it sends a greased extension",
    )
}

fn greased_version(trial: &mut Trial<'_>) -> CaseResult {
    let mut server = trial.raw_server()?;
    let ClientMessage::Hello { versions, .. } = server.await_message("hello", Some)? else {
        return Stop::fail("it does not begin with a hello");
    };
    let greased = versions.into_iter().find(|version| *version != 1);
    server.send(&ServerMessage::Welcome(of_version(
        greased.unwrap_or(0x0a0a),
    )));
    server.must_be_closed(CloseCode::VERSION)
}

/// Optional content that the document allows in any position.
fn skips(trial: &mut Trial<'_>) -> CaseResult {
    let mut server = trial.raw_server()?;
    server.await_message("hello", Some)?;
    server.send_bytes(&[1, 0x8a]);
    server.send(&ServerMessage::Welcome(Welcome {
        extensions: extension(27),
        ..hand::welcome()
    }));
    server.send_bytes(&[4, 0xfa, 0x00, 0x01, 0x02]);
    server.send_bytes(&[2, 0xef, 0x01]);
    server.await_message("join", |message| {
        matches!(message, ClientMessage::Join(_)).then_some(())
    })?;
    server.send_bytes(&[3, 0x9a, 0xff, 0xff]);
    server.send(&ServerMessage::Joined(Joined {
        extensions: extension(27 + 62),
        ..hand::joined()
    }));
    server.send(&ServerMessage::SceneEvent(hand::shape()));
    server.send_bytes(&[2, 0xc3, 0]);
    server.send(&ServerMessage::SceneEvent(hand::ball(
        hand::BALL,
        Predictor::Ballistic,
    )));
    server.send(&ServerMessage::SnapshotEnd);
    server.send_bytes(&[1, 0xff]);
    goes_on(&mut server)
}

fn byte_by_byte(trial: &mut Trial<'_>) -> CaseResult {
    let mut server = trial.raw_server()?;
    hand::awaits_join(&mut server)?;
    let mut bytes = Vec::new();
    ServerMessage::Joined(hand::joined()).encode(&mut bytes);
    ServerMessage::SceneEvent(hand::shape()).encode(&mut bytes);
    ServerMessage::SceneEvent(hand::ball(hand::BALL, Predictor::Ballistic)).encode(&mut bytes);
    ServerMessage::SnapshotEnd.encode(&mut bytes);
    for byte in bytes {
        server.connection.send_control(vec![byte]);
    }
    goes_on(&mut server)
}

fn goes_on(server: &mut RawServer) -> CaseResult {
    hand::reported(server, "joined")?;
    hand::must_go_on(server, hand::NEXT + 1, hand::TICK + 1, hand::SCENE_EVENTS)
}
