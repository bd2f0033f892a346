//! When a client asks again for what is missing, doubted or awaited.

use crate::message::ClientMessage;
use crate::time::{Instant, Span};

use super::ClientSession;

/// How long a gap may be the network's disorder before it counts as loss.
pub(super) const DISORDER: Span = Span::from_millis(4);
/// How often a member tells what it lost, where repair_symbols gave that back.
const REPORT: Span = Span::from_millis(500);
/// The longest silence between two askings for one refresh.
pub(super) const REPAIR_MOST: Span = Span::from_millis(500);
/// The pause between two askings for the whole scene, unless the stream was converged between them. It doubles, so that a
/// link that is too thin for the scene is not filled with snapshots.
const RESYNC_AGAIN: Span = Span::from_millis(1_000);
/// See [`RESYNC_AGAIN`].
pub(super) const RESYNC_MOST: Span = Span::from_millis(16_000);
/// How long an advance may be unanswered before it is asked after, where twice what the last ones took is not longer.
pub(super) const SILENCE: Span = Span::from_millis(100);
/// How long beyond [`SILENCE`] any stream may be silent before it is asked: its last packet may be the lost one. One
/// that runs freely watermarks each two and a half seconds at least.
const SILENCE_UNASKED: Span = Span::from_millis(2_900);
/// See [`SILENCE`].
pub(super) const SILENCE_MOST: Span = Span::from_millis(2_000);

impl ClientSession {
    /// Whether a tick that was asked for is not there yet.
    pub(super) fn awaits(&self) -> bool {
        let complete = self
            .replica_switch
            .shown()
            .map(|copy| copy.stream().complete());
        complete.is_some_and(|complete| complete < self.awaited)
    }

    /// Waits for a tick that was asked for, as long as the last ones let expect.
    pub(super) fn await_tick(&mut self, now: Instant) {
        let timeout = self.response_times.timeout(SILENCE_MOST);
        self.silence.begin_for(now, timeout);
    }

    fn send_loss_reports(&mut self, now: Instant) {
        self.reported = (now, self.replica_switch.lost());
        self.send_states(self.replica_switch.loss_reports());
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

    /// Looks at the stream after anything was heard: is something missing, or something awaited?
    pub(super) fn watch(&mut self, now: Instant) {
        self.switch_replica();
        let Some(copy) = self.replica_switch.shown() else {
            return;
        };
        self.response_times
            .note_complete(now, copy.stream().complete());
        let (converged, awaits) = (copy.stream().is_converged(), self.awaits());
        self.replica_switch.watch_missing(now);
        let (at, lost) = self.reported;
        if !self.replica_switch.has_missing()
            && self.replica_switch.lost() != lost
            && now >= at + REPORT
        {
            self.send_loss_reports(now);
        }
        if self.replica_switch.has_mismatch() {
            self.mismatch.begin(now);
        } else {
            self.mismatch.end();
        }
        let lost_sync = self.replica_switch.have_lost_sync();
        if lost_sync {
            self.resync_timer.begin(now);
        } else if converged {
            self.resync_timer.end();
        }
        if lost_sync && !self.awaits_snapshot() && self.resync_timer.ask(now, RESYNC_AGAIN) {
            self.resyncing = true;
            self.send(&ClientMessage::Resync);
        }
        self.silence.end();
        if awaits {
            self.await_tick(now);
        } else {
            self.silence.begin(now + SILENCE_UNASKED);
        }
    }

    /// Asks for what is due by now.
    pub(super) fn send_due_requests(&mut self, now: Instant) {
        let min_delay = Span::from_nanos(self.round_trip.as_nanos() * 5 / 4);
        let asked = self.replica_switch.ask(now, min_delay);
        if self.silence.ask(now, min_delay) {
            self.send_loss_reports(now);
        } else if !asked.is_empty() {
            self.reported = (now, self.replica_switch.lost());
            self.send_states(asked);
        }
        if self.mismatch.ask(now, min_delay) {
            self.send_states(self.replica_switch.mismatch_reports());
        }
        if self.resync_due().is_some_and(|due| due <= now) {
            self.watch(now);
        }
    }
}
