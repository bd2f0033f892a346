//! The relay forwards datagrams both ways under its configuration.
//!
//! Real sockets on loopback; every wait is for a datagram, and lost datagrams are counted, not timed.

use std::net::{Ipv4Addr, SocketAddr, UdpSocket};
use std::time::Duration;

use rhumb_transport::{
    Certificate, ClientOptions, ConnectError, Direction, LinkConfig, Probability, QuicClient,
    QuicServer, ServerOptions, Trust, UdpRelay,
};

/// Longer than any step of these tests; reached only by a failure.
const PATIENCE: Duration = Duration::from_secs(20);

fn free() -> SocketAddr {
    SocketAddr::from((Ipv4Addr::LOCALHOST, 0))
}

fn socket() -> UdpSocket {
    let socket = UdpSocket::bind(free()).expect("a free port is bound");
    socket
        .set_read_timeout(Some(PATIENCE))
        .expect("patience is not zero");
    socket
}

#[test]
fn datagrams_cross_and_come_back_to_their_sender() {
    let server = socket();
    let relay = UdpRelay::start(
        free(),
        server.local_addr().unwrap(),
        "rtt=10ms".parse().unwrap(),
        1,
    )
    .unwrap();
    let clients = [socket(), socket()];
    let mut buffer = [0; 100];
    for (client, word) in clients.iter().zip(["one", "two"]) {
        client.send_to(word.as_bytes(), relay.local_addr()).unwrap();
        let (bytes_len, from) = server.recv_from(&mut buffer).unwrap();
        server.send_to(&buffer[..bytes_len], from).unwrap();
    }
    for (client, word) in clients.iter().zip(["one", "two"]) {
        let (bytes_len, from) = client.recv_from(&mut buffer).unwrap();
        assert_eq!(
            (&buffer[..bytes_len], from),
            (word.as_bytes(), relay.local_addr())
        );
    }
    for direction in [Direction::Up, Direction::Down] {
        let counts = relay.counts(direction);
        assert_eq!(
            (
                counts.delivered.pieces,
                counts.delivered.bytes,
                counts.lost.pieces
            ),
            (2, 6, 0)
        );
    }
}

#[test]
fn quic_connects_through_a_bad_link_and_not_through_a_dead_one() {
    let certificate = Certificate::development(["localhost"]).unwrap();
    let server = QuicServer::bind(ServerOptions {
        listen: free(),
        certificate,
    })
    .unwrap();
    let config: LinkConfig = "rtt=4ms,loss=10%,reorder=5%,dup=5%".parse().unwrap();
    let relay = UdpRelay::start(free(), server.local_addr(), config, 2).unwrap();
    let options = ClientOptions::new(relay.local_addr(), Trust::Fingerprint(server.fingerprint()));
    let client = QuicClient::connect(options.clone(), PATIENCE).unwrap();
    assert!(relay.counts(Direction::Up).delivered.bytes >= 1_200);
    drop(client);
    let dead = UdpRelay::start(
        free(),
        server.local_addr(),
        LinkConfig::PERFECT.with_loss(Probability::ALL),
        3,
    )
    .unwrap();
    let options = ClientOptions {
        server: dead.local_addr(),
        ..options
    };
    let error = QuicClient::connect(options, Duration::from_millis(100)).unwrap_err();
    assert!(
        matches!(error, ConnectError::NothingAnswers { .. }),
        "{error:?}"
    );
    let counts = dead.counts(Direction::Up);
    assert!(counts.lost.pieces > 0 && counts.delivered.pieces == 0);
}
