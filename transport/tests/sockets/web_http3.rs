//! HTTP/3 below sessions of WebTransport, as clients of each draft send it.
//!
//! The client is one of QUIC alone: each test writes its bytes.

use std::net::{Ipv4Addr, SocketAddr};

use bytes::Bytes;
use quinn::{Connection, ConnectionError, RecvStream, SendStream, VarInt};
use rhumb_protocol::Ending;
use rhumb_transport::Origins;
use tokio::net::UdpSocket;
use web_transport_quinn::proto::{
    Capsule, ConnectError, ConnectResponse, Frame, Setting, Settings,
};

use crate::support::TIMEOUT;
use crate::web::{PATH, WebServer, ending, runtime, serve};

/// The settings that a client of a draft sends, beside datagrams of RFC 9297.
struct Draft {
    name: &'static str,
    /// Numbers and values.
    settings: &'static [(u64, u64)],
    /// Its name of sessions.
    protocol: &'static str,
}

const fn draft(
    name: &'static str,
    settings: &'static [(u64, u64)],
    protocol: &'static str,
) -> Draft {
    Draft {
        name,
        settings,
        protocol,
    }
}

const DRAFTS: &[Draft] = &[
    draft("2, as aioquic", &[(0x2b60_3742, 1)], "webtransport"),
    draft(
        "2, as browsers",
        &[(0x2b60_3742, 1), (0xff_d277, 1)],
        "webtransport",
    ),
    draft("7", &[(0xc671_706a, 1)], "webtransport"),
    draft("10, as webtransport-go 0.10", &[(0x08, 1)], "webtransport"),
    draft("14", &[(0x14e9_cd29, 1), (0x2b65, 8)], "webtransport"),
    draft("16", &[(0x2c7c_f000, 1)], "webtransport-h3"),
    draft("none stated", &[], "webtransport"),
];

const DATAGRAMS: (u64, u64) = (0x33, 1);

fn number(bytes: &mut Vec<u8>, number: u64) {
    let number = web_transport_quinn::proto::VarInt::from_u64(number).expect("below 2^62");
    number.encode(bytes);
}

/// The stream of settings: its type, a frame, its length, pairs.
fn settings(pairs: &[(u64, u64)]) -> Vec<u8> {
    let mut content = Vec::new();
    for (setting, value) in pairs {
        number(&mut content, *setting);
        number(&mut content, *value);
    }
    let mut stream = vec![0x00, 0x04];
    number(&mut stream, content.len() as u64);
    [stream, content].concat()
}

/// A frame of fields, name and value as text.
fn fields(lines: &[(&str, &str)]) -> Vec<u8> {
    let mut section = vec![0, 0];
    for (name, value) in lines {
        for (text, most, flags) in [(name, 7, 0x20), (value, 127, 0)] {
            let length = u8::try_from(text.len()).expect("short fields");
            match length < most {
                true => section.push(flags | length),
                false => section.extend([flags | most, length - most]),
            }
            section.extend_from_slice(text.as_bytes());
        }
    }
    let mut frame = vec![0x01];
    number(&mut frame, section.len() as u64);
    [frame, section].concat()
}

fn request<'a>(protocol: &'a str, path: &'a str) -> Vec<(&'a str, &'a str)> {
    vec![
        (":method", "CONNECT"),
        (":scheme", "https"),
        (":authority", "127.0.0.1"),
        (":path", path),
        (":protocol", protocol),
    ]
}

struct Http3 {
    connection: Connection,
    /// Streams that must stay open.
    kept: Vec<SendStream>,
    answers: Vec<RecvStream>,
}

impl Http3 {
    async fn open(server: &WebServer) -> Self {
        let pinned = server.hashes.current()[0];
        let connection = server.open(pinned, b"h3").await;
        Self {
            connection: connection.expect("the certificate for browsers"),
            kept: Vec::new(),
            answers: Vec::new(),
        }
    }

    async fn one_way(&mut self, bytes: &[u8]) {
        let mut stream = self.connection.open_uni().await.expect("it may");
        stream.write_all(bytes).await.expect("it is open");
        self.kept.push(stream);
    }

    async fn send(&self, bytes: &[u8]) -> (SendStream, RecvStream) {
        let (mut send, recv) = self.connection.open_bi().await.expect("it may");
        send.write_all(bytes).await.expect("it is open");
        (send, recv)
    }

    /// Requests a session; the status, the protocol that was chosen, and the stream.
    async fn ask(&mut self, lines: &[(&str, &str)]) -> (u16, Option<String>, SendStream) {
        let (send, mut recv) = self.send(&fields(lines)).await;
        let answer = tokio::time::timeout(TIMEOUT, ConnectResponse::read(&mut recv)).await;
        self.answers.push(recv);
        match answer.expect("an answer") {
            Ok(answer) => (answer.status.as_u16(), answer.protocol, send),
            Err(ConnectError::WrongStatus(Some(status))) => (status.as_u16(), None, send),
            Err(cause) => panic!("{cause}"),
        }
    }

    /// The control stream of the session that the first request opened.
    async fn control(&self) -> (SendStream, RecvStream) {
        let (mut send, mut recv) = self.send(&[0x40, 0x41, 0x00, b'a']).await;
        let mut echo = [0];
        recv.read_exact(&mut echo).await.expect("the echo");
        assert_eq!(&echo, b"a");
        send.write_all(b"b").await.expect("it is open");
        (send, recv)
    }

    /// A session of draft 16 with its control stream; the request's stream first.
    async fn session(&mut self) -> (SendStream, RecvStream, SendStream, RecvStream) {
        self.one_way(&settings(&[DATAGRAMS])).await;
        let (send, mut recv) = self.send(&fields(&request("webtransport-h3", PATH))).await;
        ConnectResponse::read(&mut recv).await.expect("a session");
        let (control, echo) = self.control().await;
        (send, recv, control, echo)
    }
}

/// A frame of data with the capsule that closes a session.
fn close(code: u32) -> Vec<u8> {
    let reason = String::new();
    let mut capsule = Vec::new();
    Capsule::CloseWebTransportSession { code, reason }.encode(&mut capsule);
    let mut frame = Vec::new();
    Frame::DATA.encode(&mut frame);
    number(&mut frame, capsule.len() as u64);
    [frame, capsule].concat()
}

/// A relay that lets one datagram to the server pass, and all from it.
async fn deaf(server: SocketAddr) -> SocketAddr {
    let near = UdpSocket::bind((Ipv4Addr::LOCALHOST, 0))
        .await
        .expect("a socket");
    let far = UdpSocket::bind((Ipv4Addr::LOCALHOST, 0))
        .await
        .expect("a socket");
    let address = near.local_addr().expect("it is bound");
    tokio::spawn(async move {
        let mut bytes = [0; 2048];
        let (length, client) = near.recv_from(&mut bytes).await.expect("the first flight");
        far.send_to(&bytes[..length], server)
            .await
            .expect("loopback");
        while let Ok(length) = far.recv(&mut bytes).await {
            near.send_to(&bytes[..length], client)
                .await
                .expect("loopback");
        }
    });
    address
}

#[test]
fn settings_of_all_drafts_come_with_the_first_flight_and_wait_for_nothing() {
    let server = serve(Origins::loopback());
    runtime().block_on(async {
        // The server never has the end of the handshake, and nothing of HTTP/3.
        let relay = deaf(server.address).await;
        let pinned = server.hashes.current()[0];
        let connection = server.open_through(relay, pinned, b"h3").await;
        let connection = connection.expect("the client has the end of the handshake");
        let received = async {
            let mut stream = connection.accept_uni().await.expect("the settings");
            let settings = Settings::read(&mut stream).await.expect("of http/3");
            (stream, settings)
        };
        let received = tokio::time::timeout(TIMEOUT, received).await;
        let (_stream, settings) = received.expect("settings without a word of the client");
        for (setting, value) in [
            // Extended CONNECT, datagrams, datagrams of their drafts.
            (0x08, 1),
            (0x33, 1),
            (0xff_d277, 1),
            // Drafts 2 to 6, 7 to 12, 13 and 14, 15 and 16.
            (0x2b60_3742, 1),
            (0x2b60_3743, 1),
            (0xc671_706a, 1),
            (0x14e9_cd29, 1),
            (0x2c7c_f000, 1),
        ] {
            let number = web_transport_quinn::proto::VarInt::from_u32(setting);
            let sent = settings.get(&Setting(number)).map(|sent| sent.into_inner());
            assert_eq!(sent, Some(value), "{setting:#x}");
        }
        // No limits of streams and bytes of a session: then no end keeps them.
        for setting in [0x2b61, 0x2b64, 0x2b65] {
            let number = web_transport_quinn::proto::VarInt::from_u32(setting);
            assert!(settings.get(&Setting(number)).is_none(), "{setting:#x}");
        }
    });
}

#[test]
fn a_client_of_each_draft_has_a_session() {
    let server = serve(Origins::loopback());
    runtime().block_on(async {
        for draft in DRAFTS {
            let mut client = Http3::open(&server).await;
            client
                .one_way(&settings(&[draft.settings, &[DATAGRAMS][..]].concat()))
                .await;
            let (status, chosen, _request) = client.ask(&request(draft.protocol, PATH)).await;
            assert_eq!((status, chosen), (200, None), "draft {}", draft.name);
            client.control().await;
        }
        let mut old = Http3::open(&server).await;
        old.one_way(&settings(&[(0xff_d277, 1)])).await;
        let (status, ..) = old.ask(&request("webtransport", PATH)).await;
        assert_eq!(status, 200, "datagrams before RFC 9297");
    });
}

#[test]
fn a_client_opens_its_streams_and_sends_its_frames_in_any_order() {
    let server = serve(Origins::loopback());
    runtime().block_on(async {
        let mut client = Http3::open(&server).await;
        // A reserved frame before the request, which comes before all settings.
        let reserved = [
            &[0x21, 0x02, 7, 7][..],
            &fields(&request("webtransport-h3", PATH)),
        ];
        let (_send, mut recv) = client.send(&reserved.concat()).await;
        // Streams of header compression, one without a byte, before the settings, which have a reserved one.
        let silent = client.connection.open_uni().await.expect("it may");
        client.kept.push(silent);
        client.one_way(&[0x03]).await;
        client.one_way(&settings(&[(0x40, 5), DATAGRAMS])).await;
        let answer = tokio::time::timeout(TIMEOUT, ConnectResponse::read(&mut recv)).await;
        assert!(answer.expect("an answer").is_ok());
        client.control().await;
    });
}

#[test]
fn a_server_chooses_its_protocol_where_a_client_lists_it() {
    let server = serve(Origins::loopback());
    runtime().block_on(async {
        for (list, chosen) in [
            ("\"moq-lite-04\", \"rhumb/1\"", Some("rhumb/1")),
            ("\"rhumb/2\"", None),
            // No list of texts: it counts as none.
            ("rhumb", None),
            ("\"rhumb/1", None),
        ] {
            let mut client = Http3::open(&server).await;
            client.one_way(&settings(&[DATAGRAMS])).await;
            let mut lines = request("webtransport-h3", PATH);
            lines.push(("wt-available-protocols", list));
            let (status, answered, _request) = client.ask(&lines).await;
            assert_eq!((status, answered.as_deref()), (200, chosen), "{list}");
        }
    });
}

#[test]
fn what_is_refused_has_its_status_and_no_session() {
    let with = |more: (&'static str, &'static str)| {
        let mut lines = request("webtransport-h3", PATH);
        lines.push(more);
        lines
    };
    let mut page = request("webtransport", PATH);
    page[0] = (":method", "GET");
    let mut nowhere = request("webtransport-h3", PATH);
    nowhere.remove(3);
    let server = serve(Origins::loopback());
    runtime().block_on(async {
        for (status, datagrams, lines) in [
            (403, 1, with(("origin", "https://example.org"))),
            (403, 1, with(("origin", "null"))),
            (404, 1, request("webtransport-h3", "/")),
            (404, 1, request("webtransport", "/rhumb/2")),
            (405, 1, page),
            (501, 1, request("websocket", PATH)),
            (400, 1, nowhere),
            (400, 0, request("webtransport-h3", PATH)),
        ] {
            let mut client = Http3::open(&server).await;
            client.one_way(&settings(&[(0x33, datagrams)])).await;
            let (answered, _, _request) = client.ask(&lines).await;
            assert_eq!(answered, status, "{lines:?}");
            let end = tokio::time::timeout(TIMEOUT, client.connection.closed()).await;
            let end = end.expect("the connection ends");
            assert!(
                matches!(&end, ConnectionError::ApplicationClosed(close) if close.error_code == VarInt::from_u32(0x100)),
                "{end:?}"
            );
        }
    });
    assert!(
        server.events.try_recv().is_err(),
        "the endpoint saw nothing"
    );
}

#[test]
fn fields_beyond_the_settings_are_refused_before_they_arrive() {
    let server = serve(Origins::loopback());
    runtime().block_on(async {
        let mut client = Http3::open(&server).await;
        client.one_way(&settings(&[DATAGRAMS])).await;
        let mut frame = vec![0x01];
        number(&mut frame, (16 << 10) + 1);
        let (_send, mut recv) = client.send(&frame).await;
        let answer = tokio::time::timeout(TIMEOUT, ConnectResponse::read(&mut recv)).await;
        let refused = answer.expect("an answer").unwrap_err();
        assert!(
            matches!(&refused, ConnectError::WrongStatus(Some(status)) if status.as_u16() == 431),
            "{refused}"
        );
    });
}

#[test]
fn a_second_request_is_rejected_and_the_session_goes_on() {
    let server = serve(Origins::loopback());
    runtime().block_on(async {
        let mut client = Http3::open(&server).await;
        client.one_way(&settings(&[DATAGRAMS])).await;
        let (status, _, _request) = client.ask(&request("webtransport-h3", PATH)).await;
        assert_eq!(status, 200);
        let (mut second, mut answer) = client
            .send(&fields(&request("webtransport-h3", PATH)))
            .await;
        let stopped = tokio::time::timeout(TIMEOUT, second.stopped()).await;
        let rejected = VarInt::from_u32(0x10b);
        assert_eq!(stopped.expect("it is stopped").ok(), Some(Some(rejected)));
        let end = answer.read_to_end(16).await.unwrap_err().to_string();
        assert!(end.contains(&0x10b.to_string()), "{end}");
        let _ = second.reset(VarInt::from_u32(0));
        client.control().await;
    });
}

#[test]
fn streams_that_a_client_resets_with_its_session_do_not_hide_the_close_code() {
    const GONE: VarInt = VarInt::from_u32(0x170d_7b68);
    let server = serve(Origins::loopback());
    runtime().block_on(async {
        for (reset, code, expected) in [
            (GONE, Some(9), 9),
            // Without a code, and by any other reset, the control stream broke.
            (GONE, None, 0x103),
            (VarInt::from_u32(0x10c), None, 0x103),
        ] {
            let mut client = Http3::open(&server).await;
            let (mut request, _answer, mut control, mut echo) = client.session().await;
            control.reset(reset).expect("it is open");
            echo.stop(reset).expect("it is open");
            // The server has them before the code: a datagram behind them comes back.
            let datagram = Bytes::from_static(&[0, 7]);
            let sent = client.connection.send_datagram(datagram.clone());
            sent.expect("it fits");
            let came = tokio::time::timeout(TIMEOUT, client.connection.read_datagram()).await;
            assert_eq!(came.expect("the echo").expect("the echo"), datagram);
            if let Some(code) = code {
                request.write_all(&close(code)).await.expect("it is open");
                request.finish().expect("it is open");
            }
            assert_eq!(ending(&server).await, Ending::Closed(expected));
        }
    });
}
