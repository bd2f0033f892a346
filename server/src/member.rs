//! What a scene knows of one of its members.
//!
//! The streams that it hears, and what it waits for. Follows streams by name only; who begins and ends them is the room's matter.

use rhumb_protocol::message::StreamChoice;
use rhumb_protocol::packet::StreamId;

use crate::tier_controller::TierController;

/// A client that takes part.
#[derive(Debug)]
pub(crate) struct Member {
    subscription: StreamId,
    /// The stream before, until the member has caught up with the present one.
    previous: Option<StreamId>,
    /// How many commands of this membership were applied or refused.
    commands: u64,
    /// Number of the last of them, until it is answered.
    pub(crate) unanswered: Option<u64>,
    /// The snapshot that it is to hear when all that it said at once was looked at; the last one counts.
    pub(crate) snapshot_request: Option<SnapshotRequest>,
    /// Whether its link carries its stream.
    pub(crate) link: TierController,
}

/// Which snapshot a member waits for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum SnapshotRequest {
    /// That of its stream, again.
    Again,
    /// That of another stream.
    Other(StreamChoice),
}

impl Member {
    /// Who has just joined and follows a stream.
    pub(crate) const fn new(stream: StreamId, choice: StreamChoice) -> Self {
        Self {
            subscription: stream,
            previous: None,
            commands: 0,
            unanswered: None,
            snapshot_request: None,
            link: TierController::new(choice),
        }
    }

    /// The number of the command that is applied or refused now.
    pub(crate) const fn number_command(&mut self) -> u64 {
        let number = self.commands;
        self.commands += 1;
        self.unanswered = Some(number);
        number
    }

    /// The stream that it follows.
    pub(crate) const fn stream(&self) -> StreamId {
        self.subscription
    }

    /// All streams whose datagrams it gets, each once.
    pub(crate) fn streams(&self) -> impl Iterator<Item = StreamId> + use<> {
        [Some(self.subscription), self.previous]
            .into_iter()
            .flatten()
    }

    /// Changes to a stream that it does not follow, but may be leaving; returns the one that it hears no more, if there is
    /// one. It goes on hearing the one that it has a whole copy of.
    pub(crate) fn change(&mut self, to: StreamId) -> Option<StreamId> {
        let before = std::mem::replace(&mut self.subscription, to);
        match self.previous {
            None => {
                self.previous = Some(before);
                None
            }
            Some(previous) => {
                self.previous = (previous != to).then_some(previous);
                Some(before)
            }
        }
    }

    /// It has caught up with a stream; returns the one that it needs no more, if there is one.
    pub(crate) fn caught_up(&mut self, with: StreamId) -> Option<StreamId> {
        if with != self.subscription {
            return None;
        }
        self.previous.take()
    }

    /// Whether it gets the datagrams of a stream.
    pub(crate) fn hears(&self, stream: StreamId) -> bool {
        self.streams().any(|subscribed| subscribed == stream)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const A: StreamId = StreamId(1);
    const B: StreamId = StreamId(2);
    const C: StreamId = StreamId(3);

    fn subscribed(member: &Member) -> Vec<StreamId> {
        member.streams().collect()
    }

    #[test]
    fn the_former_stream_stays_until_the_new_one_has_caught_up() {
        let mut member = Member::new(A, StreamChoice::Full);
        assert_eq!(member.change(B), None);
        assert_eq!(subscribed(&member), [B, A]);
        assert_eq!(member.caught_up(A), None);
        assert_eq!(member.caught_up(B), Some(A));
        assert_eq!(subscribed(&member), [B]);
    }

    #[test]
    fn a_second_change_keeps_the_complete_replica_s_stream() {
        let mut member = Member::new(A, StreamChoice::Full);
        assert_eq!(member.change(B), None);
        assert_eq!(member.change(C), Some(B));
        assert_eq!(subscribed(&member), [C, A]);
        assert_eq!(member.caught_up(C), Some(A));
    }

    #[test]
    fn changing_back_subscribes_once() {
        let mut member = Member::new(A, StreamChoice::Full);
        assert_eq!(member.change(B), None);
        assert_eq!(member.change(A), Some(B));
        assert_eq!(subscribed(&member), [A]);
    }
}
