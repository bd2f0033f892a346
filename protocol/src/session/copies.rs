//! The copy of a scene that a member shows, with its successor.
//!
//! Decides when one gives way to the other, and nothing else. Invariant: what is shown never falls back to an earlier
//! complete tick, unless it had lost touch.

use alloc::vec::Vec;

use bytes::Bytes;

use super::close::CloseCode;
use super::replica::Replica;
use crate::message::{Joined, Notice};
use crate::time::{Instant, Span};

/// The copies of one membership.
#[derive(Debug, Default)]
pub(crate) struct Copies {
    shown: Option<Replica>,
    /// The copy that a snapshot is filling, or that is whole and not as far yet as the one shown.
    next: Option<Replica>,
}

/// Whom a notice was for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Told {
    /// It is part of a snapshot.
    Snapshot,
    /// It is news of the scene.
    Scene,
}

impl Copies {
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
        let filling = self.next.as_mut().filter(|copy| !copy.is_whole());
        filling.ok_or(CloseCode::VIOLATION)?.end_snapshot();
        if self.shown.is_none() {
            self.shown = self.next.take();
        }
        Ok(())
    }

    /// Shows the next copy if it is as far, so that nobody sees a gap; returns the one that was shown before.
    pub(crate) fn catch_up(&mut self) -> Option<Replica> {
        let shown = self.shown.as_mut()?;
        let as_far = |next: &mut Replica| next.is_whole() && next.is_as_far_as(shown);
        let mut next = self.next.take_if(as_far)?;
        next.succeed(shown);
        Some(core::mem::replace(shown, next))
    }

    /// Takes in a notice.
    pub(crate) fn hear_notice(&mut self, notice: &Notice) -> Result<Told, CloseCode> {
        if let Some(next) = &mut self.next {
            let filling = !next.is_whole();
            next.handle_notice(notice)?;
            if filling {
                return Ok(Told::Snapshot);
            }
        }
        let shown = self.shown.as_mut().ok_or(CloseCode::VIOLATION)?;
        shown.handle_notice(notice)?;
        Ok(Told::Scene)
    }

    /// Takes in a datagram of whichever streams it is about.
    pub(crate) fn handle_datagram(&mut self, datagram: &[u8]) {
        for copy in [&mut self.next, &mut self.shown].into_iter().flatten() {
            if copy.stream().is_about(datagram) {
                copy.stream_mut().handle_datagram(datagram);
            }
        }
    }

    /// See [`Self::whole`].
    fn whole_mut(&mut self) -> impl Iterator<Item = &mut Replica> {
        let copies = [self.shown.as_mut(), self.next.as_mut()];
        copies.into_iter().flatten().filter(|copy| copy.is_whole())
    }

    /// Copies that are whole, the shown one first.
    fn whole(&self) -> impl Iterator<Item = &Replica> {
        let copies = [self.shown.as_ref(), self.next.as_ref()];
        copies.into_iter().flatten().filter(|copy| copy.is_whole())
    }

    /// Looks at what is missing now.
    pub(crate) fn watch_missing(&mut self, now: Instant) {
        for copy in self.whole_mut() {
            copy.watch_missing(now);
        }
    }

    /// Whether packets are missing.
    pub(crate) fn miss(&self) -> bool {
        self.whole().any(|copy| copy.stream().missing() > 0)
    }

    /// When to ask for what is missing.
    pub(crate) fn missing_due(&self) -> Option<Instant> {
        self.whole().filter_map(Replica::missing_due).min()
    }

    /// What to ask the server for now, of each stream that lost something.
    pub(crate) fn ask(&mut self, now: Instant, patient: Span) -> Vec<Bytes> {
        let asked = self.whole_mut().filter_map(|copy| copy.ask(now, patient));
        asked.map(Bytes::from).collect()
    }

    /// How many packets did not come by themselves, whether parities gave them back or not.
    pub(crate) fn lost(&self) -> u64 {
        self.whole().map(|copy| copy.stream().lost()).sum()
    }

    /// Whether something that was said is believed wrongly.
    pub(crate) fn doubts(&self) -> bool {
        self.whole().any(|copy| copy.stream().doubt().is_some())
    }

    /// Whether only a new snapshot helps: of the newest copy, as the one before gives way to it.
    pub(crate) fn have_lost_touch(&self) -> bool {
        let newest = self.next.as_ref().or(self.shown.as_ref());
        newest.is_some_and(|copy| copy.stream().has_lost_touch())
    }

    /// What to tell the server of each stream.
    pub(crate) fn echoes(&self) -> Vec<Bytes> {
        let streams = self.whole().map(Replica::stream);
        let echo = streams.map(|stream| stream.echo().encode(stream.stream()));
        echo.map(Bytes::from).collect()
    }

    /// What to ask the server of each stream.
    pub(crate) fn questions(&self) -> Vec<Bytes> {
        let streams = self.whole().map(Replica::stream);
        let doubt = streams.filter_map(|stream| Some(stream.doubt()?.encode(stream.stream())));
        doubt.map(Bytes::from).collect()
    }
}
