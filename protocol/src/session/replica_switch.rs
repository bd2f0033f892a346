//! Switches a member from one replica of a scene to the next.
//!
//! Decides only when the next replica replaces the shown one. Invariant: the shown replica never falls back to an
//! earlier complete tick, unless it had lost sync.

use alloc::vec::Vec;

use bytes::Bytes;

use super::close::CloseCode;
use super::replica::Replica;
use crate::endpoint::{Instant, Span};
use crate::message::{Joined, ResyncCause, SceneEvent};
use crate::packet::Datagram;
use crate::stream::StreamReceiver;

/// The replicas of one membership.
#[derive(Debug, Default)]
pub(crate) struct ReplicaSwitch {
    shown: Option<Replica>,
    /// The replica that a snapshot is filling, or a complete one that has not caught up with the shown one.
    next: Option<Replica>,
}

/// The part of the protocol to which a scene event belongs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum EventTarget {
    /// The event is part of a snapshot.
    Snapshot,
    /// The event reports a change of the scene.
    Scene,
}

impl ReplicaSwitch {
    pub(crate) const fn new() -> Self {
        Self {
            shown: None,
            next: None,
        }
    }

    /// The replica that the application displays.
    pub(crate) const fn shown(&self) -> Option<&Replica> {
        self.shown.as_ref()
    }

    /// See [`Self::shown`].
    pub(crate) const fn shown_mut(&mut self) -> Option<&mut Replica> {
        self.shown.as_mut()
    }

    /// Starts a replica that the following snapshot fills.
    pub(crate) fn begin(&mut self, joined: &Joined) {
        self.next = Some(Replica::new(joined));
    }

    /// Completes the snapshot. The first replica of a membership is shown at once.
    pub(crate) fn end_snapshot(&mut self) -> Result<(), CloseCode> {
        let filling = self.next.as_mut().filter(|replica| !replica.is_complete());
        filling.ok_or(CloseCode::VIOLATION)?.end_snapshot();
        if self.shown.is_none() {
            self.shown = self.next.take();
        }
        Ok(())
    }

    /// Shows the next replica if it has caught up, so that the display has no gap. Returns the replaced replica.
    pub(crate) fn switch_when_caught_up(&mut self) -> Option<Replica> {
        let shown = self.shown.as_mut()?;
        let as_far = |next: &mut Replica| next.is_complete() && next.has_caught_up_with(shown);
        let mut next = self.next.take_if(as_far)?;
        next.take_over(shown);
        Some(core::mem::replace(shown, next))
    }

    /// Applies a scene event to the next replica, and to the shown one unless a snapshot is being filled.
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

    /// Hands a datagram to the replicas that follow its stream.
    pub(crate) fn handle_datagram(&mut self, datagram: &Datagram<'_>) {
        for replica in [&mut self.next, &mut self.shown].into_iter().flatten() {
            if replica.stream().stream() == datagram.head().stream {
                replica.stream_mut().handle(datagram);
            }
        }
    }

    /// The receivers of complete replicas, the shown one first.
    pub(crate) fn receivers(&self) -> impl Iterator<Item = &StreamReceiver> {
        let replicas = [self.shown.as_ref(), self.next.as_ref()];
        let complete = replicas
            .into_iter()
            .flatten()
            .filter(|replica| replica.is_complete());
        complete.map(|replica| &replica.receiver)
    }

    /// See [`Self::receivers`].
    pub(crate) fn receivers_mut(&mut self) -> impl Iterator<Item = &mut StreamReceiver> {
        let replicas = [self.shown.as_mut(), self.next.as_mut()];
        let complete = replicas
            .into_iter()
            .flatten()
            .filter(|replica| replica.is_complete());
        complete.map(|replica| &mut replica.receiver)
    }

    /// The reports due now.
    pub(crate) fn report(&mut self, now: Instant, min_delay: Span) -> Vec<Bytes> {
        let mut reports = Vec::new();
        for receiver in self.receivers_mut() {
            receiver.report(now, min_delay, &mut reports);
        }
        reports
    }

    /// A report that asks for the watermark of the shown replica, if one is due.
    pub(crate) fn query(&mut self, now: Instant, pause: Span) -> Vec<Bytes> {
        let mut reports = Vec::new();
        if let Some(replica) = &mut self.shown {
            replica.receiver.query(now, pause, &mut reports);
        }
        reports
    }

    /// The replica of the newest stream, which will replace the shown one.
    fn newest(&self) -> Option<&Replica> {
        self.next.as_ref().or(self.shown.as_ref())
    }

    /// True if only a new snapshot helps.
    pub(crate) fn have_lost_sync(&self) -> bool {
        self.newest()
            .is_some_and(|replica| replica.stream().has_lost_sync())
    }

    /// The cause to give if a new snapshot is requested.
    pub(crate) fn resync_cause(&self) -> ResyncCause {
        if self
            .newest()
            .is_some_and(|replica| replica.stream().has_mismatched())
        {
            ResyncCause::ChecksumMismatch
        } else {
            ResyncCause::LostSync
        }
    }
}
