//! The ticks of a scene, and the turns of its connections between them.
//!
//! Order of a tick: commands, step, observe, send. Some messages keep their places between ticks. A turn is bounded: what is
//! left of a connection's messages waits for others and for the ticks.

use std::collections::BTreeMap;

use bytes::Bytes;
use rhumb_protocol::limits::PENDING_COMMANDS_MAX;
use rhumb_protocol::message::{ClientMessage, Denial, RemovalCause, SceneEvent, ServerMessage};
use rhumb_protocol::scene::{Cell, Command, CommandError, Locomotion, Stepping};
use rhumb_protocol::{Instant, Peer, Span};

use super::{DisconnectReason, RunningScene, SceneLoop};
use crate::baking::{self, Bake};
use crate::bodies_by_cell::Cells;
use crate::clients::{self, Clients, Turn};
use crate::hook::{Incident, Timestamps};
use crate::member::{Extent, Subscribed};
use crate::record::TickMetrics;
use crate::settings::SceneScript;
use crate::streams::Streams;

/// A free-running scene that is later than so many steps slows down instead of catching up.
const CATCH_UP_STEPS: u64 = 5;

impl RunningScene {
    /// The time of the next step: at once in a scene that must advance, never in one without members.
    pub(crate) fn next_step(&self) -> Option<Instant> {
        if self.faulted {
            return None;
        }
        if let Some(fed) = &self.fed {
            return fed.next_wake(self.config().stepping);
        }
        match self.config().stepping {
            Stepping::Lockstep => (self.scene.tick() < self.target).then_some(Instant::ZERO),
            Stepping::FreeRunning => Some(self.next_step?.max(self.pace.next_step())),
        }
    }

    /// Acts on a command, an advance, or a request for authority, in the order of sending: a message that follows an
    /// advance waits for its steps.
    pub(crate) fn handle_ordered(
        &mut self,
        peer: Peer,
        message: Result<ClientMessage, CommandError>,
        clients: &mut Clients,
    ) {
        note_activity(peer, clients);
        // The owner of a fed scene steps it by what it feeds: no message waits for that.
        let steps_pending = self.config().stepping == Stepping::Lockstep
            && self.scene.tick() < self.target
            && self.fed.is_none();
        if !steps_pending || self.faulted {
            return self.act_on(peer, message, clients);
        }
        if let Some(member) = clients.member_mut(peer) {
            member.pending_bytes += weight(&message);
            self.waiting.push_back((peer, message));
        }
    }

    /// Acts on waiting messages, up to the next advance with pending steps.
    fn act_on_waiting(&mut self, clients: &mut Clients) {
        while self.faulted || self.scene.tick() >= self.target {
            let Some((peer, message)) = self.waiting.pop_front() else {
                break;
            };
            if let Some(member) = clients.member_mut(peer) {
                member.pending_bytes = member.pending_bytes.saturating_sub(weight(&message));
            }
            self.act_on(peer, message, clients);
        }
        self.answer_pending(clients);
    }

    fn act_on(
        &mut self,
        peer: Peer,
        message: Result<ClientMessage, CommandError>,
        clients: &mut Clients,
    ) {
        if clients.member(peer).is_none() {
            return;
        }
        let command = match message {
            Ok(ClientMessage::Command(command)) => Ok(command),
            Err(error) => Err(error),
            Ok(ClientMessage::Advance { to }) => {
                let rights = self.rights_of(peer, clients).ok_or(Denial::NotAllowed);
                match rights.and_then(|rights| rights.advance(to)) {
                    Ok(()) => self.target = self.target.max(to),
                    Err(denial) => clients.send(peer, &ServerMessage::Denied(denial)),
                }
                return;
            }
            Ok(ClientMessage::TakeAuthority(request)) => {
                return self.grant_authority(peer, &request, clients);
            }
            Ok(ClientMessage::Upstream(packet)) => {
                return self.handle_upstream_message(peer, &packet, clients);
            }
            Ok(ClientMessage::Query(queries)) => {
                return self.answer_queries(peer, &queries, clients);
            }
            // Other messages do not depend on their place among the commands.
            Ok(_) => return,
        };
        let Some((number, session)) = clients.begin_command(peer) else {
            return;
        };
        if let Some(fed) = &mut self.fed {
            fed.note_command(peer);
        }
        if let Ok(command) = &command {
            self.observer.command(peer, number, command);
        }
        let unsent = self.unsent.len();
        self.pace.note_command();
        let applied = command.and_then(|command| {
            self.apply_of_member((peer, number), &command, clients)?;
            if matches!(command, Command::AddBody { .. }) {
                self.pace.note_body(peer);
            }
            Ok(())
        });
        let refused = applied.err();
        let refused = refused.map(|error| self.restore_if_failed(error, clients));
        self.observer.commanded(refused.as_ref());
        self.note_command(session, refused);
        if let Some(error) = refused {
            clients.send(peer, &ServerMessage::Refused { number, error });
        }
        let added = self.unsent.len().saturating_sub(unsent);
        if let Some(member) = clients.member_mut(peer) {
            member.added_bytes += added;
        }
    }

    pub(super) fn record_event(&mut self, scene_event: SceneEvent) {
        self.scene_events += 1;
        self.observer.scene_event(&scene_event);
        if let Some(cells) = self.used_cells() {
            cells.note(&scene_event);
        }
        ServerMessage::SceneEvent(scene_event).encode(&mut self.unsent);
    }

    /// Sends new scene events to every member, encoded once.
    pub(super) fn send_scene_events(&mut self, clients: &mut Clients) {
        let of_cells = self.used_cells().map(Cells::take_unsent);
        let of_cells = of_cells.unwrap_or_default();
        if !self.unsent.is_empty() || !of_cells.is_empty() {
            self.send_events_of_cells(&of_cells, clients);
        }
        self.authority_table.tell_removed(clients);
    }

    /// Sends the new scene events, and to members by cells those of their cells.
    fn send_events_of_cells(
        &mut self,
        of_cells: &[(Option<Cell>, Vec<u8>)],
        clients: &mut Clients,
    ) {
        let messages = Bytes::from(std::mem::take(&mut self.unsent));
        let (members, out) = clients.members_mut();
        for (member, control) in members {
            let Some(taken) = &member.cells else {
                control.send_encoded(&messages, out);
                continue;
            };
            let is_for = |cell: &Option<Cell>| cell.is_none_or(|cell| taken.contains_key(&cell));
            // One message for each cell would cost as many sends as bodies cross.
            let mut messages = Vec::new();
            for (_, of_cell) in of_cells.iter().filter(|(cell, _)| is_for(cell)) {
                messages.extend_from_slice(of_cell);
            }
            if !messages.is_empty() {
                control.send_encoded(&messages.into(), out);
            }
        }
    }

    /// Answers the input of one read after all of it was handled.
    pub(crate) fn answer_pending(&mut self, clients: &mut Clients) {
        self.send_scene_events(clients);
        self.commit(clients);
        self.shorten_log(clients);
        for (peer, snapshot_request) in clients.take_snapshot_requests() {
            match self.begin_snapshot_change(peer, snapshot_request, clients) {
                Ok(()) => self.send_snapshot(peer, 0, clients),
                Err(denial) => clients.send(peer, &ServerMessage::Denied(denial)),
            }
        }
        self.answer_cell_requests(clients);
        let tick = self.scene.tick();
        let (members, out) = clients.members_mut();
        for (member, control) in members {
            if let Some(through) = member.unanswered.take() {
                control.send(&ServerMessage::Applied { through, tick }, out);
            }
        }
    }

    /// Steps if a step is due.
    pub(crate) fn handle_timeout(&mut self, now: Instant, clients: &mut Clients) {
        if self.next_step().is_none_or(|due| due > now) {
            return;
        }
        if self.fed.is_some() && !self.begin_fed_turn(now, clients) {
            return;
        }
        if let Some(due) = self.next_step {
            let step = self.step();
            let late_by = now.since(due).as_nanos();
            self.late = late_by > step.as_nanos();
            if self.late {
                self.observer.incident(Incident::Late);
            }
            let kept = late_by <= step.as_nanos() * CATCH_UP_STEPS;
            self.next_step = Some(if kept { due + step } else { now + step });
            if !kept {
                self.observer.incident(Incident::Slowed);
            }
        }
        self.last_step = now;
        let begun = self.clock_now();
        self.tick(clients);
        self.pace.note_tick(now, self.clock_now().since(begun));
        if self.config().stepping == Stepping::FreeRunning {
            clients::send_reports(now, self.scene.tick(), clients);
        }
        self.act_on_waiting(clients);
    }

    /// The moment by the clock that measures.
    fn clock_now(&self) -> Instant {
        (self.settings.clock)()
    }

    pub(super) fn step(&self) -> Span {
        Span::from_nanos(self.config().integrator.rate.step_ns())
    }

    /// One tick: step, predict, publish.
    fn tick(&mut self, clients: &mut Clients) {
        let begun = self.clock_now();
        self.copy_if_due();
        self.observer.step_began(begun, self.scene.tick());
        let table = &mut self.authority_table;
        for scene_event in table.set_targets(&mut self.scene, clients) {
            self.record_event(scene_event);
        }
        self.run_script(clients);
        let hook = self.hook.as_mut();
        let refused = hook.map(|hook| hook.act(&mut self.scene));
        let Some(stepped) = self.step_or_restore(clients) else {
            return;
        };
        let after_step = self.clock_now();
        self.rollback.note_step(after_step.since(begun));
        self.snapshot_if_due(after_step.since(begun), clients);
        for error in refused.into_iter().flatten() {
            tracing::warn!(%error, "the scene continues without the command");
        }
        for (id, cause) in stepped.removed {
            self.note_removal(cause);
            self.remove_body(id, cause, clients);
        }
        for id in stepped.broken {
            self.ownership.remove_joint(id);
            self.record_event(SceneEvent::JointRemoved { id });
        }
        self.streams
            .observe(self.scene.tick(), self.scene.observations());
        self.observe_cells(clients);
        let observed = self.clock_now();
        self.streams.publish(self.scene_events);
        if let Some(cells) = self.used_cells() {
            cells.publish();
        }
        self.commit(clients);
        self.send_scene_events(clients);
        self.send_step_events(stepped.happened, clients);
        self.send_packets(clients);
        let timestamps = Timestamps {
            begun,
            stepped: after_step,
            observed,
            published: self.clock_now(),
        };
        self.note_times(timestamps, clients.member_count());
    }

    /// Sends the packets of the newest tick to the members of their streams.
    fn send_packets(&self, clients: &mut Clients) {
        let speaking = self.cells.as_ref().map(Cells::speaking).unwrap_or_default();
        let (members, out) = clients.members_mut();
        for (member, control) in members {
            let peer = control.peer();
            let mut send = |of: &Streams, stream| {
                let packets = of.packets(stream, peer);
                packets.for_each(|packet| control.send_datagram(packet.clone(), out));
            };
            let common = match member.extent() {
                Extent::Cells => speaking.get(&None).copied(),
                Extent::Whole => Some(&self.streams),
            };
            for stream in member.streams() {
                common.into_iter().for_each(|of| send(of, stream));
            }
            let taken = member.cells.as_ref().map_or(0, BTreeMap::len);
            if taken < speaking.len() {
                let known = |(cell, stream)| Some((*speaking.get(&Some(cell))?, stream));
                let streams = member.cell_streams().filter_map(known);
                streams.for_each(|(of, stream)| send(of, stream));
                continue;
            }
            for (cell, of) in &speaking {
                let subscribed = cell.and_then(|cell| member.subscribed(cell));
                let streams = subscribed.into_iter().flat_map(Subscribed::streams);
                streams.for_each(|stream| send(of, stream));
            }
        }
    }

    pub(crate) fn pong(&mut self, now: Instant, peer: Peer, sent: Instant, clients: &mut Clients) {
        note_activity(peer, clients);
        let pong = ServerMessage::Pong {
            sent,
            tick: self.scene.tick(),
            since_tick_ns: now.since(self.last_step).as_nanos(),
        };
        clients.send(peer, &pong);
    }

    /// Informs the members that the scene has ended.
    pub(crate) fn end(mut self, clients: &mut Clients) {
        self.delete_log(clients);
        for (peer, member) in clients.take_members() {
            if let Some(group) = member.authority {
                group.log_end(peer);
            }
            clients.send(peer, &ServerMessage::Deleted);
        }
    }
}

/// A member's message shows that it has the scene.
fn note_activity(peer: Peer, clients: &mut Clients) {
    if let Some(member) = clients.member_mut(peer) {
        member.link.note_message();
    }
}

/// Weight of a waiting message beside its shape or packet.
const MESSAGE_WEIGHT: usize = 64;

/// Weight of a waiting message: about its bytes in memory.
fn weight(message: &Result<ClientMessage, CommandError>) -> usize {
    MESSAGE_WEIGHT
        + match message {
            Ok(ClientMessage::Command(Command::AddShape { shape, .. })) => shape.bytes(),
            Ok(ClientMessage::Command(Command::SetLocomotion { locomotion, .. })) => {
                size_of::<Locomotion>() + wheels_bytes(locomotion)
            }
            Ok(ClientMessage::Command(Command::SetWheels { inputs, .. })) => size_of_val(&**inputs),
            Ok(ClientMessage::Upstream(packet)) => packet.len(),
            Ok(ClientMessage::Query(queries)) => size_of_val(&**queries),
            _ => 0,
        }
}

fn wheels_bytes(locomotion: &Locomotion) -> usize {
    match locomotion {
        Locomotion::Vehicle(vehicle) => size_of_val(&*vehicle.wheels),
        Locomotion::None | Locomotion::Character(_) => 0,
    }
}

/// Weight of the messages of one member that may wait for the steps of an advance: [`PENDING_COMMANDS_MAX`] short ones.
const PENDING_BYTES_MAX: usize = PENDING_COMMANDS_MAX * MESSAGE_WEIGHT;
/// A member for which more than this waits is behind.
const MEMBER_BEHIND_BYTES: usize = 2 << 20;

impl RunningScene {
    /// True if a member's next message must stay unread: the bodies that it adds wait for a step, as much as may waits for
    /// the steps of an advance, its commands exceed its quota, or what it added to the scene still waits for slower members.
    fn holds_back(&self, now: Instant, peer: Peer, clients: &mut Clients) -> bool {
        // Of a scene that does not step by itself, nothing waits for a step; the step of a fed one waits for commands.
        let steps = self.config().stepping == Stepping::FreeRunning
            && self.fed.is_none()
            && self.next_step().is_some();
        if steps && clients.is_paced(peer) && self.pace.holds_back(peer) {
            return true;
        }
        let Some(member) = clients.member_mut(peer) else {
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
        clients.is_any_behind(MEMBER_BEHIND_BYTES)
    }

    /// Bytes of scene events that the members have not got yet.
    const fn unsent_bytes(&self) -> usize {
        self.unsent.len()
    }
}

impl RunningScene {
    /// Attaches a script, which commands the scene before each step, and runs it once. Members get ids after
    /// those of its bodies.
    pub(crate) fn follow_script(&mut self, script: SceneScript, clients: &mut Clients) {
        self.script = Some(script);
        self.run_script(clients);
        let indices = self.scene.bodies().map(|body| body.id.index() + 1);
        let end = indices.max().unwrap_or(0);
        self.id_ranges.begin_after(end);
    }

    /// Applies the script's commands before the next step.
    fn run_script(&mut self, clients: &mut Clients) {
        let Some(mut script) = self.script.take() else {
            return;
        };
        if !self.faulted && self.scene.is_sound() {
            for command in script.commands(&self.scene) {
                // A script may add thousands of bodies at once.
                self.settings.heartbeat.beat();
                if let Err(error) = self.apply_and_announce(&command, clients) {
                    tracing::warn!(%error, "a command of the scene's script is refused");
                }
            }
        }
        self.script = Some(script);
    }
}

impl RunningScene {
    /// Adds the times of a tick to the scene's metrics.
    fn note_times(&mut self, timestamps: Timestamps, members: usize) {
        self.times.add(timestamps);
        let cells = self.cells.as_ref();
        let metrics = TickMetrics {
            tick: self.scene.tick(),
            members,
            bodies: self.scene.body_count(),
            awake: self.scene.awake_count(),
            waiting: self.streams.waiting() + cells.map_or(0, Cells::waiting),
            load: self.load.reserved(),
            step: timestamps.stepped.since(timestamps.begun),
            publish: timestamps.published.since(timestamps.stepped),
        };
        let of_cells = cells.into_iter().flat_map(Cells::all_packets);
        let mut packets = self.streams.all_packets().chain(of_cells);
        let observer = &mut self.observer;
        observer.stepped(&metrics, &self.scene, &mut packets);
    }

    /// A body whose state was not finite is a fault of the engine.
    fn note_removal(&mut self, cause: RemovalCause) {
        if cause == RemovalCause::NotFinite {
            self.observer.incident(Incident::NotFinite);
        }
    }
}

/// Messages of one connection that are handled before others, and the ticks, get their turn.
const MESSAGES_PER_TURN: usize = 512;
/// Scene events that are encoded before they are sent to the members.
const EVENT_BYTES: usize = 256 << 10;
/// The pause before a connection is tried again whose messages wait for slower members.
const RETRY: Span = Span::from_millis(20);

impl SceneLoop {
    /// Handles the messages that a connection has sent. If others have used up the time, they wait for the next call.
    pub(super) fn take_turn_at_once(&mut self, now: Instant, peer: Peer) {
        if self.turns_left == Span::ZERO && self.is_turn_timed(peer) {
            self.clients.set_turn(peer, Turn::Queued);
        } else {
            self.take_turn(now, peer, self.turns_left);
        }
    }

    /// Gives each of these connections a turn with an equal part of the time that is left, or with one message if none is left.
    pub(super) fn take_turns(&mut self, now: Instant, peers: &[Peer]) {
        for (place, peer) in peers.iter().enumerate() {
            let waiting = (peers.len() - place) as u64;
            let share = Span::from_nanos(self.turns_left.as_nanos() / waiting);
            self.take_turn(now, *peer, share);
        }
    }

    /// True if the turns of a connection are bounded by time: the members of a lockstep scene wait for one another anyway.
    fn is_turn_timed(&self, peer: Peer) -> bool {
        let running = self.running.as_ref();
        let by_clock = |of: &RunningScene| of.config().stepping == Stepping::FreeRunning;
        self.clients.is_paced(peer) && running.is_some_and(by_clock)
    }

    /// Handles a connection's messages, until none is left, it must wait, or others have their turn.
    fn take_turn(&mut self, now: Instant, peer: Peer, share: Span) {
        let (begun, is_timed) = ((self.settings.clock)(), self.is_turn_timed(peer));
        let mut left = if self.clients.is_paced(peer) {
            MESSAGES_PER_TURN
        } else {
            usize::MAX
        };
        loop {
            if self.must_wait(now, peer) {
                self.clients.set_turn(peer, Turn::Blocked);
                break;
            }
            if left == 0 {
                self.clients.set_turn(peer, Turn::Queued);
                break;
            }
            let Some(message) = self.next_message(peer) else {
                break;
            };
            if let Ok(message @ ClientMessage::Join(_)) = &message
                && !self.clients.may_snapshot(peer)
                && let Some(client) = self.clients.get_mut(peer)
            {
                client.held = Some(message.clone());
                self.clients.set_turn(peer, Turn::Blocked);
                break;
            }
            let Some(message) = self.bake(now, peer, message) else {
                self.clients.set_turn(peer, Turn::Blocked);
                break;
            };
            // A message of queries or for indices ends the turn: it is as much work as many others.
            let is_work = left != usize::MAX
                && matches!(
                    message,
                    Ok(ClientMessage::Query(_) | ClientMessage::Reserve { .. })
                );
            left = if is_work { 0 } else { left - 1 };
            self.settings.heartbeat.beat();
            self.handle_message(now, peer, message);
            self.answer_if_long();
            if is_timed && (self.settings.clock)().since(begun) >= share {
                left = 0;
                if let Some(running) = &mut self.running {
                    running.pace.note_full_turn();
                }
            }
        }
        self.end_if_broken(peer);
        self.answer_pending();
        if is_timed {
            let took = (self.settings.clock)().since(begun).as_nanos();
            let left = self.turns_left.as_nanos().saturating_sub(took);
            self.turns_left = Span::from_nanos(left);
        }
    }

    /// Sends the scene events if there are many.
    fn answer_if_long(&mut self) {
        if self
            .running
            .as_ref()
            .is_some_and(|running| running.unsent_bytes() > EVENT_BYTES)
        {
            self.answer_pending();
        }
    }

    /// True if a connection's next message must stay unread.
    fn must_wait(&mut self, now: Instant, peer: Peer) -> bool {
        if self.clients.is_behind(peer) {
            return true;
        }
        let running = self.running.as_ref();
        running.is_some_and(|running| running.holds_back(now, peer, &mut self.clients))
    }

    fn next_message(&mut self, peer: Peer) -> Option<Result<ClientMessage, CommandError>> {
        let client = self.clients.get_mut(peer)?;
        if client.turn == Turn::Over {
            return None;
        }
        match client.held.take() {
            Some(message) => Some(Ok(message)),
            None => self.clients.session(peer)?.poll_message(),
        }
    }

    /// Tries the connections again that had to wait. Those whose solids wait for others come first, the longest wait before
    /// all: so a place for a solid goes to the one that waits longest.
    pub(super) fn retry(&mut self, now: Instant) {
        self.retry_at = now + RETRY;
        let mut blocked = self.clients.take_in_turn(Turn::Blocked);
        blocked.sort_by_key(|peer| {
            let since = self.waits_to_bake_since(*peer);
            (since.is_none(), since)
        });
        self.take_turns(now, &blocked);
    }

    /// The moment since which a connection's solid waits for others; `None` if none does.
    fn waits_to_bake_since(&self, peer: Peer) -> Option<Instant> {
        self.clients.get(peer)?.bake.as_ref()?.waits_since()
    }

    /// Something that a connection waited for is there.
    pub fn handle_wake(&mut self, now: Instant) {
        self.clients.at(now);
        if self.is_baking() {
            self.retry(now);
        }
    }

    /// True if a connection waits for a solid.
    fn is_baking(&self) -> bool {
        let mut waiting = self.clients.in_turn(Turn::Blocked);
        let bakes = |peer| (self.clients.get(peer)).is_some_and(|of| of.bake.is_some());
        self.bakery.is_busy() || waiting.any(bakes)
    }

    /// Handles what arrived before the end of a connection, as far as it does something without its client: an answer
    /// would have no reader. A client that leaves loses nothing. Of one that broke off, what is beyond its rate is left out,
    /// since its session sends it again.
    pub(super) fn handle_rest(&mut self, now: Instant, peer: Peer, reason: DisconnectReason) {
        let is_left_out = |scene: &mut Self| {
            reason == DisconnectReason::Disconnected
                && (scene.clients.member(peer)).is_some_and(|member| member.is_over_rate(now))
        };
        while !is_left_out(self)
            && let Some(message) = self.next_message(peer)
        {
            self.settings.heartbeat.beat();
            match message {
                // The client is gone and joins nothing.
                Ok(ClientMessage::Join(_) | ClientMessage::Session(_)) => break,
                Ok(message) if asks_for_an_answer_alone(&message) => continue,
                _ => {}
            }
            let Some(message) = self.bake(now, peer, message) else {
                break;
            };
            self.handle_message(now, peer, message);
            self.answer_if_long();
        }
    }

    /// A message that is to be handled now: the message itself, or the error of a shape whose solid took too long. `None`
    /// if it is held until its solid is made.
    fn bake(
        &mut self,
        now: Instant,
        peer: Peer,
        message: Result<ClientMessage, CommandError>,
    ) -> Option<Result<ClientMessage, CommandError>> {
        let Ok(ClientMessage::Command(Command::AddShape { id, shape })) = &message else {
            return Some(message);
        };
        if !baking::is_heavy(shape) {
            return Some(message);
        }
        let is_new = (self.clients.get(peer)).is_some_and(|of| of.bake.is_none());
        // A new one gives way to those that wait, and is tried again after them.
        let waits = |of| self.waits_to_bake_since(of).is_some();
        let gives_way = is_new && self.clients.in_turn(Turn::Blocked).any(waits);
        let Some(client) = self.clients.get_mut(peer) else {
            return Some(message);
        };
        let running = self.running.as_mut().filter(|_| client.member.is_some());
        let Some((running, baker)) = running.and_then(|running| {
            let baker = running.baker_for(&client.permit, *id, shape)?;
            Some((running, baker))
        }) else {
            // The shape needs no solid any more; one that is made for it is of no other use.
            client.bake = None;
            return Some(message);
        };
        let bake = client.bake.get_or_insert_with(|| Bake::wanted(now));
        if !gives_way {
            self.bakery.begin(bake, now, shape, baker);
        }
        if let Some(baked) = bake.take() {
            running.put_baked(*id, shape, baked);
            client.bake = None;
            return Some(message);
        }
        if bake.takes_longer_than(self.settings.limits.bake(), now) {
            client.bake = None;
            let limit_ms =
                u32::try_from(self.settings.limits.bake_milliseconds).unwrap_or(u32::MAX);
            return Some(Err(CommandError::ShapeTooSlow { limit_ms }));
        }
        client.held = message.ok();
        None
    }
}

/// True for a message that does nothing but for its sender.
const fn asks_for_an_answer_alone(message: &ClientMessage) -> bool {
    matches!(
        message,
        ClientMessage::Query(_)
            | ClientMessage::Inspect
            | ClientMessage::Ping { .. }
            | ClientMessage::Reserve { .. }
            | ClientMessage::Resync(_)
            | ClientMessage::Subscribe(_)
            | ClientMessage::Subscribed(_)
            | ClientMessage::TierPolicy(_)
            | ClientMessage::OfCell { .. }
    )
}

#[cfg(test)]
mod tests;
