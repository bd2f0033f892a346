//! The authority of a member and its upstream.

use rhumb_reckoning::BodyId;

use crate::message::TakeAuthority;
use crate::packet::LargestPacket;
use crate::session::upstream_sender::UpstreamSender;

/// The authority of a member and its upstream.
#[derive(Debug)]
pub(super) struct UpstreamState {
    pub(super) upstream_sender: Option<UpstreamSender>,
    /// The requested authority, while the answer is pending.
    pub(super) requested_authority: Option<TakeAuthority>,
    /// The authority granted last.
    pub(super) granted: Option<TakeAuthority>,
    /// Bound on the upstream's packets.
    pub(super) largest_packet: LargestPacket,
}

impl UpstreamState {
    pub(super) const fn new() -> Self {
        Self {
            upstream_sender: None,
            requested_authority: None,
            granted: None,
            largest_packet: LargestPacket::DEFAULT,
        }
    }

    /// Removes a body that left the scene.
    pub(super) fn remove(&mut self, id: BodyId) {
        for authority in [&mut self.requested_authority, &mut self.granted]
            .into_iter()
            .flatten()
        {
            authority.bodies.retain(|body| *body != id);
        }
        if let Some(upstream_sender) = &mut self.upstream_sender {
            upstream_sender.remove(id);
        }
    }

    pub(super) fn covers(&self, id: BodyId) -> bool {
        let authorities = [&self.requested_authority, &self.granted]
            .into_iter()
            .flatten();
        authorities
            .into_iter()
            .any(|authority| authority.bodies.contains(&id))
    }
}
