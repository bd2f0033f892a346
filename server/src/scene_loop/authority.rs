//! Authority of members over bodies: grants and upstream packets.

use rhumb_protocol::Peer;
use rhumb_protocol::message::{AuthorityError, AuthorityGrant, ServerMessage, TakeAuthority};
use rhumb_protocol::packet::Datagram;
use rhumb_protocol::scene::{Command, Stepping};
use rhumb_protocol::session::UpstreamReceiver;

use super::RunningScene;
use crate::authority_group::UpstreamStatistics;
use crate::clients::Clients;
use crate::streams;

impl RunningScene {
    /// A packet of a member's upstream on the control stream, where members lead: it acts before the steps of the next
    /// advance. In a free-running scene such packets come as datagrams.
    pub(super) fn handle_upstream_message(
        &mut self,
        peer: Peer,
        packet: &[u8],
        clients: &mut Clients,
    ) {
        if self.config().stepping == Stepping::Lockstep
            && let Ok(datagram) = Datagram::open(packet)
        {
            self.handle_upstream(peer, &datagram, clients);
        }
    }

    /// Handles an upstream datagram. A lockstep scene drops it: its arrival time would make runs differ.
    pub(crate) fn handle_upstream_datagram(
        &mut self,
        peer: Peer,
        datagram: &Datagram<'_>,
        clients: &mut Clients,
    ) {
        if self.config().stepping == Stepping::FreeRunning {
            self.handle_upstream(peer, datagram, clients);
        }
    }

    pub(super) fn handle_upstream(
        &mut self,
        peer: Peer,
        datagram: &Datagram<'_>,
        clients: &mut Clients,
    ) {
        let tick = self.scene.tick();
        let group = clients
            .member_mut(peer)
            .and_then(|member| member.authority.as_mut());
        if group.is_some_and(|group| !group.handle_datagram(datagram, tick)) {
            self.authority_table.end(peer, clients);
            tracing::debug!(peer = peer.0, "lost sync with an upstream");
            clients.send(
                peer,
                &ServerMessage::AuthorityDenied(AuthorityError::LostSync),
            );
        }
    }

    pub(super) fn grant_authority(
        &mut self,
        peer: Peer,
        request: &TakeAuthority,
        clients: &mut Clients,
    ) {
        // A member that learns where a body starts must know the body first.
        self.send_scene_events(clients);
        let answer = match self.begin_authority(peer, request, clients) {
            Ok(authority) => ServerMessage::AuthorityGrant(authority),
            Err(error) => {
                tracing::debug!(peer = peer.0, %error, "authority refused");
                ServerMessage::AuthorityDenied(error)
            }
        };
        clients.send(peer, &answer);
    }

    fn begin_authority(
        &mut self,
        peer: Peer,
        request: &TakeAuthority,
        clients: &mut Clients,
    ) -> Result<AuthorityGrant, AuthorityError> {
        let rights = self.rights_of(peer, clients);
        let rights = rights.ok_or(AuthorityError::NotAllowed)?;
        rights.take_authority(&request.bodies)?;
        let mut bodies = Vec::with_capacity(request.bodies.len());
        for id in &request.bodies {
            let now = self.scene.observation(*id);
            let motion = now.ok_or(AuthorityError::UnknownBody(*id))?.motion;
            bodies.push((*id, motion));
        }
        let stream = self.new_stream(clients);
        let authority = AuthorityGrant {
            stream,
            tick: self.scene.tick(),
            bodies,
        };
        let scene = &self.scene;
        let integrator = scene.config().integrator;
        let parameters = |id| streams::parameters(scene, id);
        let receiver = UpstreamReceiver::new(&authority, request, integrator, parameters);
        self.authority_table.begin(peer, receiver, clients);
        for (id, motion) in &authority.bodies {
            // Earlier commands to the body that are not carried out yet are void.
            let pose = motion.motion().pose();
            let stands = self.scene.apply(&Command::SetPose {
                id: *id,
                position: pose.position.as_vec3(),
                rotation: pose.rotation.as_quat(),
            });
            debug_assert!(stands.is_ok(), "a body's present pose is allowed");
        }
        let bodies = authority.bodies.len();
        tracing::debug!(peer = peer.0, bodies, stream = %stream, "authority granted");
        Ok(authority)
    }

    pub(crate) fn upstream_statistics(
        &self,
        clients: &Clients,
    ) -> impl Iterator<Item = UpstreamStatistics> {
        let tick = self.scene.tick();
        clients
            .authorities()
            .map(move |(peer, group)| group.statistics(peer, tick))
    }
}
