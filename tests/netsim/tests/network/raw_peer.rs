//! Raw peers send exactly the bytes of a test and report their end.

use std::time::Duration;

use rhumb_netsim::{
    RawConnection, RawEvent, RawPeerConfig, RawPeerEnd, RawPeerError, RawPeerServer,
};
use rhumb_transport::{Certificate, Trust};

/// Time limit of every wait; only a failure reaches it.
const TIMEOUT: Duration = Duration::from_secs(10);

fn server(config: &RawPeerConfig) -> RawPeerServer {
    let certificate = Certificate::development(["localhost"]).expect("a good name");
    let anywhere = "127.0.0.1:0".parse().expect("an address");
    RawPeerServer::listen(anywhere, &certificate, config).expect("loopback has a free port")
}

fn connect(server: &RawPeerServer, config: &RawPeerConfig) -> Result<RawConnection, RawPeerError> {
    let trust = Trust::Fingerprint(server.fingerprint());
    RawConnection::connect(server.address(), "localhost", &trust, config, TIMEOUT)
}

fn pair() -> (RawPeerServer, RawConnection, RawConnection) {
    let server = server(&RawPeerConfig::default());
    let client =
        connect(&server, &RawPeerConfig::default()).expect("the server accepts the connection");
    let server_side = server.accept(TIMEOUT).expect("a client connects");
    (server, client, server_side.expect("the handshake succeeds"))
}

/// Bytes of the control stream, up to this length.
fn control(connection: &mut RawConnection, length: usize) -> Vec<u8> {
    let mut bytes = Vec::new();
    while bytes.len() < length {
        match connection.next_event(TIMEOUT) {
            Some(RawEvent::Control(more)) => bytes.extend_from_slice(&more),
            Some(RawEvent::Opened { both_ways }) => assert!(both_ways),
            other => panic!("{other:?}"),
        }
    }
    bytes
}

#[test]
fn both_peers_send_and_receive_on_both_lanes() {
    let (_server, mut client, mut server_side) = pair();
    client.open_control();
    client.send_control(vec![1, 2, 3]);
    assert_eq!(control(&mut server_side, 3), [1, 2, 3]);
    server_side.send_control(vec![4; 100_000]);
    assert_eq!(control(&mut client, 100_000), vec![4; 100_000]);
    assert!(client.send_datagram(vec![7; 1_150]));
    let event = server_side.next_event(TIMEOUT);
    assert_eq!(event, Some(RawEvent::Datagram(vec![7; 1_150].into())));
}

#[test]
fn a_close_code_arrives_unchanged() {
    let (_server, client, mut server_side) = pair();
    client.close(0x3fff_1234);
    let ended = Some(RawEvent::Ended(RawPeerEnd::Closed(0x3fff_1234)));
    assert_eq!(server_side.next_event(TIMEOUT), ended);
    assert_eq!(server_side.next_event(Duration::ZERO), None);
}

#[test]
fn a_peer_of_another_protocol_gets_the_alert() {
    let config = RawPeerConfig {
        alpn: vec![b"other".to_vec()],
        ..RawPeerConfig::default()
    };
    let server = server(&RawPeerConfig::default());
    match connect(&server, &config) {
        Err(RawPeerError::Handshake(end)) => assert_eq!(end, RawPeerEnd::Transport(0x178)),
        other => panic!("{other:?}"),
    }
}

#[test]
fn unread_control_bytes_arrive_later() {
    let (_server, mut client, mut server_side) = pair();
    client.read_control(false);
    client.open_control();
    client.send_control(vec![1]);
    assert_eq!(control(&mut server_side, 1), [1]);
    server_side.send_control(vec![9; 10]);
    assert!(server_side.send_datagram(vec![8]));
    assert_eq!(
        client.next_event(TIMEOUT),
        Some(RawEvent::Datagram(vec![8].into()))
    );
    client.read_control(true);
    assert_eq!(control(&mut client, 10), [9; 10]);
}
