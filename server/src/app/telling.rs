//! What a client hears of its actors after a frame: states and contacts.
//!
//! The published plug-in's cost grows with the square of the states that it hears, what is lost last stays lost for ever,
//! and what comes on two transports has no order. So an actor is spoken of while it is elsewhere than was said last; where
//! it has come to rest it is said again on TCP, some frames later, when every datagram about it has been read or lost.

use std::collections::{BTreeMap, BTreeSet};

use glam::{Quat, Vec3};
use rhumb_app::{ActorsCollided, Id, Message, Motion};
use rhumb_protocol::scene::BodyKind;
use rhumb_protocol::stream::{Activity, Observation};

use super::actor::Actor;
use super::ledger::Ledger;
use super::options::States;
use crate::engine::Contact;
use crate::scene::Scene;

/// What was said of a client's actors, and what is still to be.
#[derive(Debug, Default)]
pub(super) struct Telling {
    frame: u64,
    /// Where each was said to be last.
    said: BTreeMap<u32, Said>,
    /// Pairs that touched in the last frame.
    touching: BTreeSet<(u32, u32)>,
    /// Pairs that touched in this frame, where they did so deepest.
    touches: BTreeMap<(u32, u32), Contact>,
    /// Actors that were looked at in this frame.
    looked: BTreeSet<u32>,
    contacts: Vec<Contact>,
}

#[derive(Clone, Copy, Debug)]
struct Said {
    position: Vec3,
    rotation: Quat,
    /// The frame in which it is said on TCP, if it stays.
    settles: Option<u64>,
}

/// What is to be sent after a frame.
#[derive(Debug, Default)]
pub(super) struct Told {
    /// On UDP, in order.
    pub(super) passing: Vec<Message>,
    /// On TCP, in order.
    pub(super) lasting: Vec<Message>,
}

/// How far an actor may be from where it was said to be without a word: metres, and half the sine of half the angle.
const STAYS_M: f32 = 1e-3;
const STAYS_TURN: f32 = 5e-4;
/// Frames after which what rests is said again: datagrams of its last frame have been read or lost then.
const SETTLED_FRAMES: u64 = 3;

impl Telling {
    /// Looks who touches whom, after a step.
    pub(super) fn note_contacts(&mut self, ledger: &Ledger, scene: &Scene) {
        if !ledger.reports {
            return;
        }
        let mut contacts = std::mem::take(&mut self.contacts);
        for observation in scene.observations() {
            let Some((name, actor)) = ledger.actor_of(observation.id) else {
                continue;
            };
            self.looked.insert(name);
            scene.contacts(observation.id, &mut contacts);
            for contact in contacts.drain(..) {
                if let Some((other, others)) = ledger.actor_of(contact.with) {
                    self.note((name, actor), (other, others), contact);
                }
            }
        }
        self.contacts = contacts;
    }

    /// Two actors touch, as the first has it: told of that one which asks, of two of the one that walks.
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
    pub(super) fn tell(
        &mut self,
        simulation: u32,
        states: States,
        ledger: &Ledger,
        scene: &Scene,
        told: &mut Told,
    ) {
        self.frame += 1;
        let id = |object| Id { simulation, object };
        match states {
            States::All => {
                for (name, actor) in &ledger.actors {
                    told.passing.extend(state(id(*name), actor, scene));
                }
            }
            States::Active => {
                for observation in scene.observations() {
                    let Some((name, actor)) = ledger.actor_of(observation.id) else {
                        continue;
                    };
                    let message = state_of(id(name), actor, observation);
                    if observation.activity == Activity::Asleep {
                        told.lasting.extend(message);
                    } else {
                        told.passing.extend(message);
                    }
                }
            }
            States::Changed => self.tell_changed(simulation, ledger, scene, told),
        }
        self.tell_contacts(simulation, ledger, told);
    }

    fn tell_changed(&mut self, simulation: u32, ledger: &Ledger, scene: &Scene, told: &mut Told) {
        let id = |object| Id { simulation, object };
        for observation in scene.observations() {
            let Some((name, actor)) = ledger.actor_of(observation.id) else {
                continue;
            };
            let state = state_of(id(name), actor, observation);
            let Some(Message::SetDynamicActor(motion)) = state else {
                continue;
            };
            if self
                .said
                .get(&name)
                .is_some_and(|said| said.still_holds(&motion))
            {
                continue;
            }
            let said = Said {
                position: motion.position,
                rotation: motion.rotation,
                settles: Some(self.frame + SETTLED_FRAMES),
            };
            self.said.insert(name, said);
            told.passing.push(Message::SetDynamicActor(motion));
        }
        let frame = self.frame;
        self.said.retain(|name, said| {
            let Some(actor) = ledger.actors.get(name) else {
                return false;
            };
            if said.settles.take_if(|due| *due <= frame).is_some() {
                told.lasting.extend(state(id(*name), actor, scene));
            }
            true
        });
    }

    /// Pairs that began to touch, and each frame those of actors that cannot walk without it.
    fn tell_contacts(&mut self, simulation: u32, ledger: &Ledger, told: &mut Told) {
        let id = |object| Id { simulation, object };
        let upright = |name: &u32| ledger.actors.get(name).is_some_and(|a| a.upright);
        let touches = std::mem::take(&mut self.touches);
        for (pair, contact) in &touches {
            if self.touching.contains(pair) && !upright(&pair.0) && !upright(&pair.1) {
                continue;
            }
            told.passing.push(Message::ActorsCollided(ActorsCollided {
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
    }
}

impl Said {
    fn still_holds(&self, now: &Motion) -> bool {
        let turned = (now.rotation.dot(self.rotation).abs() - 1.0).abs();
        now.position.distance(self.position) <= STAYS_M && turned <= STAYS_TURN * STAYS_TURN
    }
}

/// The state of an actor that moves; none of one that left the world.
fn state(id: Id, actor: &Actor, scene: &Scene) -> Option<Message> {
    let body = actor.body?;
    let seen = scene.observation(body.id)?;
    state_of(id, actor, &seen)
}

/// The state of an actor that moves, by what was seen of its body.
fn state_of(id: Id, actor: &Actor, seen: &Observation) -> Option<Message> {
    let body = actor.body.filter(|_| actor.kind == BodyKind::Dynamic)?;
    let [px, py, pz, x, y, z, w, vx, vy, vz, wx, wy, wz] = seen.motion.parts();
    let (position, rotation) = body
        .frame
        .actor_of(Vec3::new(px, py, pz), Quat::from_xyzw(x, y, z, w));
    Some(Message::SetDynamicActor(Motion {
        actor: id,
        position,
        rotation,
        gravity_modifier: body.gravity,
        linear: Vec3::new(vx, vy, vz),
        angular: Vec3::new(wx, wy, wz),
    }))
}
