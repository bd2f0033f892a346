//! Bytes arrive at their addressee on the lane they were sent on, bounded.

use std::collections::VecDeque;
use std::sync::mpsc::{Sender, channel};

use bytes::Bytes;
use rhumb_protocol::{Ending, Endpoint, Instant, Peer, Transmit, Wake};
use rhumb_transport::{
    Certificate, ClientOptions, ClientTransport as _, DATAGRAM_BYTES_MIN, QuicClient, Received,
    TransportCode, Trust,
};

use crate::support::{Event, Running, TIMEOUT, read_control, serve};

#[test]
fn both_lanes_carry_there_and_back() {
    let server = Running::echo();
    let mut client = server.connect();
    assert!(client.max_datagram_bytes() >= DATAGRAM_BYTES_MIN);
    client.send_control(Bytes::from_static(b"hello"));
    assert_eq!(read_control(&mut client, 5), b"hello");
    let full = Bytes::from(vec![3; DATAGRAM_BYTES_MIN]);
    client.send_state(full.clone());
    assert_eq!(client.recv(TIMEOUT), Some(Received::State(full)));
    let wire = client.statistics();
    assert!(wire.sent_bytes > 1_200 && wire.received_bytes > 1_200);
    assert!(server.watch.traffic().received_bytes > 1_200);
}

#[test]
fn a_long_control_stream_arrives_whole_and_in_order() {
    let server = Running::echo();
    let mut client = server.connect();
    let sent: Vec<u8> = (0..2_000_000_u32).map(|n| (n % 31) as u8).collect();
    for piece in sent.chunks(10_007) {
        client.send_control(Bytes::copy_from_slice(piece));
    }
    assert!(read_control(&mut client, sent.len()) == sent);
}

/// Answers control bytes with a few others, and tells the test how many of them were taken.
struct Greeter {
    out: VecDeque<Transmit>,
    taken: Sender<usize>,
}

impl Endpoint for Greeter {
    fn handle_opened(&mut self, _: Instant, _: Peer) {}

    fn handle_control(&mut self, _: Instant, from: Peer, _: &[u8]) {
        let bytes = Bytes::from_static(b"few");
        self.out.push_back(Transmit::Control { to: from, bytes });
    }

    fn handle_control_taken(&mut self, _: Instant, _: Peer, bytes: usize) {
        if bytes > 0 {
            let _ = self.taken.send(bytes);
        }
    }

    fn handle_datagram(&mut self, _: Instant, _: Peer, _: &[u8]) {}

    fn handle_ended(&mut self, _: Instant, _: Peer, _: Ending) {}

    fn handle_timeout(&mut self, _: Instant) {}

    fn poll_transmit(&mut self) -> Option<Transmit> {
        self.out.pop_front()
    }

    fn poll_timeout(&self) -> Option<Wake> {
        None
    }
}

#[test]
fn a_server_learns_of_few_taken_control_bytes() {
    let (taken, informed) = channel();
    let greeter = Greeter {
        out: VecDeque::new(),
        taken,
    };
    let certificate = Certificate::development(["localhost"]).expect("localhost is a name");
    let (bound, stop, thread) = serve(certificate, greeter);
    let options = ClientOptions::new(bound.address, Trust::Fingerprint(bound.fingerprint));
    let mut client = QuicClient::connect(options, TIMEOUT).expect("the server runs");
    client.send_control(Bytes::from_static(b"hello"));
    assert_eq!(read_control(&mut client, 3), b"few");
    // The server reads its links when it is awake.
    let found = (0..1_000).find_map(|_| {
        client.send_state(Bytes::from_static(b"awake"));
        informed.recv_timeout(TIMEOUT / 1_000).ok()
    });
    assert_eq!(found, Some(3));
    stop.stop();
    thread.join().expect("the server thread returns");
}

#[test]
fn each_client_receives_only_its_own_bytes() {
    let server = Running::echo();
    let mut clients = [server.connect(), server.connect()];
    for (client, word) in clients.iter().zip([b"one", b"two"]) {
        client.send_control(Bytes::from_static(word));
        client.send_state(Bytes::from_static(word));
    }
    for (client, word) in clients.iter_mut().zip([b"one", b"two"]) {
        let mut received = Vec::new();
        while received.len() < 2 {
            received.push(client.recv(TIMEOUT).unwrap());
        }
        let word = Bytes::from_static(word);
        assert!(received.contains(&Received::Control(word.clone())));
        assert!(received.contains(&Received::State(word)));
    }
    assert_eq!(server.watch.connections().len(), 2);
}

#[test]
fn a_flood_of_control_bytes_waits_at_the_sender() {
    let (release, open_gate) = channel();
    let server = Running::start(
        Certificate::development(["localhost"]).unwrap(),
        Some(open_gate),
    );
    let mut client = server.connect();
    let piece = Bytes::from(vec![0; 16 << 10]);
    let mut sent = 0;
    // The server thread stands still: the server takes in two bounds' worth, then the client's own queue fills.
    let ending = loop {
        client.send_control(piece.clone());
        sent += piece.len();
        if let Some(received) = client.recv(std::time::Duration::from_millis(1)) {
            break received;
        }
    };
    assert_eq!(
        ending,
        Received::Ended(Ending::Closed(TransportCode::CONTROL_OVERFLOW.0))
    );
    let wire_bytes = client.statistics().sent_bytes;
    assert!(
        wire_bytes < 1 << 20,
        "{wire_bytes} of {sent} bytes left the client"
    );
    release.send(()).unwrap();
    assert_eq!(
        server.events.recv_timeout(TIMEOUT),
        Ok(Event::Opened(Peer(0)))
    );
    let ended = Event::Ended(Peer(0), Ending::Closed(TransportCode::CONTROL_OVERFLOW.0));
    assert_eq!(server.events.recv_timeout(TIMEOUT), Ok(ended));
}
