//! A stream's source over bodies that a script moves.
//!
//! No engine: bodies fall, are struck, fall asleep, are put elsewhere and ride on one another. Keeps where each was, so
//! that copies can be held against it.

use std::collections::BTreeMap;
use std::num::NonZeroU32;

use bytes::Bytes;
use glam::{DQuat, DVec3, Vec3};
use rhumb_protocol::packet::StreamId;
use rhumb_protocol::scene::Cadence;
use rhumb_protocol::stream::{
    Activity, Budget, Features, Manner, Observation, Publisher, StreamStart, StreamTerms,
    Subscriber, Witness,
};
use rhumb_reckoning::{
    Anchor, BodyId, Class, Damping, Inertia, Integrator, Metres, Predictor, Rate, Tick, Tolerance,
    Track, Verbatim,
};

use super::script::Script;

/// The stream's name.
pub(super) const STREAM: StreamId = StreamId(3);
/// Bodies have indices below it.
pub(super) const BODIES: usize = 8;
const RADIUS: Metres = Metres::new(0.5);

/// What all listeners hear of, in order.
#[derive(Clone, Copy, Debug)]
pub(super) enum News {
    Placed(BodyId, Track),
    Removed(BodyId),
    Gravity(Tick, Vec3),
}

impl News {
    pub(super) fn tell(self, subscriber: &mut Subscriber) {
        match self {
            Self::Placed(id, track) => assert!(subscriber.place(id, &manner(id), track)),
            Self::Removed(id) => assert!(subscriber.remove(id), "{id} was placed"),
            Self::Gravity(since, gravity) => subscriber.change_gravity(since, gravity),
        }
        subscriber.handle_notice();
    }
}

/// Of every body another than its neighbour's.
pub(super) fn manner(id: BodyId) -> Manner {
    let index = id.index();
    let inertia = Inertia::new([1.0, 2.0, 2.5], [0.0, 0.0, 0.0, 1.0]);
    Manner {
        radius: RADIUS,
        damping: Damping {
            linear: if index % 4 == 3 { 0.4 } else { 0.0 },
            angular: 0.0,
        },
        gravity_scale: [1.0, 0.0, 1.0, -0.5][index as usize % 4],
        inertia: inertia.ok().filter(|_| index % 3 == 2),
        class: Class::new((index % 7) as i8 - 3).expect("there are seven classes"),
    }
}

/// A body.
#[derive(Clone, Copy, Debug)]
struct Puppet {
    id: BodyId,
    position: DVec3,
    rotation: DQuat,
    linear: DVec3,
    angular: DVec3,
    asleep: bool,
    /// On whom it rides.
    mount: Option<usize>,
}

impl Puppet {
    fn verbatim(&self) -> Verbatim {
        Verbatim::new(
            self.position.as_vec3().to_array(),
            self.rotation.as_quat().to_array(),
            self.linear.as_vec3().to_array(),
            self.angular.as_vec3().to_array(),
        )
        .expect("a puppet's motion is finite")
    }

    fn step(&mut self, gravity: DVec3) {
        let (damping, scale) = (manner(self.id).damping, manner(self.id).gravity_scale);
        self.linear += gravity * f64::from(scale) / 60.0;
        self.linear *= 1.0 - f64::from(damping.linear) / 60.0;
        if self.position.y < 0.0 {
            self.linear.y = self.linear.y.abs();
        }
        self.position = (self.position + self.linear / 60.0).clamp(-FAR, FAR);
        let turn = DQuat::from_scaled_axis(self.angular / 60.0);
        self.rotation = (turn * self.rotation).normalize();
    }
}

/// Nobody goes farther.
const FAR: DVec3 = DVec3::splat(1e5);

/// The source.
pub(super) struct Source {
    pub(super) publisher: Publisher,
    witness: Witness,
    puppets: [Option<Puppet>; BODIES],
    generations: [u16; BODIES],
    /// What was told of who sleeps.
    told_asleep: [Option<(BodyId, Verbatim)>; BODIES],
    gravity: Vec3,
    pub(super) tick: Tick,
    /// How much news there was.
    pub(super) notices: u64,
    /// Where bodies were after each tick.
    past: Vec<BTreeMap<BodyId, Verbatim>>,
}

impl Source {
    /// Without bodies.
    pub(super) fn new(tolerance: Tolerance, budget: Option<Budget>) -> Self {
        let gravity = Vec3::new(0.0, -9.8, 0.0);
        let terms = StreamTerms {
            every: Cadence::EACH_TICK.every,
            tolerance,
            integrator: integrator(),
            gravity,
            features: Features::ALL,
        };
        let mut publisher = Publisher::new(STREAM, &terms, Tick::ZERO);
        if let Some(budget) = budget {
            publisher.limit(budget);
        }
        Self {
            publisher,
            witness: Witness::new(Cadence::EACH_TICK),
            puppets: [None; BODIES],
            generations: [0; BODIES],
            told_asleep: [None; BODIES],
            gravity,
            tick: Tick::ZERO,
            notices: 0,
            past: vec![BTreeMap::new()],
        }
    }

    /// What a listener begins with.
    pub(super) fn start(&self) -> StreamStart {
        StreamStart {
            stream: STREAM,
            tolerance: self.publisher.tolerance(),
            integrator: integrator(),
            every: Cadence::EACH_TICK.every,
            gravity: self.gravity,
            tick: self.tick,
            next: self.publisher.next_number(),
            notices: self.notices,
        }
    }

    /// Puts a body where there is none.
    pub(super) fn add(&mut self, index: usize, position: Vec3) -> Option<News> {
        if self.puppets[index].is_some() {
            return None;
        }
        let puppet = Puppet {
            id: BodyId::new(index as u32, self.generations[index]),
            position: position.as_dvec3().clamp(-FAR, FAR),
            rotation: DQuat::IDENTITY,
            linear: DVec3::ZERO,
            angular: DVec3::ZERO,
            asleep: false,
            mount: None,
        };
        self.puppets[index] = Some(puppet);
        let track = Track {
            origin: self.tick,
            predictor: Predictor::Ballistic,
            anchor: Anchor::Verbatim(puppet.verbatim()),
            carrier: None,
        };
        let placed = self.publisher.place(puppet.id, &manner(puppet.id), track);
        assert!(placed, "eight bodies are not too many");
        self.notices += 1;
        Some(News::Placed(puppet.id, track))
    }

    /// Takes a body out.
    pub(super) fn remove(&mut self, index: usize) -> Option<News> {
        let puppet = self.puppets[index].take()?;
        self.generations[index] = self.generations[index].wrapping_add(1);
        self.publisher.remove(puppet.id);
        self.notices += 1;
        Some(News::Removed(puppet.id))
    }

    /// Lets something else pull.
    pub(super) fn change_gravity(&mut self, gravity: Vec3) -> News {
        self.gravity = gravity;
        self.publisher.change_gravity(self.tick, gravity);
        self.notices += 1;
        News::Gravity(self.tick, gravity)
    }

    /// Something happens to a body.
    pub(super) fn strike(&mut self, script: &mut Script<'_>) {
        let (index, mount) = (script.below(BODIES), script.below(BODIES));
        let Some(puppet) = &mut self.puppets[index] else {
            return;
        };
        puppet.asleep = false;
        match script.below(5) {
            0 => puppet.linear += script.sane_vector(20.0).as_dvec3(),
            1 => puppet.angular += script.sane_vector(20.0).as_dvec3(),
            2 => puppet.position = script.sane_vector(1e5).as_dvec3(),
            3 => (puppet.linear, puppet.angular, puppet.asleep) = (DVec3::ZERO, DVec3::ZERO, true),
            _ => puppet.mount = (mount != index && puppet.mount.is_none()).then_some(mount),
        }
    }

    /// The next tick: what is said of it.
    pub(super) fn step(&mut self) -> Vec<Bytes> {
        self.tick = self.tick.next();
        let before = self.puppets;
        let mut observations = Vec::new();
        for (index, puppet) in self.puppets.iter_mut().enumerate() {
            let Some(puppet) = puppet else {
                continue;
            };
            if !puppet.asleep {
                puppet.step(self.gravity.as_dvec3());
            }
            if let Some(mount) = puppet.mount.and_then(|mount| before[mount])
                && !puppet.asleep
            {
                let offset = mount.rotation * DVec3::new(0.0, 1.0, 0.0);
                puppet.position = (mount.position + mount.linear / 60.0 + offset).clamp(-FAR, FAR);
                (puppet.linear, puppet.rotation) = (mount.linear, mount.rotation);
            }
            // An engine tells of a sleeper once.
            let sleeper = puppet.asleep.then(|| (puppet.id, puppet.verbatim()));
            if sleeper.is_none() || self.told_asleep[index] != sleeper {
                self.told_asleep[index] = sleeper;
                observations.push(Observation {
                    id: puppet.id,
                    motion: puppet.verbatim(),
                    activity: if puppet.asleep {
                        Activity::Asleep
                    } else {
                        Activity::Awake
                    },
                });
            }
        }
        let puppets = self.puppets.iter().flatten();
        self.past.push(
            puppets
                .map(|puppet| (puppet.id, puppet.verbatim()))
                .collect(),
        );
        self.witness.observe(self.tick, &observations);
        let mut said = Vec::new();
        self.publisher
            .publish(&self.witness, self.notices, &mut said);
        if said.is_empty() {
            said.push(self.publisher.vouch(self.notices));
        }
        said
    }

    /// Where a body was after a tick.
    pub(super) fn truth(&self, id: BodyId, tick: Tick) -> Option<&Verbatim> {
        self.past.get(tick.value() as usize)?.get(&id)
    }
}

fn integrator() -> Integrator {
    Integrator {
        rate: Rate::HZ_60,
        substeps: const { NonZeroU32::new(4).expect("four is not zero") },
    }
}
