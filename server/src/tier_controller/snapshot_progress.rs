//! Whether the snapshot that a member is told has passed its link.
//!
//! Decides nothing else. Invariant: what queue_delay and does not grow less is no snapshot that passes, whatever the member says.

use rhumb_protocol::packet::StreamId;
use rhumb_protocol::{Instant, Span};

/// What shows that a member has the snapshot that it is told.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Confirmation {
    /// Anything: who joins says nothing before.
    AnyMessage,
    /// An loss_report of a stream that it did not hear before, or that it follows it.
    LossReport(StreamId),
    /// That it follows a stream; loss_reports of that may be of the copy before.
    Subscribed(StreamId),
}

/// Whether a member's snapshot has passed, and what had to wait behind it.
#[derive(Clone, Copy, Debug)]
pub(super) struct SnapshotProgress {
    /// None when it came.
    expected: Option<Confirmation>,
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
/// Nor when so much queue_delay, and grows no less by a sixty-fourth in [`GRACE`]: a stream that the link does not carry may hold
/// up the very snapshot.
const STANDING: Span = Span::from_millis(250);
/// Who does not show for so long that it has the snapshot is judged all the same: not every client says what would.
const SNAPSHOT_MOST: Span = Span::from_millis(60_000);

impl SnapshotProgress {
    /// One that is told now.
    pub(super) const fn awaiting(expected: Confirmation) -> Self {
        Self {
            expected: Some(expected),
            begun: None,
            over: None,
            least: None,
        }
    }

    /// The member said such a thing.
    pub(super) fn confirm(&mut self, heard: Confirmation) {
        let shows = match (self.expected, heard) {
            (None, _) => false,
            (Some(Confirmation::AnyMessage), _) => true,
            (
                Some(Confirmation::LossReport(of)),
                Confirmation::LossReport(stream) | Confirmation::Subscribed(stream),
            )
            | (Some(Confirmation::Subscribed(of)), Confirmation::Subscribed(stream)) => {
                of == stream
            }
            (Some(Confirmation::LossReport(_) | Confirmation::Subscribed(_)), _) => false,
        };
        if shows {
            self.expected = None;
        }
    }

    /// Whether the link can be judged, where so many bytes wait now, and for so long.
    pub(super) fn is_over(&mut self, now: Instant, waiting_bytes: u64, queue_delay: Span) -> bool {
        let took = now.since(*self.begun.get_or_insert(now));
        if self.stands(now, waiting_bytes, queue_delay) {
            (self.expected, self.over) = (None, Some(now));
        }
        if self.expected.is_some() && took < SNAPSHOT_MOST {
            return false;
        }
        let passes = took.clamp(GRACE, GRACE_MOST);
        now >= *self.over.get_or_insert(now + passes)
    }

    /// Whether what queue_delay has not grown less for a while.
    fn stands(&mut self, now: Instant, waiting_bytes: u64, queue_delay: Span) -> bool {
        let (least, since) = *self.least.get_or_insert((waiting_bytes, now));
        if queue_delay <= STANDING || waiting_bytes < least - least / 64 {
            self.least = Some((waiting_bytes, now));
            return false;
        }
        now.since(since) >= GRACE
    }
}
