//! Every end is reported once, with its code, after the earlier bytes.
//!
//! It has caught: the end of a connection whose control bytes were held back was never reported.

use bytes::Bytes;
use rhumb_protocol::{Ending, Peer};
use rhumb_transport::{ClientTransport as _, QuicClient, Received, TransportCode};

use crate::support::{Event, Running, TIMEOUT, read_control, until_end};

/// More control bytes than a server reads without handling them, and fewer than its flow control lets arrive.
const WAITING_BYTES: usize = 384 << 10;
/// More control bytes than flow control lets arrive.
const STUCK_BYTES: usize = 700 << 10;

/// Waits until a server has received as many bytes as [`WAITING_BYTES`], headers of packets included.
fn wait_for_arrival(server: &Running, client: &mut QuicClient) {
    let has_arrived = (0..20_000).any(|_| {
        let has_arrived = server.watch.traffic().received_bytes >= WAITING_BYTES as u64;
        if !has_arrived {
            assert_eq!(client.recv(TIMEOUT / 20_000), None);
        }
        has_arrived
    });
    assert!(has_arrived, "{:?}", server.watch.traffic());
}

#[test]
fn a_stopped_server_closes_its_clients() {
    let mut server = Running::echo();
    let mut client = server.connect();
    client.send_control(Bytes::from_static(b"hello"));
    assert_eq!(read_control(&mut client, 5), b"hello");
    let statistics = server.stop();
    assert_eq!((statistics.opened, statistics.refused), (1, 0));
    let ended = Received::Ended(Ending::Closed(TransportCode::GOING_AWAY.0));
    assert_eq!(client.recv(TIMEOUT), Some(ended));
    assert_eq!(client.recv(TIMEOUT), None);
}

#[test]
fn bytes_sent_before_a_close_arrive() {
    let server = Running::echo();
    let mut client = server.connect();
    client.send_control(Bytes::from_static(b"!"));
    assert_eq!(read_control(&mut client, 3), b"bye");
    assert_eq!(
        client.recv(TIMEOUT),
        Some(Received::Ended(Ending::Closed(7)))
    );
    assert_eq!(
        server.events.recv_timeout(TIMEOUT),
        Ok(Event::Opened(Peer(0)))
    );
    assert_eq!(
        server.events.recv_timeout(TIMEOUT),
        Ok(Event::Ended(Peer(0), Ending::Closed(7)))
    );
}

#[test]
fn a_closing_client_delivers_its_code() {
    let server = Running::echo();
    let client = server.connect();
    client.send_control(Bytes::from_static(b"last word"));
    client.close(9);
    assert_eq!(
        server.events.recv_timeout(TIMEOUT),
        Ok(Event::Opened(Peer(0)))
    );
    assert_eq!(
        server.events.recv_timeout(TIMEOUT),
        Ok(Event::Ended(Peer(0), Ending::Closed(9)))
    );
}

#[test]
fn a_dropped_client_closes_its_connection() {
    let server = Running::echo();
    drop(server.connect());
    assert_eq!(
        server.events.recv_timeout(TIMEOUT),
        Ok(Event::Opened(Peer(0)))
    );
    let left = Ending::Closed(TransportCode::LEFT.0);
    assert_eq!(
        server.events.recv_timeout(TIMEOUT),
        Ok(Event::Ended(Peer(0), left))
    );
}

#[test]
fn a_stop_before_the_run_returns_at_once() {
    let mut server = Running::echo();
    let statistics = server.stop();
    assert_eq!(statistics.opened, 0);
}

#[test]
fn unwanted_bytes_that_arrived_before_a_close_are_handled() {
    let server = Running::unwilling();
    let mut client = server.connect();
    client.send_control(Bytes::from(vec![0; WAITING_BYTES]));
    wait_for_arrival(&server, &mut client);
    client.close(9);
    let all = (WAITING_BYTES, Ending::Closed(9));
    assert_eq!(until_end(&server.events), all);
}

#[test]
fn a_client_that_closes_while_its_bytes_wait_ends() {
    let server = Running::unwilling();
    let mut client = server.connect();
    client.send_control(Bytes::from(vec![0; STUCK_BYTES]));
    wait_for_arrival(&server, &mut client);
    client.close(9);
    let (_, ending) = until_end(&server.events);
    assert_eq!(ending, Ending::Closed(9));
}

#[test]
fn a_client_that_the_server_closes_while_its_bytes_wait_ends() {
    let server = Running::unwilling();
    let mut client = server.connect();
    client.send_control(Bytes::from(vec![0; STUCK_BYTES]));
    wait_for_arrival(&server, &mut client);
    // A datagram may be lost.
    let received = (0..1_000).find_map(|_| {
        client.send_state(Bytes::from_static(b"close"));
        client.recv(TIMEOUT / 1_000)
    });
    assert_eq!(received, Some(Received::Ended(Ending::Closed(7))));
    assert_eq!(until_end(&server.events), (0, Ending::Closed(7)));
}
