//! Bytes arrive at their addressee on the lane they were sent on, bounded.

use std::sync::mpsc::channel;

use bytes::Bytes;
use rhumb_protocol::{Ending, Peer};
use rhumb_transport::{Certificate, DATAGRAM_BYTES_MIN, Received, TransportCode};

use crate::support::{Event, Running, TIMEOUT, read_control};

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
