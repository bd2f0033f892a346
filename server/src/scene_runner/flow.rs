//! Flow control of a scene: what makes a member wait, and for how long.

use rhumb_protocol::limits::PENDING_COMMANDS_MAX;
use rhumb_protocol::{Instant, Peer};

use super::SceneRunner;
use super::weight::MESSAGE_WEIGHT;
use crate::outbox::Outbox;

/// Weight of the messages of one member that may wait for the steps of an advance: [`PENDING_COMMANDS_MAX`] short ones.
const PENDING_BYTES_MAX: usize = PENDING_COMMANDS_MAX * MESSAGE_WEIGHT;
/// A member for which more than this waits is behind.
const MEMBER_BEHIND_BYTES: usize = 2 << 20;

impl SceneRunner {
    /// True if a member's next message must stay unread: as much as may waits for the steps of an advance, its commands
    /// exceed its quota, or what it added to the scene still waits for slower members.
    pub(crate) fn holds_back(&mut self, now: Instant, peer: Peer, out: &Outbox) -> bool {
        let Some(member) = self.members.get_mut(&peer) else {
            return false;
        };
        if member.pending_bytes >= PENDING_BYTES_MAX {
            return true;
        }
        if member.is_over_rate(now) {
            return true;
        }
        if !member.adds_too_much(now) {
            return false;
        }
        let is_behind = |member: &Peer| out.waiting_bytes(*member) > MEMBER_BEHIND_BYTES;
        self.members.keys().any(is_behind)
    }

    /// True if a member has sent more commands than its rate allows.
    pub(crate) fn is_over_rate(&self, now: Instant, peer: Peer) -> bool {
        (self.members.get(&peer)).is_some_and(|member| member.is_over_rate(now))
    }

    /// Bytes of scene events that the members have not got yet.
    pub(crate) const fn unsent_bytes(&self) -> usize {
        self.unsent.len()
    }

    /// The earliest time of the next requested snapshot; `None` if none is requested, or one is under way.
    pub(crate) fn next_snapshot(&self, out: &Outbox) -> Option<Instant> {
        let requests = self.members.iter();
        let requests = requests.filter(|(_, member)| member.snapshot_request.is_some());
        requests
            .filter_map(|(peer, _)| out.snapshot_at(*peer))
            .min()
    }
}
