//! Loop of the server thread: inputs, timeouts, transmissions.
//!
//! Touches no socket: the I/O thread drives the connections. The loop sleeps whenever there is nothing to do; other
//! threads wake it. Inputs are bounded: each waiting piece holds a permit of its connection, returned when the piece
//! is handled. Each connection has a meter of its link's recent throughput: bytes handed over minus queued. The datagrams of
//! a drain go to the I/O thread together, so that a tick wakes it once however many members a scene has.
//!
//! Other threads see a running server by its counters, and stop it. Reading changes nothing. The sums keep a connection's
//! counts after its end. A stop may be requested from any thread, but not inside a signal handler, since it locks. A
//! request cannot be withdrawn.

use std::collections::{BTreeMap, BTreeSet};
use std::net::SocketAddr;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, TryRecvError};
use std::sync::{Arc, Mutex, MutexGuard};
use std::time::Duration;
use std::{fmt, thread};

use bytes::Bytes;
use quinn::{Connection, SendDatagramError};
use rhumb_link::connection::{Closing, ControlSender, wire_statistics};
use rhumb_link::tuning::{CLOSE_LEAVES, DATAGRAM_SEND_BYTES};
use rhumb_link::{Clock, HeldBack, Piece, WireStatistics};
use rhumb_protocol::session::TransportCode;
use rhumb_protocol::{Ending, Endpoint, Instant, LinkReport, Peer, Span, Transmit};
use tokio::sync::mpsc;
use tokio::sync::mpsc::error::TrySendError;

use crate::web_session::WebSession;

/// Reason why a server stopped by itself.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ServeError {
    /// The thread of the sockets failed; the log has the cause.
    IoThreadLost,
}

/// The server thread's view of the network.
#[derive(Debug)]
pub(crate) struct EndpointLoop {
    clock: Clock,
    inputs: Receiver<Input>,
    waker: Waker,
    peers: BTreeMap<Peer, OpenConnection>,
    /// Control bytes that the endpoint does not want yet: none of a peer that this end has closed. They keep their
    /// share of the bound, so that flow control slows their peers down.
    held_back: HeldBack<Piece>,
    /// Datagrams of the present drain: they leave after its control bytes, so that both can share a packet.
    states: Vec<StateDatagram>,
    batches: mpsc::Sender<Vec<StateDatagram>>,
    watch: ServerWatch,
}

#[derive(Debug)]
struct OpenConnection {
    handles: PeerHandles,
    connection_state: ConnectionState,
    link_meter: LinkMeter,
    /// Bytes of all datagrams handed over.
    handed_bytes: u64,
    /// Control bytes that the endpoint knows the connection to have taken.
    control_reported: u64,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum ConnectionState {
    Open,
    /// Closed by this end: only the connection's end is still awaited.
    Closing,
}

/// The loop's next action.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum LoopControl {
    Go,
    Stop,
}

/// Inputs handled before transmissions and timers get their turn.
const INPUTS_PER_TURN: usize = 256;

impl EndpointLoop {
    pub(crate) fn new(
        inputs: Receiver<Input>,
        waker: Waker,
        batches: mpsc::Sender<Vec<StateDatagram>>,
        watch: ServerWatch,
    ) -> Self {
        Self {
            clock: Clock::start(),
            inputs,
            waker,
            peers: BTreeMap::new(),
            held_back: HeldBack::default(),
            states: Vec::new(),
            batches,
            watch,
        }
    }

    /// Runs until stopped.
    pub(crate) fn run<E: Endpoint>(&mut self, endpoint: &mut E) -> Result<(), ServeError> {
        loop {
            self.report(endpoint);
            self.drain(endpoint);
            while self.held_back.deliver(self.clock.now(), endpoint) {
                self.drain(endpoint);
            }
            if self.wait(endpoint)? == LoopControl::Stop {
                return Ok(());
            }
            let now = self.clock.now();
            if endpoint.poll_timeout().is_some_and(|wake| wake.at <= now) {
                endpoint.handle_timeout(now);
            }
        }
    }

    /// Closes every connection and waits a little for the close frames to leave.
    pub(crate) fn close_all(&mut self) {
        for standing in self.peers.values() {
            standing.handles.closing.now(TransportCode::GOING_AWAY.0);
        }
        let has_left = |standing: &OpenConnection| standing.handles.closing.close_has_left();
        let mut remaining = CLOSE_LEAVES;
        while !self.peers.values().all(has_left) && !remaining.is_zero() {
            thread::sleep(STEP);
            remaining = remaining.saturating_sub(STEP);
        }
    }

    /// Waits for an input or the endpoint's next moment, and handles the input.
    fn wait<E: Endpoint>(&mut self, endpoint: &mut E) -> Result<LoopControl, ServeError> {
        let first = match endpoint.poll_timeout() {
            Some(wake) => match self.inputs.recv_timeout(self.clock.until(wake.at)) {
                Ok(input) => input,
                Err(RecvTimeoutError::Timeout) => return Ok(LoopControl::Go),
                Err(RecvTimeoutError::Disconnected) => return Err(ServeError::IoThreadLost),
            },
            None => self.inputs.recv().map_err(|_| ServeError::IoThreadLost)?,
        };
        let mut input = first;
        for _ in 0..INPUTS_PER_TURN {
            if self.handle(endpoint, input)? == LoopControl::Stop {
                return Ok(LoopControl::Stop);
            }
            input = match self.inputs.try_recv() {
                Ok(next) => next,
                Err(TryRecvError::Empty) => return Ok(LoopControl::Go),
                Err(TryRecvError::Disconnected) => return Err(ServeError::IoThreadLost),
            };
        }
        self.handle(endpoint, input)
    }

    fn handle<E: Endpoint>(
        &mut self,
        endpoint: &mut E,
        input: Input,
    ) -> Result<LoopControl, ServeError> {
        let now = self.clock.now();
        match input {
            Input::Opened { peer, handles } => {
                self.peers.insert(
                    peer,
                    OpenConnection {
                        handles,
                        connection_state: ConnectionState::Open,
                        link_meter: LinkMeter::new(now),
                        handed_bytes: 0,
                        control_reported: 0,
                    },
                );
                endpoint.handle_opened(now, peer);
                endpoint.handle_control_taken(now, peer, 0);
            }
            Input::Control { peer, piece } => {
                if self.is_open(peer) {
                    self.held_back.handle_control(now, endpoint, peer, piece);
                }
            }
            Input::ControlTaken { peer } => self.report_control(endpoint, peer),
            Input::Wake => self.waker.note_woken(),
            Input::State { peer, piece } => {
                if self.is_open(peer) {
                    endpoint.handle_datagram(now, peer, &piece.bytes);
                }
            }
            Input::Ended { peer, ending } => {
                self.peers.remove(&peer);
                self.held_back.deliver_rest(now, endpoint, peer);
                endpoint.handle_ended(now, peer, ending);
            }
            Input::Stop => return Ok(LoopControl::Stop),
            Input::IoOver => return Err(ServeError::IoThreadLost),
        }
        Ok(LoopControl::Go)
    }

    /// Tells the endpoint what a connection has taken of its control bytes.
    fn report_control<E: Endpoint>(&mut self, endpoint: &mut E, peer: Peer) {
        let now = self.clock.now();
        let Some(standing) = open(&mut self.peers, peer) else {
            return;
        };
        let taken = standing.handles.control.taken_bytes();
        let bytes = taken - standing.control_reported;
        standing.control_reported = taken;
        if bytes > 0 {
            endpoint.handle_control_taken(now, peer, bytes as usize);
        }
    }

    /// Reports the links of recently served connections to the endpoint.
    fn report<E: Endpoint>(&mut self, endpoint: &mut E) {
        let now = self.clock.now();
        for (peer, standing) in &mut self.peers {
            if standing.connection_state == ConnectionState::Closing
                || !standing.link_meter.is_due(now)
            {
                continue;
            }
            let connection = standing.handles.datagrams.connection();
            let free = connection.datagram_send_buffer_space();
            let waiting = DATAGRAM_SEND_BYTES.saturating_sub(free) as u64;
            let round_trip = u64::try_from(connection.rtt().as_nanos()).unwrap_or(u64::MAX);
            let handed = standing.handed_bytes;
            let report =
                (standing.link_meter).read(now, handed, waiting, Span::from_nanos(round_trip));
            endpoint.handle_link(now, *peer, &report);
        }
    }

    /// Sends the endpoint's transmissions until its links are full.
    fn drain<E: Endpoint>(&mut self, endpoint: &mut E) {
        while self.drain_once(endpoint) {}
    }

    /// Returns whether the endpoint may have more: it learned that a connection took much.
    fn drain_once<E: Endpoint>(&mut self, endpoint: &mut E) -> bool {
        let mut handed = BTreeSet::new();
        while let Some(transmit) = endpoint.poll_transmit() {
            match transmit {
                Transmit::Control { to, bytes } => {
                    self.send_control(to, bytes);
                    handed.insert(to);
                }
                Transmit::State { to, bytes } => self.queue_state(to, bytes),
                Transmit::Close { to, code } => {
                    self.send_states();
                    if let Some(standing) = open(&mut self.peers, to) {
                        standing
                            .handles
                            .control
                            .close(&standing.handles.closing, code);
                        standing.connection_state = ConnectionState::Closing;
                        self.held_back.forget(to);
                    }
                }
            }
        }
        self.send_states();
        let mut reported = false;
        for peer in handed {
            let Some(standing) = open(&mut self.peers, peer) else {
                continue;
            };
            // Reported each time that the queue empties: a rest that is never reported would look like a peer that does
            // not read.
            if standing.handles.control.is_empty_or_notify() {
                self.report_control(endpoint, peer);
                reported = true;
            }
        }
        reported
    }

    fn send_control(&mut self, to: Peer, bytes: Bytes) {
        let Some(standing) = open(&mut self.peers, to) else {
            return;
        };
        if standing.handles.control.send(bytes).is_err() {
            standing
                .handles
                .closing
                .now(TransportCode::CONTROL_OVERFLOW.0);
            standing.connection_state = ConnectionState::Closing;
            self.held_back.forget(to);
            self.watch.count(|counters| &counters.control_overflows);
            tracing::warn!(peer = to.0, "control lane too slow, closing");
        }
    }

    fn queue_state(&mut self, to: Peer, bytes: Bytes) {
        if let Some(standing) = open(&mut self.peers, to) {
            standing.handed_bytes += bytes.len() as u64;
            let lane = Arc::clone(&standing.handles.datagrams);
            self.states.push(StateDatagram { to, lane, bytes });
        }
    }

    /// Hands the datagrams to the I/O thread. If that is far behind, they go to their connections, which drop the oldest.
    fn send_states(&mut self) {
        if self.states.is_empty() {
            return;
        }
        let batch = std::mem::take(&mut self.states);
        let unsent = match self.batches.try_send(batch) {
            Ok(()) => return,
            Err(TrySendError::Full(batch) | TrySendError::Closed(batch)) => batch,
        };
        unsent.into_iter().for_each(|state| state.send(&self.watch));
    }

    fn is_open(&mut self, peer: Peer) -> bool {
        open(&mut self.peers, peer).is_some()
    }
}

/// The handles of a peer that this end has not closed.
fn open(peers: &mut BTreeMap<Peer, OpenConnection>, peer: Peer) -> Option<&mut OpenConnection> {
    peers
        .get_mut(&peer)
        .filter(|standing| standing.connection_state == ConnectionState::Open)
}

/// Interval of the checks whether the close frames have left.
const STEP: Duration = Duration::from_millis(1);

impl fmt::Display for ServeError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::IoThreadLost => f.write_str("the server's i/o thread failed; see its log"),
        }
    }
}

impl std::error::Error for ServeError {}

/// One input for the server thread.
#[derive(Debug)]
pub(crate) enum Input {
    /// A connection was opened.
    Opened { peer: Peer, handles: PeerHandles },
    /// Bytes of a control stream.
    Control { peer: Peer, piece: Piece },
    /// The connection has taken all control bytes that were handed over.
    ControlTaken { peer: Peer },
    /// The endpoint has something to transmit.
    Wake,
    /// A datagram.
    State { peer: Peer, piece: Piece },
    /// A connection has ended; its last input.
    Ended { peer: Peer, ending: Ending },
    /// The server must stop.
    Stop,
    /// The I/O thread has ended; the last input.
    IoOver,
}

/// The server thread's handles of one connection.
#[derive(Debug)]
pub(crate) struct PeerHandles {
    pub(crate) datagrams: Arc<DatagramLane>,
    pub(crate) control: ControlSender,
    pub(crate) closing: Arc<Closing>,
}

/// A datagram on its way to a connection.
#[derive(Debug)]
pub(crate) struct StateDatagram {
    to: Peer,
    lane: Arc<DatagramLane>,
    bytes: Bytes,
}

/// Drains whose datagrams may wait for the I/O thread.
pub(crate) const BATCHES_WAITING: usize = 1_024;

impl StateDatagram {
    fn send(self, watch: &ServerWatch) {
        let Self { to, lane, bytes } = self;
        let bytes_len = bytes.len();
        match lane.send(bytes) {
            Ok(()) | Err(SendDatagramError::ConnectionLost(_)) => {}
            Err(cause) => {
                watch.count(|counters| &counters.state_oversized);
                tracing::warn!(peer = to.0, bytes_len, %cause, "state datagram not sent");
            }
        }
    }
}

/// Sends the datagrams of the server thread, on the thread that drives the connections.
pub(crate) async fn send_batches(
    mut batches: mpsc::Receiver<Vec<StateDatagram>>,
    watch: ServerWatch,
) {
    while let Some(batch) = batches.recv().await {
        batch.into_iter().for_each(|state| state.send(&watch));
    }
}

/// Sends and receives the datagrams of a connection.
#[derive(Debug)]
pub(crate) struct DatagramLane {
    connection: Connection,
    /// The session of a browser; `None` for a connection of this protocol alone.
    web: Option<Arc<WebSession>>,
}

impl DatagramLane {
    pub(crate) const fn new(connection: Connection, web: Option<Arc<WebSession>>) -> Self {
        Self { connection, web }
    }

    pub(crate) const fn connection(&self) -> &Connection {
        &self.connection
    }

    /// Sends a datagram without waiting.
    pub(crate) fn send(&self, bytes: Bytes) -> Result<(), SendDatagramError> {
        self.connection.send_datagram(match &self.web {
            None => bytes,
            Some(web) => web.wrap(&bytes),
        })
    }

    /// The next datagram; `None` after the end of the connection.
    pub(crate) async fn read(&self) -> Option<Bytes> {
        loop {
            let datagram = self.connection.read_datagram().await.ok()?;
            match &self.web {
                None => return Some(datagram),
                Some(web) => {
                    // One of another session is dropped: the connection has none.
                    if let Some(bytes) = web.unwrap(datagram) {
                        return Some(bytes);
                    }
                }
            }
        }
    }

    /// Bytes of the largest datagram that fits now; `None` if the peer takes none.
    pub(crate) fn largest(&self) -> Option<usize> {
        let overhead = self.web.as_ref().map_or(0, |web| web.overhead());
        let bytes = self.connection.max_datagram_size()?;
        Some(bytes.saturating_sub(overhead))
    }
}

/// Wakes the server thread, which drains its endpoint then; all clones are one.
#[derive(Clone, Debug)]
pub struct Waker {
    inputs: Sender<Input>,
    /// True if a wake-up waits already: many before the thread wakes are one.
    waiting: Arc<AtomicBool>,
}

impl Waker {
    pub(crate) fn new(inputs: Sender<Input>) -> Self {
        Self {
            inputs,
            waiting: Arc::new(AtomicBool::new(false)),
        }
    }

    /// Wakes the server thread.
    pub fn wake(&self) {
        if !self.waiting.swap(true, Ordering::AcqRel) {
            // If the server thread has ended, there is nothing to wake.
            let _ = self.inputs.send(Input::Wake);
        }
    }

    /// The server thread is awake.
    fn note_woken(&self) {
        self.waiting.store(false, Ordering::Release);
    }
}

/// Measurements of one connection's link.
#[derive(Clone, Copy, Debug)]
pub struct LinkMeter {
    read_at: Instant,
    handed_bytes: u64,
    waiting_bytes: u64,
}

/// Time between two readings.
const INTERVAL: Span = Span::from_millis(100);

impl LinkMeter {
    /// A meter of a link that has carried nothing yet.
    pub const fn new(now: Instant) -> Self {
        Self {
            read_at: now,
            handed_bytes: 0,
            waiting_bytes: 0,
        }
    }

    /// True if it is time for another reading.
    pub fn is_due(&self, now: Instant) -> bool {
        now >= self.read_at + INTERVAL
    }

    /// Takes a reading: total bytes handed over, and how many of them still wait.
    pub fn read(
        &mut self,
        now: Instant,
        handed_bytes: u64,
        waiting_bytes: u64,
        round_trip: Span,
    ) -> LinkReport {
        let handed = handed_bytes.saturating_sub(self.handed_bytes);
        let report = LinkReport {
            waiting_bytes,
            sent_bytes: (self.waiting_bytes + handed).saturating_sub(waiting_bytes),
            over: now.since(self.read_at),
            round_trip,
        };
        *self = Self {
            read_at: now,
            handed_bytes,
            waiting_bytes,
        };
        report
    }
}

/// Reads a server's counters while it runs and after; all clones are one.
#[derive(Clone, Debug, Default)]
pub struct ServerWatch {
    shared: Arc<WatchState>,
}

#[derive(Debug, Default)]
struct WatchState {
    connections: Mutex<Connections>,
    counters: Counters,
}

#[derive(Debug, Default)]
struct Connections {
    standing: BTreeMap<Peer, Connection>,
    ended: WireStatistics,
}

/// Counters of a server over its whole life.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ServerStatistics {
    /// Connections that were opened.
    pub opened: u64,
    /// Connections that have ended.
    pub ended: u64,
    /// Attempts refused because the server was full.
    pub refused: u64,
    /// Connections closed because their peer read control bytes too slowly.
    pub control_overflows: u64,
    /// Datagrams from clients dropped because the server thread was late.
    pub state_dropped: u64,
    /// Datagrams to clients that were larger than the path allows.
    pub state_oversized: u64,
}

/// The counters behind [`ServerStatistics`].
#[derive(Debug, Default)]
pub(crate) struct Counters {
    pub(crate) opened: AtomicU64,
    pub(crate) ended: AtomicU64,
    pub(crate) refused: AtomicU64,
    control_overflows: AtomicU64,
    pub(crate) state_dropped: AtomicU64,
    state_oversized: AtomicU64,
}

impl ServerWatch {
    /// The present counters.
    #[must_use]
    pub fn statistics(&self) -> ServerStatistics {
        let read = |counter: &AtomicU64| counter.load(Ordering::Relaxed);
        let counters = &self.shared.counters;
        ServerStatistics {
            opened: read(&counters.opened),
            ended: read(&counters.ended),
            refused: read(&counters.refused),
            control_overflows: read(&counters.control_overflows),
            state_dropped: read(&counters.state_dropped),
            state_oversized: read(&counters.state_oversized),
        }
    }

    /// The traffic of each open connection, by peer.
    #[must_use]
    pub fn connections(&self) -> Vec<(Peer, SocketAddr, WireStatistics)> {
        let connections = self.lock();
        let row = |(peer, connection): (&Peer, &Connection)| {
            (
                *peer,
                connection.remote_address(),
                wire_statistics(connection),
            )
        };
        connections.standing.iter().map(row).collect()
    }

    /// The traffic of all connections, open and ended.
    #[must_use]
    pub fn traffic(&self) -> WireStatistics {
        let connections = self.lock();
        let mut sum = connections.ended;
        for connection in connections.standing.values() {
            sum += wire_statistics(connection);
        }
        sum
    }

    pub(crate) fn count(&self, pick: impl FnOnce(&Counters) -> &AtomicU64) {
        pick(&self.shared.counters).fetch_add(1, Ordering::Relaxed);
    }

    pub(crate) fn opened(&self, peer: Peer, connection: Connection) {
        self.count(|counters| &counters.opened);
        self.lock().standing.insert(peer, connection);
    }

    pub(crate) fn ended(&self, peer: Peer) {
        self.count(|counters| &counters.ended);
        let mut connections = self.lock();
        if let Some(connection) = connections.standing.remove(&peer) {
            connections.ended += wire_statistics(&connection);
        }
    }

    fn lock(&self) -> MutexGuard<'_, Connections> {
        self.shared
            .connections
            .lock()
            .expect("reading counters never panics")
    }
}

/// Requests a running server to stop; all clones are one request.
#[derive(Clone, Default)]
pub struct Stop {
    shared: Arc<Mutex<StopState>>,
}

#[derive(Default)]
struct StopState {
    requested: bool,
    wakes: Vec<Box<dyn Fn() + Send>>,
}

impl Stop {
    /// No request yet.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// Requests the stop. Servers that run with it close their connections and return; later ones return at once.
    pub fn stop(&self) {
        let mut shared = self.lock();
        shared.requested = true;
        for wake in shared.wakes.drain(..) {
            wake();
        }
    }

    /// True if the stop was requested.
    #[must_use]
    pub fn is_requested(&self) -> bool {
        self.lock().requested
    }

    /// Calls `wake` once at the request, or now if it was made already.
    pub(crate) fn on_stop(&self, wake: impl Fn() + Send + 'static) {
        let mut shared = self.lock();
        if shared.requested {
            wake();
        } else {
            shared.wakes.push(Box::new(wake));
        }
    }

    fn lock(&self) -> MutexGuard<'_, StopState> {
        self.shared.lock().expect("a wake-up never panics")
    }
}

impl fmt::Debug for Stop {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Stop")
            .field("requested", &self.is_requested())
            .finish()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sent_bytes_are_handed_over_bytes_minus_queued_ones() {
        let at = |ms| Instant::ZERO + Span::from_millis(ms);
        let mut link_meter = LinkMeter::new(at(0));
        assert!(!link_meter.is_due(at(99)) && link_meter.is_due(at(100)));
        let first = link_meter.read(at(100), 5_000, 2_000, Span::ZERO);
        assert_eq!((first.sent_bytes, first.waiting_bytes), (3_000, 2_000));
        let second = link_meter.read(at(250), 6_000, 500, Span::ZERO);
        assert_eq!(
            (second.sent_bytes, second.over),
            (2_500, Span::from_millis(150))
        );
    }
}
