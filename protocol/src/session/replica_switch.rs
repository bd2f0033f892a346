//! The copy of a scene that a member shows, with its successor.
//!
//! Decides when one gives way to the other, and nothing else. Invariant: what is shown never falls back to an earlier
//! complete tick, unless it had lost sync.

use alloc::vec::Vec;

use bytes::Bytes;

use super::close::CloseCode;
use super::replica::Replica;
use crate::message::{Joined, ResyncCause, SceneEvent};
use crate::packet::Datagram;
use crate::stream::StreamReceiver;
use crate::time::{Instant, Span};

/// The replicas of one membership.
#[derive(Debug, Default)]
pub(crate) struct ReplicaSwitch {
    shown: Option<Replica>,
    /// The copy that a snapshot is filling, or that is whole and not as far yet as the one shown.
    next: Option<Replica>,
}

/// Where a scene event belongs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum EventTarget {
    /// It is part of a snapshot.
    Snapshot,
    /// It is news of the scene.
    Scene,
}

impl ReplicaSwitch {
    pub(crate) const fn new() -> Self {
        Self {
            shown: None,
            next: None,
        }
    }

    /// The copy to look at.
    pub(crate) const fn shown(&self) -> Option<&Replica> {
        self.shown.as_ref()
    }

    /// See [`Self::shown`].
    pub(crate) const fn shown_mut(&mut self) -> Option<&mut Replica> {
        self.shown.as_mut()
    }

    /// A snapshot begins.
    pub(crate) fn begin(&mut self, joined: &Joined) {
        self.next = Some(Replica::new(joined));
    }

    /// The snapshot is whole; the first of a membership is shown at once.
    pub(crate) fn end_snapshot(&mut self) -> Result<(), CloseCode> {
        let filling = self.next.as_mut().filter(|copy| !copy.is_complete());
        filling.ok_or(CloseCode::VIOLATION)?.end_snapshot();
        if self.shown.is_none() {
            self.shown = self.next.take();
        }
        Ok(())
    }

    /// Shows the next copy if it is as far, so that nobody sees a gap; returns the one that was shown before.
    pub(crate) fn switch_when_caught_up(&mut self) -> Option<Replica> {
        let shown = self.shown.as_mut()?;
        let as_far = |next: &mut Replica| next.is_complete() && next.has_caught_up_with(shown);
        let mut next = self.next.take_if(as_far)?;
        next.take_over(shown);
        Some(core::mem::replace(shown, next))
    }

    /// Takes in a scene event.
    pub(crate) fn handle_scene_event(
        &mut self,
        scene_event: &SceneEvent,
    ) -> Result<EventTarget, CloseCode> {
        if let Some(next) = &mut self.next {
            let filling = !next.is_complete();
            next.apply_scene_event(scene_event)?;
            if filling {
                return Ok(EventTarget::Snapshot);
            }
        }
        let shown = self.shown.as_mut().ok_or(CloseCode::VIOLATION)?;
        shown.apply_scene_event(scene_event)?;
        Ok(EventTarget::Scene)
    }

    /// Takes in a datagram of whichever streams it is about.
    pub(crate) fn handle_datagram(&mut self, datagram: &Datagram<'_>) {
        for copy in [&mut self.next, &mut self.shown].into_iter().flatten() {
            if copy.stream().stream() == datagram.head().stream {
                copy.stream_mut().handle(datagram);
            }
        }
    }

    /// The receivers of replicas that are whole, the shown one first.
    pub(crate) fn receivers(&self) -> impl Iterator<Item = &StreamReceiver> {
        let replica_switch = [self.shown.as_ref(), self.next.as_ref()];
        let whole = replica_switch
            .into_iter()
            .flatten()
            .filter(|copy| copy.is_complete());
        whole.map(|copy| &copy.receiver)
    }

    /// See [`Self::receivers`].
    pub(crate) fn receivers_mut(&mut self) -> impl Iterator<Item = &mut StreamReceiver> {
        let replica_switch = [self.shown.as_mut(), self.next.as_mut()];
        let whole = replica_switch
            .into_iter()
            .flatten()
            .filter(|copy| copy.is_complete());
        whole.map(|copy| &mut copy.receiver)
    }

    /// What to report now.
    pub(crate) fn report(&mut self, now: Instant, min_delay: Span) -> Vec<Bytes> {
        let mut reports = Vec::new();
        for receiver in self.receivers_mut() {
            receiver.report(now, min_delay, &mut reports);
        }
        reports
    }

    /// The copy of the newest stream, which will replace the shown one.
    fn newest(&self) -> Option<&Replica> {
        self.next.as_ref().or(self.shown.as_ref())
    }

    /// Whether only a new snapshot helps.
    pub(crate) fn have_lost_sync(&self) -> bool {
        self.newest()
            .is_some_and(|copy| copy.stream().has_lost_sync())
    }

    /// The cause to give if a new snapshot is requested.
    pub(crate) fn resync_cause(&self) -> ResyncCause {
        if self
            .newest()
            .is_some_and(|copy| copy.stream().has_mismatched())
        {
            ResyncCause::ChecksumMismatch
        } else {
            ResyncCause::LostSync
        }
    }
}
