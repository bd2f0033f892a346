//! A client's connection to its server: received bytes, traffic, interface.
//!
//! Another thread, or a call of the server in this process, fills the inbox. It is bounded lane by lane: control stops
//! reading the stream, state drops its oldest. The end comes once, after everything else. Traffic counts UDP payloads,
//! without the headers of UDP and IP (28 or 48 bytes a datagram).
//!
//! At the server's end, a piece of received bytes holds its share of the bound until it is handled. The last pieces of a
//! connection that has ended have none. Control bytes that an endpoint does not accept yet are held back, in order for each
//! peer.

use std::collections::{BTreeMap, VecDeque};
use std::fmt;
use std::ops::AddAssign;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, OnceLock};
use std::time::{self, Duration};

use bytes::Bytes;
use rhumb_protocol::{Ending, Endpoint, Instant, LinkReport, Peer};
use tokio::sync::{Notify, OwnedSemaphorePermit, Semaphore};

/// Control bytes between the sockets and the receiver, per connection; beyond them the stream is not read.
pub const CONTROL_IN_FLIGHT_BYTES: usize = 256 << 10;

/// State bytes that wait for a client's caller; beyond them the oldest datagrams are dropped.
const STATE_INBOX_BYTES: usize = 4 << 20;

/// An open connection of a client: one reliable stream of control bytes, and state datagrams.
///
/// `QuicClient` reaches a server over the network. Other programs may bring their own.
pub trait ClientTransport: Send {
    /// Appends bytes to the control stream without waiting. A connection that cannot keep them ends.
    fn send_control(&self, bytes: Bytes);

    /// Sends one datagram without waiting. It arrives whole, or not at all.
    fn send_state(&self, bytes: Bytes);

    /// Ends the connection with a code, once the control bytes have arrived or after a short wait.
    fn close(&self, code: u32);

    /// The next received item, within `timeout`; zero does not wait.
    ///
    /// [`Received::Ended`] comes once, after everything else; from then on this returns `None` at once.
    fn recv(&mut self, timeout: Duration) -> Option<Received>;

    /// The connection's traffic so far.
    fn statistics(&self) -> WireStatistics;

    /// True if the server can use more control bytes now. A program that carries the connection for another one holds
    /// them back otherwise.
    fn wants_control(&self) -> bool {
        true
    }

    /// Tells the server the state of the link that carries the connection, where it cannot measure it.
    fn report_link(&self, report: &LinkReport) {
        let _ = report;
    }
}

/// One received item of a client.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Received {
    /// The next bytes of the control stream, cut anywhere.
    Control(Bytes),
    /// One state datagram.
    State(Bytes),
    /// The connection has ended; nothing follows.
    Ended(Ending),
}

/// The received items of a client that wait for its caller.
#[derive(Debug, Default)]
pub struct Inbox {
    waiting: Mutex<InboxState>,
    arrival: ArrivalSignal,
    space_freed: Notify,
}

/// Tells the receiver that something has come.
#[derive(Default)]
struct ArrivalSignal {
    waits: Condvar,
    hook: OnceLock<ArrivalHook>,
}

/// The function that a receiver which does not wait has called.
type ArrivalHook = Box<dyn Fn() + Send + Sync>;

impl ArrivalSignal {
    fn notify_one(&self) {
        self.waits.notify_one();
        if let Some(hook) = self.hook.get() {
            hook();
        }
    }
}

impl fmt::Debug for ArrivalSignal {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("ArrivalSignal").finish_non_exhaustive()
    }
}

#[derive(Debug, Default)]
struct InboxState {
    control: InboxQueue,
    state: InboxQueue,
    state_dropped: u64,
    ending: Option<Ending>,
    end: End,
    receiver: ReceiverState,
}

#[derive(Debug, Default)]
struct InboxQueue {
    pieces: VecDeque<Bytes>,
    cost_bytes: usize,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
enum End {
    #[default]
    Pending,
    Delivered,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
enum ReceiverState {
    #[default]
    Here,
    Gone,
}

impl Inbox {
    /// Calls `hook` now, and from then on whenever something has come, on the thread that brings it. Only the first
    /// hook counts.
    pub fn on_arrival(&self, hook: impl Fn() + Send + Sync + 'static) {
        let hook = self.arrival.hook.get_or_init(|| Box::new(hook));
        hook();
    }

    /// Adds control bytes, once the bound allows. Without a receiver they are dropped.
    pub async fn put_control(&self, bytes: &Bytes) {
        while !self.try_put_control(bytes) {
            self.space_freed.notified().await;
        }
    }

    /// Adds control bytes of a sender that keeps a bound of its own. Without a receiver they are dropped.
    pub fn put_bounded_control(&self, bytes: &Bytes) {
        let mut waiting = self.lock();
        if waiting.receiver == ReceiverState::Here {
            waiting.control.push(bytes);
            self.arrival.notify_one();
        }
    }

    /// Adds a datagram; drops the oldest ones beyond the bound.
    pub fn put_state(&self, bytes: &Bytes) {
        let mut waiting = self.lock();
        waiting.state.push(bytes);
        while waiting.state.cost_bytes > STATE_INBOX_BYTES {
            let _ = waiting.state.pop();
            waiting.state_dropped += 1;
        }
        self.arrival.notify_one();
    }

    /// Adds the end.
    pub fn put_end(&self, ending: Ending) {
        self.lock().ending = Some(ending);
        self.arrival.notify_one();
    }

    /// The next item, control first, within `timeout`; zero does not wait.
    ///
    /// [`Received::Ended`] comes once, after everything else; from then on this returns `None` at once.
    ///
    /// # Panics
    ///
    /// If a thread panicked while it held the lock, which none does.
    pub fn take(&self, timeout: Duration) -> Option<Received> {
        let mut waiting = self.lock();
        if let Some(received) = self.next(&mut waiting) {
            return Some(received);
        }
        if timeout.is_zero() {
            return None;
        }
        let deadline = time::Instant::now().checked_add(timeout);
        loop {
            if waiting.end == End::Delivered {
                return None;
            }
            let left = deadline.map_or(timeout, |deadline| {
                deadline.saturating_duration_since(time::Instant::now())
            });
            if left.is_zero() {
                return None;
            }
            (waiting, _) = self.arrival.waits.wait_timeout(waiting, left).expect(LOCK);
            if let Some(received) = self.next(&mut waiting) {
                return Some(received);
            }
        }
    }

    /// True once [`Received::Ended`] was taken.
    pub fn has_ended(&self) -> bool {
        self.lock().end == End::Delivered
    }

    /// Marks the receiver as gone.
    pub fn abandon(&self) {
        self.lock().receiver = ReceiverState::Gone;
        self.space_freed.notify_one();
    }

    /// Datagrams dropped so far.
    pub fn state_dropped(&self) -> u64 {
        self.lock().state_dropped
    }

    fn try_put_control(&self, bytes: &Bytes) -> bool {
        let mut waiting = self.lock();
        if waiting.receiver == ReceiverState::Gone {
            return true;
        }
        let full = waiting.control.cost_bytes >= CONTROL_IN_FLIGHT_BYTES;
        if !full {
            waiting.control.push(bytes);
            self.arrival.notify_one();
        }
        !full
    }

    fn next(&self, waiting: &mut InboxState) -> Option<Received> {
        if let Some(bytes) = waiting.control.pop() {
            self.space_freed.notify_one();
            return Some(Received::Control(bytes));
        }
        if let Some(bytes) = waiting.state.pop() {
            return Some(Received::State(bytes));
        }
        if waiting.end == End::Delivered {
            return None;
        }
        let ending = waiting.ending?;
        waiting.end = End::Delivered;
        Some(Received::Ended(ending))
    }

    fn lock(&self) -> MutexGuard<'_, InboxState> {
        self.waiting.lock().expect(LOCK)
    }
}

const LOCK: &str = "nothing panics while the inbox is locked";

impl InboxQueue {
    fn push(&mut self, bytes: &Bytes) {
        self.cost_bytes += bytes.len() + PIECE_COST_BYTES;
        self.pieces.push_back(bytes.clone());
    }

    fn pop(&mut self) -> Option<Bytes> {
        let bytes = self.pieces.pop_front()?;
        self.cost_bytes -= bytes.len() + PIECE_COST_BYTES;
        Some(bytes)
    }
}

/// Traffic of one connection since it began, in UDP payloads; or the sum over several.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct WireStatistics {
    /// UDP payload bytes sent.
    pub sent_bytes: u64,
    /// UDP datagrams sent.
    pub sent_datagrams: u64,
    /// UDP payload bytes received.
    pub received_bytes: u64,
    /// UDP datagrams received.
    pub received_datagrams: u64,
    /// QUIC packets that this end sent and considers lost.
    pub lost_packets: u64,
    /// Round-trip time as QUIC estimates it now; in a sum, the greatest.
    pub round_trip: Duration,
}

impl AddAssign for WireStatistics {
    fn add_assign(&mut self, other: Self) {
        self.sent_bytes += other.sent_bytes;
        self.sent_datagrams += other.sent_datagrams;
        self.received_bytes += other.received_bytes;
        self.received_datagrams += other.received_datagrams;
        self.lost_packets += other.lost_packets;
        self.round_trip = self.round_trip.max(other.round_trip);
    }
}

/// Cost of a waiting piece beside its bytes, so that empty datagrams are bounded too.
pub const PIECE_COST_BYTES: usize = 64;

/// Waiting bytes, with their share of the bound.
#[derive(Debug)]
pub struct Piece {
    /// The bytes.
    pub bytes: Bytes,
    _share: Option<OwnedSemaphorePermit>,
}

/// Bound on the bytes that wait on one lane of one connection.
#[derive(Clone, Debug)]
pub struct ByteCredit {
    bytes: Arc<Semaphore>,
}

impl ByteCredit {
    /// A bound of this number of bytes, the cost of pieces included.
    #[must_use]
    pub fn new(bytes: usize) -> Self {
        Self {
            bytes: Arc::new(Semaphore::new(bytes)),
        }
    }

    /// Waits until the bound allows the bytes.
    ///
    /// # Panics
    ///
    /// When the bytes are too many for one read.
    pub async fn admit(&self, bytes: &[u8]) -> Piece {
        let share = Arc::clone(&self.bytes)
            .acquire_many_owned(cost(bytes))
            .await
            .expect("the semaphore is never closed");
        Piece::new(bytes, Some(share))
    }

    /// `None` if the bound does not allow the bytes now.
    ///
    /// # Panics
    ///
    /// When the bytes are too many for one read.
    pub fn try_admit(&self, bytes: &[u8]) -> Option<Piece> {
        let share = Arc::clone(&self.bytes)
            .try_acquire_many_owned(cost(bytes))
            .ok()?;
        Some(Piece::new(bytes, Some(share)))
    }
}

impl Piece {
    /// Bytes that another bound limits.
    #[must_use]
    pub fn without_share(bytes: &[u8]) -> Self {
        Self::new(bytes, None)
    }

    /// Copies the bytes: they may be a sliver of a receive buffer of 64 KiB, which would then stay allocated
    /// uncounted.
    fn new(bytes: &[u8], share: Option<OwnedSemaphorePermit>) -> Self {
        Self {
            bytes: Bytes::copy_from_slice(bytes),
            _share: share,
        }
    }
}

impl AsRef<[u8]> for Piece {
    fn as_ref(&self) -> &[u8] {
        &self.bytes
    }
}

fn cost(bytes: &[u8]) -> u32 {
    u32::try_from(bytes.len() + PIECE_COST_BYTES).expect("a piece is at most a read's bytes")
}

/// Control bytes of peers that wait until the endpoint wants them.
#[derive(Debug)]
pub struct HeldBack<T> {
    pieces: BTreeMap<Peer, VecDeque<T>>,
}

impl<T: AsRef<[u8]>> HeldBack<T> {
    /// Hands control bytes on, or holds them back.
    pub fn handle_control<E: Endpoint>(
        &mut self,
        now: Instant,
        endpoint: &mut E,
        from: Peer,
        piece: T,
    ) {
        if !self.pieces.contains_key(&from) && endpoint.wants_control(from) {
            endpoint.handle_control(now, from, piece.as_ref());
        } else {
            self.pieces.entry(from).or_default().push_back(piece);
        }
    }

    /// Hands on what is wanted now; returns whether there was any.
    pub fn deliver<E: Endpoint>(&mut self, now: Instant, endpoint: &mut E) -> bool {
        let mut any = false;
        self.pieces.retain(|peer, pieces| {
            while endpoint.wants_control(*peer)
                && let Some(piece) = pieces.pop_front()
            {
                endpoint.handle_control(now, *peer, piece.as_ref());
                any = true;
            }
            !pieces.is_empty()
        });
        any
    }

    /// Hands on all that is left of a peer whose connection has ended.
    pub fn deliver_rest<E: Endpoint>(&mut self, now: Instant, endpoint: &mut E, peer: Peer) {
        for piece in self.pieces.remove(&peer).into_iter().flatten() {
            endpoint.handle_control(now, peer, piece.as_ref());
        }
    }

    /// Drops the remaining bytes of a peer.
    pub fn forget(&mut self, peer: Peer) {
        self.pieces.remove(&peer);
    }
}

impl<T> Default for HeldBack<T> {
    fn default() -> Self {
        Self {
            pieces: BTreeMap::new(),
        }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::{AtomicUsize, Ordering};

    use super::*;

    #[test]
    fn control_comes_first_and_the_end_last_and_once() {
        let inbox = Inbox::default();
        let (control, state) = (Bytes::from_static(b"c"), Bytes::from_static(b"s"));
        inbox.put_end(Ending::TimedOut);
        inbox.put_state(&state);
        assert!(inbox.try_put_control(&control));
        let mut received_items = Vec::new();
        while let Some(received) = inbox.take(Duration::MAX) {
            received_items.push(received);
        }
        let ended = Received::Ended(Ending::TimedOut);
        assert_eq!(
            received_items,
            [Received::Control(control), Received::State(state), ended]
        );
    }

    #[test]
    fn state_drops_its_oldest_beyond_the_bound() {
        let inbox = Inbox::default();
        let numbered = |n: u32| Bytes::from([n.to_be_bytes().as_slice(), &[0; 996]].concat());
        for n in 0..10_000 {
            inbox.put_state(&numbered(n));
        }
        let kept = STATE_INBOX_BYTES / (1_000 + PIECE_COST_BYTES);
        assert_eq!(inbox.state_dropped(), 10_000 - kept as u64);
        let oldest = u32::try_from(10_000 - kept).unwrap();
        assert_eq!(
            inbox.take(Duration::ZERO),
            Some(Received::State(numbered(oldest)))
        );
    }

    #[test]
    fn a_receiver_that_does_not_wait_is_called_for_each_arrival() {
        let inbox = Inbox::default();
        let bytes = Bytes::from_static(b"b");
        inbox.put_state(&bytes);
        let calls = Arc::new(AtomicUsize::new(0));
        let counted = Arc::clone(&calls);
        inbox.on_arrival(move || {
            counted.fetch_add(1, Ordering::Relaxed);
        });
        assert_eq!(calls.load(Ordering::Relaxed), 1, "something came before");
        assert!(inbox.try_put_control(&bytes));
        inbox.put_state(&bytes);
        inbox.put_end(Ending::TimedOut);
        assert_eq!(calls.load(Ordering::Relaxed), 4);
    }

    #[test]
    fn control_waits_at_the_bound() {
        let inbox = Inbox::default();
        let piece = Bytes::from(vec![0; 1_000]);
        let mut taken = 0;
        while inbox.try_put_control(&piece) {
            taken += 1;
        }
        assert!(taken * piece.len() <= CONTROL_IN_FLIGHT_BYTES + piece.len());
        assert!(inbox.take(Duration::ZERO).is_some());
        assert!(inbox.try_put_control(&piece));
    }
}
