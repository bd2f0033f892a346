//! Progress of a member's snapshot over its link.
//!
//! Invariant: a queue that does not shrink is not a snapshot in transit, whatever the member confirms.

use rhumb_protocol::packet::StreamId;
use rhumb_protocol::{Instant, Span};

/// Messages that confirm the snapshot.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Confirmation {
    /// Any message: a joining member sends nothing before.
    AnyMessage,
    /// A loss report of the new stream, or the confirmation of its subscription.
    LossReport(StreamId),
    /// The confirmation of a subscription; loss reports of the stream may concern the former copy.
    Subscribed(StreamId),
}

/// The progress of a member's snapshot, and of the queue behind it, through the link.
#[derive(Clone, Copy, Debug)]
pub(super) struct SnapshotProgress {
    /// `None` once it was confirmed.
    expected: Option<Confirmation>,
    /// The time at which the link was first observed with the snapshot in transit.
    begun: Option<Instant>,
    /// The time at which the queue behind the snapshot has passed, too.
    over: Option<Instant>,
    /// Least queue since the snapshot passed, in bytes, and its time.
    least: Option<(u64, Instant)>,
}

/// Grace after a snapshot, or as long as the snapshot took: the queue behind it must pass, too.
const GRACE: Span = Span::from_millis(2_000);
/// Longest grace after a snapshot.
const GRACE_MOST: Span = Span::from_millis(10_000);
/// No grace for a queue of this delay that does not shrink by a sixty-fourth in [`GRACE`]: an overloaded link may
/// delay the very snapshot.
const STANDING: Span = Span::from_millis(250);
/// A member without a confirmation is judged after this time: not every client sends one.
const SNAPSHOT_MOST: Span = Span::from_millis(60_000);

impl SnapshotProgress {
    /// A snapshot that is sent now.
    pub(super) const fn awaiting(expected: Confirmation) -> Self {
        Self {
            expected: Some(expected),
            begun: None,
            over: None,
            least: None,
        }
    }

    /// Handles a message of the member.
    pub(super) fn confirm(&mut self, received: Confirmation) {
        let shows = match (self.expected, received) {
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

    /// True if the link can be judged, with this queue in bytes and in delay.
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

    /// True if the queue has not shrunk for a while.
    fn stands(&mut self, now: Instant, waiting_bytes: u64, queue_delay: Span) -> bool {
        let (least, since) = *self.least.get_or_insert((waiting_bytes, now));
        if queue_delay <= STANDING || waiting_bytes < least - least / 64 {
            self.least = Some((waiting_bytes, now));
            return false;
        }
        now.since(since) >= GRACE
    }
}
