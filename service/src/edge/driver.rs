//! Drives an edge: its connections to the owner, beside those of its members.
//!
//! The server's loop calls it as its endpoint. A connection to an owner is opened on a thread of its own, and wakes the
//! loop when something has come. Invariant: what came over a connection is handed on in its order, and nothing after its
//! end; a connection that the edge has given up while it was opened is closed.

use std::collections::BTreeMap;
use std::io;
use std::net::ToSocketAddrs;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{self, Receiver, Sender};
use std::thread;
use std::time::Duration;

use rhumb_edge::{Dial, Edge, SharedPacket};
use rhumb_protocol::{Ending, Endpoint, Instant, LinkReport, Peer, Transmit, Wake, WakeReason};
use rhumb_scene::Heartbeat;
use rhumb_transport::{ClientOptions, ClientTransport, QuicClient, Received, Trust, Waker};

use super::fan_out::{Deliver, FanOutSide, Sharing};
use crate::metrics::Metrics;

/// Time to open a connection.
const DIAL: Duration = Duration::from_secs(2);
/// Connections that are opened at the same time, each by a thread; what the edge wants beyond them waits. Members that
/// come and go at once would otherwise make threads without bound.
const DIALS_MAX: usize = 64;
/// Received pieces of one connection before the others have their turn.
const PIECES_PER_TURN: usize = 1_024;

/// The server of the scenes.
#[derive(Clone, Debug)]
pub(super) struct OwnerServer {
    /// `host:port`.
    pub(super) address: String,
    pub(super) trust: Trust,
}

impl OwnerServer {
    /// Its addresses now.
    ///
    /// # Errors
    ///
    /// The name leads nowhere, or is none.
    pub(super) fn resolve(&self) -> Result<ClientOptions, String> {
        let failed = |cause: io::Error| {
            let address = &self.address;
            format!("cannot resolve the owner {address}: {cause}; give it as host:port")
        };
        let mut addresses = self.address.to_socket_addrs().map_err(failed)?;
        let first = addresses.next();
        let first = first.ok_or_else(|| failed(io::ErrorKind::NotFound.into()))?;
        let (host, _) = self.address.rsplit_once(':').unwrap_or_default();
        Ok(ClientOptions {
            server_name: host.trim_matches(['[', ']']).to_owned(),
            others: addresses.collect(),
            ..ClientOptions::new(first, self.trust.clone())
        })
    }

    /// The server at an address that this one has named. It is trusted as that says: by its fingerprint, or as this one is.
    fn at(&self, address: &str) -> Result<Self, String> {
        let (server, trust) = match address.split_once('#') {
            None => (address, self.trust.clone()),
            Some((server, print)) => {
                let print = print.parse();
                let print = print.map_err(|_| format!("{address} has no fingerprint"))?;
                (server, Trust::Fingerprint(print))
            }
        };
        let server = server.strip_prefix("rhumb://").unwrap_or(server);
        Ok(Self {
            address: server.to_owned(),
            trust,
        })
    }

    fn dial(&self, elsewhere: Option<&str>) -> Result<QuicClient, String> {
        if let Some(address) = elsewhere {
            return self.at(address)?.dial(None);
        }
        let options = self.resolve()?;
        QuicClient::connect(options, DIAL).map_err(|cause| cause.to_string())
    }
}

/// An edge with its connections to the owner.
pub(super) struct EdgeDriver {
    edge: Edge,
    owner: Arc<OwnerServer>,
    links: BTreeMap<Peer, OwnerLink>,
    news: News,
    arrived: Receiver<OwnerNews>,
    connections: usize,
    /// Threads that open connections, also those that the edge has given up.
    dialling: usize,
    metrics: Metrics,
    heartbeat: Heartbeat,
    sharing: Option<Sharing>,
}

enum OwnerLink {
    /// It is being opened.
    Dialled,
    /// The flag is true while the loop knows that something has come over it.
    Open(QuicClient, Arc<AtomicBool>),
}

/// News from other threads for the loop.
enum OwnerNews {
    Opened(Peer, Result<QuicClient, String>),
    Received(Peer),
    /// A packet that a fan-out carried.
    Shared(SharedPacket),
}

/// Their way to it.
#[derive(Clone)]
struct News {
    to: Sender<OwnerNews>,
    /// True if something waits.
    any: Arc<AtomicBool>,
    waker: Waker,
}

impl News {
    fn tell(&self, arrived: OwnerNews) {
        // An edge that has ended has no use for connections.
        let _ = self.to.send(arrived);
        self.any.store(true, Ordering::Release);
        self.waker.wake();
    }
}

impl EdgeDriver {
    /// `waker`: that of the loop which calls it. `heartbeat`: of the loop's thread.
    pub(super) fn new(
        edge: Edge,
        owner: OwnerServer,
        waker: Waker,
        (metrics, heartbeat): (Metrics, Heartbeat),
    ) -> Self {
        let (to, arrived) = mpsc::channel();
        let any = Arc::default();
        Self {
            edge,
            owner: Arc::new(owner),
            links: BTreeMap::new(),
            news: News { to, any, waker },
            arrived,
            connections: 0,
            dialling: 0,
            metrics,
            heartbeat,
            sharing: None,
        }
    }

    /// The way of packets to it.
    pub(super) fn deliver(&self) -> Deliver {
        let news = self.news.clone();
        Deliver::new(move |packet| news.tell(OwnerNews::Shared(packet)))
    }

    /// Packets come, or go, by a fan-out from now on.
    pub(super) fn share(&mut self, sharing: Sharing) {
        self.sharing = Some(sharing);
    }

    /// Hands on what has come from the owner.
    fn receive(&mut self, now: Instant) {
        self.news.any.store(false, Ordering::Release);
        while let Ok(arrived) = self.arrived.try_recv() {
            match arrived {
                OwnerNews::Opened(link, opened) => self.open(now, link, opened),
                OwnerNews::Received(link) => self.receive_over(now, link),
                OwnerNews::Shared(packet) => {
                    if let Some(sharing) = &self.sharing {
                        sharing.taken();
                    }
                    self.edge.handle_shared(now, &packet);
                }
            }
        }
    }

    fn open(&mut self, now: Instant, link: Peer, opened: Result<QuicClient, String>) {
        self.dialling -= 1;
        let is_wanted = self.links.contains_key(&link);
        match opened {
            Ok(connection) if is_wanted => {
                let (has_news, news) = (Arc::new(AtomicBool::new(false)), self.news.clone());
                let known = Arc::clone(&has_news);
                connection.on_arrival(move || {
                    if !has_news.swap(true, Ordering::AcqRel) {
                        news.tell(OwnerNews::Received(link));
                    }
                });
                self.links.insert(link, OwnerLink::Open(connection, known));
                self.edge.owner().handle_opened(now, link);
            }
            Ok(connection) => end(connection),
            Err(cause) => {
                let owner = &self.owner.address;
                tracing::warn!(%owner, %cause, "no connection to the owner");
                self.links.remove(&link);
                self.edge.owner().handle_ended(now, link, Ending::Broken);
            }
        }
    }

    fn receive_over(&mut self, now: Instant, link: Peer) {
        let Some(OwnerLink::Open(connection, has_news)) = self.links.get_mut(&link) else {
            return;
        };
        has_news.store(false, Ordering::Release);
        for _ in 0..PIECES_PER_TURN {
            let Some(received) = connection.recv(Duration::ZERO) else {
                return;
            };
            let mut owner = self.edge.owner();
            match received {
                Received::Control(bytes) => {
                    owner.handle_control(now, link, &bytes);
                    if let Some(sharing) = &mut self.sharing {
                        sharing.follow(&self.edge);
                    }
                }
                Received::State(bytes) => owner.handle_datagram(now, link, &bytes),
                Received::Ended(ending) => {
                    owner.handle_ended(now, link, ending);
                    if let Some(OwnerLink::Open(connection, _)) = self.links.remove(&link) {
                        end(connection);
                    }
                    return;
                }
            }
        }
        if !has_news.swap(true, Ordering::AcqRel) {
            self.news.tell(OwnerNews::Received(link));
        }
    }

    /// Sends what the edge has for the owner, and opens the connections that it wants.
    fn send(&mut self) {
        if let Some(sharing) = &mut self.sharing {
            sharing.publish(&mut self.edge);
        }
        while self.dialling < DIALS_MAX
            && let Some(dial) = self.edge.poll_dial()
        {
            self.dial(&dial);
        }
        while let Some(transmit) = self.edge.owner().poll_transmit() {
            match transmit {
                Transmit::Control { to, bytes } => {
                    if let Some(OwnerLink::Open(connection, _)) = self.links.get(&to) {
                        connection.send_control(bytes);
                    }
                }
                Transmit::State { to, bytes } => {
                    if let Some(OwnerLink::Open(connection, _)) = self.links.get(&to) {
                        connection.send_state(bytes);
                    }
                }
                Transmit::Close { to, code } => match self.links.get(&to) {
                    // Its end follows.
                    Some(OwnerLink::Open(connection, _)) => connection.close(code),
                    Some(OwnerLink::Dialled) => drop(self.links.remove(&to)),
                    None => {}
                },
            }
        }
    }

    fn dial(&mut self, dial: &Dial) {
        let (link, owner, news) = (dial.link, Arc::clone(&self.owner), self.news.clone());
        let elsewhere = dial.elsewhere.clone();
        tracing::debug!(scene = %dial.scene, link = link.0, "connecting to the owner");
        self.links.insert(link, OwnerLink::Dialled);
        self.dialling += 1;
        let dialled = thread::Builder::new()
            .name("rhumb-edge-dial".into())
            .spawn(move || {
                let opened = owner.dial(elsewhere.as_deref());
                news.tell(OwnerNews::Opened(link, opened));
            });
        if let Err(cause) = dialled {
            let failed = Err(format!("no thread: {cause}"));
            self.news.tell(OwnerNews::Opened(link, failed));
        }
    }
}

/// Drops a connection, which waits until its last bytes have left.
fn end(connection: QuicClient) {
    let ended = thread::Builder::new().name("rhumb-edge-close".into());
    if let Err(cause) = ended.spawn(move || drop(connection)) {
        tracing::warn!(%cause, "a connection to the owner was closed on the edge's own thread");
    }
}

impl Endpoint for EdgeDriver {
    fn handle_opened(&mut self, now: Instant, peer: Peer) {
        self.heartbeat.beat();
        self.connections += 1;
        self.metrics.count_opened();
        self.metrics.set_connections(self.connections);
        self.edge.handle_opened(now, peer);
        let side = self.sharing.as_ref().map(|sharing| sharing.side);
        if side == Some(FanOutSide::Publishes) {
            self.edge.share(peer);
        }
    }

    fn handle_control(&mut self, now: Instant, from: Peer, bytes: &[u8]) {
        self.heartbeat.beat();
        self.edge.handle_control(now, from, bytes);
    }

    fn handle_control_taken(&mut self, now: Instant, peer: Peer, bytes: usize) {
        self.edge.handle_control_taken(now, peer, bytes);
    }

    fn wants_control(&self, from: Peer) -> bool {
        self.edge.wants_control(from)
    }

    fn handle_datagram(&mut self, now: Instant, from: Peer, bytes: &[u8]) {
        self.heartbeat.beat();
        self.edge.handle_datagram(now, from, bytes);
    }

    fn handle_link(&mut self, now: Instant, peer: Peer, report: &LinkReport) {
        self.edge.handle_link(now, peer, report);
    }

    fn handle_ended(&mut self, now: Instant, peer: Peer, ending: Ending) {
        self.connections -= 1;
        self.metrics.set_connections(self.connections);
        self.edge.handle_ended(now, peer, ending);
    }

    fn handle_timeout(&mut self, now: Instant) {
        self.heartbeat.beat();
        self.receive(now);
        self.edge.handle_timeout(now);
    }

    fn poll_transmit(&mut self) -> Option<Transmit> {
        let transmit = self.edge.poll_transmit();
        match &transmit {
            Some(Transmit::Close { code, .. }) => self.metrics.count_closed(*code),
            Some(_) => {}
            None => self.send(),
        }
        transmit
    }

    fn poll_timeout(&self) -> Option<Wake> {
        self.heartbeat.rest();
        if self.news.any.load(Ordering::Acquire) {
            let (at, reason) = (Instant::ZERO, WakeReason::Input);
            return Some(Wake { at, reason });
        }
        self.edge.poll_timeout()
    }
}
