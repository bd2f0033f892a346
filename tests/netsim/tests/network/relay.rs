//! The relay forwards datagrams both ways under its configuration.
//!
//! Real sockets on loopback; every wait is for a datagram, and lost datagrams are counted, not timed.

use std::collections::VecDeque;
use std::net::{Ipv4Addr, SocketAddr, UdpSocket};
use std::thread;
use std::time::Duration;

use bytes::Bytes;
use rhumb_netsim::{Direction, LinkConfig, Probability, UdpRelay};
use rhumb_protocol::{Ending, Endpoint, Instant, Peer, Transmit, Wake};
use rhumb_transport::{
    Certificate, ClientOptions, ClientTransport, ConnectError, QuicClient, QuicServer, Received,
    ServerOptions, Stop, Trust,
};

/// Time limit of every wait; only a failure reaches it.
const TIMEOUT: Duration = Duration::from_secs(20);

fn free() -> SocketAddr {
    SocketAddr::from((Ipv4Addr::LOCALHOST, 0))
}

fn socket() -> UdpSocket {
    let socket = UdpSocket::bind(free()).expect("a free port is bound");
    socket
        .set_read_timeout(Some(TIMEOUT))
        .expect("the timeout is not zero");
    socket
}

#[test]
fn answers_arrive_at_the_sender_of_the_request() {
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
    for (client, text) in clients.iter().zip(["one", "two"]) {
        client.send_to(text.as_bytes(), relay.local_addr()).unwrap();
        let (bytes_len, from) = server.recv_from(&mut buffer).unwrap();
        server.send_to(&buffer[..bytes_len], from).unwrap();
    }
    for (client, text) in clients.iter().zip(["one", "two"]) {
        let (bytes_len, from) = client.recv_from(&mut buffer).unwrap();
        assert_eq!(
            (&buffer[..bytes_len], from),
            (text.as_bytes(), relay.local_addr())
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
    let server = QuicServer::bind(ServerOptions::new(free(), certificate)).unwrap();
    let config: LinkConfig = "rtt=4ms,loss=10%,reorder=5%,dup=5%".parse().unwrap();
    let relay = UdpRelay::start(free(), server.local_addr(), config, 2).unwrap();
    let options = ClientOptions::new(relay.local_addr(), Trust::Fingerprint(server.fingerprint()));
    let client = QuicClient::connect(options.clone(), TIMEOUT).unwrap();
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

/// Sends control bytes back.
#[derive(Default)]
struct Echo(VecDeque<Transmit>);

impl Endpoint for Echo {
    fn handle_opened(&mut self, _: Instant, _: Peer) {}

    fn handle_control(&mut self, _: Instant, from: Peer, bytes: &[u8]) {
        let bytes = Bytes::copy_from_slice(bytes);
        self.0.push_back(Transmit::Control { to: from, bytes });
    }

    fn handle_datagram(&mut self, _: Instant, _: Peer, _: &[u8]) {}
    fn handle_ended(&mut self, _: Instant, _: Peer, _: Ending) {}
    fn handle_timeout(&mut self, _: Instant) {}

    fn poll_transmit(&mut self) -> Option<Transmit> {
        self.0.pop_front()
    }

    fn poll_timeout(&self) -> Option<Wake> {
        None
    }
}

#[test]
fn a_burst_of_control_bytes_crosses_a_relay() {
    let certificate = Certificate::development(["localhost"]).unwrap();
    let server = QuicServer::bind(ServerOptions::new(free(), certificate)).unwrap();
    let (address, fingerprint) = (server.local_addr(), server.fingerprint());
    let stop = Stop::new();
    thread::scope(|scope| {
        scope.spawn(|| server.run(&mut Echo::default(), &stop));
        let relay = UdpRelay::start(free(), address, "rtt=20ms".parse().unwrap(), 1).unwrap();
        let options = ClientOptions::new(relay.local_addr(), Trust::Fingerprint(fingerprint));
        let mut client = QuicClient::connect(options, TIMEOUT).unwrap();
        let sent = vec![b'x'; 200_000];
        client.send_control(Bytes::from(sent.clone()));
        let mut read = Vec::new();
        while read.len() < sent.len() {
            match client.recv(TIMEOUT) {
                Some(Received::Control(bytes)) => read.extend_from_slice(&bytes),
                other => panic!("{} control bytes, then {other:?}", read.len()),
            }
        }
        stop.stop();
        assert_eq!(read, sent);
    });
}
