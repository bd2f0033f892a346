//! When a client reports what its replicas lack, and asks for a whole scene.

use super::super::event::Event;
use crate::message::{ClientMessage, ResyncCause};
use crate::stream::SILENCE_MOST;
use crate::time::{Instant, Span};

use super::ClientSession;

/// The pause between two requests for the whole scene, unless the stream converged between them. It doubles, so that a
/// link that is too thin for the scene is not filled with snapshots.
const RESYNC_AGAIN: Span = Span::from_millis(1_000);
/// See [`RESYNC_AGAIN`].
pub(super) const RESYNC_MOST: Span = Span::from_millis(16_000);

impl ClientSession {
    /// Whether a tick that was asked for is not there yet.
    pub(super) fn awaits(&self) -> bool {
        let complete = self
            .replica_switch
            .shown()
            .map(|copy| copy.stream().complete());
        complete.is_some_and(|complete| complete < self.awaited)
    }

    /// Starts the timeout for a tick that was asked for; the last ones decide how long it is.
    pub(super) fn await_tick(&mut self, now: Instant) {
        let timeout = self.response_times.timeout(SILENCE_MOST);
        for receiver in self.replica_switch.receivers_mut() {
            receiver.expect_within(now, timeout);
        }
    }

    /// Whether a snapshot was asked for that has not come: that of the stream again, or that of another one.
    const fn awaits_snapshot(&self) -> bool {
        self.resyncing || self.stream_selection.is_asking()
    }

    /// When to ask for the whole scene again.
    pub(super) fn resync_due(&self) -> Option<Instant> {
        let due = self.resync_timer.due()?;
        (self.replica_switch.have_lost_sync() && !self.awaits_snapshot()).then_some(due)
    }

    /// Restarts timers after anything was received.
    pub(super) fn watch(&mut self, now: Instant) {
        self.switch_replica();
        let Some(copy) = self.replica_switch.shown() else {
            return;
        };
        self.response_times
            .note_complete(now, copy.stream().complete());
        let (converged, awaits) = (copy.stream().is_converged(), self.awaits());
        for receiver in self.replica_switch.receivers_mut() {
            receiver.watch(now);
            if awaits {
                receiver.end_silence();
            } else {
                receiver.expect_watermark(now);
            }
        }
        let lost_sync = self.replica_switch.have_lost_sync();
        if lost_sync {
            self.resync_timer.begin(now);
        } else if converged {
            self.resync_timer.end();
        }
        if lost_sync && !self.awaits_snapshot() && self.resync_timer.ask(now, RESYNC_AGAIN) {
            self.resyncing = true;
            let cause = self.replica_switch.resync_cause();
            if cause == ResyncCause::ChecksumMismatch {
                self.events.push_back(Event::ChecksumMismatch);
            }
            self.send(&ClientMessage::Resync(cause));
        }
        if awaits {
            self.await_tick(now);
        }
    }

    /// Reports what is due by now.
    pub(super) fn report(&mut self, now: Instant) {
        let min_delay = Span::from_nanos(self.round_trip.as_nanos() * 5 / 4);
        let reports = self.replica_switch.report(now, min_delay);
        self.send_states(reports);
        if self.resync_due().is_some_and(|due| due <= now) {
            self.watch(now);
        }
    }
}
