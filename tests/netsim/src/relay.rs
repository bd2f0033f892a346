//! A UDP relay on real sockets that impairs traffic, for benchmarks.
//!
//! Interprets no packet: every datagram uses the state lane of its link. Runs are not repeatable to the bit, because
//! they depend on real arrival times. Delays round up to the timer's millisecond. Clients and queued datagrams are
//! bounded.

use std::fmt;
use std::io::{self, IoSliceMut};
use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr};
use std::sync::{Arc, Mutex, MutexGuard};
use std::thread::{self, JoinHandle};
use std::time::Duration;

use bytes::Bytes;
use quinn::udp::{RecvMeta, UdpSocketState};
use rhumb_transport::{Clock, bind_udp, io_runtime};
use tokio::io::Interest;
use tokio::net::UdpSocket;
use tokio::sync::{mpsc, oneshot};
use tokio::time::sleep;

use crate::config::LinkConfig;
use crate::counts::LinkCounts;
use crate::link::{Lane, Link};
use crate::sim_network::Direction;

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

/// Links of all clients, in the order of their first packets.
#[derive(Clone, Debug, Default)]
struct RelayClients {
    shared: Arc<Mutex<Vec<RelayClient>>>,
}

#[derive(Debug)]
struct RelayClient {
    client: SocketAddr,
    up: Link,
    down: Link,
}

impl UdpRelay {
    /// Listens at `listen` (port 0 picks a free one) and relays to `server`, with this configuration in each
    /// direction.
    ///
    /// Each client has its own pair of links. The relay serves 64 clients and drops the packets of others.
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
        let clients = RelayClients::default();
        let (end, ended) = oneshot::channel();
        let relay = Relay {
            clock: Clock::start(),
            front,
            server,
            config,
            seed,
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
        let mut sum = LinkCounts::default();
        for relay_client in self.clients.lock().iter() {
            let link = match direction {
                Direction::Up => &relay_client.up,
                Direction::Down => &relay_client.down,
            };
            sum += link.counts(Lane::State);
        }
        sum
    }

    /// Changes the configuration of all present links.
    pub fn set_config(&self, config: LinkConfig) {
        for relay_client in self.clients.lock().iter_mut() {
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
    fn lock(&self) -> MutexGuard<'_, Vec<RelayClient>> {
        self.shared.lock().expect("no link panics")
    }
}

/// State of the relay's thread.
struct Relay {
    clock: Clock,
    front: Socket,
    server: SocketAddr,
    config: LinkConfig,
    seed: u64,
    /// Each client's socket towards the server, in the order of `clients`.
    backs: Vec<Arc<Socket>>,
    clients: RelayClients,
}

/// A datagram from the server, for the client of this index.
struct Returned {
    index: usize,
    bytes: Bytes,
}

/// Limit of clients of one relay.
const CLIENTS_MAX: usize = 64;

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
                Some(Returned { index, bytes }) = returned.recv() => {
                    self.clients.lock()[index].down.push(self.clock.now(), bytes, Lane::State);
                }
                () = sleep(wait.unwrap_or_default()), if wait.is_some() => {}
            }
            self.pass_on().await;
        }
    }

    fn next_wait(&self) -> Option<Duration> {
        let clients = self.clients.lock();
        let moments = clients
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
        self.clients.lock()[index]
            .up
            .push(self.clock.now(), bytes, Lane::State);
    }

    /// Adds links and a socket for a new client; `None` if the limit of clients is reached.
    async fn admit(
        &mut self,
        client: SocketAddr,
        returns: &mpsc::Sender<Returned>,
    ) -> io::Result<Option<usize>> {
        let index = self.backs.len();
        if index >= CLIENTS_MAX {
            return Ok(None);
        }
        let any: IpAddr = match self.server {
            SocketAddr::V4(_) => Ipv4Addr::UNSPECIFIED.into(),
            SocketAddr::V6(_) => Ipv6Addr::UNSPECIFIED.into(),
        };
        let back = bind_udp(SocketAddr::new(any, 0))?;
        let back = Arc::new(Socket::new(back)?);
        back.socket.connect(self.server).await?;
        // The task ends with the runtime, when the relay does.
        tokio::spawn(read_back(Arc::clone(&back), index, returns.clone()));
        self.backs.push(back);
        let seed = self.seed.wrapping_add(2 * index as u64);
        let (up, down) = (
            Link::new(self.config, seed),
            Link::new(self.config, seed.wrapping_add(1)),
        );
        self.clients.lock().push(RelayClient { client, up, down });
        Ok(Some(index))
    }

    /// Forwards all packets that have arrived by now.
    async fn pass_on(&self) {
        for (index, back) in self.backs.iter().enumerate() {
            while let Some(bytes) = self.due(index, Direction::Up) {
                // A full or refusing socket loses the datagram, as a network does.
                let _ = back.socket.send(&bytes.1).await;
            }
            while let Some((client, bytes)) = self.due(index, Direction::Down) {
                let _ = self.front.socket.send_to(&bytes, client).await;
            }
        }
    }

    fn due(&self, index: usize, direction: Direction) -> Option<(SocketAddr, Bytes)> {
        let now = self.clock.now();
        let mut clients = self.clients.lock();
        let relay_client = &mut clients[index];
        let link = match direction {
            Direction::Up => &mut relay_client.up,
            Direction::Down => &mut relay_client.down,
        };
        link.pop(now).map(|(_, bytes)| (relay_client.client, bytes))
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

async fn read_back(back: Arc<Socket>, index: usize, returns: mpsc::Sender<Returned>) {
    let mut buffer = vec![0; DATAGRAM_BYTES_MAX];
    loop {
        match back.recv(&mut buffer).await {
            Ok(meta) => {
                for bytes in datagrams(&buffer, &meta) {
                    if returns.send(Returned { index, bytes }).await.is_err() {
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
