//! One scene with its members: applies wishes, steps, says what came of it.
//!
//! Neither sockets nor threads: the host feeds it requests and moments. Order of a tick: wishes, step, observe, say.

mod driving;
mod following;
mod leading;

use std::collections::{BTreeMap, VecDeque};

use bytes::Bytes;
use rhumb_protocol::limits::{
    ADVANCE_TICKS_MAX, GRANT, MEMBERS_PER_SCENE_MAX, SILENCE_MS_MAX, WISHES_WAITING_MAX,
};
use rhumb_protocol::message::{
    Denial, Extensions, Inspection, Joined, Notice, RemovalCause, ServerMessage, StreamChoice,
};
use rhumb_protocol::packet::StreamId;
use rhumb_protocol::scene::{Command, CommandError, Pace, SceneTerms};
use rhumb_protocol::session::CloseCode;
use rhumb_protocol::stream::{Activity, Observation, StreamStart};
use rhumb_protocol::{Instant, Peer, Span};
use rhumb_reckoning::{Tick, Ticks};

use crate::drives::Drives;
use crate::grants::Grants;
use crate::member::{Member, Want, Wish};
use crate::outbox::Outbox;
use crate::placing;
use crate::scene::Scene;
use crate::snapshot::snapshot;
use crate::stream_names::StreamNames;
use crate::streams::{Moment, Source, Stream, Streams};
use crate::times::{Marks, Times};

/// Reads the host's clock between the stages of a tick.
pub(crate) type Stopwatch<'a> = &'a dyn Fn() -> Instant;

/// One scene with its members.
pub(crate) struct Room {
    scene: Scene,
    members: BTreeMap<Peer, Member>,
    streams: Streams,
    names: StreamNames,
    grants: Grants,
    drives: Drives,
    notices: u64,
    /// Notices given since they were last handed to the members.
    unsaid: Vec<u8>,
    target: Tick,
    /// What was said while steps are still owed to an earlier advance.
    waiting: VecDeque<(Peer, Wish)>,
    next_step: Option<Instant>,
    last_step: Instant,
    times: Times,
    faulted: bool,
    /// Whether a client of another protocol says when it steps and ends.
    led: bool,
}

/// A free-running scene that is later than so many steps lets time go slower instead of catching up.
const CATCH_UP_STEPS: u64 = 5;

impl Room {
    /// `names`: what its streams will be called.
    pub(crate) fn new(scene: Scene, names: StreamNames) -> Self {
        let target = scene.tick();
        let streams = Streams::new(scene.terms().cadence);
        Self {
            scene,
            members: BTreeMap::new(),
            streams,
            names,
            grants: Grants::default(),
            drives: Drives::default(),
            notices: 0,
            unsaid: Vec::new(),
            target,
            waiting: VecDeque::new(),
            next_step: None,
            last_step: Instant::ZERO,
            times: Times::default(),
            faulted: false,
            led: false,
        }
    }

    pub(crate) fn terms(&self) -> &SceneTerms {
        self.scene.terms()
    }

    pub(crate) fn members(&self) -> impl Iterator<Item = Peer> {
        self.members.keys().copied()
    }

    /// When the next step is due: at once in a scene that was told to advance, never in one that nobody sees.
    pub(crate) fn next_step(&self) -> Option<Instant> {
        if self.faulted {
            return None;
        }
        match self.terms().pace {
            Pace::Lockstep => (self.scene.tick() < self.target).then_some(Instant::ZERO),
            Pace::FreeRunning => self.next_step,
        }
    }

    /// Makes a client a member; it hears the whole scene, then the stream.
    pub(crate) fn join(
        &mut self,
        now: Instant,
        peer: Peer,
        choice: StreamChoice,
        out: &mut Outbox,
    ) -> Result<(), Denial> {
        if self.faulted {
            return Err(Denial::SceneFaulted);
        }
        if self.members.len() >= MEMBERS_PER_SCENE_MAX {
            return Err(Denial::TooManyMembers);
        }
        let stream = match self.streams.follow(choice)? {
            Some(stream) => stream,
            None => self.begin_stream(choice),
        };
        if let Err(denial) = self.grant(peer, GRANT) {
            self.streams.unfollow(stream, peer);
            return Err(denial);
        }
        self.tell_notices(out);
        self.members.insert(peer, Member::new(stream, choice));
        self.tell_snapshot(peer, out);
        if self.next_step.is_none() {
            self.last_step = now;
            self.next_step = Some(now + self.step());
        }
        Ok(())
    }

    /// A name for a stream that begins now.
    fn new_stream(&mut self) -> StreamId {
        let (streams, drives) = (&self.streams, &self.drives);
        self.names
            .next(|name| streams.get(name).is_some() || drives.has(name))
    }

    fn begin_stream(&mut self, choice: StreamChoice) -> StreamId {
        let id = self.new_stream();
        let source = Source::new(choice, id, &self.scene);
        let stream = self.streams.begin(choice, source);
        for (id, manner, track, motion) in placing::everything(&self.scene) {
            stream.place(id, &manner, track, motion);
        }
        id
    }

    fn grant(&mut self, peer: Peer, count: u32) -> Result<rhumb_protocol::scene::IdRange, Denial> {
        let scene = &self.scene;
        self.grants
            .grant(peer, count, &|range| scene.vacancy(range))
            .ok_or(Denial::NoIndicesLeft)
    }

    /// Says where the stream begins, and every shape and body.
    fn tell_snapshot(&mut self, peer: Peer, out: &mut Outbox) {
        let granted = match self.grants.first(peer) {
            Some(range) => range,
            None => return,
        };
        if let Some(member) = self.members.get(&peer) {
            self.streams.tell_anew(member.stream(), peer);
        }
        let Some(stream) = self.stream_of(peer) else {
            return;
        };
        let start = StreamStart {
            stream: stream.id(),
            tolerance: stream.tolerance(),
            integrator: self.terms().integrator,
            every: self.terms().cadence.every,
            gravity: self.scene.gravity(),
            tick: stream.tick(),
            next: stream.next_number(),
            notices: self.notices,
        };
        let joined = Joined {
            choice: stream.choice,
            terms: *self.terms(),
            start,
            granted,
            extensions: Extensions::NONE,
        };
        out.say(peer, &ServerMessage::Joined(joined));
        let snapshot = snapshot(&self.scene, stream);
        out.say_encoded(peer, &Bytes::from(snapshot));
    }

    fn stream_of(&self, peer: Peer) -> Option<&Stream> {
        let member = self.members.get(&peer)?;
        self.streams.get(member.stream())
    }

    /// A client is a member no longer. Its bodies stay; what it wished behind an advance that is not reached yet goes.
    pub(crate) fn leave(&mut self, peer: Peer) {
        self.waiting.retain(|(wisher, _)| *wisher != peer);
        self.drives.end(peer);
        if let Some(member) = self.members.remove(&peer) {
            for stream in member.streams() {
                self.streams.unfollow(stream, peer);
            }
            self.grants.retire(peer);
        }
        if self.members.is_empty() {
            self.next_step = None;
        }
    }

    pub(crate) fn reserve(&mut self, peer: Peer, count: u32, out: &mut Outbox) {
        let answer = match self.grant(peer, count) {
            Ok(range) => ServerMessage::Reserved(range),
            Err(denial) => ServerMessage::Denied(denial),
        };
        out.say(peer, &answer);
    }

    /// Applies one command, or says why not; later if steps are still owed to an earlier advance.
    pub(crate) fn command(
        &mut self,
        peer: Peer,
        number: u64,
        command: Result<Command, CommandError>,
        out: &mut Outbox,
    ) {
        self.wish(peer, Wish::Command { number, command }, out);
    }

    /// Lets a lockstep scene step to a tick, after what was asked for before.
    pub(crate) fn advance(&mut self, peer: Peer, to: Tick, out: &mut Outbox) {
        self.wish(peer, Wish::Advance { to }, out);
    }

    /// A member says what it says only once it has the scene.
    fn note_word(&mut self, peer: Peer) {
        if let Some(member) = self.members.get_mut(&peer) {
            member.link.heard();
        }
    }

    fn wish(&mut self, peer: Peer, wish: Wish, out: &mut Outbox) {
        self.note_word(peer);
        let owed = self.terms().pace == Pace::Lockstep && self.scene.tick() < self.target;
        if !owed || self.faulted {
            return self.grant_wish(peer, wish, out);
        }
        if self.waiting.len() < WISHES_WAITING_MAX {
            self.waiting.push_back((peer, wish));
        } else if let Some(session) = out.session(peer) {
            session.close(CloseCode::LIMIT);
        }
    }

    /// Grants what waited, up to the next advance that steps are owed to.
    fn grant_waiting(&mut self, out: &mut Outbox) {
        while self.faulted || self.scene.tick() >= self.target {
            let Some((peer, wish)) = self.waiting.pop_front() else {
                break;
            };
            if self.members.contains_key(&peer) {
                self.grant_wish(peer, wish, out);
            }
        }
        self.settle(out);
    }

    fn grant_wish(&mut self, peer: Peer, wish: Wish, out: &mut Outbox) {
        match wish {
            Wish::Command { number, command } => {
                if let Err(error) = command.and_then(|command| self.apply(peer, &command)) {
                    out.say(peer, &ServerMessage::Refused { number, error });
                }
                if let Some(member) = self.members.get_mut(&peer) {
                    member.unanswered = Some(number);
                }
            }
            Wish::Advance { to } => match self.refuse_advance(to) {
                Some(denial) => out.say(peer, &ServerMessage::Denied(denial)),
                None => self.target = self.target.max(to),
            },
            Wish::Drive(drive) => self.grant_drive(peer, &drive, out),
            Wish::Upstream(packet) => self.hear_driver(peer, &packet, out),
        }
    }

    fn refuse_advance(&self, to: Tick) -> Option<Denial> {
        let too_far = to.value() > self.scene.tick().value() + ADVANCE_TICKS_MAX;
        match self.terms().pace {
            Pace::FreeRunning => Some(Denial::NotLockstep),
            Pace::Lockstep if self.led => Some(Denial::Led),
            Pace::Lockstep if self.faulted => Some(Denial::SceneFaulted),
            Pace::Lockstep if too_far => Some(Denial::TooFarAhead),
            Pace::Lockstep => None,
        }
    }

    fn apply(&mut self, peer: Peer, command: &Command) -> Result<(), CommandError> {
        if self.faulted {
            return Err(CommandError::SceneFaulted);
        }
        if let Command::AddBody { terms, .. } = command
            && !self.grants.allows(peer, terms.id)
        {
            return Err(CommandError::NotGranted(terms.id));
        }
        self.refuse_steering(command)?;
        self.scene.apply(command)?;
        let tick = self.scene.tick();
        match *command {
            Command::AddShape { id, ref shape } => {
                let shape = shape.clone();
                self.give(Notice::ShapeAdded { id, shape });
            }
            Command::RemoveShape { id } => self.give(Notice::ShapeRemoved { id }),
            Command::AddBody { terms, motion } => {
                let observation = Observation {
                    id: terms.id,
                    motion,
                    activity: Activity::Awake,
                };
                let tumbles = self.scene.inertia(terms.id).is_some();
                let track = placing::first_track(tick, &observation, terms.kind, tumbles);
                if let Some(manner) = placing::manner(&self.scene, terms.id) {
                    self.streams.place(terms.id, &manner, track, motion);
                }
                self.give(placing::notice(&self.scene, terms, track, None));
            }
            Command::RemoveBody { id } => {
                self.streams.remove(id);
                self.drives.remove(id);
                let cause = RemovalCause::Command;
                self.give(Notice::BodyRemoved { id, cause });
            }
            Command::AddJoint { id, joint } => self.give(Notice::JointAdded { id, joint }),
            Command::RemoveJoint { id } => self.give(Notice::JointRemoved { id }),
            Command::SetGravity { gravity } => {
                self.streams.change_gravity(tick, gravity);
                self.give(Notice::GravityChanged {
                    since: tick,
                    gravity,
                });
            }
            _ => {}
        }
        Ok(())
    }

    fn give(&mut self, notice: Notice) {
        self.notices += 1;
        ServerMessage::Notice(notice).encode(&mut self.unsaid);
    }

    /// Hands new notices to every member, encoded once.
    fn tell_notices(&mut self, out: &mut Outbox) {
        if self.unsaid.is_empty() {
            return;
        }
        let messages = Bytes::from(std::mem::take(&mut self.unsaid));
        for peer in self.members.keys() {
            out.say_encoded(*peer, &messages);
        }
    }

    /// All that a member sent at once was looked at: says what came of it.
    pub(crate) fn settle(&mut self, out: &mut Outbox) {
        self.tell_notices(out);
        let wanting: Vec<(Peer, Want)> = self
            .members
            .iter_mut()
            .filter_map(|(peer, member)| Some((*peer, member.wants.take()?)))
            .collect();
        for (peer, want) in wanting {
            match self.grant_want(peer, want) {
                Ok(()) => self.tell_snapshot(peer, out),
                Err(denial) => out.say(peer, &ServerMessage::Denied(denial)),
            }
        }
        let tick = self.scene.tick();
        for (peer, member) in &mut self.members {
            if let Some(through) = member.unanswered.take() {
                out.say(*peer, &ServerMessage::Applied { through, tick });
            }
        }
    }

    /// Steps if a step is due.
    pub(crate) fn handle_timeout(&mut self, now: Instant, clock: Stopwatch<'_>, out: &mut Outbox) {
        if self.next_step().is_none_or(|due| due > now) {
            return;
        }
        if let Some(due) = self.next_step {
            let step = self.step();
            let late_by = now.since(due).as_nanos();
            let kept = late_by <= step.as_nanos() * CATCH_UP_STEPS;
            self.next_step = Some(if kept { due + step } else { now + step });
        }
        self.last_step = now;
        self.tick(clock, out);
        if self.terms().pace == Pace::FreeRunning {
            let say = |peer, question| out.datagram(peer, question);
            self.drives.ask(now, self.scene.tick(), say);
        }
        self.grant_waiting(out);
    }

    /// Spoken ticks of silence within which a stream vouches: each tick where a member waits for it.
    fn vouch_within(&self) -> u32 {
        let rate = self.terms().integrator.rate;
        match self.terms().pace {
            Pace::Lockstep => 1,
            Pace::FreeRunning => {
                let ticks = rate.ticks() * SILENCE_MS_MAX / (1_000 * rate.seconds());
                (ticks / self.terms().cadence.every).max(1)
            }
        }
    }

    fn second(&self) -> Ticks {
        let rate = self.terms().integrator.rate;
        Ticks::new((rate.ticks() / rate.seconds()).max(1))
    }

    fn step(&self) -> Span {
        Span::from_nanos(self.terms().integrator.rate.step_ns())
    }

    /// One tick: truth, belief, words.
    fn tick(&mut self, clock: Stopwatch<'_>, out: &mut Outbox) {
        let begun = clock();
        self.drives.steer(&mut self.scene);
        let stepped = match self.scene.step() {
            Ok(stepped) => stepped,
            Err(_) => return self.fault(out),
        };
        let after_step = clock();
        for error in stepped.refused {
            tracing::warn!(%error, "the scene goes on without it");
        }
        for (id, cause) in stepped.removed {
            self.streams.remove(id);
            self.drives.remove(id);
            self.give(Notice::BodyRemoved { id, cause });
        }
        self.streams
            .observe(self.scene.tick(), self.scene.observations());
        let observed = clock();
        self.streams.publish(&Moment {
            notices: self.notices,
            vouch_within: self.vouch_within(),
            second: self.second(),
        });
        self.tell_notices(out);
        for (peer, member) in &self.members {
            for stream in member.streams() {
                for packet in self.streams.packets(stream, *peer) {
                    out.datagram(*peer, packet.clone());
                }
            }
        }
        self.times.add(Marks {
            begun,
            stepped: after_step,
            observed,
            published: clock(),
        });
    }

    /// The engine failed: everyone is told, and nothing moves any more.
    fn fault(&mut self, out: &mut Outbox) {
        self.faulted = true;
        self.next_step = None;
        let tick = self.scene.tick();
        tracing::error!(
            tick = tick.value(),
            "the engine failed; the scene stands still"
        );
        self.give(Notice::SceneFaulted { tick });
        self.tell_notices(out);
    }

    pub(crate) fn pong(&mut self, now: Instant, peer: Peer, sent: Instant, out: &mut Outbox) {
        self.note_word(peer);
        let pong = ServerMessage::Pong {
            sent,
            tick: self.scene.tick(),
            since_tick_ns: now.since(self.last_step).as_nanos(),
        };
        out.say(peer, &pong);
    }

    pub(crate) fn inspect(&self, peer: Peer, out: &mut Outbox) {
        let Some(stream) = self.stream_of(peer) else {
            return;
        };
        let said = stream.statistics();
        let inspection = Inspection {
            tick: self.scene.tick(),
            truth: self.scene.digest().value(),
            bodies: self.scene.body_count() as u32,
            awake: self.scene.awake_count() as u32,
            updates: said.updates,
            packets: said.packets,
            packet_bytes: said.bytes,
            amended: stream.amended,
            withheld: said.withheld,
            times: self.times.summary(),
        };
        out.say(peer, &ServerMessage::Inspection(inspection));
    }

    /// The scene is gone: members hear it.
    pub(crate) fn end(mut self, out: &mut Outbox) {
        for peer in self.members.keys() {
            self.drives.end(*peer);
            out.say(*peer, &ServerMessage::Deleted);
        }
    }
}
