//! I/O thread of the APP listener: accepts connections and carries bytes.
//!
//! Interprets nothing. Input for the server thread is bounded per connection; the listener closes connections beyond
//! the limit.

use core::net::SocketAddr;
use std::io;
use std::sync::Arc;
use std::time::Duration;

use rhumb_protocol::Peer;
use rhumb_transport::ByteCredit;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::tcp::{OwnedReadHalf, OwnedWriteHalf};
use tokio::net::{TcpListener, TcpStream, UdpSocket};
use tokio::sync::{Semaphore, oneshot};
use tokio::time::{sleep, timeout};

use super::connection::{AppConnectionReader, AppInput, AppInputSender, connection_queue};
use super::datagram_sender::DatagramSender;
use super::rate_limiter::limiter_of_bytes;

/// Connections at one time, at most.
const CONNECTIONS_MAX: usize = 64;
/// Deadline for the first bytes of a connection.
const FIRST_BYTES: Duration = Duration::from_secs(10);
/// Silence after which a connection ends: a live client sends a step eleven times a second.
const IDLE: Duration = Duration::from_secs(60);
/// A slower write means that the client does not read.
const WRITE: Duration = Duration::from_secs(30);
/// Time for the last bytes to leave when a connection is closed.
const FLUSH: Duration = Duration::from_millis(500);
/// Bytes between the sockets and the server thread, per connection; beyond them the connection is not read.
const IN_FLIGHT_BYTES: usize = 256 << 10;
/// Bytes of datagrams between the sockets and the server thread; beyond them datagrams are dropped.
const DATAGRAMS_IN_FLIGHT_BYTES: usize = 64 << 10;
const READ_BYTES_MAX: usize = 64 << 10;
/// Longest datagram that is read; a logon has 76 bytes.
const DATAGRAM_BYTES_MAX: usize = 512;
/// Bit of the peer numbers of this listener.
const BY_APP: u64 = 1 << 63;

/// Sockets and queue of the listener.
pub(super) struct Sockets {
    pub(super) tcp: TcpListener,
    pub(super) udp: UdpSocket,
    /// Outgoing datagrams.
    pub(super) datagram_sender: Arc<DatagramSender>,
}

/// Carries bytes until its end is requested.
pub(super) async fn carry(
    sockets: Sockets,
    inputs: AppInputSender,
    mut ended: oneshot::Receiver<()>,
) {
    let udp = Arc::new(sockets.udp);
    let datagram_writer = tokio::spawn(datagram_write_loop(
        Arc::clone(&udp),
        sockets.datagram_sender,
    ));
    let listen = tokio::spawn(datagram_read_loop(udp, inputs.clone()));
    let free_places = Arc::new(Semaphore::new(CONNECTIONS_MAX));
    let mut peers = BY_APP;
    loop {
        let accepted = tokio::select! {
            accepted = sockets.tcp.accept() => accepted,
            _ = &mut ended => break,
        };
        let (stream, from) = match accepted {
            Ok(accepted) => accepted,
            Err(cause) => {
                // The process has no free descriptor, or the client has left already: the listener goes on.
                tracing::warn!(%cause, "an app connection was not accepted");
                sleep(PAUSE).await;
                continue;
            }
        };
        let Ok(place) = Arc::clone(&free_places).try_acquire_owned() else {
            tracing::warn!(%from, "an app connection was refused: the server is full");
            continue;
        };
        let (peer, inputs) = (Peer(peers), inputs.clone());
        peers += 1;
        tokio::spawn(async move {
            serve(stream, from, peer, inputs).await;
            drop(place);
        });
    }
    datagram_writer.abort();
    listen.abort();
    // Every connection's task gets a turn to send its queued bytes.
    sleep(LAST_TURN).await;
}

/// Carries one connection from start to end.
async fn serve(stream: TcpStream, from: SocketAddr, peer: Peer, inputs: AppInputSender) {
    if let Err(cause) = stream.set_nodelay(true) {
        tracing::debug!(%cause, "an app connection ended at once");
        return;
    }
    let (near, far) = connection_queue();
    let opened = AppInput::Opened {
        peer,
        from,
        connection: near,
    };
    // If the server thread has ended, this thread ends soon too.
    let _ = inputs.send(opened);
    let (read, write) = stream.into_split();
    tokio::select! {
        why = read_loop(read, peer, &inputs) => tracing::info!(peer = peer.0, %from, %why, "an app connection ended"),
        why = write_loop(write, far) => tracing::info!(peer = peer.0, %from, %why, "an app connection was ended"),
    }
    let _ = inputs.send(AppInput::Ended { peer });
}

/// Reason for the end of a connection, for the log.
type EndReason = &'static str;

/// Reads no further than the server thread keeps up.
async fn read_loop(mut read: OwnedReadHalf, peer: Peer, inputs: &AppInputSender) -> EndReason {
    let credit = ByteCredit::new(IN_FLIGHT_BYTES);
    let mut buffer = vec![0; READ_BYTES_MAX];
    let mut time_limit = FIRST_BYTES;
    loop {
        let count = match timeout(time_limit, read.read(&mut buffer)).await {
            Ok(Ok(0)) => return "the client closed the connection",
            Ok(Ok(count)) => count,
            Ok(Err(_)) => return "the connection broke",
            Err(_) => return "the client was silent",
        };
        time_limit = IDLE;
        let piece = credit.admit(&buffer[..count]).await;
        if inputs.send(AppInput::Bytes { peer, piece }).is_err() {
            return "the server is stopping";
        }
    }
}

/// Writes queued pieces, no faster than a client can read them.
async fn write_loop(mut write: OwnedWriteHalf, mut queue: AppConnectionReader) -> EndReason {
    let mut rate_limiter = limiter_of_bytes();
    while let Some(bytes) = queue.queue.recv().await {
        rate_limiter.spend(bytes.len()).await;
        match timeout(WRITE, write.write_all(&bytes)).await {
            Ok(Ok(())) => queue.left(bytes.len()),
            Ok(Err(_)) => return "the connection broke",
            Err(_) => return "the client does not read",
        }
    }
    // The server thread has dropped its end.
    let _ = timeout(FLUSH, write.shutdown()).await;
    "the server closed the connection"
}

async fn datagram_write_loop(udp: Arc<UdpSocket>, datagram_sender: Arc<DatagramSender>) {
    loop {
        let (to, bytes) = datagram_sender.next().await;
        if let Err(cause) = udp.send_to(&bytes, to).await {
            tracing::debug!(%to, %cause, "a datagram was not sent");
        }
    }
}

async fn datagram_read_loop(udp: Arc<UdpSocket>, inputs: AppInputSender) {
    let credit = ByteCredit::new(DATAGRAMS_IN_FLIGHT_BYTES);
    let mut buffer = [0; DATAGRAM_BYTES_MAX];
    loop {
        let (count, from) = match udp.recv_from(&mut buffer).await {
            Ok(received) => received,
            // An earlier datagram was refused by its destination; datagrams carry no promise.
            Err(cause) if cause.kind() == io::ErrorKind::ConnectionRefused => continue,
            Err(cause) => {
                tracing::warn!(%cause, "a datagram was not received");
                sleep(PAUSE).await;
                continue;
            }
        };
        let Some(piece) = credit.try_admit(&buffer[..count]) else {
            continue;
        };
        if inputs.send(AppInput::Datagram { from, piece }).is_err() {
            return;
        }
    }
}

/// Pause before a failed accept is tried again.
const PAUSE: Duration = Duration::from_millis(50);
/// Long enough for a turn of each task, short enough not to delay a stop.
const LAST_TURN: Duration = Duration::from_millis(2);
