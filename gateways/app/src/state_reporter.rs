//! Reports actor states and contacts to an APP client after a frame.
//!
//! The cost of the published plug-in grows with the square of the received states, a lost last state stays lost for
//! ever, and messages on two transports have no order. So an actor's state is sent while it differs from the last sent
//! one. Some frames after the actor has come to rest, its state is sent again on TCP, when every datagram about it has
//! been read or lost.
//!
//! A client that datagrams do not reach gets all states on TCP, as far as the capacity goes. An omitted actor gets its
//! turn before an actor that was sent, also when it rests meanwhile, so that every true state is sent in the end.

use std::collections::{BTreeMap, BTreeSet, VecDeque};

use glam::{Quat, Vec3};
use rhumb_protocol::limits::HITS_MAX;
use rhumb_protocol::scene::{BodyKind, Hit};
use rhumb_protocol::stream::{Activity, Observation};
use rhumb_reckoning::BodyId;

use crate::actor::Actor;
use crate::codec::Id;
use crate::gateway::States;
use crate::message::{ActorsCollided, Message, Motion};
use crate::scene::{FrameStep, OwnScene};
use crate::world_mirror::{ContactActor, WorldMirror};

/// Last sent states of a client's actors, and pending ones.
#[derive(Debug, Default)]
pub(super) struct StateReporter {
    frame: u64,
    /// Last sent pose of each actor.
    reported: BTreeMap<u32, ReportedPose>,
    /// Actors sent in each of the last frames, by the frame in which they are sent again if they rest.
    resends: VecDeque<(u64, Vec<u32>)>,
    /// Actors that should have been sent again before, but exceeded the capacity.
    overdue: Vec<(u64, u32)>,
    /// Pairs that touched in the last frame.
    touching: BTreeSet<(u32, u32)>,
    /// Pairs that touched in this frame, at their deepest contact.
    touches: BTreeMap<(u32, u32), Hit>,
    /// Actors whose contacts were read in this frame.
    looked: BTreeSet<u32>,
    /// Actors whose states exceeded the capacity.
    left_out: BTreeSet<u32>,
    /// The actor at which states were last cut off.
    turn: u32,
}

#[derive(Clone, Copy, Debug)]
struct ReportedPose {
    position: Vec3,
    rotation: Quat,
    /// The frame in which the state is sent on TCP, if it does not change.
    resend_at: Option<u64>,
}

/// Messages to send after a frame.
#[derive(Debug, Default)]
pub(super) struct FrameOutput {
    /// Messages by datagram, where datagrams reach the client, in order.
    pub(super) passing: Vec<Message>,
    /// Messages on TCP, in order.
    pub(super) lasting: Vec<Message>,
}

/// Options of one report.
#[derive(Clone, Copy, Debug)]
pub(super) struct ReportOptions {
    /// Actors whose states are sent.
    pub(super) states: States,
    /// Transport of supersedable messages.
    pub(super) transport: Transport,
    /// The number of states that TCP still takes.
    pub(super) capacity: usize,
}

/// Transport of supersedable messages.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Transport {
    /// Datagrams.
    Datagrams,
    /// TCP: the address for datagrams is unknown.
    Stream,
}

/// Greatest difference from the sent pose without a new state: metres, and sine of half the angle, halved.
const STAYS_M: f32 = 1e-3;
const STAYS_TURN: f32 = 5e-4;
/// Frames after which a resting state is sent again: datagrams of its last frame have been read or lost by then.
const RESEND_AFTER_FRAMES: u64 = 3;

impl StateReporter {
    /// Notes the contacts of a frame's steps.
    pub(super) fn note_contacts(&mut self, mirror: &WorldMirror, steps: &[FrameStep]) {
        if !mirror.reports || steps.iter().all(|step| step.observed.is_empty()) {
            return;
        }
        let mut actors = mirror.contact_actors();
        for (place, step) in steps.iter().enumerate() {
            for id in &step.observed {
                let Some(actor) = contact_actor(&mut actors, *id) else {
                    continue;
                };
                let hits = step.contacts(*id);
                if !std::mem::replace(&mut actor.looked, true) {
                    self.looked.insert(actor.name);
                }
                actor.noted = hits.map(|hits| (place, hits.len()));
                let actor = *actor;
                for contact in hits.unwrap_or_default() {
                    let Some(other) = contact_actor(&mut actors, contact.body) else {
                        continue;
                    };
                    // From both sides it is as deep; of a body with too many, some are missing.
                    let known = |(noted, count)| noted == place && count < usize::from(HITS_MAX);
                    if !other.noted.is_some_and(known) {
                        self.note(&actor, other, *contact);
                    }
                }
            }
        }
    }

    /// Notes a contact of two actors: it belongs to the actor that asks for reports, and of two such to the avatar.
    fn note(&mut self, first: &ContactActor, second: &ContactActor, contact: Hit) {
        let rank = |actor: &ContactActor| (actor.reports, actor.upright);
        if !first.reports && !second.reports {
            return;
        }
        let own = (rank(first), second.name) >= (rank(second), first.name);
        let (pair, contact) = if own {
            ((first.name, second.name), contact)
        } else {
            let normal = -contact.normal;
            ((second.name, first.name), Hit { normal, ..contact })
        };
        let known = self.touches.entry(pair).or_insert(contact);
        if contact.distance < known.distance {
            *known = contact;
        }
    }

    /// Messages of a frame.
    pub(super) fn report(
        &mut self,
        simulation: u32,
        options: &ReportOptions,
        mirror: &WorldMirror,
        scene: &OwnScene,
        output: &mut FrameOutput,
    ) {
        self.frame += 1;
        let id = |object| Id { simulation, object };
        let mut states: Vec<Motion> = Vec::new();
        match options.states {
            States::All => {
                let all = mirror.actors.iter();
                states.extend(all.filter_map(|(name, actor)| state(id(*name), actor, scene)));
            }
            States::Active => {
                for observation in scene.observations() {
                    let Some((name, actor)) = mirror.actor_of(observation.id) else {
                        continue;
                    };
                    let state = state_of(id(name), actor, observation);
                    if observation.activity == Activity::Asleep {
                        output.lasting.extend(state.map(Message::SetDynamicActor));
                    } else {
                        states.extend(state);
                    }
                }
            }
            States::Changed => self.find_changed(simulation, mirror, scene, &mut states),
        }
        // The start of a contact is reported once: it takes precedence over repeated states.
        let contacts = self.find_contacts(simulation, mirror);
        let capacity = match options.transport {
            Transport::Datagrams => usize::MAX,
            Transport::Stream => options.capacity.saturating_sub(contacts.len()),
        };
        self.recall(simulation, mirror, scene, &mut states);
        self.leave_out(&mut states, capacity);
        if options.states == States::Changed {
            self.note_sent(&states);
            let capacity = match options.transport {
                Transport::Datagrams => options.capacity,
                Transport::Stream => capacity - states.len(),
            };
            self.answer_pending(simulation, capacity, mirror, scene, output);
        }
        let states = states.into_iter().map(Message::SetDynamicActor);
        output.passing.extend(states.chain(contacts));
    }

    /// States of actors that differ from the last sent ones.
    fn find_changed(
        &self,
        simulation: u32,
        mirror: &WorldMirror,
        scene: &OwnScene,
        states: &mut Vec<Motion>,
    ) {
        for observation in scene.observations() {
            let Some((object, actor)) = mirror.actor_of(observation.id) else {
                continue;
            };
            let Some(motion) = state_of(Id { simulation, object }, actor, observation) else {
                continue;
            };
            let reported = self.reported.get(&object);
            if reported.is_none_or(|reported| !reported.still_holds(&motion)) {
                states.push(motion);
            }
        }
    }

    /// Adds the omitted actors that are not among the states: an actor at rest was not found.
    fn recall(
        &mut self,
        simulation: u32,
        mirror: &WorldMirror,
        scene: &OwnScene,
        states: &mut Vec<Motion>,
    ) {
        let mut left_out = std::mem::take(&mut self.left_out);
        if left_out.is_empty() {
            return;
        }
        for motion in states.iter() {
            left_out.remove(&motion.actor.object);
        }
        for object in left_out {
            if let Some(actor) = mirror.actors.get(&object) {
                states.extend(state(Id { simulation, object }, actor, scene));
            }
        }
    }

    /// Keeps as many states as the capacity allows, in turn by the names of the actors.
    fn leave_out(&mut self, states: &mut Vec<Motion>, capacity: usize) {
        if states.len() <= capacity {
            return;
        }
        let turn = self.turn;
        states.sort_unstable_by_key(|motion| motion.actor.object);
        let first = states.partition_point(|motion| motion.actor.object < turn);
        states.rotate_left(first);
        let left_out = states.split_off(capacity);
        self.turn = left_out.first().map_or(turn, |next| next.actor.object);
        let names = left_out.iter().map(|motion| motion.actor.object);
        self.left_out.extend(names);
    }

    /// Forgets the states of actors that are gone.
    pub(super) fn forget(&mut self, gone: &[u32]) {
        for name in gone {
            self.reported.remove(name);
        }
    }

    /// Notes that these states are sent now.
    fn note_sent(&mut self, states: &[Motion]) {
        if states.is_empty() {
            return;
        }
        let resend_at = self.frame + RESEND_AFTER_FRAMES;
        for motion in states {
            let reported = ReportedPose {
                position: motion.position,
                rotation: motion.rotation,
                resend_at: Some(resend_at),
            };
            self.reported.insert(motion.actor.object, reported);
        }
        let names = states.iter().map(|motion| motion.actor.object);
        self.resends.push_back((resend_at, names.collect()));
    }

    /// Sends again the states of resting actors, as far as the capacity goes: the oldest first.
    fn answer_pending(
        &mut self,
        simulation: u32,
        capacity: usize,
        mirror: &WorldMirror,
        scene: &OwnScene,
        output: &mut FrameOutput,
    ) {
        let mut due = std::mem::take(&mut self.overdue);
        while let Some((resend_at, names)) = self.resends.front()
            && *resend_at <= self.frame
        {
            due.extend(names.iter().map(|name| (*resend_at, *name)));
            self.resends.pop_front();
        }
        // One that was sent again since is due later.
        due.retain(|(resend_at, name)| {
            let reported = self.reported.get(name);
            reported.is_some_and(|reported| reported.resend_at == Some(*resend_at))
        });
        match due.len() > capacity {
            true => {
                due.sort_unstable();
                self.overdue = due.split_off(capacity);
            }
            false => due.sort_unstable_by_key(|(_, name)| *name),
        }
        for (_, object) in due {
            if let Some(reported) = self.reported.get_mut(&object) {
                reported.resend_at = None;
            }
            if let Some(actor) = mirror.actors.get(&object) {
                let state = state(Id { simulation, object }, actor, scene);
                output.lasting.extend(state.map(Message::SetDynamicActor));
            }
        }
    }

    /// Pairs that start to touch, and in each frame those of actors that cannot walk without contacts.
    fn find_contacts(&mut self, simulation: u32, mirror: &WorldMirror) -> Vec<Message> {
        let mut found = Vec::new();
        if self.looked.is_empty() {
            return found;
        }
        let id = |object| Id { simulation, object };
        let upright = |name: &u32| mirror.actors.get(name).is_some_and(|a| a.upright);
        let touches = std::mem::take(&mut self.touches);
        for (pair, contact) in &touches {
            if self.touching.contains(pair) && !upright(&pair.0) && !upright(&pair.1) {
                continue;
            }
            found.push(Message::ActorsCollided(ActorsCollided {
                colliding: id(pair.0),
                collided: id(pair.1),
                point: contact.point,
                normal: contact.normal,
                separation: contact.distance,
            }));
        }
        // A sleeping pair still touches: an actor that wakes beside it has not started to touch.
        let looked = std::mem::take(&mut self.looked);
        self.touching
            .retain(|(first, second)| !looked.contains(first) && !looked.contains(second));
        self.touching.extend(touches.keys().copied());
        found
    }
}

impl ReportedPose {
    fn still_holds(&self, now: &Motion) -> bool {
        let turned = (now.rotation.dot(self.rotation).abs() - 1.0).abs();
        now.position.distance(self.position) <= STAYS_M && turned <= STAYS_TURN * STAYS_TURN
    }
}

/// The actor of a body, in a table by body index.
fn contact_actor(actors: &mut [Option<ContactActor>], id: BodyId) -> Option<&mut ContactActor> {
    let actor = actors.get_mut(id.index() as usize)?.as_mut()?;
    (actor.body == id).then_some(actor)
}

/// The state of an actor that moves; `None` for one that left the world.
fn state(id: Id, actor: &Actor, scene: &OwnScene) -> Option<Motion> {
    let body = actor.body?;
    let observation = scene.observation(body.id)?;
    state_of(id, actor, &observation)
}

/// The state of an actor that moves, from the observation of its body.
fn state_of(id: Id, actor: &Actor, observation: &Observation) -> Option<Motion> {
    let body = actor.body.filter(|_| actor.kind == BodyKind::Dynamic)?;
    let [px, py, pz, x, y, z, w, vx, vy, vz, wx, wy, wz] = observation.motion.parts();
    let (position, rotation) = body
        .frame
        .actor_of(Vec3::new(px, py, pz), Quat::from_xyzw(x, y, z, w));
    Some(Motion {
        actor: id,
        position,
        rotation,
        gravity_modifier: body.gravity,
        linear: Vec3::new(vx, vy, vz),
        angular: Vec3::new(wx, wy, wz),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn motion(object: u32) -> Motion {
        Motion {
            actor: Id {
                simulation: 7,
                object,
            },
            position: Vec3::ZERO,
            rotation: Quat::IDENTITY,
            gravity_modifier: 1.0,
            linear: Vec3::ZERO,
            angular: Vec3::ZERO,
        }
    }

    #[test]
    fn actors_take_turns() {
        let mut reporter = StateReporter::default();
        let mut output = Vec::new();
        for _ in 0..5 {
            // In the order of the bodies in the scene, not of the names.
            let mut states: Vec<Motion> = (0..25).rev().map(|n| motion(n * 1_000)).collect();
            reporter.leave_out(&mut states, 10);
            assert_eq!((states.len(), reporter.left_out.len()), (10, 15));
            reporter.left_out.clear();
            output.extend(states.iter().map(|motion| motion.actor.object));
        }
        let (first, second) = output.split_at(25);
        let once: BTreeSet<_> = first.iter().collect();
        assert_eq!(once.len(), 25, "{first:?}");
        assert_eq!(first, second);
    }

    #[test]
    fn states_are_left_out_only_without_capacity() {
        let mut reporter = StateReporter::default();
        let mut states: Vec<Motion> = [3, 1, 2].map(motion).to_vec();
        reporter.leave_out(&mut states, 3);
        assert_eq!(states, [3, 1, 2].map(motion));
        assert!(reporter.left_out.is_empty());
        reporter.leave_out(&mut states, 0);
        assert!(states.is_empty());
        assert_eq!(reporter.left_out.len(), 3);
    }
}
