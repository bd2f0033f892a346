//! Every end is reported once, with its code, after the earlier bytes.

use bytes::Bytes;
use rhumb_protocol::{Ending, Peer};
use rhumb_transport::{ClientTransport as _, Received, TransportCode};

use crate::support::{Event, Running, TIMEOUT, read_control};

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
