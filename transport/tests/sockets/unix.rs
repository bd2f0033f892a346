//! Unix sockets: the lanes and ends of the network, and files left behind.

use std::fs;
use std::io::{Read, Write};
use std::os::unix::fs::PermissionsExt;
use std::os::unix::net::UnixStream;
use std::path::PathBuf;
use std::sync::mpsc::{Receiver, channel};
use std::thread::{self, JoinHandle};

use bytes::Bytes;
use rhumb_protocol::{Ending, Endpoint, Peer};
use rhumb_transport::{
    Certificate, ClientTransport as _, QuicServer, Received, ServerOptions, Stop, TransportCode,
    UnixClient, UnixServer,
};
use tempfile::TempDir;

use crate::support::{Echo, Event, TIMEOUT, Unwilling, until_end};

/// A server with a Unix socket.
struct Running {
    folder: TempDir,
    events: Receiver<Event>,
    stop: Stop,
    thread: Option<JoinHandle<()>>,
}

impl Running {
    fn start() -> Self {
        let (sender, events) = channel();
        Self::of(Echo::new(sender), events)
    }

    /// A server that holds all control bytes back.
    fn unwilling() -> Self {
        let (sender, events) = channel();
        Self::of(Unwilling::new(sender), events)
    }

    fn of<E: Endpoint + Send + 'static>(mut endpoint: E, events: Receiver<Event>) -> Self {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let socket = UnixServer::bind(&folder.path().join("socket")).expect("a free path");
        let network = QuicServer::bind(ServerOptions::new(
            "127.0.0.1:0".parse().expect("an address"),
            Certificate::development(["localhost"]).expect("localhost is a name"),
        ));
        let network = network.expect("a free port is bound");
        let stop = Stop::new();
        let stopped = stop.clone();
        let thread = thread::spawn(move || {
            let all = socket.serve(&mut endpoint, network.waker());
            let mut all = all.expect("a thread can start");
            network
                .run(&mut all, &stopped)
                .expect("the i/o thread lives");
        });
        Self {
            folder,
            events,
            stop,
            thread: Some(thread),
        }
    }

    fn path(&self) -> PathBuf {
        self.folder.path().join("socket")
    }

    fn connect(&self) -> UnixClient {
        UnixClient::connect(&self.path()).expect("the server listens")
    }

    fn opened(&self) -> Peer {
        match self.events.recv_timeout(TIMEOUT) {
            Ok(Event::Opened(peer)) => peer,
            other => panic!("{other:?}"),
        }
    }

    fn stop(&mut self) {
        self.stop.stop();
        if let Some(thread) = self.thread.take() {
            thread.join().expect("the server's thread returns");
        }
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        self.stop();
    }
}

#[test]
fn both_lanes_come_back_and_the_end_has_its_code() {
    let server = Running::start();
    let mut client = server.connect();
    client.send_control(Bytes::from_static(b"hello"));
    let hello = Received::Control(Bytes::from_static(b"hello"));
    assert_eq!(client.recv(TIMEOUT), Some(hello));
    client.send_state(Bytes::from_static(b"state"));
    let state = Received::State(Bytes::from_static(b"state"));
    assert_eq!(client.recv(TIMEOUT), Some(state));
    let peer = server.opened();
    client.send_control(Bytes::from_static(b"!"));
    let bye = Received::Control(Bytes::from_static(b"bye"));
    assert_eq!(client.recv(TIMEOUT), Some(bye));
    let ended = Received::Ended(Ending::Closed(7));
    assert_eq!(client.recv(TIMEOUT), Some(ended));
    assert_eq!(client.recv(TIMEOUT), None);
    assert!(matches!(server.events.recv_timeout(TIMEOUT), Ok(Event::Ended(of, _)) if of == peer));
}

#[test]
fn a_client_that_leaves_is_reported_with_its_code() {
    let server = Running::start();
    let client = server.connect();
    let peer = server.opened();
    drop(client);
    let left = Event::Ended(peer, Ending::Closed(TransportCode::LEFT.0));
    assert_eq!(server.events.recv_timeout(TIMEOUT), Ok(left));
}

#[test]
fn unwanted_bytes_that_were_sent_before_a_close_are_handled() {
    let server = Running::unwilling();
    let client = server.connect();
    // Six frames: the server waits for the bound with the last in its hands, so the end alone is left in the socket.
    let sent_bytes = 6 * (64 << 10);
    client.send_control(Bytes::from(vec![0; sent_bytes]));
    client.close(9);
    let all = (sent_bytes, Ending::Closed(9));
    assert_eq!(until_end(&server.events), all);
}

#[test]
fn a_client_that_the_server_closes_while_its_bytes_wait_ends() {
    let server = Running::unwilling();
    let mut client = server.connect();
    let bytes = Bytes::from(vec![0; 5 * (64 << 10)]);
    client.send_control(bytes.clone());
    client.send_state(Bytes::from_static(b"close"));
    client.send_control(bytes);
    let ended = Received::Ended(Ending::Closed(7));
    assert_eq!(client.recv(TIMEOUT), Some(ended));
    let (handed_bytes, _) = until_end(&server.events);
    assert_eq!(handed_bytes, 0);
}

#[test]
fn much_arrives_whole_at_a_client_that_reads_late() {
    let server = Running::start();
    let mut client = server.connect();
    let sent: Vec<u8> = (0..8_000_000_u32).map(|at| (at % 97) as u8 + 64).collect();
    client.send_control(Bytes::from(sent.clone()));
    server.opened();
    let mut read = Vec::new();
    while read.len() < sent.len() {
        match client.recv(TIMEOUT) {
            Some(Received::Control(bytes)) => read.extend_from_slice(&bytes),
            other => panic!("{} control bytes, then {other:?}", read.len()),
        }
    }
    assert!(read == sent);
}

#[test]
fn a_peer_that_sends_no_frames_is_cut_off_and_harms_no_other() {
    let server = Running::start();
    let mut client = server.connect();
    server.opened();
    let mut peer = UnixStream::connect(server.path()).expect("the server listens");
    peer.write_all(&[9; 100]).expect("the socket takes bytes");
    let number = server.opened();
    let ended = Event::Ended(number, Ending::Broken);
    assert_eq!(server.events.recv_timeout(TIMEOUT), Ok(ended));
    assert_eq!(peer.read(&mut [0; 10]).ok(), Some(0));
    client.send_state(Bytes::from_static(b"state"));
    assert!(matches!(client.recv(TIMEOUT), Some(Received::State(_))));
}

#[test]
fn a_stopped_server_closes_its_clients_and_takes_its_file_away() {
    let mut server = Running::start();
    let mut client = server.connect();
    server.opened();
    let mode = fs::metadata(server.path()).expect("a file").permissions();
    assert_eq!(mode.mode() & 0o777, 0o600);
    server.stop();
    let ended = Received::Ended(Ending::Closed(TransportCode::GOING_AWAY.0));
    assert_eq!(client.recv(TIMEOUT), Some(ended));
    assert!(!server.path().exists());
}

#[test]
fn a_dead_socket_is_replaced_and_nothing_else_is() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = folder.path().join("socket");
    let dead = std::os::unix::net::UnixListener::bind(&path).expect("a free path");
    drop(dead);
    let server = UnixServer::bind(&path).expect("a dead server's socket is replaced");
    assert!(UnixServer::bind(&path).is_err(), "a server listens there");
    drop(server);
    fs::write(&path, "precious").expect("a file can be written");
    assert!(
        UnixServer::bind(&path).is_err(),
        "another file has the path"
    );
    assert_eq!(fs::read_to_string(&path).ok().as_deref(), Some("precious"));
}
