//! The APP listener of a server: bound here, served by the server's thread.
//!
//! Its I/O thread accepts connections and carries bytes. It interprets nothing. Input for the server thread is bounded
//! per connection; the listener closes connections beyond the limit.
//!
//! The published client reads TCP every 30 ms, 64 KiB at most, and loses a message that a read cuts. Sending in spans
//! keeps within that, with one limiter for each connection.

use core::fmt;
use core::net::SocketAddr;
use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::thread::JoinHandle;
use std::time::Duration;
use std::{io, thread};

use bytes::Bytes;
use rhumb_link::{ByteCredit, PIECE_COST_BYTES, Piece, bind_udp, io_runtime};
use rhumb_protocol::Peer;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::tcp::{OwnedReadHalf, OwnedWriteHalf};
use tokio::net::{TcpListener, TcpStream, UdpSocket};
use tokio::sync::{Semaphore, mpsc, oneshot};
use tokio::time::{Instant, sleep, sleep_until, timeout};

use super::datagram_sender::DatagramSender;
use crate::server::{AppHost, AppServer, AppTransmit};

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

/// The server thread's end of the listener. Its clients wait until it is served.
#[derive(Debug)]
pub struct AppListener {
    address: SocketAddr,
    inputs: Receiver<AppInput>,
    connections: BTreeMap<Peer, AppConnection>,
    datagram_sender: Arc<DatagramSender>,
    end: Option<oneshot::Sender<()>>,
    thread: Option<JoinHandle<()>>,
}

/// Ports to try when any port will do that is free for both TCP and UDP.
const PORTS_TRIED: usize = 16;
/// Inputs handled before the host gets its turn: more than the wakes that its loop takes in a turn, so that no input is
/// left without one.
const INPUTS_PER_TURN: usize = 512;

impl AppListener {
    /// Binds the address for TCP and UDP and starts the I/O thread. `wake` makes the serving thread call
    /// [`Self::serve`] soon.
    ///
    /// # Errors
    ///
    /// [`AppBindError`] names the address or the thread that failed.
    pub fn open(
        listen: AppListen,
        wake: impl Fn() + Send + Sync + 'static,
    ) -> Result<Self, AppBindError> {
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
        let (sender, inputs) = channel();
        let sender = AppInputSender {
            inputs: sender,
            wake: Arc::new(wake),
        };
        let sockets = Sockets {
            tcp,
            udp,
            datagram_sender: Arc::clone(&datagram_sender),
        };
        let thread = thread::Builder::new()
            .name("rhumb-app-io".into())
            .spawn(move || runtime.block_on(carry(sockets, sender, ended)))
            .map_err(AppBindError::Thread)?;
        Ok(Self {
            address,
            inputs,
            connections: BTreeMap::new(),
            datagram_sender,
            end: Some(end),
            thread: Some(thread),
        })
    }

    /// The address of both TCP and UDP.
    #[must_use]
    pub const fn address(&self) -> SocketAddr {
        self.address
    }

    /// Passes the waiting inputs to the server, and queues its transmissions. To be called after each wake.
    pub fn serve(&mut self, server: &mut AppServer, host: &mut dyn AppHost) {
        for _ in 0..INPUTS_PER_TURN {
            match self.inputs.try_recv() {
                Ok(input) => self.handle(input, server, host),
                // The I/O thread has ended: no further input comes.
                Err(_) => break,
            }
        }
        while let Some(transmit) = server.poll_transmit() {
            self.send(transmit);
        }
    }

    fn handle(&mut self, input: AppInput, server: &mut AppServer, host: &mut dyn AppHost) {
        match input {
            AppInput::Opened {
                peer,
                from,
                connection,
            } => {
                self.connections.insert(peer, connection);
                server.handle_opened(peer, from);
            }
            AppInput::Bytes { peer, piece } => {
                if let Some(connection) = self.connections.get(&peer) {
                    server.handle_bytes(host, peer, &piece.bytes, connection.waiting_bytes());
                }
            }
            AppInput::Datagram { from, piece } => server.handle_datagram(from, &piece.bytes),
            AppInput::Ended { peer } => {
                self.connections.remove(&peer);
                server.handle_ended(host, peer);
            }
        }
    }

    /// Queues a transmission of the endpoint. A connection that is closed or too slow is no longer read.
    fn send(&mut self, transmit: AppTransmit) {
        match transmit {
            AppTransmit::Bytes { to, bytes } => {
                let connection = self.connections.get(&to);
                if connection.is_some_and(|connection| connection.send(bytes).is_err()) {
                    tracing::warn!(peer = to.0, "an app client reads too slowly, closing");
                    self.connections.remove(&to);
                }
            }
            AppTransmit::Datagram(datagram) => self.datagram_sender.send(datagram),
            AppTransmit::Close { to } => drop(self.connections.remove(&to)),
        }
    }
}

impl Drop for AppListener {
    fn drop(&mut self) {
        self.connections.clear();
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
struct Sockets {
    tcp: TcpListener,
    udp: UdpSocket,
    /// Outgoing datagrams.
    pub(super) datagram_sender: Arc<DatagramSender>,
}

/// Carries bytes until its end is requested.
async fn carry(sockets: Sockets, inputs: AppInputSender, mut ended: oneshot::Receiver<()>) {
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
                // The process has no free descriptor, or the client has left already: the listener continues.
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

/// One input for the server thread.
#[derive(Debug)]
enum AppInput {
    Opened {
        peer: Peer,
        from: SocketAddr,
        connection: AppConnection,
    },
    Bytes {
        peer: Peer,
        piece: Piece,
    },
    Datagram {
        from: SocketAddr,
        piece: Piece,
    },
    Ended {
        peer: Peer,
    },
}

/// The I/O thread's end of the inputs.
#[derive(Clone)]
struct AppInputSender {
    inputs: Sender<AppInput>,
    /// Wakes the thread that takes the inputs.
    wake: Arc<dyn Fn() + Send + Sync>,
}

/// Error: the server thread has ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct ServerEnded;

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

impl AppInputSender {
    /// Passes an input to the server thread.
    pub(super) fn send(&self, input: AppInput) -> Result<(), ServerEnded> {
        self.inputs.send(input).map_err(|_| ServerEnded)?;
        (self.wake)();
        Ok(())
    }
}

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
    pub(super) fn send(&self, bytes: Bytes) -> Result<(), AppQueueOverflow> {
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
    pub(super) fn waiting_bytes(&self) -> usize {
        self.waiting_bytes.load(Ordering::Relaxed)
    }
}

impl AppConnectionReader {
    /// Returns the cost of written bytes.
    pub(super) fn left(&self, bytes: usize) {
        let cost = bytes + PIECE_COST_BYTES;
        self.waiting_bytes.fetch_sub(cost, Ordering::Relaxed);
    }
}

/// A budget for each span of time.
#[derive(Clone, Debug)]
struct RateLimiter {
    span: Duration,
    most: usize,
    /// End of the span in which budget was last spent.
    until: Option<Instant>,
    spent: usize,
}

/// Limit of a TCP connection: one read takes a whole span, which fills a quarter of it.
const fn limiter_of_bytes() -> RateLimiter {
    RateLimiter::new(Duration::from_millis(35), 16 << 10)
}

impl RateLimiter {
    const fn new(span: Duration, most: usize) -> Self {
        Self {
            span,
            most,
            until: None,
            spent: 0,
        }
    }

    /// Spends an amount at a moment.
    ///
    /// # Errors
    ///
    /// The moment from which on it can be spent. An amount above the budget of a span gets a span of its own.
    fn try_spend(&mut self, now: Instant, amount: usize) -> Result<(), Instant> {
        match self.until {
            Some(until) if now < until => {
                if self.spent + amount > self.most {
                    return Err(until);
                }
            }
            _ => {
                self.until = Some(now + self.span);
                self.spent = 0;
            }
        }
        self.spent += amount;
        Ok(())
    }

    /// Waits until the amount can be spent, and spends it.
    async fn spend(&mut self, amount: usize) {
        while let Err(at) = self.try_spend(Instant::now(), amount) {
            sleep_until(at).await;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test(start_paused = true)]
    async fn each_span_has_the_full_budget() {
        let begun = Instant::now();
        let mut rate_limiter = limiter_of_bytes();
        let mut moments = Vec::new();
        for _ in 0..25 {
            rate_limiter.spend(1_400).await;
            moments.push(begun.elapsed().as_millis());
        }
        let expected = [vec![0; 11], vec![35; 11], vec![70; 3]];
        assert_eq!(moments, expected.concat());
    }

    #[tokio::test(start_paused = true)]
    async fn an_amount_above_the_budget_gets_its_own_span() {
        let begun = Instant::now();
        let mut rate_limiter = limiter_of_bytes();
        rate_limiter.spend(1).await;
        rate_limiter.spend(1 << 20).await;
        assert_eq!(begun.elapsed().as_millis(), 35);
        rate_limiter.spend(1).await;
        assert_eq!(begun.elapsed().as_millis(), 70);
    }
}
