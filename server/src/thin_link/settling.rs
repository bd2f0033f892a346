//! Whether the snapshot that a member is told has passed its link.
//!
//! Decides nothing else. Invariant: what waits and does not grow less is no snapshot that passes, whatever the member says.

use rhumb_protocol::packet::StreamId;
use rhumb_protocol::{Instant, Span};

/// What shows that a member has the snapshot that it is told.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Awaited {
    /// Anything: who joins says nothing before.
    Word,
    /// An echo of a stream that it did not hear before, or that it follows it.
    Echo(StreamId),
    /// That it follows a stream; echoes of that may be of the copy before.
    Followed(StreamId),
}

/// Whether a member's snapshot has passed, and what had to wait behind it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Settling {
    /// None when it came.
    awaited: Option<Awaited>,
    /// When the link was first looked at with the snapshot on it.
    begun: Option<Instant>,
    /// When what waited behind the snapshot has passed, too.
    over: Option<Instant>,
    /// The least that waited since it matters, in bytes, and when.
    least: Option<(u64, Instant)>,
}

/// The link is not judged for so long after a snapshot, or as long as that took: what waited behind it passes, too.
const GRACE: Span = Span::from_millis(2_000);
/// It is never spared longer than this after a snapshot.
const GRACE_MOST: Span = Span::from_millis(10_000);
/// Nor when so much waits, and grows no less by a sixty-fourth in [`GRACE`]: a stream that the link does not carry may hold
/// up the very snapshot.
const STANDING: Span = Span::from_millis(250);
/// Who does not show for so long that it has the snapshot is judged all the same: not every client says what would.
const SNAPSHOT_MOST: Span = Span::from_millis(60_000);

impl Settling {
    /// One that is told now.
    pub(super) const fn until(awaited: Awaited) -> Self {
        Self {
            awaited: Some(awaited),
            begun: None,
            over: None,
            least: None,
        }
    }

    /// The member said such a thing.
    pub(super) fn hear(&mut self, heard: Awaited) {
        let shows = match (self.awaited, heard) {
            (None, _) => false,
            (Some(Awaited::Word), _) => true,
            (Some(Awaited::Echo(of)), Awaited::Echo(stream) | Awaited::Followed(stream))
            | (Some(Awaited::Followed(of)), Awaited::Followed(stream)) => of == stream,
            (Some(Awaited::Echo(_) | Awaited::Followed(_)), _) => false,
        };
        if shows {
            self.awaited = None;
        }
    }

    /// Whether the link can be judged, where so many bytes wait now, and for so long.
    pub(super) fn is_over(&mut self, now: Instant, waiting_bytes: u64, waits: Span) -> bool {
        let took = now.since(*self.begun.get_or_insert(now));
        if self.stands(now, waiting_bytes, waits) {
            (self.awaited, self.over) = (None, Some(now));
        }
        if self.awaited.is_some() && took < SNAPSHOT_MOST {
            return false;
        }
        let passes = took.clamp(GRACE, GRACE_MOST);
        now >= *self.over.get_or_insert(now + passes)
    }

    /// Whether what waits has not grown less for a while.
    fn stands(&mut self, now: Instant, waiting_bytes: u64, waits: Span) -> bool {
        let (least, since) = *self.least.get_or_insert((waiting_bytes, now));
        if waits <= STANDING || waiting_bytes < least - least / 64 {
            self.least = Some((waiting_bytes, now));
            return false;
        }
        now.since(since) >= GRACE
    }
}
