//! Requests of members to a scene: commands, queries, inspections, authority.
//!
//! With commands: what they change for streams and members.
//!
//! Answers to queries and events of bodies are work and bytes beside the stream: a scene that is late answers no queries,
//! and a member that reads slowly gets no events until it has caught up.

use bytes::Bytes;
use rhumb_protocol::Peer;
use rhumb_protocol::message::{
    AuthorityError, AuthorityGrant, Inspection, QueryError, QueryResult, RemovalCause, SceneEvent,
    ServerMessage, TakeAuthority, TickEvents,
};
use rhumb_protocol::packet::Datagram;
use rhumb_protocol::scene::{
    Answer, BodyDesc, BodyEvent, Command, CommandError, Query, Shape, ShapeId, Stepping,
};
use rhumb_protocol::session::UpstreamReceiver;
use rhumb_protocol::stream::Activity;
use rhumb_reckoning::{BodyId, BodyState, Tick};

use super::RunningScene;
use crate::bodies_by_cell::Placement;
use crate::clients::{Clients, SceneClient};
use crate::engine::{BakedShape, Baker, UnusableShape};
use crate::event_monitor::{EventKey, StepEvents};
use crate::load;
use crate::member::UpstreamStatistics;
use crate::permit::Permit;
use crate::record::Author;
use crate::rights::{self, Rights};
use crate::streams;

impl RunningScene {
    /// The rights of a client.
    pub(super) fn rights<'a>(
        &'a self,
        peer: Peer,
        permit: &'a Permit,
        clients: &'a Clients,
    ) -> Rights<'a> {
        Rights {
            peer,
            permit,
            scene: &self.scene,
            is_faulted: self.faulted,
            owner: self.owner,
            is_fed: self.fed.is_some(),
            ownership: &self.ownership,
            authority_table: &self.authority_table,
            clients,
            limits: &self.settings.limits,
        }
    }

    /// The same of a member; `None` for a client that is none.
    pub(super) fn rights_of<'a>(&'a self, peer: Peer, clients: &'a Clients) -> Option<Rights<'a>> {
        let (permit, _) = clients.get(peer).and_then(SceneClient::membership)?;
        Some(self.rights(peer, permit, clients))
    }

    /// The function that makes the solid of a shape that a member may add; `None` if the command is refused anyway, or if
    /// the engine makes solids only by itself.
    pub(crate) fn baker_for(&self, permit: &Permit, id: ShapeId, shape: &Shape) -> Option<Baker> {
        if self.faulted || self.is_log_full() {
            return None;
        }
        let ownership = &self.ownership;
        let has_share = rights::has_share_of_shapes(permit, ownership, &self.scene, shape);
        let command = Command::AddShape {
            id,
            shape: shape.clone(),
        };
        (has_share && rights::includes(permit, ownership, &command, self.config()))
            .then(|| self.scene.baker_for(id, shape))?
    }

    /// Keeps a solid for the next command that adds its shape.
    pub(crate) fn put_baked(
        &mut self,
        id: ShapeId,
        shape: &Shape,
        baked: Result<BakedShape, UnusableShape>,
    ) {
        self.scene.put_baked(id, shape, baked);
    }

    /// Carries out a command of a member, and notes what now belongs to its client.
    pub(super) fn apply_of_member(
        &mut self,
        (peer, number): (Peer, u64),
        command: &Command,
        clients: &mut Clients,
    ) -> Result<(), CommandError> {
        let rights = self.rights_of(peer, clients);
        rights.ok_or(CommandError::NotAllowed)?.command(command)?;
        if self.request_of_owner((peer, number), command, clients)? {
            return Ok(());
        }
        if self.is_log_full() {
            let retry_seconds = load::RETRY_SECONDS;
            return Err(CommandError::Overloaded { retry_seconds });
        }
        self.apply_and_announce(command, clients)?;
        let client = clients.name(peer).cloned();
        self.ownership.note(client.as_ref(), command);
        let member = peer;
        self.scene
            .record_mut()
            .attribute(Author { member, number }, client);
        Ok(())
    }

    /// Applies a command of a member or of the script, and records what it changed for the streams and the members.
    pub(super) fn apply_and_announce(
        &mut self,
        command: &Command,
        clients: &mut Clients,
    ) -> Result<(), CommandError> {
        self.copy_if_due();
        self.carry_out(command)?;
        let tick = self.scene.tick();
        match *command {
            Command::AddShape { id, ref shape } => self.announce_shape(id, shape.clone()),
            Command::RemoveShape { id } => self.forget_shape(id),
            Command::AddBody { desc, motion } => {
                self.place(desc, motion, Activity::Awake);
                self.announce_silence(&desc);
            }
            Command::ChangeBody { desc } => {
                if let Some(there) = self.scene.observation_at_tick(desc.id) {
                    self.place(desc, there.motion, there.activity);
                }
            }
            Command::RemoveBody { id } => {
                self.remove_body(id, RemovalCause::Command, clients);
            }
            Command::AddJoint { id, ref joint } | Command::ChangeJoint { id, ref joint } => {
                self.record_event(SceneEvent::JointAdded { id, joint: **joint });
            }
            Command::RemoveJoint { id } => self.record_event(SceneEvent::JointRemoved { id }),
            Command::SetGravity { gravity } => {
                self.streams.change_gravity(tick, gravity);
                self.record_event(SceneEvent::GravityChanged {
                    since: tick,
                    gravity,
                });
            }
            _ => {}
        }
        Ok(())
    }

    /// Records that there is a shape, also for later members.
    pub(super) fn announce_shape(&mut self, id: ShapeId, shape: Shape) {
        let from = self.unsent.len();
        self.record_event(SceneEvent::ShapeAdded { id, shape });
        let event = Bytes::copy_from_slice(&self.unsent[from..]);
        self.shape_events.insert(id, event);
    }

    /// Records that a shape is gone.
    pub(super) fn forget_shape(&mut self, id: ShapeId) {
        self.shape_events.remove(&id);
        self.record_event(SceneEvent::ShapeRemoved { id });
    }

    /// Places a new or changed body in every stream: both ends predict it by its description from the newest tick on.
    pub(super) fn place(&mut self, desc: BodyDesc, motion: BodyState, activity: Activity) {
        let (tick, tumbles) = (self.scene.tick(), self.scene.inertia(desc.id).is_some());
        let track = streams::first_track(tick, (motion, activity), &desc, tumbles);
        if let Some(parameters) = streams::parameters(&self.scene, desc.id) {
            self.streams.insert(desc.id, &parameters, track, motion);
        }
        self.place_in_cells(&Placement {
            desc,
            motion,
            track,
        });
        self.record_event(streams::scene_event(&self.scene, desc, track, None));
    }

    /// Carries out a command if the scene and the server admit it.
    fn carry_out(&mut self, command: &Command) -> Result<(), CommandError> {
        let (limits, load) = (&self.settings.limits, &mut self.load);
        rights::admit(command, &self.scene, &self.authority_table, limits, load)?;
        let applied = self.scene.apply(command);
        match command {
            Command::AddBody { .. } if applied.is_err() => self.load.remove_body(),
            Command::SetLocomotion { .. } if applied.is_err() => self.reserve_locomotion(),
            // A body that changes may cease to be a character.
            Command::ChangeBody { .. } => self.reserve_locomotion(),
            _ => {}
        }
        applied
    }

    /// Reserves what the characters and vehicles of the scene cost now.
    pub(super) fn reserve_locomotion(&mut self) {
        let steps = load::locomotion_steps(self.scene.locomotions());
        let _ = self.load.set_locomotion(steps);
    }

    /// Removes what the scene keeps of a body that has left it.
    pub(super) fn remove_body(&mut self, id: BodyId, cause: RemovalCause, clients: &mut Clients) {
        self.streams.remove(id);
        if let Some(fed) = &mut self.fed {
            fed.forget(id);
        }
        self.authority_table.remove(id, clients);
        self.ownership.remove_body(id);
        self.load.remove_body();
        self.reserve_locomotion();
        self.record_event(SceneEvent::BodyRemoved { id, cause });
    }
}

fn encoded(tick: Tick, missed: u64, events: Vec<BodyEvent>) -> Bytes {
    let events = TickEvents {
        tick,
        missed,
        events,
    };
    let mut bytes = Vec::new();
    ServerMessage::TickEvents(events).encode(&mut bytes);
    Bytes::from(bytes)
}

impl RunningScene {
    /// Answers a member's message of queries.
    pub(super) fn answer_queries(&mut self, peer: Peer, queries: &[Query], clients: &mut Clients) {
        // Answers keep the order of messages: pending commands are answered first.
        self.answer_pending(clients);
        let answers = self.evaluate(peer, queries, clients);
        let Some(member) = clients.member_mut(peer) else {
            return;
        };
        let result = QueryResult {
            number: member.number_query(),
            tick: self.scene.tick(),
            answers,
        };
        clients.send(peer, &ServerMessage::QueryResult(result));
    }

    /// Charges the queries to the member, and evaluates them.
    fn evaluate(
        &mut self,
        peer: Peer,
        queries: &[Query],
        clients: &mut Clients,
    ) -> Result<Vec<Answer>, QueryError> {
        if self.faulted {
            return Err(QueryError::SceneFaulted);
        }
        let (now, count) = (clients.now(), clients.member_count());
        let cost = queries.iter().map(Query::cost).sum();
        // The members of a lockstep scene wait for one another anyway.
        if self.config().stepping == Stepping::FreeRunning
            && let Some(member) = clients.member_mut(peer)
            && (self.late || !member.query_budget.spend(now, cost, count))
        {
            return Err(QueryError::Overloaded);
        }
        self.scene.query(queries)
    }

    /// Sends the events of a step to the members, encoded once. A member that missed some gets what stands, too.
    pub(super) fn send_step_events(&mut self, happened: StepEvents, clients: &mut Clients) {
        let (scene, tick) = (&self.scene, self.scene.tick());
        let count = happened.count();
        let (mut shared, mut standing) = (None, None);
        let (members, out) = clients.members_mut();
        for (member, control) in members {
            if control.is_behind() {
                member.miss_events(count);
            } else if let Some(after) = member.standing_after {
                let standing = standing.get_or_insert_with(|| scene.standing_events());
                let (events, due) = happened.with_standing(tick, standing, after);
                let missed = happened.missed + std::mem::take(&mut member.missed_events);
                member.standing_after = match happened.missed {
                    0 => due,
                    _ => Some(EventKey::FIRST),
                };
                if missed > 0 || !events.is_empty() {
                    control.send_encoded(&encoded(tick, missed, events), out);
                }
            } else if count > 0 {
                let shared = shared
                    .get_or_insert_with(|| encoded(tick, happened.missed, happened.of_tick(tick)));
                control.send_encoded(shared, out);
                if happened.missed > 0 {
                    member.standing_after = Some(EventKey::FIRST);
                }
            }
        }
    }

    /// Tells a new member what stands; what exceeds a message, or waits for its snapshot, comes with the next ticks.
    pub(super) fn tell_standing(&self, peer: Peer, clients: &mut Clients) {
        let standing = self.scene.standing_events();
        let tick = self.scene.tick();
        let (events, due) = StepEvents::default().with_standing(tick, &standing, EventKey::FIRST);
        let Some(member) = clients.member_mut(peer) else {
            return;
        };
        member.standing_after = due;
        if !events.is_empty() {
            clients.send_encoded(peer, &encoded(self.scene.tick(), 0, events));
        }
    }

    pub(crate) fn inspect(&mut self, peer: Peer, clients: &mut Clients) {
        let times = self.times.summary();
        let Some(stream) = self.stream_of(peer, clients) else {
            return;
        };
        let sent = stream.sender.statistics();
        let inspection = Inspection {
            tick: self.scene.tick(),
            truth: self.scene.digest().value(),
            bodies: self.scene.body_count() as u32,
            awake: self.scene.awake_count() as u32,
            updates: sent.updates,
            packets: sent.packets,
            packet_bytes: sent.bytes,
            mismatches: stream.sender.mismatches(),
            over_budget: sent.over_budget,
            times,
        };
        clients.send(peer, &ServerMessage::Inspection(inspection));
    }
}

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

    fn handle_upstream(&mut self, peer: Peer, datagram: &Datagram<'_>, clients: &mut Clients) {
        let tick = self.scene.tick();
        let group = clients
            .member_mut(peer)
            .and_then(|member| member.authority.as_mut());
        if group.is_some_and(|group| !group.handle_datagram(datagram, tick)) {
            self.send_scene_events(clients);
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
        if self.fed.is_some() {
            return Err(AuthorityError::NotAllowed);
        }
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
