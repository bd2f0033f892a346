//! `rhumb-server edge`: serves members of scenes that another server steps.
//!
//! Opens the server of its members, and drives the edge until it is stopped. Steps nothing, and keeps nothing on disk.
//!
//! The server's loop calls the driver as its endpoint. A connection to an owner is opened on a thread of its own, and wakes
//! the loop when something has come. Invariant: what came over a connection is handed on in its order, and nothing after its
//! end; a connection that the edge has given up while it was opened is closed.
//!
//! A fan-out carries the packets of streams from one edge to many. The edge that publishes is the owner of those that follow.
//! Connections between them carry all but the packets, which the fan-out may drop, repeat and disorder (PROTOCOL 14-1). A
//! program brings the fan-out; this file sends nothing by itself.

use std::collections::{BTreeMap, BTreeSet};
use std::error::Error;
use std::net::{SocketAddr, ToSocketAddrs};
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::mpsc::{self, Receiver, Sender};
use std::time::Duration;
use std::{io, thread};

use clap::Args;
use rhumb_edge::{Dial, Edge, EdgeSettings, SharedPacket, SharedStream};
use rhumb_protocol::message::{Role, Token};
use rhumb_protocol::{
    Ending, Endpoint, Instant, LinkReport, Peer, Span, Transmit, Wake, WakeReason,
};
use rhumb_scene::{Heartbeat, Limits, Permit, ServerLoad};
use rhumb_transport::{
    ClientOptions, ClientTransport, Clock, Fingerprint, IdleLimit, Origins, PageOrigin, QuicClient,
    QuicServer, Received, ServerOptions, Stop, Trust, Waker, WebOptions,
};
use tracing::level_filters::LevelFilter;

use crate::http::{self, TcpService};
use crate::metrics::Metrics;
use crate::serve::{Identity, RunError, bind_metrics, seconds_since_1970};
use crate::start::{kind_of, write_lines};
use crate::{access, log, signals};

/// The owner of the scenes, and the members of the edge.
#[derive(Debug, Args)]
pub struct EdgeArguments {
    /// The server of the scenes.
    #[arg(long, value_name = "HOST:PORT")]
    owner: String,
    /// Fingerprint of the owner's certificate, as the owner prints it.
    #[arg(
        long,
        value_name = "HEX",
        conflicts_with = "roots",
        required_unless_present = "roots"
    )]
    fingerprint: Option<Fingerprint>,
    /// PEM file with roots that sign the owner's certificate, in place of its fingerprint.
    #[arg(long, value_name = "FILE")]
    roots: Option<PathBuf>,
    /// File with the token that the edge shows for itself, where the owner asks for tokens; an observer's suffices.
    #[arg(long, value_name = "FILE")]
    token: Option<PathBuf>,
    /// UDP address for members; port 0 picks a free one.
    #[arg(long, default_value = "127.0.0.1:4434")]
    listen: SocketAddr,
    /// PEM file with the certificate chain; without it a development certificate is made at start.
    #[arg(long, requires = "key")]
    cert: Option<PathBuf>,
    /// PEM file with the certificate's private key.
    #[arg(long, requires = "cert")]
    key: Option<PathBuf>,
    /// Every member is an observer without a token, and is served by the edge alone.
    #[arg(long)]
    observers: bool,
    /// Lets members without a token come from other machines too: those of an owner without tokens, and those of --observers
    /// and --metrics.
    #[arg(long)]
    open_to_network: bool,
    /// Origin of a web page that may connect, as https://host:port, or * for all; may be repeated. Pages of this machine
    /// may always.
    #[arg(long, value_name = "ORIGIN", conflicts_with = "no_web")]
    web_origin: Vec<PageOrigin>,
    /// Serves no browsers.
    #[arg(long)]
    no_web: bool,
    /// TCP address for metrics (/metrics) and health (/health).
    #[arg(long, value_name = "ADDRESS")]
    metrics: Option<SocketAddr>,
    /// Log level: off, error, warn, info, debug or trace.
    #[arg(long, default_value = "info")]
    log: LevelFilter,
}

impl EdgeArguments {
    fn owner(&self) -> Result<OwnerServer, Box<dyn Error>> {
        let trust = match (self.fingerprint, &self.roots) {
            (Some(fingerprint), _) => Trust::Fingerprint(fingerprint),
            (None, Some(roots)) => Trust::Roots(roots.clone()),
            (None, None) => return Err("give --fingerprint or --roots of the owner".into()),
        };
        let address = self.owner.clone();
        Ok(OwnerServer { address, trust })
    }

    fn token(&self) -> Result<Option<Token>, Box<dyn Error>> {
        let Some(path) = &self.token else {
            return Ok(None);
        };
        let failed = |cause: &dyn Error| format!("{}: {cause}", path.display());
        let text = std::fs::read_to_string(path).map_err(|cause| failed(&cause))?;
        let token = text.trim().parse::<Token>();
        Ok(Some(token.map_err(|cause| failed(&cause))?))
    }

    fn identity(&self) -> Identity {
        match (self.cert.clone(), self.key.clone()) {
            (Some(certificate), Some(key)) => Identity::Files { certificate, key },
            _ => Identity::Development,
        }
    }

    /// Refuses what would let other machines in without a token, unless the operator says so.
    fn check_open(&self) -> Result<(), RunError> {
        let listeners = [
            ("--observers", Some(self.listen).filter(|_| self.observers)),
            ("--metrics", self.metrics),
        ];
        let open = listeners.into_iter().find_map(|(flag, address)| {
            let address = address.filter(|address| !address.ip().is_loopback())?;
            Some(RunError::OpenToNetwork { address, flag })
        });
        match open {
            Some(refusal) if !self.open_to_network => Err(refusal),
            _ => Ok(()),
        }
    }

    fn settings(&self) -> Result<EdgeSettings, Box<dyn Error>> {
        let role = match self.observers {
            true => Role::Observer,
            false => Role::Owner,
        };
        Ok(EdgeSettings {
            limits: Limits::default(),
            token: self.token()?,
            permit: Arc::new(Permit {
                role,
                ..Permit::OPEN
            }),
            asks_tokens: !self.open_to_network && !self.listen.ip().is_loopback(),
            token_life: |token| {
                let seconds = access::stated_seconds_left(token, seconds_since_1970())?;
                Some(Span::from_millis(seconds.saturating_mul(1_000)))
            },
        })
    }
}

/// Runs an edge until SIGINT or SIGTERM.
pub(crate) fn run(arguments: &EdgeArguments) -> Result<(), Box<dyn Error>> {
    run_with(arguments, |_| Ok(()))
}

/// Runs an edge at one end of a fan-out, until SIGINT or SIGTERM. `open` makes the fan-out, which delivers packets by its
/// argument.
///
/// # Errors
///
/// The reason why an edge cannot start, and the error of `open`.
pub fn run_shared_edge(
    arguments: &EdgeArguments,
    side: FanOutSide,
    open: impl FnOnce(Deliver) -> Result<Box<dyn FanOut>, Box<dyn Error>>,
) -> Result<(), Box<dyn Error>> {
    run_with(arguments, |driver| {
        let deliver = driver.deliver();
        let fan_out = open(deliver.clone())?;
        driver.share(Sharing::new(side, fan_out, deliver));
        Ok(())
    })
}

fn run_with(
    arguments: &EdgeArguments,
    prepare: impl FnOnce(&mut EdgeDriver) -> Result<(), Box<dyn Error>>,
) -> Result<(), Box<dyn Error>> {
    let (owner, settings) = (arguments.owner()?, arguments.settings()?);
    arguments.check_open()?;
    owner.resolve()?;
    let _last_lines = log::start(arguments.log, settings.limits.log_lines_per_second);
    let identity = arguments.identity();
    let web = (!arguments.no_web).then(|| WebOptions {
        origins: arguments.web_origin.iter().cloned().collect::<Origins>(),
        certificate: identity.web(),
    });
    let transport = QuicServer::bind(ServerOptions {
        listen: arguments.listen,
        certificate: identity.certificate()?,
        web,
        idle_limit: IdleLimit::Usual,
    })
    .map_err(RunError::Bind)?;
    let (metrics, clock) = (Metrics::default(), Clock::start());
    let heartbeat = Heartbeat::new(move || clock.now());
    metrics.set_dispatcher(heartbeat.clone(), ServerLoad::default(), &settings.limits);
    let answering = answer_metrics(arguments.metrics, metrics.clone())?;
    let (edge, waker) = (Edge::new(settings), transport.waker());
    let mut driver = EdgeDriver::new(edge, owner.clone(), waker, (metrics, heartbeat));
    prepare(&mut driver)?;
    announce(&transport, &identity, (&owner, answering.as_ref()));
    let stop = Stop::new();
    let running = signals::obey(&stop, None);
    let served = transport.run(&mut driver, &stop);
    drop(driver);
    running.store(false, Ordering::Relaxed);
    let statistics = served.map_err(RunError::Serve)?;
    tracing::info!(connections = statistics.opened, "stopped");
    Ok(())
}

fn answer_metrics(
    address: Option<SocketAddr>,
    metrics: Metrics,
) -> Result<Option<(SocketAddr, TcpService)>, RunError> {
    let Some(address) = address else {
        return Ok(None);
    };
    let (listener, local) = bind_metrics(address)?;
    let named = !local.ip().is_loopback();
    let answer = Arc::new(move |request: &_| metrics.answer(request, named));
    let started = http::start(listener, "rhumb-server-metrics", answer);
    Ok(Some((local, started.map_err(RunError::Thread)?)))
}

/// Prints the address and the fingerprint to pin, as a server does.
fn announce(
    transport: &QuicServer,
    identity: &Identity,
    (owner, answering): (&OwnerServer, Option<&(SocketAddr, TcpService)>),
) {
    let metrics = answering.map(|(at, _)| format!("metrics at http://{at}/metrics\n"));
    let hashes = transport.certificate_hashes().current();
    let hash = |hash: &Fingerprint| format!("certificate hash for browsers {hash}\n");
    let hashes: String = hashes.iter().map(hash).collect();
    write_lines(&format!(
        "rhumb-server {} edge of {}\nlistening on {}\ncertificate {}\nfingerprint {}\n{}{hashes}",
        env!("CARGO_PKG_VERSION"),
        owner.address,
        transport.local_addr(),
        kind_of(identity),
        transport.fingerprint(),
        metrics.unwrap_or_default(),
    ));
}

/// Time to open a connection.
const DIAL: Duration = Duration::from_secs(2);
/// Connections that are opened at the same time, each by a thread; what the edge wants beyond them waits. Members that
/// come and go at once would otherwise make threads without bound.
const DIALS_MAX: usize = 64;
/// Received pieces of one connection before the others have their turn.
const PIECES_PER_TURN: usize = 1_024;

/// The server of the scenes.
#[derive(Clone, Debug)]
struct OwnerServer {
    /// `host:port`.
    address: String,
    trust: Trust,
}

impl OwnerServer {
    /// Its addresses now.
    ///
    /// # Errors
    ///
    /// The name leads nowhere, or is none.
    fn resolve(&self) -> Result<ClientOptions, String> {
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
struct EdgeDriver {
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
    fn new(
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
    fn deliver(&self) -> Deliver {
        let news = self.news.clone();
        Deliver::new(move |packet| news.tell(OwnerNews::Shared(packet)))
    }

    /// Packets come, or go, by a fan-out from now on.
    fn share(&mut self, sharing: Sharing) {
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

/// Packets of a fan-out that wait for the edge; beyond them the newest are dropped, as a network drops them. Derived: 4
/// MiB of packets of the usual size.
const WAITING_MAX: usize = 4_096;

/// A carrier of packets.
pub trait FanOut: Send {
    /// Hands a packet to all that follow its stream. Does not wait; what cannot be sent now is dropped.
    fn publish(&mut self, packet: SharedPacket);

    /// Delivers the packets of these streams from now on, and of no others.
    fn follow(&mut self, streams: &BTreeSet<SharedStream>);
}

/// The end of a fan-out at which an edge is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FanOutSide {
    /// Its members are edges, which receive packets by the fan-out alone.
    Publishes,
    /// Its owner is an edge that publishes.
    Follows,
}

/// The way of packets to the edge, from any thread.
#[derive(Clone)]
pub struct Deliver {
    waiting: Arc<AtomicUsize>,
    to: Arc<dyn Fn(SharedPacket) + Send + Sync>,
}

impl Deliver {
    fn new(to: impl Fn(SharedPacket) + Send + Sync + 'static) -> Self {
        let (waiting, to) = (Arc::default(), Arc::new(to));
        Self { waiting, to }
    }

    /// A packet has come.
    pub fn packet(&self, packet: SharedPacket) {
        if self.waiting.fetch_add(1, Ordering::AcqRel) < WAITING_MAX {
            return (self.to)(packet);
        }
        self.taken();
    }

    /// The edge has taken one.
    fn taken(&self) {
        self.waiting.fetch_sub(1, Ordering::AcqRel);
    }
}

/// An edge's end of a fan-out.
struct Sharing {
    side: FanOutSide,
    fan_out: Box<dyn FanOut>,
    deliver: Deliver,
    followed: BTreeSet<SharedStream>,
}

impl Sharing {
    fn new(side: FanOutSide, fan_out: Box<dyn FanOut>, deliver: Deliver) -> Self {
        Self {
            side,
            fan_out,
            deliver,
            followed: BTreeSet::new(),
        }
    }

    /// Publishes what an edge has for it.
    fn publish(&mut self, edge: &mut Edge) {
        while let Some(packet) = edge.poll_shared() {
            self.fan_out.publish(packet);
        }
    }

    /// Follows the streams that an edge needs now.
    fn follow(&mut self, edge: &Edge) {
        let needed: BTreeSet<_> = edge.streams().collect();
        if self.side == FanOutSide::Follows && needed != self.followed {
            self.fan_out.follow(&needed);
            self.followed = needed;
        }
    }

    /// The edge takes a packet.
    fn taken(&self) {
        self.deliver.taken();
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Mutex;

    use rhumb_protocol::packet::StreamId;

    use super::*;

    #[test]
    fn packets_that_an_edge_does_not_take_are_dropped() {
        let taken = Arc::new(Mutex::new(Vec::new()));
        let came = Arc::clone(&taken);
        let deliver = Deliver::new(move |packet| came.lock().expect("unpoisoned").push(packet));
        let packet = |number: u32| SharedPacket {
            of: SharedStream {
                scene: "stage".parse().expect("a valid name"),
                stream: StreamId(1),
            },
            bytes: number.to_be_bytes().to_vec().into(),
        };
        for number in 0..10_000 {
            deliver.packet(packet(number));
        }
        assert_eq!(taken.lock().expect("unpoisoned").len(), WAITING_MAX);
        deliver.taken();
        deliver.packet(packet(10_000));
        assert_eq!(
            taken.lock().expect("unpoisoned").last(),
            Some(&packet(10_000))
        );
    }
}
