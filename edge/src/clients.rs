//! The clients of an edge.
//!
//! Hands what a mirror received to the members that it serves. Knows mirrors by their numbers and asks no owner. Invariant: a
//! packet, a scene event and the events of a tick reach each of these members once.

use std::collections::BTreeMap;

use bytes::Bytes;
use rhumb_protocol::Peer;
use rhumb_protocol::message::{Denial, ServerMessage, StreamChoice, TickEvents};
use rhumb_protocol::scene::{BodyEvent, SceneConfig, SceneName};
use rhumb_protocol::session::CloseCode;
use rhumb_reckoning::Tick;
use rhumb_scene::PendingOutput;

use crate::client::{EdgeClient, EdgeMember, MirrorId};
use crate::mirror::Mirror;

/// The clients by their connections.
#[derive(Debug, Default)]
pub(crate) struct Clients {
    pub(crate) by_peer: BTreeMap<Peer, EdgeClient>,
}

impl Clients {
    /// The connections, for a loop that changes clients.
    pub(crate) fn peers(&self) -> Vec<Peer> {
        self.by_peer.keys().copied().collect()
    }

    /// The members whose newest stream is that of a mirror.
    pub(crate) fn members_of(&mut self, id: MirrorId) -> impl Iterator<Item = &mut EdgeMember> {
        let members = self.by_peer.values_mut();
        let members = members.filter_map(|client| client.member.as_mut());
        members.filter(move |member| member.mirror == id)
    }

    /// Control bytes for all members that a mirror serves.
    pub(crate) fn forward_control(&mut self, id: MirrorId, bytes: &Bytes, out: &mut PendingOutput) {
        for client in self.served_by(id) {
            if client.takes_events(id) {
                client.control.send_encoded(bytes, out);
            }
        }
    }

    /// The events of a tick, and the bytes that tell them.
    pub(crate) fn forward_events(
        &mut self,
        id: MirrorId,
        events: (&TickEvents, &Bytes),
        mirror: &Mirror,
        out: &mut PendingOutput,
    ) {
        let mut standing = None;
        for client in self.served_by(id) {
            let standing = match client.lacks_standing() {
                true => standing.get_or_insert_with(|| mirror.standing()).as_slice(),
                false => &[],
            };
            client.tell_events(events, standing, out);
        }
    }

    /// A packet; returns true if a fan-out is to carry it, too.
    pub(crate) fn forward_packet(
        &self,
        id: MirrorId,
        bytes: &Bytes,
        out: &mut PendingOutput,
    ) -> bool {
        let mut is_shared = false;
        for client in self.by_peer.values() {
            let member = client.member.as_ref();
            if !member.is_some_and(|member| member.takes(id)) {
                continue;
            }
            match client.is_shared {
                true => is_shared = true,
                false => client.control.send_datagram(bytes.clone(), out),
            }
        }
        is_shared
    }

    /// True if a client needs a mirror.
    pub(crate) fn need(&self, id: MirrorId, mirror: &Mirror) -> bool {
        let clients = self.by_peer.values();
        let mut of_scene = clients.filter(|client| client.scene.as_ref() == Some(&mirror.scene));
        mirror.is_asked() || of_scene.any(|client| client.needs(id, mirror.choice))
    }

    /// True if a member that a mirror serves does not know all that stands.
    pub(crate) fn lack_standing(&self, id: MirrorId) -> bool {
        let mut clients = self.by_peer.values();
        clients.any(|client| client.is_served_by(id) && client.lacks_standing())
    }

    /// Tells the members that a mirror serves the next part of what stands.
    pub(crate) fn tell_standing(
        &mut self,
        id: MirrorId,
        (tick, standing): (Tick, &[BodyEvent]),
        out: &mut PendingOutput,
    ) {
        for client in self.served_by(id) {
            client.tell_standing(tick, standing, out);
        }
    }

    /// The scene of a mirror is deleted: returns the observers that are members no more. Others hear it from the owner, and no
    /// scene event precedes that any more.
    pub(crate) fn end_scene(
        &mut self,
        (id, scene, choice): (MirrorId, &SceneName, StreamChoice),
        out: &mut PendingOutput,
    ) -> Vec<Peer> {
        let mut ended = Vec::new();
        let of_scene =
            (self.by_peer.values_mut()).filter(|client| client.scene.as_ref() == Some(scene));
        for client in of_scene.filter(|client| client.voice.is_some()) {
            let joins = client.joining.filter(|joining| joining.is_granted());
            let joins = joins.is_some_and(|joining| joining.choice == choice);
            client.scene_is_over |= joins || client.is_served_by(id);
        }
        for client in self.served_by(id).filter(|client| client.voice.is_none()) {
            client.member = None;
            client.control.send(&ServerMessage::Deleted, out);
            ended.push(client.control.peer());
        }
        ended
    }

    /// Welcomes the observers of a scene. `config`: `None` if there is no such scene.
    pub(crate) fn greet_observers(
        &mut self,
        scene: &SceneName,
        config: Option<SceneConfig>,
        out: &mut PendingOutput,
    ) {
        for client in self.by_peer.values_mut() {
            let is_of_scene = client.scene.as_ref() == Some(scene);
            if is_of_scene && !client.is_greeted && client.voice.is_none() {
                client.is_greeted = true;
                let role = client.has_token.then_some(client.permit.role);
                if let Some(session) = client.control.session(out) {
                    session.welcome(config, role);
                }
            }
        }
    }

    /// The owner has denied a mirror's join: the joins of its clients are denied, too, and the changes of members to its stream.
    /// Returns true if a client waits for it all the same: the scene was created after the denial, or is deleted.
    pub(crate) fn deny(
        &mut self,
        (id, scene, choice): (MirrorId, &SceneName, StreamChoice),
        denial: Denial,
        out: &mut PendingOutput,
    ) -> bool {
        let of = (Some(id), choice);
        let mut is_awaited = false;
        let of_scene = self.by_peer.values_mut();
        for client in of_scene.filter(|client| client.scene.as_ref() == Some(scene)) {
            is_awaited |= client.deny(of, denial, out);
        }
        is_awaited
    }

    /// Closes the connections of clients that wait for a stream that cannot be had now, and of observers that wait to learn of
    /// its scene.
    pub(crate) fn turn_away(
        &mut self,
        (scene, choice): (&SceneName, StreamChoice),
        out: &mut PendingOutput,
    ) {
        let of_scene = self.by_peer.values_mut();
        for client in of_scene.filter(|client| client.scene.as_ref() == Some(scene)) {
            let joins = client
                .joining
                .is_some_and(|joining| joining.choice == choice);
            let asks = !client.is_greeted && client.voice.is_none();
            if (joins || asks)
                && let Some(session) = client.control.session(out)
            {
                session.close(CloseCode::BUSY);
            }
        }
    }

    fn served_by(&mut self, id: MirrorId) -> impl Iterator<Item = &mut EdgeClient> {
        let clients = self.by_peer.values_mut();
        clients.filter(move |client| client.is_served_by(id))
    }
}
