//! A server in this process, and its clients' connections, without sockets.
//!
//! A call of a client steps the server, or a thread of its own does. The server side neither waits nor sleeps. A panic of
//! the server ends its connections, and never reaches a caller. A client's inputs arrive by a call or a queue. A server
//! with a driver of its own, such as one with sockets, has such clients beside its others.
//! Each client counts its own bytes until the server has used them, so that one that floods takes nothing from the others.

mod peers;

use std::collections::BTreeMap;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::sync::{Arc, Mutex};
use std::time::Duration;
use std::{io, thread};

use bytes::Bytes;
use rhumb_link::{
    ClientTransport, Clock, HeldBack, Inbox, Received, TransportCode, WireStatistics,
};
use rhumb_protocol::{Ending, Endpoint, Instant, LinkReport, Peer, Span, Transmit};
use rhumb_scene::{Checkpoint, CheckpointError, Feeds, SceneName, SceneRouter, SceneSettings};

use crate::client::Client;
use crate::server_connection::ServerConnection;

pub use self::peers::{LocalPeers, WithLocalPeers, is_local_peer};

/// Inputs that the server's thread handles before outputs and ticks get their turn.
const INPUTS_PER_TURN: usize = 256;
/// Time after which the ticks are handled before any further input.
const INPUTS_TIME: Span = Span::from_millis(1);
/// Stack of the server's thread: what a main thread has.
const STACK_BYTES: usize = 8 << 20;

/// A physics server in this process.
///
/// [`connect`](Self::connect) stands where [`Client::connect`](crate::Client) stands otherwise. Every later call is the
/// same, so that a simulator begins with its physics in its own process, and moves it to another machine by one line. The
/// packets are those of the network.
///
/// | server | a lockstep frame | a pipelined frame | a free-running scene |
/// |---|---|---|---|
/// | [`LocalServer::new`] | no thread is woken | the caller steps | steps within calls of its clients |
/// | [`LocalServer::spawn`] | two threads are woken | steps beside the caller | steps at its own rate |
///
/// Clones are one server. It ends with the last of them and of its clients.
#[derive(Clone)]
pub struct LocalServer {
    host: Host,
    next_peer: Arc<AtomicU64>,
    /// `None` where another driver runs the scenes.
    feeds: Option<Feeds>,
}

impl LocalServer {
    /// A server that steps on the thread of the client that calls it, with the default limits.
    #[must_use]
    pub fn new() -> Self {
        Self::of(scenes())
    }

    /// A server that steps on a thread of its own, with the default limits.
    ///
    /// # Errors
    ///
    /// The system's, if the thread cannot start.
    pub fn spawn() -> io::Result<Self> {
        Self::spawn_of(scenes())
    }

    /// As [`Self::new`], with hooks, limits and threads of the engine as these scenes have them.
    #[must_use]
    pub fn of(scenes: SceneRouter) -> Self {
        let feeds = scenes.feeds();
        let driver = Driver::new(scenes, Clock::start());
        Self::at(Host::Caller(Arc::new(Mutex::new(driver))), feeds)
    }

    /// As [`Self::spawn`], with hooks, limits and threads of the engine as these scenes have them.
    ///
    /// # Errors
    ///
    /// The system's, if the thread cannot start.
    pub fn spawn_of(scenes: SceneRouter) -> io::Result<Self> {
        let (sender, inputs) = channel();
        let feeds = scenes.feeds();
        let mut driver = Driver::new(scenes, Clock::start());
        thread::Builder::new()
            .name("rhumb-local-server".to_owned())
            .stack_size(STACK_BYTES)
            .spawn(move || run(&mut driver, &inputs))?;
        Ok(Self::at(Host::Thread(InputQueue::new(sender)), feeds))
    }

    /// Connects a client. The connection waits for no socket and cannot fail.
    #[must_use]
    pub fn connect(&self) -> ServerConnection {
        let peer = Peer(self.next_peer.fetch_add(1, Ordering::Relaxed));
        ServerConnection::over(LocalConnection::open(self.host.clone(), peer, None))
    }

    /// A connection that the caller carries for another program, such as a browser. The server treats it as one more
    /// client. `arrived` is called whenever something may be received, on the thread that steps the server.
    #[must_use]
    pub fn open(&self, arrived: impl Fn() + Send + Sync + 'static) -> Box<dyn ClientTransport> {
        let peer = Peer(self.next_peer.fetch_add(1, Ordering::Relaxed));
        let arrived = Arrived(Box::new(arrived));
        Box::new(LocalConnection::open(
            self.host.clone(),
            peer,
            Some(arrived),
        ))
    }

    /// The whole state of a scene: bodies, joints, sleep, contacts, and the engine's own memory of them.
    ///
    /// It has everything that the server has read. [`Client::inspect`] waits until that is all which a client sent.
    ///
    /// # Errors
    ///
    /// [`CheckpointError`] for a name that no scene has, and for a scene or a server that cannot be saved: those of
    /// [`Self::beside`] cannot.
    pub fn save(&self, scene: &str) -> Result<Checkpoint, CheckpointError> {
        let name = name(scene)?;
        self.host.call(move |scenes, _| scenes.save(&name))
    }

    /// Makes a scene that continues from a checkpoint, to be joined by its name.
    ///
    /// Given the same commands before the same ticks, it runs to the same bits as the scene that was saved, here and on
    /// another machine. Bodies keep their ids. It has no members at first: a server ends it if no client joins for ten
    /// minutes.
    ///
    /// # Errors
    ///
    /// [`CheckpointError`] for a name that a scene has already, for limits of the server, and as
    /// [`Checkpoint::scene`].
    ///
    /// # Example
    ///
    /// ```
    /// use rhumb_client::scene::{BodyDesc, Shape};
    /// use rhumb_client::{LocalServer, PipelineDepth};
    ///
    /// # fn main() -> Result<(), rhumb_client::MainError> {
    /// let server = LocalServer::new();
    /// let mut client = server.connect().join("drop")?;
    /// client.add_body(BodyDesc::dynamic(Shape::ball(0.5)).at(0.0, 10.0, 0.0))?;
    /// client.advance(PipelineDepth::LOCKSTEP)?;
    /// server.restore("another-drop", &server.save("drop")?)?;
    /// let mut other = server.connect().join("another-drop")?;
    /// other.advance(PipelineDepth::LOCKSTEP)?;
    /// client.advance(PipelineDepth::LOCKSTEP)?;
    /// assert_eq!(client.inspect()?.truth, other.inspect()?.truth);
    /// # Ok(())
    /// # }
    /// ```
    pub fn restore(&self, scene: &str, checkpoint: &Checkpoint) -> Result<(), CheckpointError> {
        let (name, checkpoint) = (name(scene)?, checkpoint.clone());
        self.host
            .call(move |scenes, now| scenes.restore(now, &name, &checkpoint))
    }

    fn at(host: Host, feeds: Feeds) -> Self {
        Self {
            host,
            next_peer: Arc::default(),
            feeds: Some(feeds),
        }
    }
}

fn name(scene: &str) -> Result<SceneName, CheckpointError> {
    scene.parse().map_err(|cause| CheckpointError::SceneName {
        scene: scene.to_owned(),
        cause,
    })
}

impl Client {
    /// Connects to a server of this client's own, which steps on the thread of the client's calls.
    ///
    /// # Example
    ///
    /// ```
    /// use rhumb_client::scene::{BodyDesc, Shape};
    /// use rhumb_client::{Client, PipelineDepth};
    ///
    /// # fn main() -> Result<(), rhumb_client::MainError> {
    /// let mut client = Client::local().join("drop")?;
    /// client.add_body(BodyDesc::fixed(Shape::cuboid(10.0, 0.5, 10.0)).at(0.0, -0.5, 0.0))?;
    /// let ball = client.add_body(BodyDesc::dynamic(Shape::ball(0.5)).at(0.0, 10.0, 0.0))?;
    /// for _ in 0..180 {
    ///     client.advance(PipelineDepth::LOCKSTEP)?;
    /// }
    /// let height = client.view().position(ball).ok_or("the ball is gone")?.y;
    /// assert!((height - 0.5).abs() < 0.1, "{height}");
    /// # Ok(())
    /// # }
    /// ```
    #[must_use]
    pub fn local() -> ServerConnection {
        LocalServer::new().connect()
    }
}

impl Default for LocalServer {
    fn default() -> Self {
        Self::new()
    }
}

fn scenes() -> SceneRouter {
    let stopwatch = Clock::start();
    SceneRouter::new(SceneSettings::new(move || stopwatch.now()))
}

/// Runs a server until its last client is gone.
fn run(driver: &mut Driver<SceneRouter>, inputs: &Receiver<Queued>) {
    loop {
        let first = match driver.run() {
            None => inputs.recv().map_err(|_| RecvTimeoutError::Disconnected),
            Some(left) => inputs.recv_timeout(left),
        };
        match first {
            Ok(first) => {
                let until = driver.clock.now() + INPUTS_TIME;
                first.handle(driver);
                for message in inputs.try_iter().take(INPUTS_PER_TURN) {
                    message.handle(driver);
                    if driver.clock.now() > until {
                        break;
                    }
                }
            }
            Err(RecvTimeoutError::Timeout) => {}
            Err(RecvTimeoutError::Disconnected) => return,
        }
    }
}

/// Longest sleep of a client whose server runs on the threads of its clients: another client's call may have brought
/// the server's next moment forward.
const NAP: Duration = Duration::from_millis(5);

/// An open connection of a client to a server in this process.
struct LocalConnection {
    host: Host,
    peer: Peer,
    inbox: Arc<Inbox>,
    clock: Clock,
    /// Control bytes that the server has not used yet.
    waiting_control: Arc<AtomicUsize>,
    /// Bytes of datagrams that it has not taken yet.
    waiting_state: Arc<AtomicUsize>,
    sent: LocalTraffic,
    received: LocalTraffic,
    /// Control bytes that wait in the inbox.
    inbox_bytes: Arc<InboxBytes>,
}

/// Bytes and pieces, without headers: there are none.
#[derive(Default)]
struct LocalTraffic {
    bytes: AtomicU64,
    pieces: AtomicU64,
}

impl LocalConnection {
    fn open(host: Host, peer: Peer, arrived: Option<Arrived>) -> Self {
        let connection = Self {
            host,
            peer,
            inbox: Arc::default(),
            clock: Clock::start(),
            waiting_control: Arc::default(),
            waiting_state: Arc::default(),
            sent: LocalTraffic::default(),
            received: LocalTraffic::default(),
            inbox_bytes: Arc::default(),
        };
        let inbox = Arc::clone(&connection.inbox);
        let bytes = Arc::clone(&connection.inbox_bytes);
        let client = LocalClient::new(inbox, bytes, arrived);
        connection.send(LocalInput::Opened(client));
        connection
    }

    /// Hands an input to the server; without one, the connection has ended.
    fn send(&self, input: LocalInput) {
        if self.host.send(self.peer, input).is_err() {
            self.inbox.put_end(Ending::Broken);
        }
    }

    /// Runs a server on this thread as far as is due; returns how long a wait may last.
    fn run_server(&self) -> Duration {
        let Host::Caller(driver) = &self.host else {
            return Duration::MAX;
        };
        match driver.lock() {
            Ok(mut driver) => driver.run().map_or(NAP, |left| left.min(NAP)),
            Err(_) => {
                self.inbox.put_end(Ending::Broken);
                Duration::ZERO
            }
        }
    }
}

impl ClientTransport for LocalConnection {
    fn send_control(&self, bytes: Bytes) {
        self.sent.add(bytes.len());
        if let Some(counted) = CountedBytes::within(WAITING_BYTES_MAX, &self.waiting_control, bytes)
        {
            return self.send(LocalInput::Control(counted));
        }
        let code = TransportCode::CONTROL_OVERFLOW.0;
        self.send(LocalInput::Closed(code));
        self.inbox.put_end(Ending::Closed(code));
    }

    fn send_state(&self, bytes: Bytes) {
        self.sent.add(bytes.len());
        // As on a network, a datagram that cannot be kept is lost.
        let counted = CountedBytes::within(WAITING_STATE_BYTES_MAX, &self.waiting_state, bytes);
        if let Some(counted) = counted {
            self.send(LocalInput::State(counted));
        }
    }

    fn wants_control(&self) -> bool {
        self.waiting_control.load(Ordering::Relaxed) < CARRIED_BYTES_MAX
    }

    fn report_link(&self, report: &LinkReport) {
        self.send(LocalInput::Link(*report));
    }

    fn close(&self, code: u32) {
        self.send(LocalInput::Closed(code));
    }

    fn recv(&mut self, timeout: Duration) -> Option<Received> {
        let timeout = Span::from_nanos(u64::try_from(timeout.as_nanos()).unwrap_or(u64::MAX));
        let until = self.clock.now() + timeout;
        let received = loop {
            let pause = self.run_server();
            let left = self.clock.until(until);
            match self.inbox.take(pause.min(left)) {
                Some(received) => break received,
                None if left.is_zero() || self.inbox.has_ended() => return None,
                None => {}
            }
        };
        match &received {
            Received::Control(bytes) => {
                self.received.add(bytes.len());
                let news = self.inbox_bytes.take(bytes.len());
                if news > 0 {
                    self.send(LocalInput::Taken(news));
                }
            }
            Received::State(bytes) => self.received.add(bytes.len()),
            Received::Ended(_) => {}
        }
        Some(received)
    }

    fn statistics(&self) -> WireStatistics {
        WireStatistics {
            sent_bytes: self.sent.bytes.load(Ordering::Relaxed),
            sent_datagrams: self.sent.pieces.load(Ordering::Relaxed),
            received_bytes: self.received.bytes.load(Ordering::Relaxed),
            received_datagrams: self.received.pieces.load(Ordering::Relaxed),
            ..WireStatistics::default()
        }
    }
}

impl Drop for LocalConnection {
    fn drop(&mut self) {
        self.inbox.abandon();
        // A server that is gone needs no word of it.
        let _ = (self.host).send(self.peer, LocalInput::Closed(TransportCode::LEFT.0));
    }
}

impl LocalTraffic {
    fn add(&self, bytes: usize) {
        self.bytes.fetch_add(bytes as u64, Ordering::Relaxed);
        self.pieces.fetch_add(1, Ordering::Relaxed);
    }
}

/// Called when something may be received.
struct Arrived(Box<dyn Fn() + Send + Sync>);

/// One input of a client.
enum LocalInput {
    Opened(LocalClient),
    Control(CountedBytes),
    /// The client has taken this number of control bytes out of its inbox that the server does not know of.
    Taken(usize),
    State(CountedBytes),
    /// The state of the link that carries the client.
    Link(LinkReport),
    /// The client has closed its connection, with this code.
    Closed(u32),
}

/// A server, and the inboxes of its clients.
struct Driver<E> {
    server: E,
    clock: Clock,
    clients: BTreeMap<Peer, LocalClient>,
    held_back: HeldBack<CountedBytes>,
    /// True after a panic: the server is in an unknown state, and is not called again.
    broken: bool,
}

/// The inbox of a client, and its control bytes.
struct LocalClient {
    inbox: Arc<Inbox>,
    /// Of a client that another program carries.
    arrived: Option<Arrived>,
    bytes: Arc<InboxBytes>,
}

/// Control bytes that wait in an inbox. Both ends count, so that the server is woken only for what it has to know.
#[derive(Default)]
struct InboxBytes {
    waiting: AtomicUsize,
    /// The inputs that do not count as taken.
    unreported: AtomicUsize,
}

/// Control bytes that count as taken while they wait in an inbox. A client that is not polled for minutes stays, as one
/// behind a socket does, whose thread reads for it.
const TAKEN_BYTES_MAX: usize = 1 << 20;

impl InboxBytes {
    /// Notes bytes before they are put; returns how many count as taken.
    fn put(&self, bytes: usize) -> usize {
        let waiting = self.waiting.fetch_add(bytes, Ordering::Relaxed) + bytes;
        if waiting > TAKEN_BYTES_MAX {
            self.unreported.fetch_add(bytes, Ordering::Relaxed);
            return 0;
        }
        bytes
    }

    /// Notes bytes that the client has taken; returns how many the server does not know of.
    fn take(&self, bytes: usize) -> usize {
        self.waiting.fetch_sub(bytes, Ordering::Relaxed);
        // Only the client takes, so that what it sees here is still there.
        let news = bytes.min(self.unreported.load(Ordering::Relaxed));
        self.unreported.fetch_sub(news, Ordering::Relaxed);
        news
    }
}

impl LocalClient {
    const fn new(inbox: Arc<Inbox>, bytes: Arc<InboxBytes>, arrived: Option<Arrived>) -> Self {
        Self {
            inbox,
            arrived,
            bytes,
        }
    }

    fn end(&self, ending: Ending) {
        self.inbox.put_end(ending);
        self.tell();
    }

    fn tell(&self) {
        if let Some(arrived) = &self.arrived {
            (arrived.0)();
        }
    }

    /// Puts control bytes into the inbox; returns how many count as taken.
    fn put(&self, bytes: &Bytes) -> usize {
        // The inbox's lock orders the count before the client's.
        let taken = self.bytes.put(bytes.len());
        self.inbox.put_bounded_control(bytes);
        self.tell();
        taken
    }
}

impl<E> Driver<E> {
    fn new(server: E, clock: Clock) -> Self {
        Self {
            server,
            clock,
            clients: BTreeMap::new(),
            held_back: HeldBack::default(),
            broken: false,
        }
    }

    /// Ends every connection.
    fn end(&mut self, ending: Ending) {
        for client in std::mem::take(&mut self.clients).into_values() {
            client.end(ending);
        }
    }
}

impl Driver<SceneRouter> {
    /// Hands an input to the server. Its transmissions wait for [`Self::run`].
    fn handle(&mut self, from: Peer, input: LocalInput) {
        if self.broken
            && let LocalInput::Opened(client) = &input
        {
            client.end(Ending::Broken);
        }
        self.guard(|driver| driver.take(from, input));
    }

    /// Runs all due work, and delivers the transmissions of the server. Returns the time until the next timeout, if the
    /// server has one.
    fn run(&mut self) -> Option<Duration> {
        self.guard(Self::turn).flatten()
    }

    /// Calls the server, unless it has panicked, in this call or before.
    fn guard<T>(&mut self, call: impl FnOnce(&mut Self) -> T) -> Option<T> {
        if self.broken {
            return None;
        }
        let called = catch_unwind(AssertUnwindSafe(|| call(self)));
        if called.is_err() {
            tracing::error!("the server in this process panicked");
            self.broken = true;
            self.end(Ending::Broken);
        }
        called.ok()
    }

    fn turn(&mut self) -> Option<Duration> {
        let now = self.clock.now();
        if self
            .server
            .poll_timeout()
            .is_some_and(|wake| wake.at <= now)
        {
            self.server.handle_timeout(now);
        }
        self.transmit();
        while self.held_back.deliver(now, &mut self.server) {
            self.transmit();
        }
        let wake = self.server.poll_timeout()?;
        Some(self.clock.until(wake.at))
    }
}

impl<E: Endpoint> Driver<E> {
    fn take(&mut self, from: Peer, input: LocalInput) {
        let now = self.clock.now();
        match input {
            LocalInput::Opened(client) => {
                self.clients.insert(from, client);
                self.server.handle_opened(now, from);
                self.server.handle_control_taken(now, from, 0);
            }
            LocalInput::Control(bytes) => {
                (self.held_back).handle_control(now, &mut self.server, from, bytes);
            }
            LocalInput::Taken(bytes) => {
                if self.clients.contains_key(&from) {
                    self.server.handle_control_taken(now, from, bytes);
                }
            }
            LocalInput::State(bytes) => self.server.handle_datagram(now, from, bytes.as_ref()),
            LocalInput::Link(report) => self.server.handle_link(now, from, &report),
            LocalInput::Closed(code) => {
                if let Some(client) = self.clients.remove(&from) {
                    (self.held_back).deliver_rest(now, &mut self.server, from);
                    client.end(Ending::Closed(code));
                    self.server.handle_ended(now, from, Ending::Closed(code));
                }
            }
        }
    }

    fn transmit(&mut self) {
        while let Some(transmit) = self.server.poll_transmit() {
            self.send(transmit);
        }
    }

    /// Puts a transmission into the inbox of its client.
    fn send(&mut self, transmit: Transmit) {
        match transmit {
            Transmit::Control { to, bytes } => {
                let taken = self.clients.get(&to).map(|client| client.put(&bytes));
                if let Some(taken) = taken.filter(|taken| *taken > 0) {
                    let now = self.clock.now();
                    self.server.handle_control_taken(now, to, taken);
                }
            }
            Transmit::State { to, bytes } => {
                if let Some(client) = self.clients.get(&to) {
                    client.inbox.put_state(&bytes);
                    client.tell();
                }
            }
            Transmit::Close { to, code } => {
                let now = self.clock.now();
                if let Some(client) = self.clients.remove(&to) {
                    self.held_back.forget(to);
                    let ending = Ending::Closed(code);
                    client.end(ending);
                    self.server.handle_ended(now, to, ending);
                }
            }
        }
    }
}

/// Control bytes of one client that may wait for the server.
const WAITING_BYTES_MAX: usize = 64 << 20;
/// Bytes of datagrams of one client that may wait for the server.
const WAITING_STATE_BYTES_MAX: usize = 4 << 20;
/// Control bytes that may wait before the program that carries a connection holds more back.
const CARRIED_BYTES_MAX: usize = 256 << 10;

/// The thread on which a server runs.
#[derive(Clone)]
enum Host {
    /// The thread of each client's call.
    Caller(Arc<Mutex<Driver<SceneRouter>>>),
    /// One of its own.
    Thread(InputQueue),
}

/// Inputs that wait for the server's thread. Each client counts its own bytes among them.
#[derive(Clone)]
struct InputQueue {
    sender: Sender<Queued>,
    /// Called after each input, where no thread waits for them.
    wake: Option<Arc<dyn Fn() + Send + Sync>>,
}

/// An entry of the queue to the server's thread.
enum Queued {
    Input(QueuedInput),
    Call(ScenesCall),
}

/// A call of the scenes, which sends its own answer.
type ScenesCall = Box<dyn FnOnce(&mut SceneRouter, Instant) + Send>;

/// One waiting input.
struct QueuedInput {
    from: Peer,
    input: LocalInput,
}

/// An input could not be handed over: the server is gone.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct ServerGone;

impl Host {
    /// Hands over an input. A server on the caller's thread has handled it when this returns.
    fn send(&self, from: Peer, input: LocalInput) -> Result<(), ServerGone> {
        match self {
            Self::Caller(driver) => {
                // No panic leaves the driver.
                let mut driver = driver.lock().map_err(|_| ServerGone)?;
                driver.handle(from, input);
                Ok(())
            }
            Self::Thread(queue) => queue.send(from, input),
        }
    }

    /// Calls the scenes, after everything that was handed over before.
    fn call<T: Send + 'static>(
        &self,
        call: impl FnOnce(&mut SceneRouter, Instant) -> Result<T, CheckpointError> + Send + 'static,
    ) -> Result<T, CheckpointError> {
        match self {
            Self::Caller(driver) => {
                let mut driver = driver.lock().map_err(|_| CheckpointError::NoServer)?;
                let called = driver.guard(|driver| {
                    let now = driver.clock.now();
                    call(&mut driver.server, now)
                });
                called.unwrap_or(Err(CheckpointError::NoServer))
            }
            // The scenes of another driver are not known here.
            Self::Thread(InputQueue { wake: Some(_), .. }) => Err(CheckpointError::NoServer),
            Self::Thread(queue) => {
                let (sender, answer) = channel();
                let call: ScenesCall = Box::new(move |scenes, now| {
                    // A caller that panicked waits for no answer.
                    let _ = sender.send(call(scenes, now));
                });
                let sent = queue.sender.send(Queued::Call(call));
                sent.map_err(|_| CheckpointError::NoServer)?;
                answer.recv().unwrap_or(Err(CheckpointError::NoServer))
            }
        }
    }
}

impl InputQueue {
    const fn new(sender: Sender<Queued>) -> Self {
        Self { sender, wake: None }
    }

    fn send(&self, from: Peer, input: LocalInput) -> Result<(), ServerGone> {
        let message = Queued::Input(QueuedInput { from, input });
        self.sender.send(message).map_err(|_| ServerGone)?;
        if let Some(wake) = &self.wake {
            wake();
        }
        Ok(())
    }
}

impl Queued {
    fn handle(self, driver: &mut Driver<SceneRouter>) {
        match self {
            Self::Input(input) => driver.handle(input.from, input.input),
            Self::Call(call) => {
                driver.guard(|driver| {
                    let now = driver.clock.now();
                    call(&mut driver.server, now);
                });
            }
        }
    }
}

/// Cost of a waiting input beside its bytes.
const INPUT_COST_BYTES: usize = 64;

fn cost(bytes: &Bytes) -> usize {
    INPUT_COST_BYTES + bytes.len()
}

/// Bytes of a client that count until the server has used them, wherever they wait.
struct CountedBytes {
    bytes: Bytes,
    waiting: Arc<AtomicUsize>,
}

impl CountedBytes {
    /// Counts bytes; `None` if the client has more of them waiting than it may.
    pub(crate) fn within(most: usize, waiting: &Arc<AtomicUsize>, bytes: Bytes) -> Option<Self> {
        if waiting.load(Ordering::Relaxed) + cost(&bytes) > most {
            return None;
        }
        waiting.fetch_add(cost(&bytes), Ordering::Relaxed);
        let waiting = Arc::clone(waiting);
        Some(Self { bytes, waiting })
    }
}

impl AsRef<[u8]> for CountedBytes {
    fn as_ref(&self) -> &[u8] {
        &self.bytes
    }
}

impl Drop for CountedBytes {
    fn drop(&mut self) {
        self.waiting.fetch_sub(cost(&self.bytes), Ordering::Relaxed);
    }
}

#[cfg(test)]
mod tests;
