//! Which stream a member asks for: one at a time, and then the newest wish
//!
//! Says nothing itself. Invariants: nothing is asked while a question is not answered (PROTOCOL 4.8-14), and whatever the
//! server does, a wish is taken, so that nobody is ever kept from another stream.

use crate::message::StreamChoice;

/// What was asked for, and what is wanted in its place.
#[derive(Clone, Copy, Debug)]
pub(super) struct StreamSelection {
    /// Asked for, and not answered.
    asked: Option<StreamChoice>,
    /// To be asked for next.
    wanted: Option<StreamChoice>,
    /// Where the server moves the member: the snapshot of that comes next, whatever was asked for.
    moved: Option<StreamChoice>,
    pending_replica: PendingReplica,
}

/// Why there is a copy that is not shown yet.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum PendingReplica {
    /// There is none, or one of the stream that is followed already.
    Nothing,
    /// It was asked for.
    Asked(StreamChoice),
    /// The server moves the member.
    TierChanged,
}

impl StreamSelection {
    /// Nothing is wanted but what is there.
    pub(super) const fn new() -> Self {
        Self {
            asked: None,
            wanted: None,
            moved: None,
            pending_replica: PendingReplica::Nothing,
        }
    }

    /// This stream is wanted, and none that was wanted before.
    pub(super) fn select(&mut self, choice: StreamChoice) {
        let is_on_its_way = match self.asked {
            Some(asked) => asked == choice,
            None => self.pending_replica == PendingReplica::Asked(choice),
        };
        self.wanted = (!is_on_its_way).then_some(choice);
    }

    /// What to ask for now, if anything.
    pub(super) const fn ask(&mut self) -> Option<StreamChoice> {
        if self.asked.is_some() {
            return None;
        }
        self.asked = self.wanted.take();
        self.asked
    }

    /// Whether a question is not answered.
    pub(super) const fn is_asking(&self) -> bool {
        self.asked.is_some()
    }

    /// The server moves the member.
    pub(super) const fn handle_tier_changed(&mut self, to: StreamChoice) {
        self.moved = Some(to);
    }

    /// A snapshot begins: the answer to what was asked for, that of a move, or the present stream's again.
    pub(super) fn handle_joined(&mut self, choice: StreamChoice) {
        if self.moved.take() == Some(choice) {
            self.pending_replica = PendingReplica::TierChanged;
        } else if self.asked == Some(choice) {
            self.asked = None;
            self.pending_replica = PendingReplica::Asked(choice);
        }
    }

    /// What was asked for is denied.
    pub(super) const fn handle_denied(&mut self) {
        self.asked = None;
    }

    /// The copy that came is shown; whether that is an answer or a move, and no mere refresh.
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

    /// After this was asked for.
    fn requested(choice: StreamChoice) -> StreamSelection {
        let mut stream_selection = StreamSelection::new();
        stream_selection.select(choice);
        assert_eq!(stream_selection.ask(), Some(choice));
        stream_selection
    }

    #[test]
    fn the_newest_request_is_sent_after_the_pending_one_is_answered() {
        let mut stream_selection = requested(EXACT);
        stream_selection.select(FULL);
        stream_selection.select(FINE);
        assert_eq!(stream_selection.ask(), None);
        stream_selection.handle_joined(EXACT);
        assert_eq!(stream_selection.ask(), Some(FINE));
        stream_selection.handle_denied();
        assert_eq!(stream_selection.ask(), None);
        assert!(!stream_selection.is_asking());
    }

    #[test]
    fn a_pending_stream_is_not_requested_again() {
        let mut stream_selection = requested(EXACT);
        stream_selection.select(FINE);
        stream_selection.select(EXACT);
        stream_selection.handle_joined(EXACT);
        assert_eq!(stream_selection.ask(), None);
        stream_selection.select(EXACT);
        assert_eq!(stream_selection.ask(), None);
        assert!(stream_selection.take_subscription_change());
        stream_selection.select(EXACT);
        assert_eq!(stream_selection.ask(), Some(EXACT));
    }

    #[test]
    fn a_tier_change_answers_no_pending_request() {
        let mut stream_selection = requested(FINE);
        stream_selection.handle_tier_changed(FINE);
        stream_selection.handle_joined(FINE);
        assert!(stream_selection.is_asking(), "that was the move's snapshot");
        stream_selection.handle_joined(FINE);
        assert!(!stream_selection.is_asking());
        // What comes by a move is asked for all the same: a choice is the member's own.
        stream_selection.handle_tier_changed(EXACT);
        stream_selection.handle_joined(EXACT);
        stream_selection.select(EXACT);
        assert_eq!(stream_selection.ask(), Some(EXACT));
    }

    #[test]
    fn a_resync_snapshot_is_no_subscription_change() {
        let mut stream_selection = StreamSelection::new();
        stream_selection.handle_joined(FINE);
        assert!(!stream_selection.take_subscription_change());
        let mut stream_selection = requested(EXACT);
        stream_selection.handle_joined(FINE);
        assert!(stream_selection.is_asking() && !stream_selection.take_subscription_change());
        stream_selection.handle_joined(EXACT);
        stream_selection.handle_joined(EXACT);
        assert!(stream_selection.take_subscription_change());
    }
}
