//! QUIC client for a frame loop: every call returns within a given time.
//!
//! Does not resolve names, interpret bytes or reconnect. Its sockets run on a thread of its own, joined when it is
//! dropped.

use std::fmt;
use std::io;
use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr};
use std::sync::Arc;
use std::sync::mpsc;
use std::thread::{self, JoinHandle};
use std::time::Duration;

use bytes::Bytes;
use rhumb_protocol::session::TransportCode;

use super::client_io::run_io;
use super::client_io::{Attempt, EstablishedConnection};
use super::connect_error::ConnectError;
use super::inbox::{Inbox, Received};
use super::statistics::WireStatistics;
use super::trust::{self, Trust};
use super::tuning;
use crate::client_transport::ClientTransport;
use crate::socket::io_runtime;

/// The server to connect to, and how to authenticate it.
#[derive(Clone, Debug)]
pub struct ClientOptions {
    /// The server's address; the caller resolves names.
    pub server: SocketAddr,
    /// Other addresses of the same server. They are tried too, in turn with the first one's family and the other: each a
    /// little later than the one before, and the first that answers is taken (RFC 8305).
    pub others: Vec<SocketAddr>,
    /// The name that the server's certificate must have; a pinned certificate may have any.
    pub server_name: String,
    /// Condition under which the certificate is trusted.
    pub trust: Trust,
    /// The local address; `None` for any of the server's family.
    pub bind: Option<SocketAddr>,
}

/// An open connection to a server, until one end closes it.
pub struct QuicClient {
    connected: EstablishedConnection,
    inbox: Arc<Inbox>,
    thread: Option<JoinHandle<()>>,
}

impl ClientOptions {
    /// A server at an address, with the name `localhost`, from any local address.
    #[must_use]
    pub fn new(server: SocketAddr, trust: Trust) -> Self {
        Self {
            server,
            others: Vec::new(),
            server_name: "localhost".into(),
            trust,
            bind: None,
        }
    }
}

impl QuicClient {
    /// Connects within `timeout`.
    ///
    /// # Errors
    ///
    /// [`ConnectError`] names the cause and the address; of several addresses each, with its cause.
    pub fn connect(options: ClientOptions, timeout: Duration) -> Result<Self, ConnectError> {
        let addresses = in_turn(options.server, &options.others);
        let attempts = addresses.into_iter().map(|server| {
            // A verifier keeps its refusal, so each attempt has one of its own.
            let (tls, certificate_check) =
                trust::tls(&options.trust).map_err(ConnectError::Roots)?;
            let config = tuning::client(tls)
                .map_err(|cause| ConnectError::Thread(io::Error::other(cause)))?;
            Ok(Attempt {
                server,
                server_name: options.server_name.clone(),
                bind: options.bind.unwrap_or_else(|| any_of_family(server)),
                config,
                certificate_check,
                timeout,
            })
        });
        let attempts = attempts.collect::<Result<Vec<_>, ConnectError>>()?;
        let runtime = io_runtime().map_err(ConnectError::Thread)?;
        let (ready, connected) = mpsc::sync_channel(1);
        let inbox = Arc::new(Inbox::default());
        let thread = thread::Builder::new()
            .name("rhumb-client-io".into())
            .spawn({
                let inbox = Arc::clone(&inbox);
                move || runtime.block_on(run_io(attempts, ready, inbox))
            })
            .map_err(ConnectError::Thread)?;
        match connected.recv() {
            Ok(connected) => Ok(Self {
                connected: connected?,
                inbox,
                thread: Some(thread),
            }),
            Err(_) => Err(ConnectError::Thread(io::Error::other(
                "the thread ended before it connected",
            ))),
        }
    }

    /// Received datagrams that were dropped because the caller did not take them in time.
    #[must_use]
    pub fn state_dropped(&self) -> u64 {
        self.inbox.state_dropped()
    }

    /// The largest datagram that can be sent now, never less than [`DATAGRAM_BYTES_MIN`](super::DATAGRAM_BYTES_MIN).
    #[must_use]
    pub fn max_datagram_bytes(&self) -> usize {
        let now = self.connected.connection.max_datagram_size();
        now.map_or(tuning::DATAGRAM_BYTES_MIN, |bytes| {
            bytes.max(tuning::DATAGRAM_BYTES_MIN)
        })
    }

    /// The server's address.
    #[must_use]
    pub fn server(&self) -> SocketAddr {
        self.connected.connection.remote_address()
    }
}

impl ClientTransport for QuicClient {
    /// Control bytes come before datagrams that wait at the same time.
    fn recv(&mut self, timeout: Duration) -> Option<Received> {
        self.inbox.take(timeout)
    }

    /// If the queue is full, the connection closes with [`TransportCode::CONTROL_OVERFLOW`].
    fn send_control(&self, bytes: Bytes) {
        if self.connected.control.send(bytes).is_err() {
            self.connected
                .closing
                .now(TransportCode::CONTROL_OVERFLOW.0);
        }
    }

    /// A datagram larger than [`max_datagram_bytes`](Self::max_datagram_bytes) is dropped.
    fn send_state(&self, bytes: Bytes) {
        let bytes_len = bytes.len();
        if let Err(cause) = self.connected.connection.send_datagram(bytes) {
            tracing::debug!(bytes_len, %cause, "state datagram not sent");
        }
    }

    fn close(&self, code: u32) {
        self.connected.control.close(&self.connected.closing, code);
    }

    fn statistics(&self) -> WireStatistics {
        WireStatistics::of(&self.connected.connection)
    }
}

impl Drop for QuicClient {
    /// Closes if neither end did, and waits for the close frame to leave: little more than half a second at most.
    fn drop(&mut self) {
        self.inbox.abandon();
        self.close(TransportCode::LEFT.0);
        if let Some(thread) = self.thread.take()
            && thread.join().is_err()
        {
            tracing::error!("the client's i/o thread panicked");
        }
    }
}

impl fmt::Debug for QuicClient {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("QuicClient")
            .field("server", &self.server())
            .finish_non_exhaustive()
    }
}

fn any_of_family(server: SocketAddr) -> SocketAddr {
    let any: IpAddr = match server {
        SocketAddr::V4(_) => Ipv4Addr::UNSPECIFIED.into(),
        SocketAddr::V6(_) => Ipv6Addr::UNSPECIFIED.into(),
    };
    SocketAddr::new(any, 0)
}

/// Addresses, each once, the two families in turn; the first one stays first.
fn in_turn(first: SocketAddr, others: &[SocketAddr]) -> Vec<SocketAddr> {
    let (mut same, mut different) = (vec![first], Vec::new());
    for other in others {
        let of_family = match other.is_ipv4() == first.is_ipv4() {
            true => &mut same,
            false => &mut different,
        };
        if !of_family.contains(other) {
            of_family.push(*other);
        }
    }
    let (mut same, mut different) = (same.into_iter(), different.into_iter());
    let pairs = std::iter::from_fn(|| match (same.next(), different.next()) {
        (None, None) => None,
        pair => Some(pair),
    });
    pairs
        .flat_map(|(one, other)| [one, other])
        .flatten()
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_families_of_addresses_take_turns() {
        let addresses = ["[::1]:1", "[::2]:1", "[::1]:1", "10.0.0.1:1", "[::3]:1"];
        let [first, others @ ..] = addresses.map(|address| address.parse().expect("an address"));
        let turns = in_turn(first, &others)
            .into_iter()
            .map(|address| address.to_string());
        let expected = ["[::1]:1", "10.0.0.1:1", "[::2]:1", "[::3]:1"];
        assert_eq!(turns.collect::<Vec<_>>(), expected);
        assert_eq!(in_turn(first, &[]), [first]);
    }
}
