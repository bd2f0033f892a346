//! A relay that conditions links: delay, jitter, loss, rate.
//!
//! For views, tests and figures; a server uses it for nothing else. The link has neither socket nor clock, and its seed
//! decides everything; the relay carries real datagrams over such links. It interprets no packet: every datagram uses the
//! state lane of its link. Runs are not repeatable to the bit, because they depend on real arrival times. Delays round up
//! to the timer's millisecond. Clients and queued datagrams are bounded; a new client takes the place of one that has been
//! silent for long.

mod config;
mod link;

use std::io::IoSliceMut;
use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr};
use std::sync::{Arc, Mutex, MutexGuard};
use std::thread::JoinHandle;
use std::time::Duration;
use std::{fmt, io, thread};

use bytes::Bytes;
use quinn::udp::{RecvMeta, UdpSocketState};
use rhumb_link::{Clock, bind_udp, io_runtime};
use rhumb_protocol::{Instant, Span};
use tokio::io::Interest;
use tokio::net::UdpSocket;
use tokio::sync::{mpsc, oneshot};
use tokio::task::JoinHandle as Task;
use tokio::time::sleep;

pub use self::config::{LinkConfig, LinkConfigError, Probability};
pub use self::link::{Lane, Link, LinkCounts, Tally};

/// A relay in front of a server; it runs until it is dropped.
#[derive(Debug)]
pub struct UdpRelay {
    local_addr: SocketAddr,
    clients: RelayClients,
    end: Option<oneshot::Sender<()>>,
    thread: Option<JoinHandle<()>>,
}

/// Reason why a relay cannot start.
#[derive(Debug)]
pub enum RelayError {
    /// The address cannot be bound.
    Address {
        /// The address.
        listen: SocketAddr,
        /// The system's error.
        cause: io::Error,
    },
    /// The relay's thread cannot start.
    Thread(io::Error),
}

/// Links of all clients, in the order of their first packets, and the configuration of the next ones.
#[derive(Clone, Debug)]
struct RelayClients {
    shared: Arc<Mutex<RelayState>>,
}

#[derive(Debug)]
struct RelayState {
    config: LinkConfig,
    clients: Vec<RelayClient>,
    /// Counts of clients whose place another one has taken.
    past: [LinkCounts; 2],
}

#[derive(Debug)]
struct RelayClient {
    client: SocketAddr,
    up: Link,
    down: Link,
    /// When its last datagram came, in either direction.
    last: Instant,
}

impl UdpRelay {
    /// Listens at `listen` (port 0 picks a free one) and relays to `server`, with this configuration in each
    /// direction.
    ///
    /// Each client has its own pair of links. The relay serves 64 clients at one time: another one takes the place of a
    /// client that has been silent for a minute, or its packets are dropped.
    ///
    /// # Errors
    ///
    /// [`RelayError`] names the address or the thread that failed, with the system's error.
    pub fn start(
        listen: SocketAddr,
        server: SocketAddr,
        config: LinkConfig,
        seed: u64,
    ) -> Result<Self, RelayError> {
        let address = |cause| RelayError::Address { listen, cause };
        let front = bind_udp(listen).map_err(address)?;
        let local_addr = front.local_addr().map_err(address)?;
        let runtime = io_runtime().map_err(RelayError::Thread)?;
        let front = {
            let _inside = runtime.enter();
            Socket::new(front).map_err(address)?
        };
        let clients = RelayClients::new(config);
        let (end, ended) = oneshot::channel();
        let relay = Relay {
            clock: Clock::start(),
            front,
            server,
            seed,
            admitted: 0,
            backs: Vec::new(),
            clients: clients.clone(),
        };
        let thread = thread::Builder::new()
            .name("rhumb-relay".into())
            .spawn(move || runtime.block_on(relay.run(ended)))
            .map_err(RelayError::Thread)?;
        Ok(Self {
            local_addr,
            clients,
            end: Some(end),
            thread: Some(thread),
        })
    }

    /// The address that clients connect to.
    #[must_use]
    pub fn local_addr(&self) -> SocketAddr {
        self.local_addr
    }

    /// Datagrams and bytes received, lost and forwarded in one direction, over all clients.
    #[must_use]
    pub fn counts(&self, direction: Direction) -> LinkCounts {
        let shared = self.clients.lock();
        let mut sum = shared.past[direction as usize];
        for relay_client in &shared.clients {
            sum += relay_client.link(direction).counts(Lane::State);
        }
        sum
    }

    /// The configuration of the links of later clients.
    #[must_use]
    pub fn config(&self) -> LinkConfig {
        self.clients.lock().config
    }

    /// Changes the configuration of all links, present and later ones.
    pub fn set_config(&self, config: LinkConfig) {
        let mut shared = self.clients.lock();
        shared.config = config;
        for relay_client in &mut shared.clients {
            relay_client.up.set_config(config);
            relay_client.down.set_config(config);
        }
    }
}

impl Drop for UdpRelay {
    fn drop(&mut self) {
        if let Some(end) = self.end.take() {
            // An error means that the thread has ended already.
            let _ = end.send(());
        }
        if let Some(thread) = self.thread.take()
            && thread.join().is_err()
        {
            tracing::error!("the relay's thread panicked");
        }
    }
}

impl RelayClients {
    fn new(config: LinkConfig) -> Self {
        let shared = RelayState {
            config,
            clients: Vec::new(),
            past: [LinkCounts::default(); 2],
        };
        Self {
            shared: Arc::new(Mutex::new(shared)),
        }
    }

    fn lock(&self) -> MutexGuard<'_, RelayState> {
        self.shared.lock().expect("no link panics")
    }
}

impl RelayState {
    /// The place for a new client: a free one, or that of the client that has been silent the longest.
    fn place(&self, now: Instant) -> Option<usize> {
        if self.clients.len() < CLIENTS_MAX {
            return Some(self.clients.len());
        }
        let clients = self.clients.iter().enumerate();
        let (index, oldest) = clients.min_by_key(|(_, relay_client)| relay_client.last)?;
        (now.since(oldest.last) >= SILENT).then_some(index)
    }

    fn put(&mut self, index: usize, relay_client: RelayClient) {
        match self.clients.get_mut(index) {
            None => self.clients.push(relay_client),
            Some(place) => {
                let before = std::mem::replace(place, relay_client);
                for direction in [Direction::Up, Direction::Down] {
                    self.past[direction as usize] += before.link(direction).counts(Lane::State);
                }
            }
        }
    }
}

impl RelayClient {
    const fn link(&self, direction: Direction) -> &Link {
        match direction {
            Direction::Up => &self.up,
            Direction::Down => &self.down,
        }
    }

    const fn link_mut(&mut self, direction: Direction) -> &mut Link {
        match direction {
            Direction::Up => &mut self.up,
            Direction::Down => &mut self.down,
        }
    }

    fn push(&mut self, now: Instant, bytes: Bytes, direction: Direction) {
        self.last = now;
        self.link_mut(direction).push(now, bytes, Lane::State);
    }
}

/// State of the relay's thread.
struct Relay {
    clock: Clock,
    front: Socket,
    server: SocketAddr,
    seed: u64,
    /// Clients admitted so far.
    admitted: u64,
    /// Each client's way towards the server, in the order of `clients`.
    backs: Vec<Back>,
    clients: RelayClients,
}

/// A client's socket towards the server, and the task that reads it.
struct Back {
    socket: Arc<Socket>,
    reader: Task<()>,
}

impl Drop for Back {
    fn drop(&mut self) {
        self.reader.abort();
    }
}

/// A datagram from the server, for a client.
struct Returned {
    index: usize,
    client: SocketAddr,
    bytes: Bytes,
}

/// Limit of clients of one relay.
const CLIENTS_MAX: usize = 64;

/// A client that has been silent for longer may lose its place: its connection has timed out.
const SILENT: Span = Span::from_millis(60_000);

/// Limit of queued datagrams from the server.
const RETURNED_MAX: usize = 4_096;

/// The largest UDP payload.
const DATAGRAM_BYTES_MAX: usize = 65_535;

impl Relay {
    async fn run(mut self, mut ended: oneshot::Receiver<()>) {
        let (returns, mut returned) = mpsc::channel(RETURNED_MAX);
        let mut buffer = vec![0; DATAGRAM_BYTES_MAX];
        loop {
            let wait = self.next_wait();
            tokio::select! {
                _ = &mut ended => return,
                received = self.front.recv(&mut buffer) => {
                    if let Ok(meta) = received {
                        for bytes in datagrams(&buffer, &meta) {
                            self.take_up(meta.addr, bytes, &returns).await;
                        }
                    }
                }
                Some(Returned { index, client, bytes }) = returned.recv() => {
                    let mut shared = self.clients.lock();
                    let relay_client = &mut shared.clients[index];
                    // The place may be another client's by now.
                    if relay_client.client == client {
                        relay_client.push(self.clock.now(), bytes, Direction::Down);
                    }
                }
                () = sleep(wait.unwrap_or_default()), if wait.is_some() => {}
            }
            self.pass_on().await;
        }
    }

    fn next_wait(&self) -> Option<Duration> {
        let shared = self.clients.lock();
        let moments = shared
            .clients
            .iter()
            .flat_map(|relay_client| [relay_client.up.next_at(), relay_client.down.next_at()]);
        moments.flatten().min().map(|at| self.clock.until(at))
    }

    async fn take_up(
        &mut self,
        client: SocketAddr,
        bytes: Bytes,
        returns: &mpsc::Sender<Returned>,
    ) {
        let known = self
            .clients
            .lock()
            .clients
            .iter()
            .position(|relay_client| relay_client.client == client);
        let index = match known {
            Some(index) => index,
            None => match self.admit(client, returns).await {
                Ok(Some(index)) => index,
                Ok(None) => return,
                Err(cause) => {
                    return tracing::warn!(%client, %cause, "no socket towards the server");
                }
            },
        };
        self.clients.lock().clients[index].push(self.clock.now(), bytes, Direction::Up);
    }

    /// Adds links and a socket for a new client; `None` if no place is left.
    async fn admit(
        &mut self,
        client: SocketAddr,
        returns: &mpsc::Sender<Returned>,
    ) -> io::Result<Option<usize>> {
        let now = self.clock.now();
        let Some(index) = self.clients.lock().place(now) else {
            return Ok(None);
        };
        let any: IpAddr = match self.server {
            SocketAddr::V4(_) => Ipv4Addr::UNSPECIFIED.into(),
            SocketAddr::V6(_) => Ipv6Addr::UNSPECIFIED.into(),
        };
        let socket = bind_udp(SocketAddr::new(any, 0))?;
        let socket = Arc::new(Socket::new(socket)?);
        socket.socket.connect(self.server).await?;
        let reading = read_back(Arc::clone(&socket), (index, client), returns.clone());
        let reader = tokio::spawn(reading);
        let back = Back { socket, reader };
        match self.backs.get_mut(index) {
            None => self.backs.push(back),
            Some(place) => *place = back,
        }
        let seed = self.seed.wrapping_add(2 * self.admitted);
        self.admitted += 1;
        let mut shared = self.clients.lock();
        let config = shared.config;
        let relay_client = RelayClient {
            client,
            up: Link::new(config, seed),
            down: Link::new(config, seed.wrapping_add(1)),
            last: now,
        };
        shared.put(index, relay_client);
        Ok(Some(index))
    }

    /// Forwards all packets that have arrived by now.
    async fn pass_on(&self) {
        for (index, back) in self.backs.iter().enumerate() {
            while let Some(bytes) = self.due(index, Direction::Up) {
                // A full or refusing socket loses the datagram, as a network does.
                let _ = back.socket.socket.send(&bytes.1).await;
            }
            while let Some((client, bytes)) = self.due(index, Direction::Down) {
                let _ = self.front.socket.send_to(&bytes, client).await;
            }
        }
    }

    fn due(&self, index: usize, direction: Direction) -> Option<(SocketAddr, Bytes)> {
        let now = self.clock.now();
        let mut shared = self.clients.lock();
        let relay_client = &mut shared.clients[index];
        let popped = relay_client.link_mut(direction).pop(now);
        popped.map(|(_, bytes)| (relay_client.client, bytes))
    }
}

/// A socket that splits segmented receives: loopback may deliver several datagrams in one buffer.
struct Socket {
    socket: UdpSocket,
    state: UdpSocketState,
}

impl Socket {
    fn new(socket: std::net::UdpSocket) -> io::Result<Self> {
        let state = UdpSocketState::new((&socket).into())?;
        let socket = UdpSocket::from_std(socket)?;
        Ok(Self { socket, state })
    }

    /// One receive: datagrams of one sender, all of `stride` bytes but the last.
    async fn recv(&self, buffer: &mut [u8]) -> io::Result<RecvMeta> {
        let receive = || {
            let mut meta = [RecvMeta::default()];
            let mut pieces = [IoSliceMut::new(buffer)];
            self.state
                .recv((&self.socket).into(), &mut pieces, &mut meta)?;
            Ok(meta[0])
        };
        self.socket.async_io(Interest::READABLE, receive).await
    }
}

/// The datagrams of one receive.
fn datagrams<'a>(buffer: &'a [u8], meta: &RecvMeta) -> impl Iterator<Item = Bytes> + use<'a> {
    let stride = meta.stride.max(1);
    buffer[..meta.len]
        .chunks(stride)
        .map(Bytes::copy_from_slice)
}

async fn read_back(
    back: Arc<Socket>,
    (index, client): (usize, SocketAddr),
    returns: mpsc::Sender<Returned>,
) {
    let mut buffer = vec![0; DATAGRAM_BYTES_MAX];
    loop {
        match back.recv(&mut buffer).await {
            Ok(meta) => {
                for bytes in datagrams(&buffer, &meta) {
                    let returned = Returned {
                        index,
                        client,
                        bytes,
                    };
                    if returns.send(returned).await.is_err() {
                        return;
                    }
                }
            }
            // The server's port is closed for now; it may open again.
            Err(cause) if cause.kind() == io::ErrorKind::ConnectionRefused => {}
            Err(cause) => {
                return tracing::warn!(index, %cause, "the socket towards the server failed");
            }
        }
    }
}

impl fmt::Display for RelayError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Address { listen, cause } => {
                write!(
                    f,
                    "cannot relay at udp {listen}: {cause}; choose another address or port 0"
                )
            }
            Self::Thread(cause) => write!(f, "cannot start the relay's thread: {cause}"),
        }
    }
}

impl std::error::Error for RelayError {
    fn source(&self) -> Option<&(dyn std::error::Error + 'static)> {
        match self {
            Self::Address { cause, .. } | Self::Thread(cause) => Some(cause),
        }
    }
}

/// Direction of a link.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Direction {
    /// From a client to the server.
    Up,
    /// From the server to a client.
    Down,
}

#[cfg(test)]
mod tests {
    use super::*;

    fn client(number: u16, last: Instant) -> RelayClient {
        RelayClient {
            client: SocketAddr::from(([127, 0, 0, 1], number)),
            up: Link::new(LinkConfig::PERFECT, 1),
            down: Link::new(LinkConfig::PERFECT, 2),
            last,
        }
    }

    #[test]
    fn a_new_client_takes_the_place_of_one_that_has_been_silent_for_long() {
        let clients = RelayClients::new(LinkConfig::PERFECT);
        let mut shared = clients.lock();
        let early = Instant::from_nanos(5);
        for number in 0..CLIENTS_MAX {
            assert_eq!(shared.place(early), Some(number));
            let last = if number == 7 { early } else { early + SILENT };
            shared.put(number, client(number as u16, last));
        }
        shared.clients[7].push(early, Bytes::from_static(b"up"), Direction::Up);
        assert_eq!(shared.place(early + Span::from_nanos(1)), None);
        let later = early + SILENT;
        assert_eq!(shared.place(later), Some(7));
        shared.put(7, client(1_000, later));
        assert_eq!(shared.place(later), None);
        assert_eq!(shared.clients.len(), CLIENTS_MAX);
        assert_eq!(shared.past[Direction::Up as usize].pushed.pieces, 1);
    }
}
