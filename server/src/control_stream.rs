//! The control stream of a client, and what goes out beside it.
//!
//! Knows sessions, neither scenes nor members. Datagrams are shared: one packet for many members is one allocation.
//! Invariant: a driver that reports what links take is handed at most [`WINDOW_BYTES`] and one piece beyond that for a
//! connection. All other waiting bytes are counted here, and a connection whose peer does not read is closed.

use std::collections::{BTreeSet, VecDeque};

use bytes::Bytes;
use rhumb_protocol::message::{Grease, ServerMessage};
use rhumb_protocol::session::{CloseCode, ServerSession, TransportCode};
use rhumb_protocol::{Instant, Peer, Span, Transmit};

use crate::hook::Traffic;
use crate::settings::Limits;

/// Control bytes handed to the driver beyond those that the link has taken.
const WINDOW_BYTES: usize = 256 << 10;
/// Longest piece of control bytes.
const PIECE_BYTES: usize = 64 << 10;
/// Waiting answers to a connection beyond which its messages are not read.
const ANSWERS_WAITING_BYTES: usize = 256 << 10;
/// A peer that has taken bytes in this time reads.
const READS: Span = Span::from_millis(1_000);

/// The control stream of a client, and its snapshots.
#[derive(Debug)]
pub struct ControlStream {
    peer: Peer,
    /// `None` once it is closed.
    session: Option<ServerSession>,
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
    /// The batch of the log that must be durable before its control bytes go out.
    kept_back: Option<u64>,
    /// The counters of the scene that its client is a member of.
    traffic: Option<Traffic>,
}

/// Bytes and datagrams that go out next.
#[derive(Debug)]
pub struct PendingOutput {
    /// Clients whose control streams may have data to send.
    sendable: BTreeSet<Peer>,
    datagrams: VecDeque<Transmit>,
    now: Instant,
    limits: Limits,
}

impl ControlStream {
    /// The client.
    #[must_use]
    pub const fn peer(&self) -> Peer {
        self.peer
    }

    /// The control stream of a client that has just connected.
    #[must_use]
    pub const fn new(peer: Peer, grease: Grease, now: Instant) -> Self {
        Self {
            peer,
            session: Some(ServerSession::new(grease)),
            rest: Bytes::new(),
            handed: 0,
            taken: None,
            snapshot_end: 0,
            snapshot_after: Instant::ZERO,
            taken_at: now,
            kept_back: None,
            traffic: None,
        }
    }

    /// Its session, unless it is closed; it may have data to send afterwards.
    pub fn session(&mut self, out: &mut PendingOutput) -> Option<&mut ServerSession> {
        // The session may now send something, and no longer waits since its last sending.
        self.note_idle(out.now);
        let session = self.session.as_mut()?;
        out.sendable.insert(self.peer);
        Some(session)
    }

    /// Sends a message.
    pub fn send(&mut self, message: &ServerMessage, out: &mut PendingOutput) {
        if let Some(session) = self.session(out) {
            session.send(message);
        }
    }

    /// Sends messages that were encoded once for many members.
    pub fn send_encoded(&mut self, messages: &Bytes, out: &mut PendingOutput) {
        if let Some(session) = self.session(out) {
            session.send_encoded(messages);
        }
    }

    /// Sends a datagram beside it.
    pub fn send_datagram(&self, bytes: Bytes, out: &mut PendingOutput) {
        if let Some(traffic) = self.open_traffic() {
            traffic.add_sent(bytes.len());
        }
        let to = self.peer;
        out.datagrams.push_back(Transmit::State { to, bytes });
    }

    /// Notes that the link has nothing to take, if it has not.
    fn note_idle(&mut self, now: Instant) {
        if self.in_driver() == 0 && self.queued() == 0 {
            self.taken_at = now;
        }
    }

    pub(crate) fn open_traffic(&self) -> Option<&Traffic> {
        self.session.as_ref().and(self.traffic.as_ref())
    }

    fn queued(&self) -> usize {
        let session = self.session.as_ref();
        self.rest.len() + session.map_or(0, ServerSession::queued_bytes)
    }

    /// Bytes that the driver has and the link has not taken.
    fn in_driver(&self) -> u64 {
        self.taken.map_or(0, |taken| self.handed - taken)
    }

    fn has_room(&self) -> bool {
        self.in_driver() < WINDOW_BYTES as u64
    }

    /// Waiting bytes beyond those of a snapshot.
    fn waiting(&self) -> usize {
        let end = self.handed + self.queued() as u64;
        let from = self.handed - self.in_driver();
        (end - from.max(self.snapshot_end)) as usize
    }

    /// True if so much waits for the client that no more of its messages are answered.
    #[must_use]
    pub fn is_behind(&self) -> bool {
        self.taken.is_some() && self.waiting() > ANSWERS_WAITING_BYTES
    }

    /// Bytes that wait for the client beside its snapshot; none for one that has taken nothing for a second, since no
    /// other is to wait for it.
    pub(crate) fn waiting_bytes(&self, now: Instant) -> usize {
        let reads = self.taken.is_some() && now.since(self.taken_at) < READS;
        if reads { self.waiting() } else { 0 }
    }

    /// The earliest time of a snapshot; `None` while one is under way.
    #[must_use]
    pub fn snapshot_at(&self) -> Option<Instant> {
        self.session.as_ref()?;
        match self.taken {
            // A driver that reports nothing, as in a test, has no links to spare.
            None => Some(Instant::ZERO),
            Some(taken) => (taken >= self.snapshot_end).then_some(self.snapshot_after),
        }
    }

    /// True if a snapshot may begin: none is under way, and the last one was long enough ago.
    #[must_use]
    pub fn may_snapshot(&self, now: Instant) -> bool {
        self.snapshot_at().is_some_and(|at| at <= now)
    }

    fn next_piece(&mut self) -> Option<Bytes> {
        if self.rest.is_empty() {
            self.rest = self.session.as_mut()?.poll_control()?;
        }
        let length = self.rest.len().min(PIECE_BYTES);
        self.handed += length as u64;
        if let Some(traffic) = &self.traffic {
            traffic.add_sent(length);
        }
        Some(self.rest.split_to(length))
    }

    /// The code for a client that reads too slowly: too much waits for it, or it has taken nothing for long.
    fn overflow(&self, out: &PendingOutput) -> Option<CloseCode> {
        self.taken?;
        let waits = self.in_driver() > 0 || self.queued() > 0;
        let unread_for = out.now.since(self.taken_at);
        let stalled = self.kept_back.is_none() && waits && unread_for >= out.limits.stall();
        (stalled || self.waiting() > out.limits.waiting_bytes())
            .then_some(CloseCode(TransportCode::CONTROL_OVERFLOW.0))
    }

    fn poll(&mut self, out: &PendingOutput) -> Option<Transmit> {
        let to = self.peer;
        let overflow = self.overflow(out);
        let session = self.session.as_mut()?;
        if let Some(code) = overflow {
            session.close(code);
        }
        if self.has_room()
            && self.kept_back.is_none()
            && let Some(bytes) = self.next_piece()
        {
            return Some(Transmit::Control { to, bytes });
        }
        let code = self.session.as_ref()?.poll_close()?.0;
        // The bytes that the closed window holds back are lost with the connection.
        (self.session, self.rest) = (None, Bytes::new());
        if code == TransportCode::CONTROL_OVERFLOW.0 {
            tracing::warn!(peer = to.0, "a client reads too slowly, closing");
        }
        Some(Transmit::Close { to, code })
    }

    /// Starts to count its bytes.
    pub(crate) fn count(&mut self, traffic: Traffic) {
        self.traffic = Some(traffic);
    }

    /// True once it is closed.
    #[must_use]
    pub const fn is_closed(&self) -> bool {
        self.session.is_none()
    }

    /// True if the driver reports what the link takes.
    #[must_use]
    pub const fn is_paced(&self) -> bool {
        self.taken.is_some()
    }

    /// Bytes of the client's messages that were not handled yet.
    #[must_use]
    pub fn unread_bytes(&self) -> usize {
        self.session.as_ref().map_or(0, ServerSession::unread_bytes)
    }

    /// Keeps its bytes back until a batch of the log is durable.
    pub(crate) const fn keep_back(&mut self, batch: u64) {
        self.kept_back = Some(batch);
    }

    /// Sends what was kept back, if its batch is due.
    pub(crate) fn release(&mut self, is_due: &impl Fn(u64) -> bool, out: &mut PendingOutput) {
        if self.kept_back.is_some_and(is_due) {
            (self.kept_back, self.taken_at) = (None, out.now);
            out.sendable.insert(self.peer);
        }
    }

    /// The link took so many more bytes.
    pub fn note_taken(&mut self, bytes: usize, out: &mut PendingOutput) {
        let taken = self.taken.unwrap_or(self.handed) + bytes as u64;
        self.taken = Some(taken.min(self.handed));
        self.taken_at = out.now;
        out.sendable.insert(self.peer);
    }

    /// A snapshot of so many bytes was queued.
    pub fn note_snapshot(&mut self, bytes: usize, out: &PendingOutput) {
        self.snapshot_end = self.handed + self.queued() as u64;
        let pause = bytes as u64 * 1_000_000_000 / out.limits.snapshot_bytes_per_second();
        self.snapshot_after = out.now + Span::from_nanos(pause);
    }

    /// Closes the connection of a client that reads too slowly; returns whether it did.
    pub fn close_if_stalled(&mut self, out: &mut PendingOutput) -> bool {
        self.note_idle(out.now);
        let Some(code) = self.overflow(out) else {
            return false;
        };
        let session = self.session(out);
        session.map(|session| session.close(code)).is_some()
    }
}

impl PendingOutput {
    /// Nothing to send.
    #[must_use]
    pub const fn new(limits: Limits) -> Self {
        Self {
            sendable: BTreeSet::new(),
            datagrams: VecDeque::new(),
            now: Instant::ZERO,
            limits,
        }
    }

    /// Sets the present moment.
    pub const fn at(&mut self, now: Instant) {
        self.now = now;
    }

    /// The present moment.
    #[must_use]
    pub const fn now(&self) -> Instant {
        self.now
    }

    /// Sends nothing more to a client.
    pub fn forget(&mut self, peer: Peer) {
        self.sendable.remove(&peer);
    }

    /// A client whose control stream may have data to send. These go first: datagrams may belong to a stream that they
    /// announce.
    #[must_use]
    pub fn next_sendable(&self) -> Option<Peer> {
        self.sendable.first().copied()
    }

    /// The next transmission of such a client's control stream; `None` once it has nothing to send.
    pub fn poll_control(
        &mut self,
        peer: Peer,
        control: Option<&mut ControlStream>,
    ) -> Option<Transmit> {
        let transmit = control.and_then(|control| control.poll(self));
        if transmit.is_none() {
            self.sendable.remove(&peer);
        }
        transmit
    }

    /// The next datagram.
    pub fn poll_datagram(&mut self) -> Option<Transmit> {
        self.datagrams.pop_front()
    }
}
