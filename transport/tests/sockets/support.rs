//! Servers on threads of their own, and their clients.
//!
//! Proves nothing itself. A dropped server is stopped and joined.

use std::collections::VecDeque;
use std::net::{Ipv4Addr, SocketAddr};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::thread::{self, JoinHandle};
use std::time::Duration;

use bytes::Bytes;
use rhumb_protocol::{Ending, Endpoint, Instant, Peer, Transmit, Wake};
use rhumb_transport::{
    Certificate, ClientOptions, ClientTransport as _, Fingerprint, QuicClient, QuicServer,
    Received, ServerOptions, ServerStatistics, ServerWatch, Stop, Trust,
};

/// Longer than any step of these tests; reached only by a failure.
pub(crate) const TIMEOUT: Duration = Duration::from_secs(20);

/// An event of an endpoint for the test.
#[derive(Debug, PartialEq, Eq)]
pub(crate) enum Event {
    Opened(Peer),
    /// This number of control bytes was handed to [`Unwilling`].
    Control(usize),
    Ended(Peer, Ending),
}

/// Returns the received bytes; the control byte `!` makes it send `bye` and close with code 7.
pub(crate) struct Echo {
    out: VecDeque<Transmit>,
    events: Sender<Event>,
    /// Each connection waits here before it is opened, if the test wants to block the server thread.
    open_gate: Option<Receiver<()>>,
}

impl Endpoint for Echo {
    fn handle_opened(&mut self, _: Instant, peer: Peer) {
        let _ = self.events.send(Event::Opened(peer));
        if let Some(open_gate) = &self.open_gate {
            let _ = open_gate.recv();
        }
    }

    fn handle_control(&mut self, _: Instant, from: Peer, bytes: &[u8]) {
        let close = bytes.contains(&b'!');
        let bytes = if close {
            Bytes::from_static(b"bye")
        } else {
            Bytes::copy_from_slice(bytes)
        };
        self.out.push_back(Transmit::Control { to: from, bytes });
        if close {
            self.out.push_back(Transmit::Close { to: from, code: 7 });
        }
    }

    fn handle_datagram(&mut self, _: Instant, from: Peer, bytes: &[u8]) {
        let bytes = Bytes::copy_from_slice(bytes);
        self.out.push_back(Transmit::State { to: from, bytes });
    }

    fn handle_ended(&mut self, _: Instant, peer: Peer, ending: Ending) {
        let _ = self.events.send(Event::Ended(peer, ending));
    }

    fn handle_timeout(&mut self, _: Instant) {}

    fn poll_transmit(&mut self) -> Option<Transmit> {
        self.out.pop_front()
    }

    fn poll_timeout(&self) -> Option<Wake> {
        None
    }
}

impl Echo {
    /// An echo that does not block the server thread.
    pub(crate) const fn new(events: Sender<Event>) -> Self {
        Self {
            out: VecDeque::new(),
            events,
            open_gate: None,
        }
    }
}

/// Wants no control bytes, and closes a connection with code 7 for a datagram.
pub(crate) struct Unwilling {
    out: VecDeque<Transmit>,
    events: Sender<Event>,
}

impl Endpoint for Unwilling {
    fn handle_opened(&mut self, _: Instant, peer: Peer) {
        let _ = self.events.send(Event::Opened(peer));
    }

    fn handle_control(&mut self, _: Instant, _: Peer, bytes: &[u8]) {
        let _ = self.events.send(Event::Control(bytes.len()));
    }

    fn handle_datagram(&mut self, _: Instant, from: Peer, _: &[u8]) {
        self.out.push_back(Transmit::Close { to: from, code: 7 });
    }

    fn handle_ended(&mut self, _: Instant, peer: Peer, ending: Ending) {
        let _ = self.events.send(Event::Ended(peer, ending));
    }

    fn handle_timeout(&mut self, _: Instant) {}

    fn wants_control(&self, _: Peer) -> bool {
        false
    }

    fn poll_transmit(&mut self) -> Option<Transmit> {
        self.out.pop_front()
    }

    fn poll_timeout(&self) -> Option<Wake> {
        None
    }
}

impl Unwilling {
    pub(crate) const fn new(events: Sender<Event>) -> Self {
        Self {
            out: VecDeque::new(),
            events,
        }
    }
}

/// The control bytes that [`Unwilling`] was handed before the next end of a connection, and the end.
pub(crate) fn until_end(events: &Receiver<Event>) -> (usize, Ending) {
    let mut handed_bytes = 0;
    loop {
        match events.recv_timeout(TIMEOUT) {
            Ok(Event::Opened(_)) => {}
            Ok(Event::Control(bytes)) => handed_bytes += bytes,
            Ok(Event::Ended(_, ending)) => return (handed_bytes, ending),
            Err(cause) => panic!("no end after {handed_bytes} control bytes: {cause}"),
        }
    }
}

pub(crate) struct Running {
    pub(crate) address: SocketAddr,
    pub(crate) fingerprint: Fingerprint,
    pub(crate) watch: ServerWatch,
    pub(crate) events: Receiver<Event>,
    stop: Stop,
    thread: Option<JoinHandle<ServerStatistics>>,
}

impl Running {
    pub(crate) fn echo() -> Self {
        Self::start(
            Certificate::development(["localhost"]).expect("localhost is a name"),
            None,
        )
    }

    pub(crate) fn start(certificate: Certificate, open_gate: Option<Receiver<()>>) -> Self {
        let (sender, events) = channel();
        let mut echo = Echo::new(sender);
        echo.open_gate = open_gate;
        Self::of(certificate, echo, events)
    }

    /// A server that holds all control bytes back.
    pub(crate) fn unwilling() -> Self {
        let (sender, events) = channel();
        let certificate = Certificate::development(["localhost"]).expect("localhost is a name");
        Self::of(certificate, Unwilling::new(sender), events)
    }

    pub(crate) fn echo_at(listen: SocketAddr) -> Self {
        let (sender, events) = channel();
        let certificate = Certificate::development(["localhost"]).expect("localhost is a name");
        Self::bound(serve_at(listen, certificate, Echo::new(sender)), events)
    }

    fn of<E: Endpoint + Send + 'static>(
        certificate: Certificate,
        endpoint: E,
        events: Receiver<Event>,
    ) -> Self {
        Self::bound(serve(certificate, endpoint), events)
    }

    fn bound(
        (bound, stop, thread): (Bound, Stop, JoinHandle<ServerStatistics>),
        events: Receiver<Event>,
    ) -> Self {
        let Bound {
            address,
            fingerprint,
            watch,
        } = bound;
        Self {
            address,
            fingerprint,
            watch,
            events,
            stop,
            thread: Some(thread),
        }
    }

    pub(crate) fn options(&self) -> ClientOptions {
        ClientOptions::new(self.address, Trust::Fingerprint(self.fingerprint))
    }

    pub(crate) fn connect(&self) -> QuicClient {
        QuicClient::connect(self.options(), TIMEOUT).expect("the server runs")
    }

    pub(crate) fn stop(&mut self) -> ServerStatistics {
        self.stop.stop();
        let thread = self.thread.take().expect("stopped once");
        thread.join().expect("the server thread returns")
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        self.stop.stop();
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

/// Address and fingerprint of a running server.
pub(crate) struct Bound {
    pub(crate) address: SocketAddr,
    pub(crate) fingerprint: Fingerprint,
    pub(crate) watch: ServerWatch,
}

/// Runs an endpoint on a thread of its own.
pub(crate) fn serve<E: Endpoint + Send + 'static>(
    certificate: Certificate,
    endpoint: E,
) -> (Bound, Stop, JoinHandle<ServerStatistics>) {
    serve_at(
        SocketAddr::from((Ipv4Addr::LOCALHOST, 0)),
        certificate,
        endpoint,
    )
}

/// Runs an endpoint at an address, on a thread of its own.
pub(crate) fn serve_at<E: Endpoint + Send + 'static>(
    listen: SocketAddr,
    certificate: Certificate,
    mut endpoint: E,
) -> (Bound, Stop, JoinHandle<ServerStatistics>) {
    let server =
        QuicServer::bind(ServerOptions::new(listen, certificate)).expect("a free port is bound");
    let bound = Bound {
        address: server.local_addr(),
        fingerprint: server.fingerprint(),
        watch: server.watch(),
    };
    let stop = Stop::new();
    let thread = thread::spawn({
        let stop = stop.clone();
        move || {
            server
                .run(&mut endpoint, &stop)
                .expect("the i/o thread lives")
        }
    });
    (bound, stop, thread)
}

/// Reads control bytes until the expected count, or until the connection ends.
pub(crate) fn read_control(client: &mut QuicClient, bytes_len: usize) -> Vec<u8> {
    let mut read = Vec::new();
    while read.len() < bytes_len {
        match client.recv(TIMEOUT) {
            Some(Received::Control(bytes)) => read.extend_from_slice(&bytes),
            Some(Received::State(_)) => {}
            other => panic!("{} control bytes, then {other:?}", read.len()),
        }
    }
    read
}
