//! L1.3: the QUIC connection below the session.

use std::time::Duration;

use rhumb_netsim::{Carrier, RawPeerConfig, RawPeerEnd};
use rhumb_protocol::limits::DATAGRAM_BYTES_MAX;
use rhumb_protocol::message::{ClientMessage, ServerMessage, StreamChoice};
use rhumb_protocol::session::CloseCode;
use rhumb_transport::Clock;

use super::scenery::lockstep;
use super::table::table;
use crate::case::{Case, CaseRow};
use crate::outcome::{CaseResult, Stop, ensure, should};
use crate::trial::Trial;

/// Close codes of the transport.
const NO_CONTROL_STREAM: u64 = 0x103;
const NO_DATAGRAMS: u64 = 0x104;

/// The cases of plain connections: promise, citations, test function.
const QUIC: &[CaseRow] = &[
    (
        1,
        "a connection negotiates the ALPN name rhumb/1",
        "PROTOCOL 1.1-1",
        |trial| {
            let (line, _relay) = trial.try_connect(&RawPeerConfig::default())?;
            ensure(
                line.alpn().as_deref() == Some(b"rhumb/1"),
                "ALPN names rhumb/1",
            )
        },
    ),
    (
        2,
        "a client with another ALPN protocol is refused",
        "PROTOCOL 1.1-1",
        |trial| refused_alpn(trial, b"h2"),
    ),
    (
        3,
        "a client with a later protocol version in ALPN is refused",
        "PROTOCOL 1.1-1",
        |trial| refused_alpn(trial, b"rhumb/2"),
    ),
];

/// The cases of sessions of browsers.
const WEB: &[CaseRow] = &[
    (
        13,
        "a session carries the protocol as a connection does",
        "PROTOCOL 1.5-1, 1.5-3, 1.5-4",
        |trial| {
            let mut client = trial.client()?;
            client.enter(lockstep(), StreamChoice::Full)?;
            client.barrier().map(drop)
        },
    ),
    (
        14,
        "a request for another path is refused with status 404",
        "PROTOCOL 1.5-2",
        |trial| {
            let config = RawPeerConfig {
                path: "/rhumb/2".to_owned(),
                ..RawPeerConfig::over(Carrier::WebTransport)
            };
            refused_request(trial, &config, "404")
        },
    ),
    (
        15,
        "a page of another origin is refused with status 403",
        "PROTOCOL 1.5-6",
        |trial| {
            let config = RawPeerConfig {
                origin: Some("https://pages.example".to_owned()),
                ..RawPeerConfig::over(Carrier::WebTransport)
            };
            refused_request(trial, &config, "403")
        },
    ),
    (
        16,
        "a close code is that of the session",
        "PROTOCOL 1.5-5",
        |trial| {
            let mut client = trial.client()?;
            client.hello()?;
            client.send_bytes(&[1, 0x7d]);
            client.must_be_closed(CloseCode::MALFORMED)
        },
    ),
];

/// The cases of both.
const CASES: &[CaseRow] = &[
    (
        4,
        "a server accepts the longest datagrams",
        "PROTOCOL 1.1-4, 5.8-5",
        |trial| {
            let (line, _relay) = trial.try_connect(&RawPeerConfig::default())?;
            let most = line.datagram_bytes_max().unwrap_or_default();
            ensure(
                most >= DATAGRAM_BYTES_MAX,
                format!("1150 bytes, not {most}"),
            )
        },
    ),
    (
        5,
        "a client that accepts no datagrams is closed with code 0x104",
        "PROTOCOL 1.1-4",
        |trial| small_datagrams(trial, None),
    ),
    (
        6,
        "a client that accepts only short datagrams is closed with code 0x104",
        "PROTOCOL 1.1-4",
        |trial| small_datagrams(trial, Some(600)),
    ),
    (
        9,
        "a client that resets the control stream is closed with code 0x103",
        "PROTOCOL 1.1-2",
        |trial| {
            let mut client = trial.client()?;
            client.hello()?;
            client.connection.reset_control(7);
            client.must_be_closed_with(&[NO_CONTROL_STREAM])
        },
    ),
    (
        10,
        "another stream of a client has no effect",
        "PROTOCOL 1.1-3, 1.1-2",
        other_streams,
    ),
    (
        11,
        "what was sent before a close arrives",
        "PROTOCOL 1.4-4",
        last_words,
    ),
    (
        12,
        "a client that closes has left, whatever its close code",
        "PROTOCOL 3.4-1, 3.5-9, 3.3-3",
        closes,
    ),
];

/// Cases that wait for a timer of the server.
const SLOW: &[CaseRow] = &[(
    7,
    "a client without a control stream is closed after five seconds",
    "PROTOCOL 1.4-3",
    no_control_stream,
)];

/// The same, of plain connections: of a session's end the suite's client tells no reason.
const SLOW_QUIC: &[CaseRow] = &[(
    8,
    "a silent connection times out after ten seconds",
    "PROTOCOL 1.4-1",
    silent,
)];

pub(super) fn cases() -> Vec<Case> {
    let quic = table("L1.3", &[], QUIC).map(|case| case.only_over(Carrier::Quic));
    let web = table("L1.3", &[], WEB).map(|case| case.only_over(Carrier::WebTransport));
    quic.chain(web)
        .chain(table("L1.3", &[], CASES))
        .chain(table("L1.3", &[], SLOW).map(Case::slow))
        .chain(
            table("L1.3", &[], SLOW_QUIC)
                .map(Case::slow)
                .map(|case| case.only_over(Carrier::Quic)),
        )
        .collect()
}

/// The request of a session is answered by a status.
fn refused_request(trial: &mut Trial<'_>, config: &RawPeerConfig, status: &str) -> CaseResult {
    match trial.try_connect(config) {
        Ok(_) => Stop::fail("it is accepted"),
        Err(Stop::Fail(why)) if why.contains(status) => Ok(()),
        Err(other) => Stop::fail(format!("not refused with {status}: {}", other.why())),
    }
}

fn refused_alpn(trial: &mut Trial<'_>, alpn: &[u8]) -> CaseResult {
    let config = RawPeerConfig {
        alpn: vec![alpn.to_vec()],
        ..RawPeerConfig::default()
    };
    match trial.try_connect(&config) {
        Ok(_) => Stop::fail("it is accepted"),
        // The TLS alert no_application_protocol (120), as a QUIC error code.
        Err(Stop::Fail(why)) if why.contains("0x178") => Ok(()),
        Err(other) => Stop::fail(format!(
            "not refused with no_application_protocol: {}",
            other.why()
        )),
    }
}

fn small_datagrams(trial: &mut Trial<'_>, datagram_bytes: Option<u16>) -> CaseResult {
    let scene = trial.scene();
    let config = RawPeerConfig {
        datagram_bytes,
        ..RawPeerConfig::default()
    };
    let mut client = trial.bare_client(&scene, &config)?;
    client.connection.open_control();
    client.must_be_closed_with(&[NO_DATAGRAMS])
}

fn no_control_stream(trial: &mut Trial<'_>) -> CaseResult {
    let scene = trial.scene();
    let mut client = trial.bare_client(&scene, &RawPeerConfig::default())?;
    let clock = Clock::start();
    while client.ended.is_none() && clock.now().as_nanos() < 8_000_000_000 {
        client.next_message()?;
    }
    let seconds = clock.now().as_nanos() as f64 / 1e9;
    let given_up = client.ended == Some(RawPeerEnd::Closed(NO_CONTROL_STREAM));
    should(
        given_up,
        format!("closed with code 0x103, not {:?}", client.ended),
    )?;
    should(
        (4.0..=7.0).contains(&seconds),
        format!("after 5 s, not {seconds:.1} s"),
    )
}

fn silent(trial: &mut Trial<'_>) -> CaseResult {
    let scene = trial.scene();
    let config = RawPeerConfig {
        idle: Duration::from_secs(60),
        keep_alive: None,
        ..RawPeerConfig::default()
    };
    let mut client = trial.bare_client(&scene, &config)?;
    client.connection.open_control();
    client.hello()?;
    let clock = Clock::start();
    while client.ended.is_none() && clock.now().as_nanos() < 16_000_000_000 {
        client.next_message()?;
    }
    let seconds = clock.now().as_nanos() as f64 / 1e9;
    ensure(
        client.ended == Some(RawPeerEnd::TimedOut),
        format!("it times out, not {:?}", client.ended),
    )?;
    ensure(
        (9.0..=13.0).contains(&seconds),
        format!("after 10 s, not {seconds:.1} s"),
    )
}

fn other_streams(trial: &mut Trial<'_>) -> CaseResult {
    let mut client = trial.client()?;
    client.hello()?;
    client.connection.open_another(true);
    client.connection.open_another(false);
    // The server may ignore or stop the streams; the control stream must still work.
    client.create(lockstep())?;
    client.join(StreamChoice::Full)?;
    client.barrier().map(drop)
}

fn last_words(trial: &mut Trial<'_>) -> CaseResult {
    let mut client = trial.client()?;
    client.hello()?;
    let mut bytes = Vec::new();
    ClientMessage::Create(lockstep()).encode(&mut bytes);
    bytes.extend_from_slice(&[1, 0x7d]);
    client.send_bytes(&bytes);
    client
        .await_message("answer that was due before the close", |message| {
            matches!(message, ServerMessage::Created).then_some(())
        })
        .or_else(|stop| should(false, stop.why()))?;
    client.must_be_closed(CloseCode::MALFORMED)
}

fn closes(trial: &mut Trial<'_>) -> CaseResult {
    let mut one = trial.client()?;
    one.enter(lockstep(), StreamChoice::Full)?;
    let scene = one.scene.clone();
    one.connection.close(0x3fff_1234);
    drop(one);
    let mut other = trial.client_of(&scene)?;
    let welcome = other.hello()?;
    ensure(welcome.scene.is_some(), "its scene still exists")?;
    other.join(StreamChoice::Full)?;
    other.barrier().map(drop)
}
