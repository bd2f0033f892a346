//! I/O thread of the client: connects once and carries until the end.
//!
//! Interprets nothing and never retries. Of several addresses, the first that answers is taken. `connect_error` names the
//! reasons of a failure.

use std::io;
use std::net::SocketAddr;
use std::sync::Arc;
use std::sync::mpsc::SyncSender;
use std::time::Duration;

use quinn::{
    ClientConfig, ConnectError as QuinnConnectError, Connection, Endpoint, EndpointConfig,
    ReadError, RecvStream, SendStream, TokioRuntime,
};
use rhumb_protocol::session::TransportCode;
use tokio::task::JoinSet;
use tokio::time::{self, sleep};

use super::closing::Closing;
use super::connect_error::ConnectError;
use super::connection_id::Unnamed;
use super::control_queue::{ControlSender, ControlWriter, control_queue};
use super::inbox::Inbox;
use super::trust::CertificateCheck;
use super::tuning::{CLOSE_LEAVES, DATAGRAM_BYTES_MIN};
use crate::socket::bind_udp;

/// Parameters of one connection attempt.
pub(super) struct Attempt {
    pub(super) server: SocketAddr,
    pub(super) server_name: String,
    pub(super) bind: SocketAddr,
    pub(super) config: ClientConfig,
    pub(super) certificate_check: CertificateCheck,
    pub(super) timeout: Duration,
}

/// Both sides of a connection, or the reason why there is none.
type Outcome = Result<(EstablishedConnection, ClientConnection), ConnectError>;

/// Time that an address has for its answer before the next one is tried too. Source: RFC 8305, section 5.
const STAGGER: Duration = Duration::from_millis(250);

/// The caller's side of a connection.
#[derive(Debug)]
pub(super) struct EstablishedConnection {
    pub(super) connection: Connection,
    pub(super) control: ControlSender,
    pub(super) closing: Arc<Closing>,
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
pub(super) async fn run_io(
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
