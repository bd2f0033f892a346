//! The I/O thread of the second listener: accepts, and carries to the host thread.
//!
//! Interprets nothing. What waits for the host is bounded per connection; a full house closes at the listener.

use core::net::SocketAddr;
use std::io;
use std::sync::Arc;
use std::sync::mpsc::Sender;
use std::time::Duration;

use rhumb_protocol::Peer;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::tcp::{OwnedReadHalf, OwnedWriteHalf};
use tokio::net::{TcpListener, TcpStream, UdpSocket};
use tokio::sync::{Semaphore, oneshot};
use tokio::time::{sleep, timeout};

use super::connection::{AppConnectionReader, AppInput, line};
use super::datagram_sender::DatagramSender;
use super::rate_limiter;
use crate::piece::ByteCredit;
use crate::quic::Input;

/// Connections at one time.
const CONNECTIONS_MAX: usize = 64;
/// The first bytes of a connection have to come in this time.
const FIRST_BYTES: Duration = Duration::from_secs(10);
/// A client that has said nothing for so long is gone: one that lives says a step eleven times a second.
const IDLE: Duration = Duration::from_secs(60);
/// A write that takes longer is to a client that reads no more.
const WRITE: Duration = Duration::from_secs(30);
/// What was said last to a client may take so long to leave.
const FLUSH: Duration = Duration::from_millis(500);
/// Bytes between the sockets and the host thread, per connection; beyond them a connection is not read.
const IN_FLIGHT_BYTES: usize = 256 << 10;
/// Bytes of datagrams between the sockets and the host thread; beyond them they are dropped.
const DATAGRAMS_IN_FLIGHT_BYTES: usize = 64 << 10;
const READ_BYTES_MAX: usize = 64 << 10;
/// Longest datagram that is looked at; a logon has 76 bytes.
const DATAGRAM_BYTES_MAX: usize = 512;
/// The bit of a peer that came by this listener.
const BY_APP: u64 = 1 << 63;

/// What the listener consists of.
pub(super) struct Sockets {
    pub(super) tcp: TcpListener,
    pub(super) udp: UdpSocket,
    /// Datagrams on their way out.
    pub(super) datagram_sender: Arc<DatagramSender>,
}

/// Carries until the end is asked for.
pub(super) async fn carry(sockets: Sockets, host: Sender<Input>, mut ended: oneshot::Receiver<()>) {
    let udp = Arc::new(sockets.udp);
    let talk = tokio::spawn(datagram_write_loop(
        Arc::clone(&udp),
        sockets.datagram_sender,
    ));
    let listen = tokio::spawn(datagram_read_loop(udp, host.clone()));
    let room = Arc::new(Semaphore::new(CONNECTIONS_MAX));
    let mut peers = BY_APP;
    loop {
        let accepted = tokio::select! {
            accepted = sockets.tcp.accept() => accepted,
            _ = &mut ended => break,
        };
        let (stream, from) = match accepted {
            Ok(accepted) => accepted,
            Err(cause) => {
                // Out of descriptors, or gone before it was looked at: neither ends the listener.
                tracing::warn!(%cause, "an app connection was not accepted");
                sleep(PAUSE).await;
                continue;
            }
        };
        let Ok(place) = Arc::clone(&room).try_acquire_owned() else {
            tracing::warn!(%from, "an app connection was refused: the house is full");
            continue;
        };
        let (peer, host) = (Peer(peers), host.clone());
        peers += 1;
        tokio::spawn(async move {
            serve(stream, from, peer, host).await;
            drop(place);
        });
    }
    talk.abort();
    listen.abort();
    // Every connection's task has a turn to send what it has.
    sleep(LAST_TURN).await;
}

/// Carries one connection from its first moment to its last.
async fn serve(stream: TcpStream, from: SocketAddr, peer: Peer, host: Sender<Input>) {
    if let Err(cause) = stream.set_nodelay(true) {
        tracing::debug!(%cause, "an app connection was gone at once");
        return;
    }
    let (near, far) = line();
    let opened = AppInput::Opened {
        peer,
        from,
        line: near,
    };
    // A host that is gone hears nothing: the thread ends soon.
    let _ = host.send(Input::App(opened));
    let (read, write) = stream.into_split();
    tokio::select! {
        why = read_loop(read, peer, &host) => tracing::info!(peer = peer.0, %from, %why, "an app connection ended"),
        why = write_loop(write, far) => tracing::info!(peer = peer.0, %from, %why, "an app connection was ended"),
    }
    let _ = host.send(Input::App(AppInput::Ended { peer }));
}

/// Why a connection is over, in words for the log.
type Why = &'static str;

/// Reads no further than the host thread keeps up.
async fn read_loop(mut read: OwnedReadHalf, peer: Peer, host: &Sender<Input>) -> Why {
    let credit = ByteCredit::new(IN_FLIGHT_BYTES);
    let mut buffer = vec![0; READ_BYTES_MAX];
    let mut patience = FIRST_BYTES;
    loop {
        let count = match timeout(patience, read.read(&mut buffer)).await {
            Ok(Ok(0)) => return "the client closed it",
            Ok(Ok(count)) => count,
            Ok(Err(_)) => return "it broke",
            Err(_) => return "the client was silent",
        };
        patience = IDLE;
        let piece = credit.admit(&buffer[..count]).await;
        if host
            .send(Input::App(AppInput::Bytes { peer, piece }))
            .is_err()
        {
            return "the server is stopping";
        }
    }
}

/// Writes what is queued, piece by piece and no faster than a client can bear.
async fn write_loop(mut write: OwnedWriteHalf, mut line: AppConnectionReader) -> Why {
    let mut rate_limiter = rate_limiter::of_bytes();
    while let Some(bytes) = line.queue.recv().await {
        rate_limiter.spend(bytes.len()).await;
        match timeout(WRITE, write.write_all(&bytes)).await {
            Ok(Ok(())) => line.left(bytes.len()),
            Ok(Err(_)) => return "it broke",
            Err(_) => return "the client does not read",
        }
    }
    // The host has said its last.
    let _ = timeout(FLUSH, write.shutdown()).await;
    "the server closed it"
}

async fn datagram_write_loop(udp: Arc<UdpSocket>, datagram_sender: Arc<DatagramSender>) {
    loop {
        let (to, bytes) = datagram_sender.next().await;
        if let Err(cause) = udp.send_to(&bytes, to).await {
            tracing::debug!(%to, %cause, "a datagram was not sent");
        }
    }
}

async fn datagram_read_loop(udp: Arc<UdpSocket>, host: Sender<Input>) {
    let credit = ByteCredit::new(DATAGRAMS_IN_FLIGHT_BYTES);
    let mut buffer = [0; DATAGRAM_BYTES_MAX];
    loop {
        let (count, from) = match udp.recv_from(&mut buffer).await {
            Ok(heard) => heard,
            // What we sent before was refused by somebody, which tells us nothing new.
            Err(cause) if cause.kind() == io::ErrorKind::ConnectionRefused => continue,
            Err(cause) => {
                tracing::warn!(%cause, "a datagram was not heard");
                sleep(PAUSE).await;
                continue;
            }
        };
        let Some(piece) = credit.try_admit(&buffer[..count]) else {
            continue;
        };
        if host
            .send(Input::App(AppInput::Datagram { from, piece }))
            .is_err()
        {
            return;
        }
    }
}

/// Between two attempts at what failed for want of something.
const PAUSE: Duration = Duration::from_millis(50);
/// Long enough for a turn of each task, short enough that nobody waits for it.
const LAST_TURN: Duration = Duration::from_millis(2);
