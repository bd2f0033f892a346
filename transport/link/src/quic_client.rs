//! QUIC client for a frame loop: every call returns within a given time.
//!
//! Does not resolve names, interpret bytes or reconnect. Its sockets run on a thread of its own, joined when it is
//! dropped. That thread connects once, never retries, and carries bytes until the end. Of several addresses, the first
//! that answers is taken. `connect_error` names the reasons of a failure.

use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr};
use std::sync::mpsc::SyncSender;
use std::sync::{Arc, mpsc};
use std::thread::JoinHandle;
use std::time::Duration;
use std::{fmt, io, thread};

use bytes::Bytes;
use quinn::{
    ClientConfig, ConnectError as QuinnConnectError, Connection, Endpoint, EndpointConfig,
    ReadError, RecvStream, SendStream, TokioRuntime,
};
use rhumb_protocol::session::TransportCode;
use tokio::task::JoinSet;
use tokio::time;
use tokio::time::sleep;

use crate::client_transport::{ClientTransport, Inbox, Received, WireStatistics};
use crate::connect_error::ConnectError;
use crate::connection::{
    Closing, ControlSender, ControlWriter, Unnamed, control_queue, wire_statistics,
};
use crate::system::{bind_udp, io_runtime};
use crate::trust::{CertificateCheck, Trust};
use crate::tuning::{CLOSE_LEAVES, DATAGRAM_BYTES_MIN};
use crate::{trust, tuning};

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

    /// The largest datagram that can be sent now, never less than [`DATAGRAM_BYTES_MIN`].
    #[must_use]
    pub fn max_datagram_bytes(&self) -> usize {
        let now = self.connected.connection.max_datagram_size();
        now.map_or(DATAGRAM_BYTES_MIN, |bytes| bytes.max(DATAGRAM_BYTES_MIN))
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
        wire_statistics(&self.connected.connection)
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

/// Parameters of one connection attempt.
struct Attempt {
    pub server: SocketAddr,
    pub server_name: String,
    pub bind: SocketAddr,
    pub config: ClientConfig,
    pub certificate_check: CertificateCheck,
    pub timeout: Duration,
}

/// Both sides of a connection, or the reason why there is none.
type Outcome = Result<(EstablishedConnection, ClientConnection), ConnectError>;

/// Time that an address has for its answer before the next one is tried too. Source: RFC 8305, section 5.
const STAGGER: Duration = Duration::from_millis(250);

/// The caller's side of a connection.
#[derive(Debug)]
struct EstablishedConnection {
    pub connection: Connection,
    pub control: ControlSender,
    pub closing: Arc<Closing>,
}

/// The I/O thread's side of a connection.
struct ClientConnection {
    connection: Connection,
    closing: Arc<Closing>,
    writer: ControlWriter,
    send: SendStream,
    recv: RecvStream,
}

/// Connects, reports, and carries the connection until it has ended and its close frame has left.
async fn run_io(
    attempts: Vec<Attempt>,
    ready: SyncSender<Result<EstablishedConnection, ConnectError>>,
    inbox: Arc<Inbox>,
) {
    let carried = match race(attempts).await {
        Ok((connected, carried)) => {
            if ready.send(Ok(connected)).is_err() {
                return;
            }
            carried
        }
        // The caller waits for the result; without a caller there is nothing to report.
        Err(error) => return drop(ready.send(Err(error))),
    };
    let ClientConnection {
        connection,
        closing,
        mut writer,
        mut send,
        recv,
    } = carried;
    let ending = tokio::join!(
        closing.ended(),
        writer.run(&closing, &mut send, || ()),
        read_control(recv, &closing, &inbox),
        read_state(&connection, &inbox),
    )
    .0;
    inbox.put_end(ending);
    let close_frame_left = async {
        while !closing.close_has_left() {
            sleep(STEP).await;
        }
    };
    // If the frame does not leave in time, the server's idle timeout ends the connection.
    let _ = time::timeout(CLOSE_LEAVES, close_frame_left).await;
}

/// The first connection of several attempts. An attempt begins when the one before has failed, or has taken its time.
async fn race(attempts: Vec<Attempt>) -> Outcome {
    let servers: Vec<_> = attempts.iter().map(|attempt| attempt.server).collect();
    let timeout = attempts
        .first()
        .map_or(Duration::ZERO, |attempt| attempt.timeout);
    // Each address is tried, and has half of the time limit at the least.
    let stagger = STAGGER.min(timeout / (2 * servers.len().max(1) as u32));
    let (mut failed, mut running) = (Vec::new(), JoinSet::new());
    let mut waiting = attempts.into_iter();
    let deadline = time::Instant::now() + timeout;
    let mut next = time::Instant::now();
    loop {
        if time::Instant::now() >= next || running.is_empty() {
            match waiting.next() {
                Some(attempt) => {
                    let server = attempt.server;
                    running.spawn(async move { (server, connect(attempt).await) });
                    next = time::Instant::now() + stagger;
                }
                None if running.is_empty() => break,
                None => next = deadline,
            }
        }
        match time::timeout_at(next.min(deadline), running.join_next()).await {
            Ok(Some(Ok((_, Ok(connected))))) => return Ok(connected),
            Ok(Some(Ok((server, Err(error))))) => {
                failed.push((server, error));
                next = time::Instant::now();
            }
            Ok(Some(Err(broken))) => {
                return Err(ConnectError::Thread(io::Error::other(broken)));
            }
            Ok(None) => {}
            Err(_) if time::Instant::now() >= deadline => break,
            Err(_) => {}
        }
    }
    let error = |server: SocketAddr| {
        let place = failed.iter().position(|(other, _)| *other == server);
        place.map_or(ConnectError::NothingAnswers { server, timeout }, |place| {
            failed.swap_remove(place).1
        })
    };
    let mut errors: Vec<_> = servers.into_iter().map(error).collect();
    Err(match errors.len() {
        1 => errors.remove(0),
        _ => ConnectError::EachAddress(errors),
    })
}

async fn connect(attempt: Attempt) -> Outcome {
    let Attempt {
        server,
        server_name,
        bind,
        config,
        certificate_check,
        timeout,
    } = attempt;
    let socket = bind_udp(bind).map_err(|cause| ConnectError::LocalSocket { bind, cause })?;
    let mut local = EndpointConfig::default();
    // One connection per socket: the address identifies it, so that packets to this end need no connection id.
    local.cid_generator(|| Box::new(Unnamed));
    let endpoint = Endpoint::new(local, None, socket, Arc::new(TokioRuntime))
        .map_err(|cause| ConnectError::LocalSocket { bind, cause })?;
    let failed = |cause| {
        ConnectError::from_handshake(cause, server, &server_name, &certificate_check, timeout)
    };
    let connecting = endpoint
        .connect_with(config, server, &server_name)
        .map_err(|cause| match cause {
            QuinnConnectError::InvalidServerName(server_name) => {
                ConnectError::ServerName { server_name }
            }
            _ => ConnectError::ServerAddress { server, bind },
        })?;
    let connection = connecting.await.map_err(failed)?;
    let closing = Closing::of(&connection, None);
    if connection
        .max_datagram_size()
        .is_none_or(|bytes| bytes < DATAGRAM_BYTES_MIN)
    {
        closing.now(TransportCode::NO_DATAGRAMS.0);
        return Err(ConnectError::OtherProtocol { server });
    }
    let (send, recv) = connection.open_bi().await.map_err(failed)?;
    let (control, writer) = control_queue();
    let connected = EstablishedConnection {
        connection: connection.clone(),
        control,
        closing: Arc::clone(&closing),
    };
    Ok((
        connected,
        ClientConnection {
            connection,
            closing,
            writer,
            send,
            recv,
        },
    ))
}

/// Reads no further than the receiver keeps up.
async fn read_control(mut stream: RecvStream, closing: &Closing, inbox: &Inbox) {
    loop {
        match stream.read_chunk(READ_BYTES_MAX, true).await {
            Ok(Some(chunk)) => inbox.put_control(&chunk.bytes).await,
            Ok(None) | Err(ReadError::ConnectionLost(_)) => return,
            Err(_) => return closing.now(TransportCode::NO_CONTROL_STREAM.0),
        }
    }
}

async fn read_state(connection: &Connection, inbox: &Inbox) {
    while let Ok(bytes) = connection.read_datagram().await {
        inbox.put_state(&bytes);
    }
}

/// Bytes of one read of the control stream, at most.
const READ_BYTES_MAX: usize = 64 << 10;

/// Interval of the checks whether the close frame has left.
const STEP: Duration = Duration::from_millis(1);

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
