//! What a client hears of its actors after a frame: states and contacts.
//!
//! The published plug-in's cost grows with the square of the states that it hears, what is lost last stays lost for ever,
//! and what comes on two transports has no order. So an actor is spoken of while it is elsewhere than was reported last; where
//! it has come to rest it is reported again on TCP, some frames later, when every datagram about it has been read or lost.
//!
//! A client that datagrams do not reach hears all on TCP, as far as there is capacity: who is left out has its turn before who
//! was output, and has it also when it lies still meanwhile, so that nothing that is true is left unsaid for good.

use std::collections::{BTreeMap, BTreeSet};

use glam::{Quat, Vec3};
use rhumb_app::{ActorsCollided, Id, Message, Motion};
use rhumb_protocol::scene::BodyKind;
use rhumb_protocol::stream::{Activity, Observation};

use super::actor::Actor;
use super::options::States;
use super::world_mirror::WorldMirror;
use crate::engine::Contact;
use crate::scene::Scene;

/// What was reported of a client's actors, and what is still to be.
#[derive(Debug, Default)]
pub(super) struct StateReporter {
    frame: u64,
    /// Where each was reported to be last.
    reported: BTreeMap<u32, ReportedPose>,
    /// Pairs that touched in the last frame.
    touching: BTreeSet<(u32, u32)>,
    /// Pairs that touched in this frame, where they did so deepest.
    touches: BTreeMap<(u32, u32), Contact>,
    /// Actors that were looked at in this frame.
    looked: BTreeSet<u32>,
    contacts: Vec<Contact>,
    /// Actors for whose states there was no capacity.
    left_out: BTreeSet<u32>,
    /// The actor from which on states were left out last.
    turn: u32,
}

#[derive(Clone, Copy, Debug)]
struct ReportedPose {
    position: Vec3,
    rotation: Quat,
    /// The frame in which it is reported on TCP, if it stays.
    settles: Option<u64>,
}

/// What is to be sent after a frame.
#[derive(Debug, Default)]
pub(super) struct FrameOutput {
    /// By datagram where those reach the client, in order.
    pub(super) passing: Vec<Message>,
    /// On TCP, in order.
    pub(super) lasting: Vec<Message>,
}

/// How a client is output.
#[derive(Clone, Copy, Debug)]
pub(super) struct ReportOptions {
    /// Of which actors.
    pub(super) states: States,
    /// How it is output what passes.
    pub(super) transport: Transport,
    /// How many more states TCP takes.
    pub(super) capacity: usize,
}

/// How a client is output what passes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Transport {
    /// By datagram.
    Datagrams,
    /// On TCP: nobody knows where its datagrams should go.
    Stream,
}

/// How far an actor may be from where it was reported to be without a word: metres, and half the sine of half the angle.
const STAYS_M: f32 = 1e-3;
const STAYS_TURN: f32 = 5e-4;
/// Frames after which what rests is reported again: datagrams of its last frame have been read or lost then.
const SETTLED_FRAMES: u64 = 3;

impl StateReporter {
    /// Looks who touches whom, after a step.
    pub(super) fn note_contacts(&mut self, mirror: &WorldMirror, scene: &Scene) {
        if !mirror.reports {
            return;
        }
        let mut contacts = std::mem::take(&mut self.contacts);
        for observation in scene.observations() {
            let Some((name, actor)) = mirror.actor_of(observation.id) else {
                continue;
            };
            self.looked.insert(name);
            scene.contacts(observation.id, &mut contacts);
            for contact in contacts.drain(..) {
                if let Some((other, others)) = mirror.actor_of(contact.with) {
                    self.note((name, actor), (other, others), contact);
                }
            }
        }
        self.contacts = contacts;
    }

    /// Two actors touch, as the first has it: output of that one which asks, of two of the one that walks.
    fn note(&mut self, first: (u32, &Actor), second: (u32, &Actor), contact: Contact) {
        let rank = |actor: &Actor| (actor.reports, actor.upright);
        if !first.1.reports && !second.1.reports {
            return;
        }
        let own = (rank(first.1), second.0) >= (rank(second.1), first.0);
        let (pair, contact) = if own {
            ((first.0, second.0), contact)
        } else {
            let normal = -contact.normal;
            ((second.0, first.0), Contact { normal, ..contact })
        };
        let known = self.touches.entry(pair).or_insert(contact);
        if contact.separation < known.separation {
            *known = contact;
        }
    }

    /// What a frame comes to.
    pub(super) fn report(
        &mut self,
        simulation: u32,
        options: &ReportOptions,
        mirror: &WorldMirror,
        scene: &Scene,
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
        // What begins to touch is reported once: it is not left out for what is reported again and again.
        let contacts = self.find_contacts(simulation, mirror);
        let capacity = match options.transport {
            Transport::Datagrams => usize::MAX,
            Transport::Stream => options.capacity.saturating_sub(contacts.len()),
        };
        self.recall(simulation, mirror, scene, &mut states);
        self.leave_out(&mut states, capacity);
        if options.states == States::Changed {
            self.note_said(&states);
            let capacity = match options.transport {
                Transport::Datagrams => options.capacity,
                Transport::Stream => capacity - states.len(),
            };
            self.answer_pending(simulation, capacity, mirror, scene, output);
        }
        let states = states.into_iter().map(Message::SetDynamicActor);
        output.passing.extend(states.chain(contacts));
    }

    /// States of actors that are elsewhere than was reported last.
    fn find_changed(
        &self,
        simulation: u32,
        mirror: &WorldMirror,
        scene: &Scene,
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

    /// Adds those who were left out and are not among the states: who lies still by now was not found.
    fn recall(
        &mut self,
        simulation: u32,
        mirror: &WorldMirror,
        scene: &Scene,
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

    /// Leaves as many states as there is capacity for: in turn, by the names of the actors.
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

    /// These are reported now.
    fn note_said(&mut self, states: &[Motion]) {
        let settles = Some(self.frame + SETTLED_FRAMES);
        for motion in states {
            let reported = ReportedPose {
                position: motion.position,
                rotation: motion.rotation,
                settles,
            };
            self.reported.insert(motion.actor.object, reported);
        }
    }

    /// Says again what has come to rest, as far as there is capacity: what waited longest first. Forgets who is gone.
    fn answer_pending(
        &mut self,
        simulation: u32,
        capacity: usize,
        mirror: &WorldMirror,
        scene: &Scene,
        output: &mut FrameOutput,
    ) {
        let frame = self.frame;
        let mut due: Vec<(u64, u32)> = Vec::new();
        self.reported.retain(|object, reported| {
            let settles = reported.settles.filter(|settles| *settles <= frame);
            due.extend(settles.map(|settles| (settles, *object)));
            mirror.actors.contains_key(object)
        });
        if due.len() > capacity {
            due.sort_unstable();
            due.truncate(capacity);
        }
        for (_, object) in due {
            if let Some(reported) = self.reported.get_mut(&object) {
                reported.settles = None;
            }
            if let Some(actor) = mirror.actors.get(&object) {
                let state = state(Id { simulation, object }, actor, scene);
                output.lasting.extend(state.map(Message::SetDynamicActor));
            }
        }
    }

    /// Pairs that began to touch, and each frame those of actors that cannot walk without it.
    fn find_contacts(&mut self, simulation: u32, mirror: &WorldMirror) -> Vec<Message> {
        let mut found = Vec::new();
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
                separation: contact.separation,
            }));
        }
        // What sleeps touches on: who wakes beside it has not begun to.
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

/// The state of an actor that moves; none of one that left the world.
fn state(id: Id, actor: &Actor, scene: &Scene) -> Option<Motion> {
    let body = actor.body?;
    let seen = scene.observation(body.id)?;
    state_of(id, actor, &seen)
}

/// The state of an actor that moves, by what was seen of its body.
fn state_of(id: Id, actor: &Actor, seen: &Observation) -> Option<Motion> {
    let body = actor.body.filter(|_| actor.kind == BodyKind::Dynamic)?;
    let [px, py, pz, x, y, z, w, vx, vy, vz, wx, wy, wz] = seen.motion.parts();
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
            // As bodies lie in a scene, and not as they are named.
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
