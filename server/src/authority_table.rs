//! Authority of members over the bodies of a scene.
//!
//! Knows which member has a body; the member has what arrives for its bodies. Invariants: at most one member has authority
//! over a body, and a member moves no other bodies.

use std::collections::{BTreeMap, BTreeSet};

use rhumb_protocol::message::SceneEvent;
use rhumb_protocol::session::UpstreamReceiver;
use rhumb_protocol::{Instant, Peer};
use rhumb_reckoning::{BodyId, Tick};

use crate::authority_group::AuthorityGroup;
use crate::clients::Clients;
use crate::scene::Scene;

/// Authority of all members over bodies of one scene.
#[derive(Debug, Default)]
pub(crate) struct AuthorityTable {
    authorities: BTreeMap<BodyId, Peer>,
    /// Bodies of silent members whose authority has ended since the last step.
    released: BTreeSet<BodyId>,
}

impl AuthorityTable {
    /// The member with authority over a body.
    pub(crate) fn authority_of(&self, id: BodyId) -> Option<Peer> {
        self.authorities.get(&id).copied()
    }

    /// Gives a member authority over these bodies, in place of its former ones.
    pub(crate) fn begin(&mut self, peer: Peer, receiver: UpstreamReceiver, clients: &mut Clients) {
        self.end(peer, clients);
        if let Some(member) = clients.member_mut(peer)
            && receiver.bodies().next().is_some()
        {
            let bodies = receiver.bodies();
            self.authorities.extend(bodies.map(|id| (id, peer)));
            member.authority = Some(AuthorityGroup::new(receiver));
        }
    }

    /// Ends a member's authority; its bodies stand still.
    pub(crate) fn end(&mut self, peer: Peer, clients: &mut Clients) {
        let member = clients.member_mut(peer);
        let Some(group) = member.and_then(|member| member.authority.take()) else {
            return;
        };
        self.authorities.retain(|_, authority| *authority != peer);
        if group.is_silent() {
            self.released.extend(group.bodies());
        }
        group.log_end(peer);
    }

    /// Removes a body that has left the scene.
    pub(crate) fn remove(&mut self, id: BodyId, clients: &mut Clients) {
        let Some(peer) = self.authorities.remove(&id) else {
            return;
        };
        let member = clients.member_mut(peer);
        if let Some(group) = member.and_then(|member| member.authority.as_mut()) {
            group.remove(id);
            if group.bodies().next().is_none() {
                self.end(peer, clients);
            }
        }
    }

    /// Sets the targets of all bodies for the next step. Returns the scene events of members that became silent or are
    /// active again.
    pub(crate) fn set_targets(
        &mut self,
        scene: &mut Scene,
        clients: &mut Clients,
    ) -> Vec<SceneEvent> {
        let tick = scene.tick().next();
        let mut scene_events = Vec::new();
        let bodies: Vec<_> = std::mem::take(&mut self.released)
            .into_iter()
            .filter(|id| scene.body(*id).is_some())
            .collect();
        if !bodies.is_empty() {
            scene_events.push(SceneEvent::PublisherActive { tick, bodies });
        }
        for (member, control) in clients.members_mut().0 {
            let group = member.authority.as_mut();
            scene_events.extend(group.and_then(|group| group.set_targets(control.peer(), scene)));
        }
        scene_events
    }
}

/// Sends NACKs for lost packets, and probes to silent members.
pub(crate) fn send_reports(now: Instant, tick: Tick, clients: &mut Clients) {
    let (members, out) = clients.members_mut();
    for (member, control) in members {
        let group = member.authority.as_mut();
        for report in group.map_or(Vec::new(), |group| group.poll_reports(now, tick)) {
            control.send_datagram(report, out);
        }
    }
}
