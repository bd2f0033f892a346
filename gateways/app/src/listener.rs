//! The APP listener: an I/O thread, and a thread for each client.
//!
//! The I/O thread accepts connections and carries bytes. It interprets nothing. Input for the thread of a client is
//! bounded; a client that waits for its scene is not read, and delays no other. The listener closes connections beyond
//! the limit.
//!
//! The published client reads TCP every 30 ms, 64 KiB at most, and loses a message that a read cuts. Sending in spans
//! keeps within that, with one limiter for each connection.

use core::fmt;
use core::future::pending;
use core::net::SocketAddr;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::thread::JoinHandle;
use std::time::Duration;
use std::{io, thread};

use bytes::Bytes;
use rhumb_link::{ByteCredit, PIECE_COST_BYTES, Piece, bind_udp, io_runtime};
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::tcp::{OwnedReadHalf, OwnedWriteHalf};
use tokio::net::{TcpListener, TcpStream, UdpSocket};
use tokio::sync::{OwnedSemaphorePermit, Semaphore, mpsc, oneshot};
use tokio::time::{sleep, timeout};

use crate::client::AppClient;
use crate::datagram_sender::DatagramSender;
use crate::gateway::Gateway;
use crate::send_queue::{AppTransmit, limiter_of_bytes};

/// Address and rate of the APP listener.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct AppListen {
    /// The address of both TCP and UDP; port 0 picks one that is free for both.
    pub address: SocketAddr,
    /// Datagrams to one address in a millisecond; `None` for no limit.
    pub datagrams_per_ms: Option<u32>,
}

/// Reason why the APP listener cannot be opened.
#[derive(Debug)]
pub enum AppBindError {
    /// The address cannot be bound.
    Address {
        /// The address.
        address: SocketAddr,
        /// The system's error.
        cause: io::Error,
    },
    /// The I/O thread cannot start.
    Thread(io::Error),
}

/// A listener that serves its clients. Dropping it ends their connections.
#[derive(Debug)]
pub struct AppListener {
    address: SocketAddr,
    end: Option<oneshot::Sender<()>>,
    thread: Option<JoinHandle<()>>,
}

/// Ports to try when any port will do that is free for both TCP and UDP.
const PORTS_TRIED: usize = 16;
impl AppListener {
    /// Binds the address for TCP and UDP, and serves the clients that connect.
    ///
    /// # Errors
    ///
    /// [`AppBindError`] names the address or the thread that failed.
    pub fn open(listen: AppListen, gateway: Arc<Gateway>) -> Result<Self, AppBindError> {
        let address = listen.address;
        let wrong = |cause| AppBindError::Address { address, cause };
        let runtime = io_runtime().map_err(AppBindError::Thread)?;
        let (tcp, udp) = {
            let _inside = runtime.enter();
            bind_both(address).map_err(wrong)?
        };
        let address = tcp.local_addr().map_err(wrong)?;
        let datagram_sender = Arc::new(DatagramSender::new(listen.datagrams_per_ms));
        let (end, ended) = oneshot::channel();
        let sockets = Sockets {
            tcp,
            udp,
            datagram_sender,
            gateway,
        };
        let thread = thread::Builder::new()
            .name("rhumb-app-io".into())
            .spawn(move || runtime.block_on(carry(sockets, ended)))
            .map_err(AppBindError::Thread)?;
        Ok(Self {
            address,
            end: Some(end),
            thread: Some(thread),
        })
    }

    /// The address of both TCP and UDP.
    #[must_use]
    pub const fn address(&self) -> SocketAddr {
        self.address
    }
}

impl Drop for AppListener {
    fn drop(&mut self) {
        if let Some(end) = self.end.take() {
            // An error means that the thread has ended already.
            let _ = end.send(());
        }
        if let Some(thread) = self.thread.take()
            && thread.join().is_err()
        {
            tracing::error!("the i/o thread of app clients panicked");
        }
    }
}

/// Sockets of both kinds on one port.
fn bind_both(address: SocketAddr) -> io::Result<(TcpListener, UdpSocket)> {
    let mut tries = 0;
    loop {
        tries += 1;
        let tcp = std::net::TcpListener::bind(address)?;
        tcp.set_nonblocking(true)?;
        match bind_udp(tcp.local_addr()?) {
            Ok(udp) => {
                udp.set_nonblocking(true)?;
                return Ok((TcpListener::from_std(tcp)?, UdpSocket::from_std(udp)?));
            }
            // The port that TCP got may be taken on UDP.
            Err(_) if address.port() == 0 && tries < PORTS_TRIED => {}
            Err(cause) => return Err(cause),
        }
    }
}

impl fmt::Display for AppBindError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Address { address, cause } => write!(
                f,
                "cannot listen on tcp and udp {address}: {cause}; choose another address or port 0"
            ),
            Self::Thread(cause) => write!(f, "cannot start the i/o thread of app clients: {cause}"),
        }
    }
}

impl std::error::Error for AppBindError {
    fn source(&self) -> Option<&(dyn std::error::Error + 'static)> {
        match self {
            Self::Address { cause, .. } | Self::Thread(cause) => Some(cause),
        }
    }
}

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
/// Bytes between a socket and the thread of its client; beyond them the connection is not read.
const IN_FLIGHT_BYTES: usize = 256 << 10;
const READ_BYTES_MAX: usize = 64 << 10;
/// Longest datagram that is read; a logon has 76 bytes.
const DATAGRAM_BYTES_MAX: usize = 512;
/// A client that has sent nothing for this time is asked whether its scene is still there.
const SILENCE: Duration = Duration::from_millis(500);
/// Stack of a client's thread: what a main thread has.
const STACK_BYTES: usize = 8 << 20;

/// Sockets of the listener, and the gateway of its clients.
struct Sockets {
    tcp: TcpListener,
    udp: UdpSocket,
    /// Outgoing datagrams.
    datagram_sender: Arc<DatagramSender>,
    gateway: Arc<Gateway>,
}

/// Carries bytes until its end is requested.
async fn carry(sockets: Sockets, mut ended: oneshot::Receiver<()>) {
    let Sockets {
        tcp,
        udp,
        datagram_sender,
        gateway,
    } = sockets;
    let udp = Arc::new(udp);
    let queue = Arc::clone(&datagram_sender);
    let datagram_writer = tokio::spawn(datagram_write_loop(Arc::clone(&udp), queue));
    let listen = tokio::spawn(datagram_read_loop(udp, Arc::clone(&gateway)));
    let free_places = Arc::new(Semaphore::new(CONNECTIONS_MAX));
    let mut number = 0;
    loop {
        let accepted = tokio::select! {
            accepted = tcp.accept() => accepted,
            _ = &mut ended => break,
        };
        let (stream, from) = match accepted {
            Ok(accepted) => accepted,
            Err(cause) => {
                // The process has no free descriptor, or the client has left already: the listener continues.
                tracing::warn!(%cause, "an app connection was not accepted");
                sleep(PAUSE).await;
                continue;
            }
        };
        let Ok(place) = Arc::clone(&free_places).try_acquire_owned() else {
            let most = CONNECTIONS_MAX;
            tracing::warn!(%from, most, "an app connection was refused: the gateway has as many as it may");
            continue;
        };
        number += 1;
        let client = AppClient::new(&gateway, number, from);
        let thread = ClientThread::start(client, Arc::clone(&datagram_sender), place);
        tokio::spawn(serve(stream, from, number, thread));
    }
    datagram_writer.abort();
    listen.abort();
    // Every connection's task gets a turn to send its queued bytes.
    sleep(LAST_TURN).await;
}

/// The thread of a client, from the side of its sockets.
struct ClientThread {
    inputs: Sender<Piece>,
    /// The bytes that it sends.
    outputs: AppConnectionReader,
}

impl ClientThread {
    /// Starts the thread of a client, which holds its place until it ends.
    fn start(
        client: AppClient,
        datagrams: Arc<DatagramSender>,
        place: OwnedSemaphorePermit,
    ) -> io::Result<Self> {
        let (sender, inputs) = channel();
        let (connection, outputs) = connection_queue();
        thread::Builder::new()
            .name("rhumb-app-client".to_owned())
            .stack_size(STACK_BYTES)
            .spawn(move || {
                run(client, &inputs, &connection, &datagrams);
                drop(place);
            })?;
        Ok(Self {
            inputs: sender,
            outputs,
        })
    }
}

/// Serves a client until its connection ends or is to be closed.
fn run(
    mut client: AppClient,
    inputs: &Receiver<Piece>,
    connection: &AppConnection,
    datagrams: &DatagramSender,
) {
    loop {
        match inputs.recv_timeout(SILENCE) {
            Ok(piece) => client.handle_bytes(&piece.bytes, connection.waiting_bytes()),
            Err(RecvTimeoutError::Timeout) => client.handle_silence(),
            Err(RecvTimeoutError::Disconnected) => return,
        }
        while let Some(transmit) = client.poll_transmit() {
            match transmit {
                AppTransmit::Bytes(bytes) => {
                    if connection.send(bytes).is_err() {
                        let most = WAITING_BYTES_MAX;
                        return tracing::warn!(
                            most,
                            "an app client reads too slowly, closing: more bytes wait"
                        );
                    }
                }
                AppTransmit::Datagram(datagram) => datagrams.send(datagram),
                AppTransmit::Close => return,
            }
        }
    }
}

/// Carries one connection from start to end.
async fn serve(stream: TcpStream, from: SocketAddr, peer: u64, thread: io::Result<ClientThread>) {
    let ClientThread { inputs, outputs } = match thread {
        Ok(thread) => thread,
        Err(cause) => return tracing::error!(peer, %from, %cause, "no thread for an app client"),
    };
    if let Err(cause) = stream.set_nodelay(true) {
        tracing::debug!(%cause, "an app connection ended at once");
        return;
    }
    let (read, write) = stream.into_split();
    tokio::select! {
        why = read_loop(read, &inputs) => tracing::info!(peer, %from, %why, "an app connection ended"),
        why = write_loop(write, outputs) => tracing::info!(peer, %from, %why, "an app connection was ended"),
    }
}

/// Reason for the end of a connection, for the log.
type EndReason = &'static str;

/// Reads no further than the client's thread keeps up.
async fn read_loop(mut read: OwnedReadHalf, inputs: &Sender<Piece>) -> EndReason {
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
        if inputs.send(piece).is_err() {
            // Messages that the thread has sent are still written.
            pending::<()>().await;
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
    // The client's thread has ended.
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

async fn datagram_read_loop(udp: Arc<UdpSocket>, gateway: Arc<Gateway>) {
    let mut buffer = [0; DATAGRAM_BYTES_MAX];
    loop {
        match udp.recv_from(&mut buffer).await {
            Ok((count, from)) => gateway.handle_datagram(from, &buffer[..count]),
            // An earlier datagram was refused by its destination; datagrams carry no promise.
            Err(cause) if cause.kind() == io::ErrorKind::ConnectionRefused => {}
            Err(cause) => {
                tracing::warn!(%cause, "a datagram was not received");
                sleep(PAUSE).await;
            }
        }
    }
}

/// Pause before a failed accept is tried again.
const PAUSE: Duration = Duration::from_millis(50);
/// Long enough for a turn of each task, short enough not to delay a stop.
const LAST_TURN: Duration = Duration::from_millis(2);

/// The sending end of a connection's outgoing bytes. Dropping it ends the connection, after the queued bytes.
#[derive(Debug)]
struct AppConnection {
    queue: mpsc::UnboundedSender<Bytes>,
    waiting_bytes: Arc<AtomicUsize>,
}

/// The reading end, which the I/O thread empties.
#[derive(Debug)]
struct AppConnectionReader {
    queue: mpsc::UnboundedReceiver<Bytes>,
    waiting_bytes: Arc<AtomicUsize>,
}

/// Error: the queue has reached its bound.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct AppQueueOverflow;

/// Queued bytes per client, at most: minutes of a busy region's updates over TCP.
const WAITING_BYTES_MAX: usize = 4 << 20;

fn connection_queue() -> (AppConnection, AppConnectionReader) {
    let (sender, receiver) = mpsc::unbounded_channel();
    let waiting_bytes = Arc::new(AtomicUsize::new(0));
    let near = AppConnection {
        queue: sender,
        waiting_bytes: Arc::clone(&waiting_bytes),
    };
    let far = AppConnectionReader {
        queue: receiver,
        waiting_bytes,
    };
    (near, far)
}

impl AppConnection {
    /// Appends bytes without waiting.
    fn send(&self, bytes: Bytes) -> Result<(), AppQueueOverflow> {
        let cost = bytes.len() + PIECE_COST_BYTES;
        let waiting = self.waiting_bytes.fetch_add(cost, Ordering::Relaxed);
        if waiting + cost > WAITING_BYTES_MAX {
            return Err(AppQueueOverflow);
        }
        // Without a reader the connection has ended; its end is reported separately.
        let _ = self.queue.send(bytes);
        Ok(())
    }

    /// Cost of the queued bytes, with the fixed cost of each piece.
    fn waiting_bytes(&self) -> usize {
        self.waiting_bytes.load(Ordering::Relaxed)
    }
}

impl AppConnectionReader {
    /// Returns the cost of written bytes.
    fn left(&self, bytes: usize) {
        let cost = bytes + PIECE_COST_BYTES;
        self.waiting_bytes.fetch_sub(cost, Ordering::Relaxed);
    }
}
