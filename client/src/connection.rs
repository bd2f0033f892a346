//! A connection to a server, its session, and attempts to reach it again.
//!
//! Moves bytes between the two on the caller's thread, and contains no protocol logic. A wait ends at the given deadline
//! at the latest. Attempts to reach the server again have a thread of their own: the pause before each of them doubles up
//! to a limit, and is shortened at random, so that the clients of a server that comes back do not all arrive at once.

use std::collections::hash_map::RandomState;
use std::hash::BuildHasher as _;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, RecvTimeoutError, TrySendError, sync_channel};
use std::time::Duration;
use std::{io, thread};

use rhumb_link::{ClientTransport, Clock, Received, WireStatistics};
use rhumb_protocol::session::ClientSession;
use rhumb_protocol::stream::{PublisherStatistics, SubscriberStatistics};
use rhumb_protocol::{Endpoint, Instant, Peer, Span, Transmit};
use rhumb_reckoning::Tick;

/// A connection, whatever carries its bytes.
pub(crate) type BoxedConnection = Box<dyn ClientTransport>;

/// Reaches the server of an ended connection again, within some time, or the server at an address that it has named.
pub(crate) type Redial =
    Arc<dyn Fn(Option<&str>, Duration) -> Option<BoxedConnection> + Send + Sync>;

/// A connection and its session.
pub(crate) struct Pump {
    pub(crate) session: ClientSession,
    pub(crate) connection: BoxedConnection,
    /// Reaches the server again, if that is possible.
    redial: Option<Redial>,
    reconnector: Option<Reconnector>,
    clock: Clock,
    /// True if the server could not be reached again.
    gave_up: bool,
    /// Attempts in a row that began at a server that another one had named.
    followed: u32,
    /// Called with all bytes in both directions, for recording.
    tap: Option<Tap>,
}

/// Callback that receives all bytes between session and connection.
pub(crate) type Tap = Box<dyn FnMut(TapChannel, &[u8]) + Send>;

/// Channel and direction of bytes between a client and its server.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TapChannel {
    /// Bytes of the control stream from the server.
    ControlDown,
    /// Bytes of the control stream to the server.
    ControlUp,
    /// A datagram from the server.
    StateDown,
    /// A datagram to the server.
    StateUp,
}

/// Limit of received pieces per turn, so that a fast server cannot starve timers and the caller.
const PIECES_PER_TURN: usize = 4_096;

/// Limit of turns in which a call reads what waits for it. Derived: an inbox of 4 MiB holds 16 turns of empty datagrams.
pub(crate) const TURNS_MAX: usize = 32;

/// The one peer of a client.
const SERVER: Peer = Peer(0);

impl Pump {
    pub(crate) fn new(
        session: ClientSession,
        connection: BoxedConnection,
        redial: Option<Redial>,
    ) -> Self {
        let mut pump = Self {
            session,
            connection,
            redial,
            reconnector: None,
            gave_up: false,
            followed: 0,
            clock: Clock::start(),
            tap: None,
        };
        pump.session.handle_opened(pump.clock.now(), SERVER);
        pump.flush();
        pump
    }

    pub(crate) fn now(&self) -> Instant {
        self.clock.now()
    }

    pub(crate) fn tap(&mut self, tap: Tap) {
        self.tap = Some(tap);
    }

    /// Sends everything that the session has queued.
    pub(crate) fn flush(&mut self) {
        while let Some(transmit) = self.session.poll_transmit() {
            match transmit {
                Transmit::Control { bytes, .. } => {
                    self.note(TapChannel::ControlUp, &bytes);
                    self.connection.send_control(bytes);
                }
                Transmit::State { bytes, .. } => {
                    self.note(TapChannel::StateUp, &bytes);
                    self.connection.send_state(bytes);
                }
                Transmit::Close { code, .. } => self.connection.close(code),
            }
        }
    }

    /// Handles received data, and waits for its first piece until `deadline` at most; `true` if more may wait than one
    /// turn handles.
    pub(crate) fn turn(&mut self, deadline: Instant) -> bool {
        if self.reconnector.is_some() {
            return self.await_connection(deadline);
        }
        self.flush();
        let now = self.clock.now();
        let wake = self
            .session
            .poll_timeout()
            .map_or(deadline, |wake| wake.at.min(deadline));
        let wait = Duration::from_nanos(wake.since(now).as_nanos());
        let mut next = self.connection.recv(wait);
        let mut left = PIECES_PER_TURN;
        while let Some(received) = next {
            self.handle(received);
            left -= 1;
            if left == 0 {
                break;
            }
            next = self.connection.recv(Duration::ZERO);
        }
        self.session.handle_timeout(self.clock.now());
        self.flush();
        left == 0
    }

    /// Begins to reach the server again, to continue the session; `false` if it cannot. `full_since`: the time for
    /// which it has had no place; the present one otherwise.
    ///
    /// A server that has named another one is not waited for: the first attempt goes there at once. After
    /// [`FOLLOWED_MAX`] in a row there is a pause, as servers may name each other.
    pub(crate) fn reconnect(&mut self, full_since: Instant, until: Instant) -> bool {
        let named = self.session.elsewhere().map(str::to_owned);
        let elsewhere = named.filter(|_| self.followed < FOLLOWED_MAX);
        self.followed = elsewhere.as_ref().map_or(0, |_| self.followed + 1);
        let Some(redial) = self.redial.clone().filter(|_| self.session.can_reconnect()) else {
            return false;
        };
        let full_for = Duration::from_nanos(self.clock.now().since(full_since).as_nanos());
        let attempts = Attempts {
            redial,
            elsewhere,
            clock: self.clock,
            pause: first_pause(full_for),
            until,
        };
        match Reconnector::start(attempts) {
            Ok(reconnector) => {
                self.reconnector = Some(reconnector);
                self.session.reconnect().is_ok()
            }
            Err(_) => false,
        }
    }

    /// Goes with a new session to the server that the last one has named; `false` if it named none, or none that answers.
    pub(crate) fn follow(&mut self, session: ClientSession, timeout: Duration) -> bool {
        let place = self.session.elsewhere().map(str::to_owned);
        place.is_some_and(|place| self.open(Some(&place), session, timeout))
    }

    /// Goes with a new session to one of the servers of its own address; `false` if none answers.
    pub(crate) fn ask_again(&mut self, session: ClientSession, timeout: Duration) -> bool {
        self.open(None, session, timeout)
    }

    fn open(&mut self, place: Option<&str>, session: ClientSession, timeout: Duration) -> bool {
        let reached = (self.redial.as_ref()).and_then(|redial| redial(place, timeout));
        let Some(connection) = reached else {
            return false;
        };
        self.connection = connection;
        self.session = session;
        self.session.handle_opened(self.clock.now(), SERVER);
        self.flush();
        true
    }

    /// True if the attempts to reach the server again are over without success.
    pub(crate) const fn has_given_up(&self) -> bool {
        self.gave_up
    }

    /// Waits until `deadline` at most for the server to be reached again; `true` if it is.
    fn await_connection(&mut self, deadline: Instant) -> bool {
        let now = self.clock.now();
        let wait = Duration::from_nanos(deadline.since(now).as_nanos());
        let progress = self
            .reconnector
            .as_ref()
            .map(|attempts| attempts.wait(wait));
        match progress {
            Some(ReconnectProgress::Connected(connection)) => {
                self.connection = connection;
                self.session.handle_opened(self.clock.now(), SERVER);
                self.flush();
            }
            Some(ReconnectProgress::GaveUp) | None => self.gave_up = true,
            Some(ReconnectProgress::Trying) => return false,
        }
        self.reconnector = None;
        true
    }

    fn handle(&mut self, received: Received) {
        let now = self.clock.now();
        match received {
            Received::Control(bytes) => {
                self.note(TapChannel::ControlDown, &bytes);
                self.session.handle_control(now, SERVER, &bytes);
            }
            Received::State(bytes) => {
                self.note(TapChannel::StateDown, &bytes);
                self.session.handle_datagram(now, SERVER, &bytes);
            }
            Received::Ended(ending) => self.session.handle_ended(now, SERVER, ending),
        }
    }

    fn note(&mut self, channel: TapChannel, bytes: &[u8]) {
        if let Some(tap) = &mut self.tap {
            tap(channel, bytes);
        }
    }
}

/// A duration as a protocol span; longer ones than the span's maximum (centuries) saturate.
pub(crate) fn span(duration: Duration) -> Span {
    Span::from_nanos(u64::try_from(duration.as_nanos()).unwrap_or(u64::MAX))
}

/// Servers that a client asks for one scene, each named by the one before, before it waits.
pub(crate) const FOLLOWED_MAX: u32 = 8;
/// First pause.
pub(crate) const PAUSE_FIRST: Duration = Duration::from_millis(100);
/// Longest pause.
const PAUSE_MAX: Duration = Duration::from_secs(5);
/// Time for one attempt.
pub(crate) const ATTEMPT: Duration = Duration::from_secs(3);
/// Time for one attempt at a server that another one has named: it may have ended since.
const ATTEMPT_ELSEWHERE: Duration = Duration::from_secs(1);

/// Attempts to reach a server again: each after a pause, and none from a moment of the clock on.
pub(crate) struct Attempts {
    pub(crate) redial: Redial,
    /// The address that the last server has named, tried first and at once.
    pub(crate) elsewhere: Option<String>,
    pub(crate) clock: Clock,
    pub(crate) pause: Duration,
    pub(crate) until: Instant,
}

/// Attempts until one succeeds or the time is over.
pub(crate) struct Reconnector {
    connected: Receiver<Option<BoxedConnection>>,
}

/// The state of the attempts.
pub(crate) enum ReconnectProgress {
    Connected(BoxedConnection),
    Trying,
    GaveUp,
}

impl Reconnector {
    /// Begins the attempts.
    pub(crate) fn start(attempts: Attempts) -> io::Result<Self> {
        let (to, connected) = sync_channel(1);
        let attempts = move || {
            // A client that is gone needs no connection: it closes when it is dropped.
            match to.try_send(attempts.run()) {
                Ok(()) | Err(TrySendError::Full(_) | TrySendError::Disconnected(_)) => {}
            }
        };
        thread::Builder::new()
            .name("rhumb-reconnect".to_owned())
            .spawn(attempts)?;
        Ok(Self { connected })
    }

    /// Waits for a connection for some time at most.
    pub(crate) fn wait(&self, timeout: Duration) -> ReconnectProgress {
        match self.connected.recv_timeout(timeout) {
            Ok(Some(connection)) => ReconnectProgress::Connected(connection),
            Ok(None) | Err(RecvTimeoutError::Disconnected) => ReconnectProgress::GaveUp,
            Err(RecvTimeoutError::Timeout) => ReconnectProgress::Trying,
        }
    }
}

/// The pause before the next attempt at a server that has had no place for so long: the time grows by half with each.
pub(crate) fn first_pause(full_for: Duration) -> Duration {
    (full_for / 2).clamp(PAUSE_FIRST, PAUSE_MAX)
}

impl Attempts {
    /// A connection; `None` if no attempt succeeds in time.
    fn run(self) -> Option<BoxedConnection> {
        if let Some(place) = &self.elsewhere
            && let Some(connection) = (self.redial)(Some(place), ATTEMPT_ELSEWHERE)
        {
            return Some(connection);
        }
        let mut pause = self.pause;
        loop {
            thread::sleep(shortened(pause));
            if self.clock.now() >= self.until {
                return None;
            }
            if let Some(connection) = (self.redial)(None, ATTEMPT) {
                return Some(connection);
            }
            pause = (pause * 2).min(PAUSE_MAX);
        }
    }
}

/// A pause between half of this one and all of it.
fn shortened(pause: Duration) -> Duration {
    // Each state of the library's hashes has another random key.
    let [share, ..] = RandomState::new().hash_one(()).to_ne_bytes();
    pause / 2 + pause / 2 * u32::from(share) / 255
}

/// Statistics of a client's connection and stream.
#[derive(Clone, Copy, Debug)]
pub struct Statistics {
    /// Bytes, datagrams and round trip of the connection.
    pub wire: WireStatistics,
    /// Packets and updates received.
    pub stream: SubscriberStatistics,
    /// Packets and updates of the upstream since the last authority grant.
    pub upstream: PublisherStatistics,
    /// The newest tick up to which the subscriber knows that everything is published.
    pub watermark_tick: Tick,
    /// The newest tick at which every body is within its tolerance.
    pub complete: Tick,
    /// Ticks by which the view lies behind the server's clock; `None` before the clock is known.
    pub behind_ticks: Option<f64>,
    /// Events that were dropped unread: [`poll_event`](crate::Client::poll_event) was not called for more than are kept.
    pub events_left_out: u64,
    /// Pairs that touch and that [`contacts`](crate::Client::contacts) lacks; see
    /// [`contacts_left_out`](crate::Client::contacts_left_out).
    pub contacts_left_out: u64,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_server_that_has_no_place_is_asked_ever_more_rarely() {
        let (mut tried, mut attempts) = (Duration::ZERO, 0);
        while tried < Duration::from_secs(60) {
            tried += first_pause(tried);
            attempts += 1;
        }
        assert!((10..=25).contains(&attempts), "{attempts}");
    }

    #[test]
    fn a_pause_is_shortened_by_half_at_most() {
        for _ in 0..100 {
            let pause = shortened(PAUSE_FIRST);
            assert!(pause >= PAUSE_FIRST / 2 && pause <= PAUSE_FIRST);
        }
    }
}
