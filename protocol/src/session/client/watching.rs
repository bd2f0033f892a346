//! When a client asks again for what is missing, doubted or awaited.

use crate::message::ClientMessage;
use crate::time::{Instant, Span};

use super::ClientSession;

/// How long a gap may be the network's disorder before it counts as loss.
pub(super) const DISORDER: Span = Span::from_millis(4);
/// How often a member tells what it lost, where parities gave that back.
const REPORT: Span = Span::from_millis(500);
/// The longest silence between two askings for one repair.
pub(super) const REPAIR_MOST: Span = Span::from_millis(500);
/// The pause between two askings for the whole scene, unless the stream was settled between them. It doubles, so that a
/// link that is too thin for the scene is not filled with snapshots.
const RESYNC_AGAIN: Span = Span::from_millis(1_000);
/// See [`RESYNC_AGAIN`].
pub(super) const RESYNC_MOST: Span = Span::from_millis(16_000);
/// How long an advance may be unanswered before it is asked after, where twice what the last ones took is not longer.
pub(super) const SILENCE: Span = Span::from_millis(100);
/// How long beyond [`SILENCE`] any stream may be silent before it is asked: its last packet may be the lost one. One
/// that runs freely vouches each two and a half seconds at least.
const SILENCE_UNASKED: Span = Span::from_millis(2_900);
/// See [`SILENCE`].
pub(super) const SILENCE_MOST: Span = Span::from_millis(2_000);

impl ClientSession {
    /// Whether a tick that was asked for is not there yet.
    pub(super) fn awaits(&self) -> bool {
        let complete = self.copies.shown().map(|copy| copy.stream().complete());
        complete.is_some_and(|complete| complete < self.awaited)
    }

    /// Waits for a tick that was asked for, as long as the last ones let expect.
    pub(super) fn await_tick(&mut self, now: Instant) {
        let patience = self.answers.patience(SILENCE_MOST);
        self.silence.begin_for(now, patience);
    }

    fn send_echoes(&mut self, now: Instant) {
        self.reported = (now, self.copies.lost());
        self.send_states(self.copies.echoes());
    }

    /// Whether a snapshot was asked for that has not come: that of the stream again, or that of another one.
    const fn awaits_snapshot(&self) -> bool {
        self.resyncing || self.choosing.is_asking()
    }

    /// When to ask for the whole scene again.
    pub(super) fn touch_due(&self) -> Option<Instant> {
        let due = self.touch.due()?;
        (self.copies.have_lost_touch() && !self.awaits_snapshot()).then_some(due)
    }

    /// Looks at the stream after anything was heard: is something missing, or something awaited?
    pub(super) fn watch(&mut self, now: Instant) {
        self.change_copies();
        let Some(copy) = self.copies.shown() else {
            return;
        };
        self.answers.hear(now, copy.stream().complete());
        let (settled, awaits) = (copy.stream().is_settled(), self.awaits());
        self.copies.watch_missing(now);
        let (at, lost) = self.reported;
        if !self.copies.miss() && self.copies.lost() != lost && now >= at + REPORT {
            self.send_echoes(now);
        }
        if self.copies.doubts() {
            self.doubt.begin(now);
        } else {
            self.doubt.end();
        }
        let lost_touch = self.copies.have_lost_touch();
        if lost_touch {
            self.touch.begin(now);
        } else if settled {
            self.touch.end();
        }
        if lost_touch && !self.awaits_snapshot() && self.touch.ask(now, RESYNC_AGAIN) {
            self.resyncing = true;
            self.say(&ClientMessage::Resync);
        }
        self.silence.end();
        if awaits {
            self.await_tick(now);
        } else {
            self.silence.begin(now + SILENCE_UNASKED);
        }
    }

    /// Asks for what is due by now.
    pub(super) fn ask_what_is_due(&mut self, now: Instant) {
        let patient = Span::from_nanos(self.round_trip.as_nanos() * 5 / 4);
        let asked = self.copies.ask(now, patient);
        if self.silence.ask(now, patient) {
            self.send_echoes(now);
        } else if !asked.is_empty() {
            self.reported = (now, self.copies.lost());
            self.send_states(asked);
        }
        if self.doubt.ask(now, patient) {
            self.send_states(self.copies.questions());
        }
        if self.touch_due().is_some_and(|due| due <= now) {
            self.watch(now);
        }
    }
}
