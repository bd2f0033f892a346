//! The timers of a client's loss reports and resyncs.

use super::super::event::Event;
use crate::message::{ClientMessage, ResyncCause};
use crate::stream::SILENCE_MOST;
use crate::time::{Instant, Span};

use super::ClientSession;
use super::timeouts::RESYNC_AGAIN;

impl ClientSession {
    /// True if a tick requested by `advance` is not complete yet.
    pub(super) fn awaits(&self) -> bool {
        let complete = self
            .replica_switch
            .shown()
            .map(|replica| replica.stream().complete());
        complete.is_some_and(|complete| complete < self.awaited)
    }

    /// Starts the timeout for a requested tick. The latest response times decide its length.
    pub(super) fn await_tick(&mut self, now: Instant) {
        let timeout = self.response_times.timeout(SILENCE_MOST);
        for receiver in self.replica_switch.receivers_mut() {
            receiver.expect_within(now, timeout);
        }
    }

    /// True if a requested snapshot is pending, of the present stream or of another one.
    const fn awaits_snapshot(&self) -> bool {
        self.resyncing || self.stream_selection.awaits_answer()
    }

    /// The time of the next request for a snapshot; None if the replica has not lost sync.
    pub(super) fn resync_due(&self) -> Option<Instant> {
        let due = self.resync_timer.due()?;
        (self.replica_switch.have_lost_sync() && !self.awaits_snapshot()).then_some(due)
    }

    /// Shows a replica that has caught up and restarts the timers. Called after each received message and datagram.
    pub(super) fn watch(&mut self, now: Instant) {
        self.switch_replica();
        let Some(replica) = self.replica_switch.shown() else {
            return;
        };
        self.response_times
            .note_complete(now, replica.stream().complete());
        let (converged, awaits) = (replica.stream().is_converged(), self.awaits());
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
        if lost_sync && !self.awaits_snapshot() && self.resync_timer.fire(now, RESYNC_AGAIN) {
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

    /// Sends the reports due now.
    pub(super) fn report(&mut self, now: Instant) {
        let min_delay = Span::from_nanos(self.round_trip.as_nanos() * 5 / 4);
        let reports = self.replica_switch.report(now, min_delay);
        self.send_states(reports);
        if self.resync_due().is_some_and(|due| due <= now) {
            self.watch(now);
        }
    }
}
