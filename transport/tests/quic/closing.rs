//! Every end is told, once, with its code, after what was said before it.

use bytes::Bytes;
use rhumb_protocol::{Ending, Peer};
use rhumb_transport::{Received, TransportCode};

use crate::support::{Event, PATIENCE, Running, read_control};

#[test]
fn a_stopped_server_tells_its_clients() {
    let mut server = Running::echo();
    let mut client = server.connect();
    client.send_control(Bytes::from_static(b"hello"));
    assert_eq!(read_control(&mut client, 5), b"hello");
    let statistics = server.stop();
    assert_eq!((statistics.opened, statistics.refused), (1, 0));
    let ended = Received::Ended(Ending::Closed(TransportCode::GOING_AWAY.0));
    assert_eq!(client.recv(PATIENCE), Some(ended));
    assert_eq!(client.recv(PATIENCE), None);
}

#[test]
fn what_the_endpoint_said_before_closing_arrives() {
    let server = Running::echo();
    let mut client = server.connect();
    client.send_control(Bytes::from_static(b"!"));
    assert_eq!(read_control(&mut client, 3), b"bye");
    assert_eq!(
        client.recv(PATIENCE),
        Some(Received::Ended(Ending::Closed(7)))
    );
    assert_eq!(
        server.events.recv_timeout(PATIENCE),
        Ok(Event::Opened(Peer(0)))
    );
    assert_eq!(
        server.events.recv_timeout(PATIENCE),
        Ok(Event::Ended(Peer(0), Ending::Closed(7)))
    );
}

#[test]
fn a_client_that_closes_tells_its_code() {
    let server = Running::echo();
    let client = server.connect();
    client.send_control(Bytes::from_static(b"last word"));
    client.close(9);
    assert_eq!(
        server.events.recv_timeout(PATIENCE),
        Ok(Event::Opened(Peer(0)))
    );
    assert_eq!(
        server.events.recv_timeout(PATIENCE),
        Ok(Event::Ended(Peer(0), Ending::Closed(9)))
    );
}

#[test]
fn a_dropped_client_has_left() {
    let server = Running::echo();
    drop(server.connect());
    assert_eq!(
        server.events.recv_timeout(PATIENCE),
        Ok(Event::Opened(Peer(0)))
    );
    let left = Ending::Closed(TransportCode::LEFT.0);
    assert_eq!(
        server.events.recv_timeout(PATIENCE),
        Ok(Event::Ended(Peer(0), left))
    );
}

#[test]
fn a_stop_said_early_stops_at_once() {
    let mut server = Running::echo();
    let statistics = server.stop();
    assert_eq!(statistics.opened, 0);
}
