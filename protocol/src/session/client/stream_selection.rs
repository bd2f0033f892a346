//! A member's requests for streams: one at a time, the newest choice last.
//!
//! Sends nothing itself. Invariants: the member sends no request while another one is unanswered (PROTOCOL 4.8-14), and
//! every choice is requested in the end, whatever the server does.

use crate::message::StreamChoice;

/// The requested stream and the choice that follows it.
#[derive(Clone, Copy, Debug)]
pub(super) struct StreamSelection {
    /// The stream requested last, while the answer is pending.
    requested: Option<StreamChoice>,
    /// The stream to request next.
    wanted: Option<StreamChoice>,
    /// The stream to which the server moves the member. Its snapshot comes next, before that of a requested stream.
    moved: Option<StreamChoice>,
    pending_replica: PendingReplica,
}

/// The reason of a replica that is not shown yet.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum PendingReplica {
    /// No such replica exists, or it follows the present stream.
    Nothing,
    /// The member requested this stream.
    Requested(StreamChoice),
    /// The server moves the member to this stream.
    TierChanged,
}

impl StreamSelection {
    /// No choice and no pending request.
    pub(super) const fn new() -> Self {
        Self {
            requested: None,
            wanted: None,
            moved: None,
            pending_replica: PendingReplica::Nothing,
        }
    }

    /// Selects a stream in place of any earlier choice.
    pub(super) fn select(&mut self, choice: StreamChoice) {
        let is_pending = match self.requested {
            Some(requested) => requested == choice,
            None => self.pending_replica == PendingReplica::Requested(choice),
        };
        self.wanted = (!is_pending).then_some(choice);
    }

    /// The stream to request now, if any.
    pub(super) const fn take_request(&mut self) -> Option<StreamChoice> {
        if self.requested.is_some() {
            return None;
        }
        self.requested = self.wanted.take();
        self.requested
    }

    /// True if a request is unanswered.
    pub(super) const fn awaits_answer(&self) -> bool {
        self.requested.is_some()
    }

    /// Notes that the server moves the member to another stream.
    pub(super) const fn handle_tier_changed(&mut self, to: StreamChoice) {
        self.moved = Some(to);
    }

    /// Notes the start of a snapshot: an answer, a move, or the present stream again.
    pub(super) fn handle_joined(&mut self, choice: StreamChoice) {
        if self.moved.take() == Some(choice) {
            self.pending_replica = PendingReplica::TierChanged;
        } else if self.requested == Some(choice) {
            self.requested = None;
            self.pending_replica = PendingReplica::Requested(choice);
        }
    }

    /// Notes that the server denied the request.
    pub(super) const fn handle_denied(&mut self) {
        self.requested = None;
    }

    /// True if the replica now shown is an answer or a move rather than a resync.
    pub(super) fn take_subscription_change(&mut self) -> bool {
        core::mem::replace(&mut self.pending_replica, PendingReplica::Nothing)
            != PendingReplica::Nothing
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rhumb_reckoning::Tolerance;

    const EXACT: StreamChoice = StreamChoice::Within(Tolerance::EXACT);
    const FINE: StreamChoice = StreamChoice::Within(Tolerance::FINE);
    const FULL: StreamChoice = StreamChoice::Full;

    /// A selection with this request pending.
    fn with_request(choice: StreamChoice) -> StreamSelection {
        let mut stream_selection = StreamSelection::new();
        stream_selection.select(choice);
        assert_eq!(stream_selection.take_request(), Some(choice));
        stream_selection
    }

    #[test]
    fn the_newest_request_is_sent_after_the_pending_one_is_answered() {
        let mut stream_selection = with_request(EXACT);
        stream_selection.select(FULL);
        stream_selection.select(FINE);
        assert_eq!(stream_selection.take_request(), None);
        stream_selection.handle_joined(EXACT);
        assert_eq!(stream_selection.take_request(), Some(FINE));
        stream_selection.handle_denied();
        assert_eq!(stream_selection.take_request(), None);
        assert!(!stream_selection.awaits_answer());
    }

    #[test]
    fn a_pending_stream_is_not_requested_again() {
        let mut stream_selection = with_request(EXACT);
        stream_selection.select(FINE);
        stream_selection.select(EXACT);
        stream_selection.handle_joined(EXACT);
        assert_eq!(stream_selection.take_request(), None);
        stream_selection.select(EXACT);
        assert_eq!(stream_selection.take_request(), None);
        assert!(stream_selection.take_subscription_change());
        stream_selection.select(EXACT);
        assert_eq!(stream_selection.take_request(), Some(EXACT));
    }

    #[test]
    fn a_tier_change_answers_no_pending_request() {
        let mut stream_selection = with_request(FINE);
        stream_selection.handle_tier_changed(FINE);
        stream_selection.handle_joined(FINE);
        assert!(
            stream_selection.awaits_answer(),
            "the snapshot of a move answers no request"
        );
        stream_selection.handle_joined(FINE);
        assert!(!stream_selection.awaits_answer());
        // The member requests its own choice even if the server already moves it to that stream.
        stream_selection.handle_tier_changed(EXACT);
        stream_selection.handle_joined(EXACT);
        stream_selection.select(EXACT);
        assert_eq!(stream_selection.take_request(), Some(EXACT));
    }

    #[test]
    fn a_resync_snapshot_is_no_subscription_change() {
        let mut stream_selection = StreamSelection::new();
        stream_selection.handle_joined(FINE);
        assert!(!stream_selection.take_subscription_change());
        let mut stream_selection = with_request(EXACT);
        stream_selection.handle_joined(FINE);
        assert!(stream_selection.awaits_answer() && !stream_selection.take_subscription_change());
        stream_selection.handle_joined(EXACT);
        stream_selection.handle_joined(EXACT);
        assert!(stream_selection.take_subscription_change());
    }
}
