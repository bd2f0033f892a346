//! Attempts to reach a server again, on a thread of their own.
//!
//! The pause before each attempt doubles up to a limit, and is shortened at random, so that the clients of a server that
//! comes back do not all arrive at once.

use std::collections::hash_map::RandomState;
use std::hash::BuildHasher as _;
use std::io;
use std::sync::mpsc::{Receiver, RecvTimeoutError, TrySendError, sync_channel};
use std::thread;
use std::time::Duration;

use rhumb_protocol::Instant;
use rhumb_transport::Clock;

use crate::redial::{BoxedConnection, Redial};

/// First pause.
const PAUSE_FIRST: Duration = Duration::from_millis(100);
/// Longest pause.
const PAUSE_MAX: Duration = Duration::from_secs(5);
/// Time for one attempt.
const ATTEMPT: Duration = Duration::from_secs(3);

/// Attempts that go on until one succeeds or the time is over.
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
    /// Begins the attempts after a pause; none begins after a moment of this clock.
    pub(crate) fn start(
        redial: Redial,
        clock: Clock,
        pause: Duration,
        until: Instant,
    ) -> io::Result<Self> {
        let (to, connected) = sync_channel(1);
        let attempts = move || {
            // A client that is gone needs no connection: it closes when it is dropped.
            match to.try_send(run(&redial, clock, pause, until)) {
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

/// Attempts to connect; `None` if none succeeds in time.
fn run(
    redial: &Redial,
    clock: Clock,
    mut pause: Duration,
    until: Instant,
) -> Option<BoxedConnection> {
    loop {
        thread::sleep(shortened(pause));
        if clock.now() >= until {
            return None;
        }
        if let Some(connection) = redial(ATTEMPT) {
            return Some(connection);
        }
        pause = (pause * 2).min(PAUSE_MAX);
    }
}

/// A pause between half of this one and all of it.
fn shortened(pause: Duration) -> Duration {
    // Each state of the library's hashes has another random key.
    let [share, ..] = RandomState::new().hash_one(()).to_ne_bytes();
    pause / 2 + pause / 2 * u32::from(share) / 255
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
