//! QUIC client for a frame loop: every call returns within a given time.
//!
//! Does not resolve names, interpret bytes or reconnect. Its sockets run on a thread of its own, joined when it is
//! dropped. That thread connects once, never retries, and carries bytes until the end. Of several addresses, the first
//! that answers is taken. [`ConnectError`] names the reasons of a failure.
//!
//! A failed attempt has a reason for the user to act on, and is not repeated here. A refused certificate outranks the
//! alert that QUIC reports for it.

use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr};
use std::sync::Arc;
use std::sync::mpsc::{self, SyncSender};
use std::thread::{self, JoinHandle};
use std::time::Duration;
use std::{fmt, io};

use bytes::Bytes;
use quinn::{
    ClientConfig, ConnectError as QuinnConnectError, Connection, ConnectionError, Endpoint,
    EndpointConfig, ReadError, RecvStream, SendStream, TokioRuntime, TransportErrorCode, rustls,
};
use rhumb_protocol::session::TransportCode;
use tokio::task::JoinSet;
use tokio::time::{self, sleep};

use crate::client_transport::{ClientTransport, Inbox, Received, WireStatistics};
use crate::connection::{
    Closing, ControlSender, ControlWriter, Unnamed, control_queue, wire_statistics,
};
use crate::system::{bind_udp, io_runtime};
use crate::trust::{self, CertificateCheck, CertificateError, Distrust, Fingerprint, Trust};
use crate::tuning::{self, CLOSE_LEAVES, DATAGRAM_BYTES_MIN};

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

    /// Calls `hook` now, and from then on whenever there is something to receive, on the thread of the sockets. It must
    /// not wait. Only the first hook counts.
    pub fn on_arrival(&self, hook: impl Fn() + Send + Sync + 'static) {
        self.inbox.on_arrival(hook);
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

/// Reason of a failed connection attempt.
#[derive(Debug)]
pub enum ConnectError {
    /// Nothing answered in time.
    NothingAnswers {
        /// The server's address.
        server: SocketAddr,
        /// The duration of the attempt.
        timeout: Duration,
    },
    /// The server's certificate is not the pinned one.
    WrongFingerprint {
        /// The server's address.
        server: SocketAddr,
        /// The pinned fingerprint.
        expected: Fingerprint,
        /// The fingerprint of the server's certificate.
        presented: Fingerprint,
    },
    /// No trusted root signed the server's certificate for its name.
    Untrusted {
        /// The server's address.
        server: SocketAddr,
        /// The requested name.
        server_name: String,
        /// The TLS error.
        cause: rustls::Error,
    },
    /// The server speaks another protocol, or another version of this one.
    OtherProtocol {
        /// The server's address.
        server: SocketAddr,
    },
    /// The server refused the attempt: it is full, or stopping.
    Refused {
        /// The server's address.
        server: SocketAddr,
    },
    /// The handshake failed for another reason.
    Handshake {
        /// The server's address.
        server: SocketAddr,
        /// The QUIC error.
        cause: ConnectionError,
    },
    /// The file of trusted roots cannot be used.
    Roots(CertificateError),
    /// The server's name is invalid.
    ServerName {
        /// The name.
        server_name: String,
    },
    /// The server's address cannot be reached from this machine.
    ServerAddress {
        /// The address.
        server: SocketAddr,
        /// The local address of the attempt.
        bind: SocketAddr,
    },
    /// The local socket failed.
    LocalSocket {
        /// The local address.
        bind: SocketAddr,
        /// The system's error.
        cause: io::Error,
    },
    /// The I/O thread cannot start, or failed.
    Thread(io::Error),
    /// The server has several addresses, and none of them led to it: the reason for each, in the order of attempts.
    EachAddress(Vec<Self>),
}

impl ConnectError {
    /// The meaning of a failed handshake, given the verifier's refusal.
    pub fn from_handshake(
        cause: ConnectionError,
        server: SocketAddr,
        server_name: &str,
        certificate_check: &CertificateCheck,
        timeout: Duration,
    ) -> Self {
        match certificate_check.refusal() {
            Some(&Distrust::OtherFingerprint {
                expected,
                presented,
            }) => {
                return ConnectError::WrongFingerprint {
                    server,
                    expected,
                    presented,
                };
            }
            Some(Distrust::Roots(cause)) => {
                let (server_name, cause) = (server_name.to_owned(), cause.clone());
                return ConnectError::Untrusted {
                    server,
                    server_name,
                    cause,
                };
            }
            None => {}
        }
        let no_alpn = TransportErrorCode::crypto(NO_APPLICATION_PROTOCOL);
        match cause {
            ConnectionError::TimedOut => ConnectError::NothingAnswers { server, timeout },
            ConnectionError::VersionMismatch => ConnectError::OtherProtocol { server },
            ConnectionError::TransportError(error) if error.code == no_alpn => {
                ConnectError::OtherProtocol { server }
            }
            ConnectionError::ConnectionClosed(close) if close.error_code == no_alpn => {
                ConnectError::OtherProtocol { server }
            }
            ConnectionError::ConnectionClosed(close)
                if close.error_code == TransportErrorCode::CONNECTION_REFUSED =>
            {
                ConnectError::Refused { server }
            }
            ConnectionError::ApplicationClosed(_) => ConnectError::Refused { server },
            cause => ConnectError::Handshake { server, cause },
        }
    }
}

/// TLS alert for an unknown application protocol. Source: RFC 7301, section 3.2.
const NO_APPLICATION_PROTOCOL: u8 = 120;

impl fmt::Display for ConnectError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NothingAnswers { server, timeout } => write!(
                f,
                "nothing answered at {server} within {timeout:?}: \
                check the address, that the server runs, and that udp passes"
            ),
            Self::WrongFingerprint {
                server,
                expected,
                presented,
            } => write!(
                f,
                "{server} shows another certificate than the pinned one: \
                expected {expected}, presented {presented}; \
                pin the new one if the server's certificate was renewed"
            ),
            Self::Untrusted {
                server,
                server_name,
                cause,
            } => {
                write!(
                    f,
                    "the certificate of {server} is not trusted for the name {server_name}: {cause}"
                )
            }
            Self::OtherProtocol { server } => {
                write!(
                    f,
                    "{server} does not speak rhumb/1: check the port and the server's version"
                )
            }
            Self::Refused { server } => write!(
                f,
                "{server} refused the connection: it is full or stopping, try later"
            ),
            Self::Handshake { server, cause } => {
                write!(f, "the handshake with {server} failed: {cause}")
            }
            Self::Roots(cause) => cause.fmt(f),
            Self::ServerName { server_name } => {
                write!(
                    f,
                    "{server_name:?} is not a server name: give a host name or an address"
                )
            }
            Self::ServerAddress { server, bind } => {
                write!(
                    f,
                    "{server} cannot be reached from {bind}: check its port and family"
                )
            }
            Self::LocalSocket { bind, cause } => {
                write!(f, "cannot open a local udp socket at {bind}: {cause}")
            }
            Self::Thread(cause) => write!(f, "the client's i/o thread failed: {cause}"),
            Self::EachAddress(errors) => {
                write!(f, "none of {} addresses leads to the server", errors.len())?;
                errors.iter().try_for_each(|error| write!(f, "; {error}"))
            }
        }
    }
}

impl std::error::Error for ConnectError {
    fn source(&self) -> Option<&(dyn std::error::Error + 'static)> {
        match self {
            Self::Untrusted { cause, .. } => Some(cause),
            Self::Handshake { cause, .. } => Some(cause),
            Self::Roots(cause) => Some(cause),
            Self::LocalSocket { cause, .. } | Self::Thread(cause) => Some(cause),
            _ => None,
        }
    }
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
