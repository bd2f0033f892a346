//! Outgoing data of all connections: control messages and datagrams.
//!
//! Knows sessions, not scenes. Datagrams are shared: one packet for many members is one allocation. Invariant: a driver
//! that reports what links take is handed at most [`WINDOW_BYTES`] and one piece beyond that for a connection. What
//! else waits is counted here, and a connection whose peer does not read is closed.

use std::collections::{BTreeMap, BTreeSet, VecDeque};

use bytes::Bytes;
use rhumb_protocol::message::{Grease, ServerMessage};
use rhumb_protocol::session::{CloseCode, ServerSession, TransportCode};
use rhumb_protocol::{Instant, Peer, Span, Transmit};

use crate::limits::Limits;
use crate::observer::Traffic;

/// Control bytes handed to the driver beyond those that the link has taken.
const WINDOW_BYTES: usize = 256 << 10;
/// Longest piece of control bytes.
const PIECE_BYTES: usize = 64 << 10;
/// Waiting answers to a connection beyond which its messages are not read.
const ANSWERS_WAITING_BYTES: usize = 256 << 10;
/// A peer that has taken bytes in this time reads.
const READS: Span = Span::from_millis(1_000);

/// The sessions of all connections and their outgoing data.
#[derive(Debug)]
pub(crate) struct Outbox {
    lanes: BTreeMap<Peer, PeerQueue>,
    /// Connections whose sessions may have data to send.
    sendable: BTreeSet<Peer>,
    ready: VecDeque<Transmit>,
    now: Instant,
    limits: Limits,
}

/// The control lane of one connection.
#[derive(Debug)]
struct PeerQueue {
    session: ServerSession,
    /// The rest of a piece that was cut.
    rest: Bytes,
    /// Bytes handed to the driver so far.
    handed: u64,
    /// Bytes that the link has taken so far; `None` if the driver does not report them.
    taken: Option<u64>,
    /// Value of `handed` at which the last snapshot has been handed over.
    snapshot_end: u64,
    /// The earliest time of the next snapshot.
    snapshot_after: Instant,
    /// The last time at which the link took bytes, or had none to take.
    taken_at: Instant,
    /// True while its control bytes wait for the disk.
    kept_back: bool,
    /// The figures of the scene that its client is a member of.
    bytes: Option<Traffic>,
}

impl PeerQueue {
    fn queued(&self) -> usize {
        self.rest.len() + self.session.queued_bytes()
    }

    /// Bytes that the driver has and the link has not taken.
    fn in_driver(&self) -> u64 {
        self.taken.map_or(0, |taken| self.handed - taken)
    }

    fn is_open(&self) -> bool {
        self.in_driver() < WINDOW_BYTES as u64
    }

    /// Waiting bytes beyond those of a snapshot.
    fn waiting(&self) -> usize {
        let end = self.handed + self.queued() as u64;
        let from = self.handed - self.in_driver();
        (end - from.max(self.snapshot_end)) as usize
    }

    fn snapshot_under_way(&self) -> bool {
        self.taken.is_some_and(|taken| taken < self.snapshot_end)
    }

    fn next_piece(&mut self) -> Option<Bytes> {
        if self.rest.is_empty() {
            self.rest = self.session.poll_control()?;
        }
        let length = self.rest.len().min(PIECE_BYTES);
        self.handed += length as u64;
        if let Some(counts) = &self.bytes {
            counts.add_sent(length);
        }
        Some(self.rest.split_to(length))
    }
}

impl Outbox {
    pub(crate) const fn new(limits: Limits) -> Self {
        Self {
            lanes: BTreeMap::new(),
            sendable: BTreeSet::new(),
            ready: VecDeque::new(),
            now: Instant::ZERO,
            limits,
        }
    }

    pub(crate) fn open(&mut self, peer: Peer, grease: Grease) {
        let lane = PeerQueue {
            session: ServerSession::new(grease),
            rest: Bytes::new(),
            handed: 0,
            taken: None,
            snapshot_end: 0,
            snapshot_after: Instant::ZERO,
            taken_at: self.now,
            kept_back: false,
            bytes: None,
        };
        self.lanes.insert(peer, lane);
    }

    /// True if it has no connections.
    pub(crate) fn is_empty(&self) -> bool {
        self.lanes.is_empty()
    }

    pub(crate) fn forget(&mut self, peer: Peer) {
        self.lanes.remove(&peer);
        self.sendable.remove(&peer);
    }

    /// Sets the present moment.
    pub(crate) fn at(&mut self, now: Instant) {
        self.now = now;
    }

    /// Starts to count the bytes of a connection.
    pub(crate) fn count(&mut self, peer: Peer, bytes: Traffic) {
        if let Some(lane) = self.lanes.get_mut(&peer) {
            lane.bytes = Some(bytes);
        }
    }

    /// Bytes of a connection arrive at this moment.
    pub(crate) fn receive(&mut self, now: Instant, peer: Peer, bytes: usize) {
        self.now = now;
        if let Some(counts) = self.counts(peer) {
            counts.add_received(bytes);
        }
    }

    fn counts(&self, peer: Peer) -> Option<&Traffic> {
        self.lanes.get(&peer)?.bytes.as_ref()
    }

    /// The present moment.
    pub(crate) fn now(&self) -> Instant {
        self.now
    }

    /// True if the driver reports what the link of a connection takes.
    pub(crate) fn is_paced(&self, peer: Peer) -> bool {
        (self.lanes.get(&peer)).is_some_and(|lane| lane.taken.is_some())
    }

    /// A connection's session; it may have data to send afterwards.
    pub(crate) fn session(&mut self, peer: Peer) -> Option<&mut ServerSession> {
        let lane = self.lanes.get_mut(&peer)?;
        self.sendable.insert(peer);
        Some(&mut lane.session)
    }

    pub(crate) fn send(&mut self, to: Peer, message: &ServerMessage) {
        if let Some(session) = self.session(to) {
            session.send(message);
        }
    }

    /// Sends messages that were encoded once for many members.
    pub(crate) fn send_encoded(&mut self, to: Peer, messages: &Bytes) {
        if let Some(session) = self.session(to) {
            session.send_encoded(messages);
        }
    }

    /// Keeps all control bytes of a connection back until [`Self::release`].
    pub(crate) fn keep_back(&mut self, peer: Peer) {
        if let Some(lane) = self.lanes.get_mut(&peer) {
            lane.kept_back = true;
        }
    }

    /// Sends what was kept back.
    pub(crate) fn release(&mut self, peer: Peer) {
        let now = self.now;
        if let Some(lane) = self.lanes.get_mut(&peer) {
            (lane.kept_back, lane.taken_at) = (false, now);
            self.sendable.insert(peer);
        }
    }

    pub(crate) fn datagram(&mut self, to: Peer, bytes: Bytes) {
        if let Some(counts) = self.counts(to) {
            counts.add_sent(bytes.len());
        }
        self.ready.push_back(Transmit::State { to, bytes });
    }

    /// The link took so many more bytes of a connection.
    pub(crate) fn note_taken(&mut self, peer: Peer, bytes: usize) {
        let now = self.now;
        if let Some(lane) = self.lanes.get_mut(&peer) {
            let taken = lane.taken.unwrap_or(lane.handed) + bytes as u64;
            lane.taken = Some(taken.min(lane.handed));
            lane.taken_at = now;
            self.sendable.insert(peer);
        }
    }

    /// A snapshot of so many bytes was queued for a connection.
    pub(crate) fn note_snapshot(&mut self, peer: Peer, bytes: usize) {
        let (now, per_second) = (self.now, self.limits.snapshot_bytes_per_second());
        if let Some(lane) = self.lanes.get_mut(&peer) {
            lane.snapshot_end = lane.handed + lane.queued() as u64;
            let pause = bytes as u64 * 1_000_000_000 / per_second;
            lane.snapshot_after = now + Span::from_nanos(pause);
        }
    }

    /// True if a snapshot for a connection may begin: none is under way, and the last one was long enough ago.
    pub(crate) fn may_snapshot(&self, peer: Peer) -> bool {
        self.snapshot_at(peer).is_some_and(|at| at <= self.now)
    }

    /// The earliest time of a snapshot for a connection; `None` while one is under way.
    pub(crate) fn snapshot_at(&self, peer: Peer) -> Option<Instant> {
        let lane = self.lanes.get(&peer)?;
        if lane.snapshot_under_way() {
            return None;
        }
        // A driver that reports nothing, as in a test, has no links to spare.
        let paced = lane.taken.is_some();
        Some(if paced {
            lane.snapshot_after
        } else {
            Instant::ZERO
        })
    }

    /// True if so much waits for a connection that no more of its messages are answered.
    pub(crate) fn is_behind(&self, peer: Peer) -> bool {
        self.lanes
            .get(&peer)
            .is_some_and(|lane| lane.taken.is_some() && lane.waiting() > ANSWERS_WAITING_BYTES)
    }

    /// Bytes that wait for a connection beside its snapshot; none for a peer that has taken nothing for a second, since
    /// no other peer is to wait for it.
    pub(crate) fn waiting_bytes(&self, peer: Peer) -> usize {
        let reads = |lane: &&PeerQueue| self.now.since(lane.taken_at) < READS;
        let lane = self.lanes.get(&peer).filter(reads);
        lane.filter(|lane| lane.taken.is_some())
            .map_or(0, PeerQueue::waiting)
    }

    /// Bytes of a connection's messages that were not handled yet.
    pub(crate) fn unread_bytes(&self, peer: Peer) -> usize {
        let lane = self.lanes.get(&peer);
        lane.map_or(0, |lane| lane.session.unread_bytes())
    }

    /// The code for a connection whose peer reads too slowly: too much waits for it, or it has taken nothing for long.
    fn overflow(lane: &PeerQueue, limits: &Limits, now: Instant) -> Option<CloseCode> {
        lane.taken?;
        let waits = lane.in_driver() > 0 || lane.queued() > 0;
        let stalled = !lane.kept_back && waits && now.since(lane.taken_at) >= limits.stall();
        (stalled || lane.waiting() > limits.waiting_bytes())
            .then_some(CloseCode(TransportCode::CONTROL_OVERFLOW.0))
    }

    /// Closes a connection whose peer reads too slowly; returns whether it did.
    pub(crate) fn close_if_stalled(&mut self, peer: Peer) -> bool {
        let (now, limits) = (self.now, self.limits);
        let Some(lane) = self.lanes.get_mut(&peer) else {
            return false;
        };
        if lane.in_driver() == 0 && lane.queued() == 0 {
            lane.taken_at = now;
        }
        let Some(code) = Self::overflow(lane, &limits, now) else {
            return false;
        };
        lane.session.close(code);
        self.sendable.insert(peer);
        true
    }

    pub(crate) fn poll(&mut self) -> Option<Transmit> {
        // Messages go first: datagrams may belong to a stream that they announce.
        while let Some(peer) = self.sendable.first().copied() {
            if let Some(transmit) = self.poll_lane(peer) {
                return Some(transmit);
            }
            self.sendable.remove(&peer);
        }
        self.ready.pop_front()
    }

    fn poll_lane(&mut self, peer: Peer) -> Option<Transmit> {
        let (now, limits) = (self.now, self.limits);
        let lane = self.lanes.get_mut(&peer)?;
        if let Some(code) = Self::overflow(lane, &limits, now) {
            lane.session.close(code);
        }
        if lane.is_open()
            && !lane.kept_back
            && let Some(bytes) = lane.next_piece()
        {
            return Some(Transmit::Control { to: peer, bytes });
        }
        let code = lane.session.poll_close()?;
        // The bytes that the closed window holds back are lost with the connection.
        self.forget(peer);
        if code.0 == TransportCode::CONTROL_OVERFLOW.0 {
            tracing::warn!(peer = peer.0, "a client reads too slowly, closing");
        }
        Some(Transmit::Close {
            to: peer,
            code: code.0,
        })
    }
}
