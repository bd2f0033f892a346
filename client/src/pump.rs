//! Moves bytes between a connection and its session, on the caller's thread.
//!
//! Contains no protocol logic. A wait ends at the given deadline at the latest.

use std::time::Duration;

use rhumb_protocol::session::ClientSession;
use rhumb_protocol::{Endpoint, Instant, Peer, Span, Transmit};
use rhumb_transport::{Clock, Received};

use crate::reconnector::{ReconnectProgress, Reconnector, first_pause};
use crate::redial::{BoxedConnection, Redial};

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

    /// Handles received data, and waits for its first piece until `deadline` at most; `false` when nothing arrived.
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
        let mut received_any = false;
        let mut next = self.connection.recv(wait);
        let mut left = PIECES_PER_TURN;
        while let Some(received) = next {
            received_any = true;
            self.handle(received);
            left -= 1;
            if left == 0 {
                break;
            }
            next = self.connection.recv(Duration::ZERO);
        }
        self.session.handle_timeout(self.clock.now());
        self.flush();
        received_any
    }

    /// Begins to reach the server again, to go on with the session; `false` if it cannot. `full_since`: the time for
    /// which it has had no place; the present one otherwise.
    pub(crate) fn reconnect(&mut self, full_since: Instant, until: Instant) -> bool {
        let Some(redial) = self.redial.clone().filter(|_| self.session.can_reconnect()) else {
            return false;
        };
        let full_for = Duration::from_nanos(self.clock.now().since(full_since).as_nanos());
        match Reconnector::start(redial, self.clock, first_pause(full_for), until) {
            Ok(reconnector) => {
                self.reconnector = Some(reconnector);
                self.session.reconnect().is_ok()
            }
            Err(_) => false,
        }
    }

    /// True if the attempts to reach the server again are over without success.
    pub(crate) const fn has_given_up(&self) -> bool {
        self.gave_up
    }

    /// Waits until `deadline` at most for the server to be reached again.
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
